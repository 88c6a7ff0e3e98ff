#include "effigy/body/fill_maps.h"

#include <gtest/gtest.h>

namespace effigy {
namespace {

// Every texel of a small atlas.
UvTexels full_atlas(int size) {
  UvTexels texels;
  texels.size = size;
  for (int i = 0; i < size * size; ++i) texels.texel.push_back(i);
  return texels;
}

TEST(FillMaps, HiddenTexelsGetANeighbour) {
  constexpr int kSize = 8;
  std::vector<float> presence;
  const auto shows = [](size_t i) { return (i % kSize + i / kSize) % 2 == 0; };
  // A chequerboard, as training leaves it.
  for (size_t i = 0; i < kSize * kSize; ++i) presence.push_back(shows(i) ? 0.9f : 0.01f);
  const std::vector<size_t> from = standing_in(full_atlas(kSize), presence);
  for (size_t i = 0; i < from.size(); ++i) {
    EXPECT_TRUE(shows(from[i]));
    if (shows(i)) {
      EXPECT_EQ(from[i], i);
    } else {
      const auto step = [](size_t a, size_t b) { return a > b ? a - b : b - a; };
      EXPECT_EQ(step(from[i] % kSize, i % kSize) + step(from[i] / kSize, i / kSize), 1u);
    }
  }
}

TEST(FillMaps, FarTexelsAreReachedAndEmptyMapsStay) {
  std::vector<float> presence(256, 0.0f);
  for (size_t i = 0; i < 32; ++i) presence[i] = 1.0f;  // two rows of sixteen
  for (const size_t from : standing_in(full_atlas(16), presence)) EXPECT_LT(from, 32u);

  const std::vector<float> none(256, 0.0f);
  const std::vector<size_t> same = standing_in(full_atlas(16), none);
  for (size_t i = 0; i < same.size(); ++i) EXPECT_EQ(same[i], i);
}

}  // namespace
}  // namespace effigy
