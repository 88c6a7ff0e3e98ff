// FLIP: A Difference Evaluator for Alternating Images, Andersson et al., HPG 2020 (LDR). Section
// numbers below are the paper's.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/image/colour.h"
#include "effigy/image/filter.h"
#include "effigy/image/metrics.h"

namespace effigy {
namespace {

// 0.7 m from a 0.7 m wide display of 3840 pixels: 67.02 pixels per degree.
constexpr double kPixelsPerDegree = 0.7 * (3840.0 / 0.7) * std::numbers::pi / 180.0;
constexpr float kColourPower = 0.7f;     // q_c
constexpr float kColourKnee = 0.4f;      // p_c
constexpr float kColourKneeOut = 0.95f;  // p_t
constexpr double kFeatureWidth = 0.082;  // w, degrees
constexpr float kFeaturePower = 0.5f;    // q_f

using Vec3 = std::array<float, 3>;

// Linear sRGB primaries and D65, IEC 61966-2-1.
constexpr std::array<double, 9> kXyzFromRgb = {
    10135552.0 / 24577794, 8788810.0 / 24577794, 4435075.0 / 24577794,
    2613072.0 / 12288897,  8788810.0 / 12288897, 887015.0 / 12288897,
    1425312.0 / 73733382,  8788810.0 / 73733382, 70074185.0 / 73733382};

// XYZ divided by the white point (RGB = 1, 1, 1), and its inverse.
struct ColourSpace {
  std::array<float, 9> white_from_rgb{}, rgb_from_white{};

