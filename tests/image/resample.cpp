#include "effigy/image/resample.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"
#include "image/pictures.h"

namespace effigy {
namespace {

using test::noise_picture;
using test::noise_picture8;

TEST(Image, PlanesAndBack) {
  const Image image = noise_picture(7, 5, 3, 1);
  const Planes planes = to_planes(image);
  EXPECT_EQ(planes.plane(2)[3 * 7 + 4], image.at(4, 3)[2]);
  EXPECT_EQ(to_image(planes).data, image.data);
}

TEST(Image, EightBits) {
  Image8 all(256, 1, 1);
  for (size_t i = 0; i < 256; ++i) all.data[i] = static_cast<uint8_t>(i);
  EXPECT_EQ(to_8bit(to_float(all)).data, all.data);
  Image odd(5, 1, 1);
  odd.data = {-1.0f, 2.0f, std::nanf(""), std::numeric_limits<float>::infinity(), 0.4999f / 255};
  EXPECT_EQ(to_8bit(odd).data, (std::vector<uint8_t>{0, 255, 0, 255, 0}));
}

TEST(Colour, SrgbCurve) {
  EXPECT_NEAR(srgb_from_linear(0.5f), 0.735357f, 1e-5f);
  EXPECT_NEAR(srgb_from_linear(0.001f), 0.01292f, 1e-7f);
  EXPECT_NEAR(srgb_from_linear(-0.5f), -0.735357f, 1e-5f);
  for (float x = -1.5f; x < 1.5f; x += 0.013f)
    EXPECT_NEAR(linear_from_srgb(srgb_from_linear(x)), x, 2e-6f);
  for (const auto transform : {DisplayTransform::kSrgb, DisplayTransform::kReinhardSrgb})
    EXPECT_EQ(display_transform_from_name(to_string(transform)), transform);
  EXPECT_THROW(display_transform_from_name("filmic"), Error);
}

TEST(Resize, KeepsTheMeanWhenShrinking) {
  const Image image = noise_picture(60, 36, 3, 2);
  double mean = 0.0;
  for (float v : image.data) mean += v;
  mean /= static_cast<double>(image.data.size());
  for (const auto& [w, h] : {std::pair{30, 18}, {17, 11}, {1, 1}, {59, 35}}) {
    const Image small = resize(image, w, h);
    double sum = 0.0;
    for (float v : small.data) sum += v;
    EXPECT_NEAR(sum / static_cast<double>(small.data.size()), mean, 1e-6) << w << " x " << h;
  }
}

TEST(Resize, HalfIsTheMeanOfFour) {
  const Image image = noise_picture(8, 6, 1, 3);
  const Image half = resize(image, 4, 3);
  const float mean =
      (image.at(4, 2)[0] + image.at(5, 2)[0] + image.at(4, 3)[0] + image.at(5, 3)[0]) / 4;
  EXPECT_NEAR(half.at(2, 1)[0], mean, 1e-6f);
}

TEST(Resize, GrowingIsBilinear) {
  Image ramp(4, 2, 1);
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 4; ++x)
      ramp.at(x, y)[0] = static_cast<float>(x) + 10.0f * static_cast<float>(y);
  const Image large = resize(ramp, 16, 8);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 16; ++x) {
      const double u = std::clamp((x + 0.5) / 4 - 0.5, 0.0, 3.0);
      const double v = std::clamp((y + 0.5) / 4 - 0.5, 0.0, 1.0);
      EXPECT_NEAR(large.at(x, y)[0], u + 10.0 * v, 1e-5);
      float sample = 0.0f;
      sample_bilinear(ramp, (x + 0.5) / 4, (y + 0.5) / 4, &sample);
      EXPECT_NEAR(sample, u + 10.0 * v, 1e-5);
    }
}

TEST(Crop, WholePixelsAreCopied) {
  const Image8 image = noise_picture8(9, 7, 3, 4);
  const Image8 crop = crop_resize(image, 2, 1, 5, 4, 5, 4);
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 5; ++x)
      for (int c = 0; c < 3; ++c) EXPECT_EQ(crop.at(x, y)[c], image.at(x + 2, y + 1)[c]);
}

TEST(Crop, OutsideIsFilled) {
  const Image8 image(4, 4, 3, 200);
  const Image8 crop = crop_resize(image, -2, -2, 8, 8, 8, 8, 10);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x)
      EXPECT_EQ(crop.at(x, y)[0], x >= 2 && x < 6 && y >= 2 && y < 6 ? 200 : 10);
  // Half of each border pixel covered: (200 + 10) / 2 along an edge.
  const Image8 half = crop_resize(image, -1, 0, 8, 4, 4, 2, 10);
  EXPECT_EQ(half.at(0, 0)[0], 105);
  EXPECT_EQ(half.at(1, 0)[0], 200);
  const Image8 nowhere = crop_resize(image, 1e12, -1e12, 8, 8, 3, 3, 7);
  for (uint8_t value : nowhere.data) EXPECT_EQ(value, 7);
  const Image8 tiny = crop_resize(image, 1e12, 1e12, 0.5, 0.5, 3, 3, 7);
  for (uint8_t value : tiny.data) EXPECT_EQ(value, 7);
}

TEST(Crop, ShrinkingIsTheAreaMean) {
  const Image8 image = noise_picture8(40, 40, 1, 8);
  const Image8 one = crop_resize(image, 3.5, 4.25, 20, 20, 1, 1);
  double sum = 0.0;
  for (int y = 0; y < 40; ++y)
    for (int x = 0; x < 40; ++x) {
      const double w = std::max(0.0, std::min(23.5, x + 1.0) - std::max(3.5, x + 0.0));
      const double h = std::max(0.0, std::min(24.25, y + 1.0) - std::max(4.25, y + 0.0));
      sum += w * h * image.at(x, y)[0];
    }
  EXPECT_NEAR(one.data[0], sum / 400.0, 0.51);
}

TEST(Blur, MatchesTheKernelAndKeepsConstants) {
  Image dot(41, 31, 2);
  dot.at(20, 15)[1] = 1.0f;
  const Image blurred = gaussian_blur(dot, 2.0);
  const double peak = blurred.at(20, 15)[1];
  EXPECT_NEAR(peak, 1.0 / (2.0 * 3.14159265 * 4.0), 1e-4);
  EXPECT_NEAR(blurred.at(23, 16)[1], peak * std::exp(-10.0 / 8.0), 1e-6);
  EXPECT_EQ(blurred.at(20, 15)[0], 0.0f);
  const Image flat = gaussian_blur(Image(5, 4, 3, 0.3f), 9.0);  // wider than the picture
  for (float value : flat.data) EXPECT_NEAR(value, 0.3f, 1e-6f);
  EXPECT_EQ(gaussian_blur(dot, 0.0).data, dot.data);
}

}  // namespace
}  // namespace effigy
