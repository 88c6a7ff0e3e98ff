#include "effigy/report/overlay.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "effigy/image/colour.h"

namespace effigy {
namespace {

// Coverage painted in white on black, in pixels.
double painted(const Image8& image) {
  double sum = 0.0;
  for (size_t i = 0; i < image.data.size(); i += static_cast<size_t>(image.channels))
    sum += image.data[i] / 255.0;
  return sum;
}

const Ink kWhite{{255, 255, 255}, 1.0f, 2.0f};

TEST(Lines, CoverTheirArea) {
  for (int k = 0; k < 24; ++k) {
    const double angle = k * std::numbers::pi / 12 + 0.03;
    Image8 image(200, 200, 3);
    draw_line(image, 100.3, 99.8, 100.3 + 70 * std::cos(angle), 99.8 + 70 * std::sin(angle),
              kWhite);
    // Length times width, and two round ends.
    EXPECT_NEAR(painted(image), 2.0 * 70 + std::numbers::pi, 4.0) << k;
    Image8 reversed(200, 200, 3);
    draw_line(reversed, 100.3 + 70 * std::cos(angle), 99.8 + 70 * std::sin(angle), 100.3, 99.8,
              kWhite);
    EXPECT_NEAR(painted(image), painted(reversed), 0.5) << k;
  }
}

TEST(Lines, EveryPixelIsPaintedOnce) {
  // With half opacity, pixels painted twice would exceed half of white.
  Ink half = kWhite;
  half.opacity = 0.5f;
  for (int k = 0; k < 16; ++k) {
    Image8 image(220, 220, 3);
    const double angle = 0.1 + k * 0.39;
    draw_line(image, 110, 110, 110 + 100 * std::cos(angle), 110 + 100 * std::sin(angle), half);
    for (uint8_t value : image.data) EXPECT_LE(value, 128);
  }
}

TEST(Lines, ClippedAndBadEnds) {
  const double nan = std::nan(""), infinity = std::numeric_limits<double>::infinity();
  Image8 image(50, 40, 3);
  draw_line(image, nan, 1, 2, 3, kWhite);
  draw_line(image, 1, 1, infinity, 3, kWhite);
  draw_line(image, -100, -100, -50, 300, kWhite);
  draw_point(image, nan, 3, 4, kWhite);
  draw_point(image, 1e12, 1e12, 4, kWhite);
  EXPECT_EQ(painted(image), 0.0);
  draw_line(image, -1e7, 20, 1e7, 20, kWhite);
  EXPECT_NEAR(painted(image), 2.0 * 50, 1.0);
  Image8 dot(20, 20, 3);
  draw_line(dot, 10, 10, 10, 10, kWhite);  // no length: a dot
  EXPECT_NEAR(painted(dot), std::numbers::pi, 0.5);
}

TEST(Points, DiscAndRing) {
  Image8 image(60, 60, 4);
  draw_point(image, 30.2, 29.7, 10, kWhite);
  EXPECT_NEAR(painted(image), std::numbers::pi * 100, 3.0);
  EXPECT_EQ(image.at(30, 30)[3], 255);
  EXPECT_EQ(image.at(2, 2)[3], 0);
  Image8 ring(60, 60, 3);
  draw_circle(ring, 30, 30, 20, kWhite);
  EXPECT_NEAR(painted(ring), 2 * std::numbers::pi * 20 * 2, 4.0);
  EXPECT_EQ(ring.at(30, 30)[0], 0);
}

TEST(Wireframe, EdgesOnceAndBackFacesLeftOut) {
  // A square of two triangles, counter-clockwise as seen (y down).
  const std::vector<float> corners = {20, 80, 80, 80, 80, 20, 20, 20};
  const std::vector<int32_t> front = {0, 1, 2, 0, 2, 3}, back = {0, 2, 1, 0, 3, 2};
  Ink half = kWhite;
  half.opacity = 0.5f;
  Image8 image(100, 100, 3);
  draw_triangle_wireframe(image, corners, front, half);
  const double expected = 2.0 * (4 * 60 + 60 * std::numbers::sqrt2) * 128 / 255;
  EXPECT_NEAR(painted(image), expected, 8.0);
  EXPECT_EQ(image.at(49, 50)[0], 128);  // the diagonal, shared, is drawn once
  Image8 none(100, 100, 3);
  draw_triangle_wireframe(none, corners, back, half);
  EXPECT_EQ(painted(none), 0.0);
  draw_triangle_wireframe(none, corners, back, half, false);
  EXPECT_NEAR(painted(none), expected, 8.0);
  std::vector<float> broken = corners;
  broken[6] = std::nanf("");
  Image8 one(100, 100, 3);
  draw_triangle_wireframe(one, broken, front, half);
  EXPECT_GT(painted(one), 0.0);
  EXPECT_EQ(one.at(20, 50)[0], 0);  // edge 3-0 belongs to the broken triangle
}

TEST(ColourMap, LightnessRisesEvenly) {
  double last = -1.0;
  for (int i = 0; i <= 255; ++i) {
    const Rgb8 c = map_colour(i / 255.0, ColourMap::kPerceptual);
    const float y = luminance(linear_from_srgb(c[0] / 255.0f), linear_from_srgb(c[1] / 255.0f),
                              linear_from_srgb(c[2] / 255.0f));
    const double lightness = 116.0 * std::cbrt(static_cast<double>(y)) - 16.0;
    if (i > 0) {
      EXPECT_GT(lightness, last - 0.5) << i;
      EXPECT_LT(lightness, last + 1.5) << i;
    }
    last = lightness;
  }
  EXPECT_GT(last, 85.0);
  EXPECT_EQ(map_colour(-3, ColourMap::kGrey), (Rgb8{0, 0, 0}));
  EXPECT_EQ(map_colour(3, ColourMap::kGrey), (Rgb8{255, 255, 255}));
  EXPECT_EQ(map_colour(std::nan(""), ColourMap::kGrey), (Rgb8{0, 0, 0}));
}

TEST(PlaneViews, NormalsRgbAndCoverage) {
  Planes planes(2, 1, 4);
  planes.plane(0)[0] = 1, planes.plane(1)[0] = 0, planes.plane(2)[0] = -1;
  planes.plane(0)[1] = std::nanf("");
  const std::vector<float> coverage = {1.0f, 0.5f};
  PlaneView view;
  view.coverage = coverage.data();
  view.background = {100, 100, 100};
  const Image8 normals = colour_normals(planes, 0, view);
  EXPECT_EQ(normals.at(0, 0)[0], 255);
  EXPECT_EQ(normals.at(0, 0)[1], 128);
  EXPECT_EQ(normals.at(0, 0)[2], 0);
  EXPECT_EQ(normals.at(1, 0)[0], 50);   // not a number is black, half covered
  EXPECT_EQ(normals.at(1, 0)[1], 114);  // (128 + 100) / 2
  EXPECT_EQ(colour_rgb(planes, 0).at(0, 0)[0], 255);
  EXPECT_EQ(colour_rgb(planes, 0).at(0, 0)[2], 0);
}

TEST(PlaneViews, ScalarsFindTheirRange) {
  Planes planes(100, 1, 1);
  std::vector<float> coverage(100, 1.0f);
  for (int i = 0; i < 100; ++i) planes.plane(0)[i] = static_cast<float>(i);
  planes.plane(0)[50] = std::numeric_limits<float>::infinity();
  planes.plane(0)[99] = 1e9f;
  coverage[99] = 0.0f;  // background
  PlaneView view;
  view.coverage = coverage.data();
  const Image8 grey = colour_scalar(planes, 0, ColourMap::kGrey, 0, 0, false, view);
  EXPECT_EQ(grey.at(0, 0)[0], 0);
  EXPECT_EQ(grey.at(98, 0)[0], 255);
  EXPECT_NEAR(grey.at(49, 0)[0], 127, 4);
  const Image8 reversed = colour_scalar(planes, 0, ColourMap::kGrey, 0, 0, true, view);
  EXPECT_EQ(reversed.at(0, 0)[0], 255);
  const Image8 fixed = colour_scalar(planes, 0, ColourMap::kGrey, 0, 255);
  EXPECT_EQ(fixed.at(77, 0)[0], 77);
  const Image8 flat = colour_scalar(Planes(4, 4, 1, 3.0f), 0, ColourMap::kGrey);
  EXPECT_EQ(flat.at(1, 1)[0], 0);
}

TEST(PlaneViews, UvAndDifference) {
  Planes planes(2, 1, 2);
  planes.plane(0)[0] = 0.25f, planes.plane(1)[0] = 0.75f;
  planes.plane(0)[1] = std::numeric_limits<float>::infinity();
  const Image8 uv = colour_uv(planes, 0);
  EXPECT_EQ(uv.at(0, 0)[0], 64);
  EXPECT_EQ(uv.at(0, 0)[1], 191);
  EXPECT_EQ(uv.at(1, 0)[0], 0);
  const Image8 a(3, 1, 3, 100);
  Image8 b = a;
  b.at(1, 0)[0] = 130;
  b.at(2, 0)[0] = b.at(2, 0)[1] = b.at(2, 0)[2] = 200;
  const Image8 difference = colour_difference(a, b, 0.2);
  const auto at = [&](int x) {
    return Rgb8{difference.at(x, 0)[0], difference.at(x, 0)[1], difference.at(x, 0)[2]};
  };
  EXPECT_EQ(at(0), map_colour(0.0, ColourMap::kPerceptual));
  EXPECT_EQ(at(1), map_colour(30.0 / 3 / 255 / 0.2, ColourMap::kPerceptual));
  EXPECT_EQ(at(2), map_colour(1.0, ColourMap::kPerceptual));
}

}  // namespace
}  // namespace effigy