  ColourSpace() {
    std::array<double, 9> m{};
    for (size_t i = 0; i < 3; ++i) {
      const double white = kXyzFromRgb[3 * i] + kXyzFromRgb[3 * i + 1] + kXyzFromRgb[3 * i + 2];
      for (size_t j = 0; j < 3; ++j) m[3 * i + j] = kXyzFromRgb[3 * i + j] / white;
    }
    const double determinant = m[0] * (m[4] * m[8] - m[5] * m[7]) -
                               m[1] * (m[3] * m[8] - m[5] * m[6]) +
                               m[2] * (m[3] * m[7] - m[4] * m[6]);
    for (size_t i = 0; i < 3; ++i)
      for (size_t j = 0; j < 3; ++j) {
        const size_t a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
        rgb_from_white[3 * i + j] = static_cast<float>(
            (m[3 * a + c] * m[3 * b + d] - m[3 * a + d] * m[3 * b + c]) / determinant);
        white_from_rgb[3 * i + j] = static_cast<float>(m[3 * i + j]);
      }
  }
};

const ColourSpace& colour_space() {
  static const ColourSpace space;
  return space;
}

Vec3 multiply(const std::array<float, 9>& m, const Vec3& v) {
  return {m[0] * v[0] + m[1] * v[1] + m[2] * v[2], m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
          m[6] * v[0] + m[7] * v[1] + m[8] * v[2]};
}

// YCxCz, the linearised CIELAB (Section 4.1.1).
Vec3 ycxcz_from_rgb(const Vec3& rgb) {
  const Vec3 xyz = multiply(colour_space().white_from_rgb, rgb);
  return {116.0f * xyz[1] - 16.0f, 500.0f * (xyz[0] - xyz[1]), 200.0f * (xyz[1] - xyz[2])};
}

Vec3 rgb_from_ycxcz(const Vec3& value) {
  const float y = (value[0] + 16.0f) / 116.0f;
  return multiply(colour_space().rgb_from_white, {y + value[1] / 500.0f, y, y - value[2] / 200.0f});
}

// CIELAB with Hunt's adjustment of the chroma (Section 4.1.2).
Vec3 hunt_lab_from_rgb(const Vec3& rgb) {
  Vec3 f = multiply(colour_space().white_from_rgb, rgb);
  constexpr float delta = 6.0f / 29.0f;
  for (float& value : f)
    value = value > delta * delta * delta ? std::cbrt(value)
                                          : value / (3.0f * delta * delta) + 4.0f / 29.0f;
  const float lightness = 116.0f * f[1] - 16.0f;
  return {lightness, 0.01f * lightness * 500.0f * (f[0] - f[1]),
          0.01f * lightness * 200.0f * (f[1] - f[2])};
}

float hyab(const Vec3& a, const Vec3& b) {
  return std::fabs(a[0] - b[0]) + std::hypot(a[1] - b[1], a[2] - b[2]);
}

// One Gaussian of a contrast sensitivity filter: its taps, and its share of the 2D kernel.
struct Lobe {
  std::vector<float> kernel;
  float share;
};

// Contrast sensitivity filter a1 sqrt(pi/b1) exp(-pi^2 d^2 / b1) + (a2, b2), d in degrees,
// normalised over the square of pixels within 3 sigma of the widest one (Section 4.1.1).
std::vector<Lobe> sensitivity_filter(std::initializer_list<std::array<double, 2>> terms) {
  constexpr double pi = std::numbers::pi;
  const int radius =
      static_cast<int>(std::ceil(3.0 * std::sqrt(0.04 / (2.0 * pi * pi)) * kPixelsPerDegree));
  std::vector<Lobe> lobes;
  double total = 0.0;
  std::vector<double> masses;
  for (const auto& [a, b] : terms) {
    std::vector<double> taps;
    double sum = 0.0;
    for (int i = -radius; i <= radius; ++i) {
      const double degrees = i / kPixelsPerDegree;
      taps.push_back(std::exp(-pi * pi * degrees * degrees / b));
      sum += taps.back();
    }
    masses.push_back(a * std::sqrt(pi / b) * sum * sum);
    total += masses.back();
    Lobe lobe{{}, 0.0f};
    for (double tap : taps) lobe.kernel.push_back(static_cast<float>(tap / sum));
    lobes.push_back(lobe);
  }
  for (size_t i = 0; i < lobes.size(); ++i) lobes[i].share = static_cast<float>(masses[i] / total);
  return lobes;
}

// sRGB picture -> planes of YCxCz.
Planes ycxcz_planes(const Image& image) {
  Planes planes(image.width, image.height, 3);
  parallel_for(static_cast<size_t>(image.height), 16, [&](size_t begin, size_t end, int) {
    const auto width = static_cast<size_t>(image.width);
    for (size_t i = begin * width; i < end * width; ++i) {
      const float* p = image.data.data() + 3 * i;
      const Vec3 value =
          ycxcz_from_rgb({linear_from_srgb(p[0]), linear_from_srgb(p[1]), linear_from_srgb(p[2])});
      for (int c = 0; c < 3; ++c) planes.plane(c)[i] = value[static_cast<size_t>(c)];
    }
  });
  return planes;
}

// What the eye resolves of a picture, as Hunt-adjusted CIELAB planes.
Planes perceived(const Planes& ycxcz) {
  const std::array<std::vector<Lobe>, 3> filters = {
      sensitivity_filter({{1.0, 0.0047}}), sensitivity_filter({{1.0, 0.0053}}),
      sensitivity_filter({{34.1, 0.04}, {13.5, 0.025}})};
  const int width = ycxcz.width, height = ycxcz.height;
  Planes result(width, height, 3);
  std::vector<float> lobe_plane(ycxcz.pixels());
  for (int c = 0; c < 3; ++c)
    for (const Lobe& lobe : filters[static_cast<size_t>(c)]) {
      filter_separable(ycxcz.plane(c), width, height, 1, lobe.kernel, lobe.kernel,
                       lobe_plane.data());
      float* out = result.plane(c);
      for (size_t i = 0; i < lobe_plane.size(); ++i) out[i] += lobe.share * lobe_plane[i];
    }
  parallel_for(static_cast<size_t>(height), 16, [&](size_t begin, size_t end, int) {
    const auto row = static_cast<size_t>(width);
    for (size_t i = begin * row; i < end * row; ++i) {
      Vec3 rgb = rgb_from_ycxcz({result.plane(0)[i], result.plane(1)[i], result.plane(2)[i]});
      for (float& value : rgb) value = std::clamp(value, 0.0f, 1.0f);
      const Vec3 lab = hunt_lab_from_rgb(rgb);
      for (int c = 0; c < 3; ++c) result.plane(c)[i] = lab[static_cast<size_t>(c)];
    }
  });
  return result;
}

// First and second derivative of a Gaussian, positive and negative taps each summing to one
// (Section 4.2).
struct FeatureKernels {
  std::vector<float> blur, edge, point;

