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

TEST(FillMaps, HiddenTexelsLookLikeTheirNeighbours) {
  constexpr int kSize = 8;
  const UvTexels texels = full_atlas(kSize);
  std::vector<float> presence, map;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const bool shows = (x + y) % 2 == 0;  // a chequerboard, as training leaves it
      presence.push_back(shows ? 0.9f : 0.01f);
      map.push_back(shows ? 0.1f * static_cast<float>(x) : 0.0f);
      map.push_back(shows ? 0.5f : 0.0f);
    }
  const std::vector<float> before = map;
  fill_hidden_texels(texels, presence, 2, map);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const auto i = static_cast<size_t>(y * kSize + x);
      EXPECT_FLOAT_EQ(map[2 * i + 1], 0.5f);
      if ((x + y) % 2 == 0) {
        EXPECT_EQ(map[2 * i], before[2 * i]);  // what shows stays
      } else if (x > 0 && x < kSize - 1) {
        EXPECT_NEAR(map[2 * i], 0.1f * static_cast<float>(x), 1e-6f);  // between left and right
      }
    }
}

TEST(FillMaps, FarTexelsAreReachedAndEmptyMapsStay) {
  const UvTexels texels = full_atlas(16);
  std::vector<float> presence(256, 0.0f), map(256, 0.0f);
  for (int i = 0; i < 32; ++i) presence[static_cast<size_t>(i)] = 1.0f;  // two rows of sixteen
  std::fill_n(map.begin(), 32, 0.7f);
  fill_hidden_texels(texels, presence, 1, map);
  for (const float value : map) EXPECT_FLOAT_EQ(value, 0.7f);

  // Nothing shows: nothing to fill from, nothing divided by.
  std::vector<float> dark(256, 0.25f);
  const std::vector<float> none(256, 0.0f);
  fill_hidden_texels(texels, none, 1, dark);
  for (const float value : dark) EXPECT_EQ(value, 0.25f);
}

}  // namespace
}  // namespace effigy
