// Real spherical harmonics: orthonormal, with the sign and order that they say, derivatives, and
// the addition theorem.
#include "effigy/light/spherical_harmonics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "effigy/base/random.h"
#include "effigy/geometry/types.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr size_t kCount = sh_count(kMostShOrder);

Vec3d random_direction(Random& random) {
  return Vec3d(random.normal(), random.normal(), random.normal()).normalized();
}

// By the definition: associated Legendre functions with the Condon-Shortley sign of the standard
// library (which leaves the sign out) and angles.
double by_angles(int l, int m, const Vec3d& d) {
  const unsigned am = static_cast<unsigned>(std::abs(m)), ul = static_cast<unsigned>(l);
  const double phi = std::atan2(d.y(), d.x());
  double ratio = 1;
  for (unsigned k = ul - am + 1; k <= ul + am; ++k) ratio *= k;
  const double norm = std::sqrt((2 * l + 1) / (4 * kPi * ratio));
  const double p = (am % 2 ? -1.0 : 1.0) * std::assoc_legendre(ul, am, d.z());
  if (m == 0) return norm * p;
  return std::sqrt(2.0) * norm * p * (m > 0 ? std::cos(m * phi) : std::sin(-m * phi));
}

TEST(SphericalHarmonics, AgreeWithTheDefinition) {
  Random random(1);
  for (int k = 0; k < 50; ++k) {
    const Vec3d d = random_direction(random);
    double values[kCount];
    evaluate_sh(kMostShOrder, d.data(), values);
    for (int l = 0; l <= kMostShOrder; ++l)
      for (int m = -l; m <= l; ++m)
        EXPECT_NEAR(values[l * l + l + m], by_angles(l, m, d), 1e-12) << l << " " << m;
    const Vec3f f = d.cast<float>();
    float single[kCount];
    evaluate_sh(kMostShOrder, f.data(), single);
    for (size_t i = 0; i < kCount; ++i) EXPECT_NEAR(single[i], values[i], 3e-6);
  }
}

TEST(SphericalHarmonics, PolesAreNotSingular) {
  for (const double z : {1.0, -1.0}) {
    const Vec3d d(0, 0, z);
    for_each_sh(kMostShOrder, d.data(), [&](int l, int m, double value, const double* g) {
      EXPECT_TRUE(std::isfinite(g[0]) && std::isfinite(g[1]) && std::isfinite(g[2]));
      const double expected = m == 0 ? std::sqrt((2 * l + 1) / (4 * kPi)) * (l % 2 ? z : 1.0) : 0.0;
      EXPECT_NEAR(value, expected, 1e-13);
    });
  }
}

TEST(SphericalHarmonics, AreOrthonormal) {
  // Gauss-like product rule: exact enough with many rows.
  constexpr int kRows = 400, kColumns = 40;
  std::vector<double> gram(kCount * kCount, 0.0);
  for (int r = 0; r < kRows; ++r) {
    const double theta = kPi * (r + 0.5) / kRows;
    for (int c = 0; c < kColumns; ++c) {
      const double phi = 2 * kPi * (c + 0.5) / kColumns;
      const Vec3d d(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                    std::cos(theta));
      const double area =
          2 * kPi / kColumns * (std::cos(kPi * r / kRows) - std::cos(kPi * (r + 1) / kRows));
      double values[kCount];
      evaluate_sh(kMostShOrder, d.data(), values);
      for (size_t i = 0; i < kCount; ++i)
        for (size_t j = 0; j < kCount; ++j) gram[i * kCount + j] += area * values[i] * values[j];
    }
  }
  for (size_t i = 0; i < kCount; ++i)
    for (size_t j = 0; j < kCount; ++j)
      EXPECT_NEAR(gram[i * kCount + j], i == j ? 1.0 : 0.0, 1e-3) << i << " " << j;
}

TEST(SphericalHarmonics, DerivativesAlongTheSphere) {
  Random random(2);
  for (int k = 0; k < 20; ++k) {
    const Vec3d d = random_direction(random), t = d.cross(random_direction(random)).normalized();
    constexpr double kStep = 1e-6;
    const Vec3d a = (d + kStep * t).normalized(), b = (d - kStep * t).normalized();
    double above[kCount], below[kCount];
    evaluate_sh(kMostShOrder, a.data(), above);
    evaluate_sh(kMostShOrder, b.data(), below);
    for_each_sh(kMostShOrder, d.data(), [&](int l, int m, double, const double* g) {
      const auto i = static_cast<size_t>(l * l + l + m);
      EXPECT_NEAR(t.dot(Vec3d(g[0], g[1], g[2])), (above[i] - below[i]) / (2 * kStep), 1e-7);
    });
  }
}

TEST(SphericalHarmonics, AdditionTheorem) {
  Random random(3);
  for (int k = 0; k < 20; ++k) {
    const Vec3d a = random_direction(random), b = random_direction(random);
    double ya[kCount], yb[kCount];
    evaluate_sh(kMostShOrder, a.data(), ya);
    evaluate_sh(kMostShOrder, b.data(), yb);
    for (int l = 0; l <= kMostShOrder; ++l) {
      double sum = 0;
      for (int m = -l; m <= l; ++m) sum += ya[l * l + l + m] * yb[l * l + l + m];
      const double expected =
          (2 * l + 1) / (4 * kPi) * std::legendre(static_cast<unsigned>(l), a.dot(b));
      EXPECT_NEAR(sum, expected, 1e-13);
    }
  }
}

}  // namespace
}  // namespace effigy