  FeatureKernels() {
    const double sigma = 0.5 * kFeatureWidth * kPixelsPerDegree;
    const int radius = static_cast<int>(std::ceil(3.0 * sigma));
    blur = gaussian_kernel(sigma, radius);
    for (int x = -radius; x <= radius; ++x) {
      const double g = std::exp(-0.5 * x * x / (sigma * sigma));
      edge.push_back(static_cast<float>(-x * g));
      point.push_back(static_cast<float>((x * x / (sigma * sigma) - 1.0) * g));
    }
    normalise(edge);
    normalise(point);
  }

  static void normalise(std::vector<float>& kernel) {
    double positive = 0.0, negative = 0.0;
    for (float tap : kernel) (tap > 0.0f ? positive : negative) += static_cast<double>(tap);
    for (float& tap : kernel)
      tap = static_cast<float>(static_cast<double>(tap) / (tap > 0.0f ? positive : -negative));
  }
};

// Strength of the edges and of the points of an achromatic plane in [0, 1].
struct Features {
  std::vector<float> edges, points;
};

Features find_features(const Planes& ycxcz) {
  static const FeatureKernels kernels;
  const size_t pixels = ycxcz.pixels();
  std::vector<float> grey(pixels), along_x(pixels), along_y(pixels);
  for (size_t i = 0; i < pixels; ++i) grey[i] = (ycxcz.plane(0)[i] + 16.0f) / 116.0f;
  const auto strength = [&](const std::vector<float>& kernel) {
    filter_separable(grey.data(), ycxcz.width, ycxcz.height, 1, kernel, kernels.blur,
                     along_x.data());
    filter_separable(grey.data(), ycxcz.width, ycxcz.height, 1, kernels.blur, kernel,
                     along_y.data());
    std::vector<float> norm(pixels);
    for (size_t i = 0; i < pixels; ++i)
      norm[i] = std::sqrt(along_x[i] * along_x[i] + along_y[i] * along_y[i]);
    return norm;
  };
  return {strength(kernels.edge), strength(kernels.point)};
}

}  // namespace

double flip(const Image& reference, const Image& test) {
  EFFIGY_CHECK_EQ(reference.width, test.width);
  EFFIGY_CHECK_EQ(reference.height, test.height);
  EFFIGY_CHECK(reference.channels == 3 && test.channels == 3 && !reference.empty());
  const Planes a = ycxcz_planes(reference), b = ycxcz_planes(test);
  const Planes seen_a = perceived(a), seen_b = perceived(b);
  const Features features_a = find_features(a), features_b = find_features(b);
  const float largest =
      std::pow(hyab(hunt_lab_from_rgb({0, 1, 0}), hunt_lab_from_rgb({0, 0, 1})), kColourPower);
  const float knee = kColourKnee * largest;
  const auto width = static_cast<size_t>(reference.width);
  std::vector<double> rows(static_cast<size_t>(reference.height));
  parallel_for(rows.size(), 16, [&](size_t begin, size_t end, int) {
    for (size_t i = begin * width; i < end * width; ++i) {
      const float distance =
          std::pow(hyab({seen_a.plane(0)[i], seen_a.plane(1)[i], seen_a.plane(2)[i]},
                        {seen_b.plane(0)[i], seen_b.plane(1)[i], seen_b.plane(2)[i]}),
                   kColourPower);
      // Section 4.1.3: most of the range for small differences.
      const float colour = distance < knee ? kColourKneeOut / knee * distance
                                           : kColourKneeOut + (distance - knee) / (largest - knee) *
                                                                  (1.0f - kColourKneeOut);
      const float feature_distance =
          std::max(std::fabs(features_a.edges[i] - features_b.edges[i]),
                   std::fabs(features_a.points[i] - features_b.points[i]));
      const float feature = std::pow(
          std::clamp(feature_distance / std::numbers::sqrt2_v<float>, 0.0f, 1.0f), kFeaturePower);
      rows[i / width] += static_cast<double>(std::pow(colour, 1.0f - feature));
    }
  });
  double total = 0.0;
  for (double row : rows) total += row;
  return total / (static_cast<double>(width) * static_cast<double>(rows.size()));
}

}  // namespace effigy
