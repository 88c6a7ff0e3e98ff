#include "effigy/learn/pyramid_loss.h"

#include <cmath>

#include "effigy/base/random.h"
#include "support.h"

namespace effigy {
namespace {

Planes random_planes(int width, int height, uint64_t stream) {
  Planes planes(width, height, 3);
  Random random(3, stream);
  for (float& value : planes.data) value = static_cast<float>(random.uniform());
  return planes;
}

TEST(PyramidLoss, OfEqualAndOfConstantlyDifferentImages) {
  const Planes image = random_planes(33, 20, 1);
  EXPECT_EQ(pyramid_loss(image, image, 3, 4, 1, nullptr), 0.0);
  Planes brighter = image;
  for (float& value : brighter.data) value += 0.25f;
  // A constant is in the low-pass rest alone: one of the levels (33x20, 17x10, 9x5, 5x3).
  EXPECT_NEAR(pyramid_loss(brighter, image, 3, 4, 1, nullptr), 0.25 / 4, 1e-6);
}

// A checker is in the finest band, a broad blob in the coarse ones.
TEST(PyramidLoss, BandsTellSizesApart) {
  const Planes black(64, 64, 3);
  Planes checker = black;
  for (int c = 0; c < 3; ++c)
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) checker.plane(c)[y * 64 + x] = (x + y) % 2 ? 0.5f : -0.5f;
  EXPECT_NEAR(pyramid_loss(checker, black, 3, 4, 1, nullptr), 0.5 / 4, 0.01);
}

TEST(PyramidLoss, GradientAgainstDifferences) {
  const Planes target = random_planes(21, 14, 2);
  Planes colour = random_planes(21, 14, 3), d(21, 14, 3);
  pyramid_loss(colour, target, 3, 3, 2.0f, &d);
  for (size_t i = 5; i < colour.data.size(); i += 61) {
    constexpr float kStep = 1e-3f;
    Planes moved = colour;
    moved.data[i] += kStep;
    const double up = 2 * pyramid_loss(moved, target, 3, 3, 1, nullptr);
    moved.data[i] -= 2 * kStep;
    const double down = 2 * pyramid_loss(moved, target, 3, 3, 1, nullptr);
    EXPECT_NEAR((up - down) / (2 * static_cast<double>(kStep)), static_cast<double>(d.data[i]),
                2e-4)
        << i;
  }
}

}  // namespace
}  // namespace effigy
