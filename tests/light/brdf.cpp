// The BRDF table against brute-force integration, energy, derivatives.
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "effigy/light/brdf_table.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;

// The two integrals by their definition over half vectors on a warped grid, in double: D, V and F
// written out, nothing shared with the library.
struct Integrals {
  double scale, bias;
};
Integrals brute_force(double nv, double roughness, int steps = 700) {
  const double a = roughness * roughness, a2 = a * a, sine = std::sqrt(1 - nv * nv);
  Integrals sum{0, 0};
  for (int i = 0; i < steps; ++i) {
    // Half vectors: tan(theta) = a sqrt(u / (1 - u)), u in (0, 1) (u = w^2 (3 - 2w) crowds both
    // ends).
    const double w = (i + .5) / steps, u = w * w * (3 - 2 * w), du = 6 * w * (1 - w) / steps;
    const double cos2 = (1 - u) / (1 + (a2 - 1) * u), ct = std::sqrt(cos2);
    const double st = std::sqrt(1 - cos2);
    for (int j = 0; j < steps; ++j) {
      const double phi = kPi * (j + .5) / steps;
      const double vh = st * std::cos(phi) * sine + ct * nv;
      const double nl = 2 * vh * ct - nv;
      if (vh <= 0 || nl <= 0) continue;
      const double vis =
          0.5 / (nl * std::sqrt(nv * nv * (1 - a2) + a2) + nv * std::sqrt(nl * nl * (1 - a2) + a2));
      // D (n.h) dh = du dphi / 2pi; dl = 4 (v.h) dh.
      const double value = vis * nl * 4 * vh / ct * du / steps;
      const double f = std::pow(1 - vh, 5);
      sum.scale += value * (1 - f);
      sum.bias += value * f;
    }
  }
  return sum;
}

TEST(BrdfTable, MatchesBruteForceAtTexelCentres) {
  const BrdfTable& table = brdf_table();
  double largest = 0;
  for (const int row : {0, 1, 3, 8, 20, 40, 63})
    for (const int column : {0, 1, 2, 5, 12, 30, 63}) {
      const double nv = (column + .5) / table.size, r = (row + .5) / table.size;
      const Integrals expected = brute_force(nv, r);
      const float* value = &table.value[2 * (row * table.size + column)];
      const double error =
          std::max(std::abs(value[0] - expected.scale), std::abs(value[1] - expected.bias));
      largest = std::max(largest, error);
      EXPECT_LT(error, 1e-3) << "n.v " << nv << " r " << r << " " << value[0] << " vs "
                             << expected.scale << ", " << value[1] << " vs " << expected.bias;
    }
  std::printf("  largest error at texel centres %.5f\n", largest);
}

TEST(BrdfTable, InterpolationIsCloseBetweenTexels) {
  const BrdfTable& table = brdf_table();
  double largest = 0;
  for (const double r : {0.15, 0.3, 0.4, 0.55, 0.7, 0.9})
    for (const double nv : {0.06, 0.12, 0.3, 0.5, 0.77, 0.95}) {
      const Integrals expected = brute_force(nv, r, 300);
      const BrdfSample s = sample_brdf(table, static_cast<float>(nv), static_cast<float>(r));
      largest =
          std::max({largest, std::abs(s.scale - expected.scale), std::abs(s.bias - expected.bias)});
    }
  std::printf("  largest error between texels %.5f\n", largest);
  EXPECT_LT(largest, 1.5e-3);
}

TEST(BrdfTable, MirrorLimitIsSchlick) {
  const BrdfTable& table = brdf_table();
  for (int column = 2; column < table.size; ++column) {
    const double nv = (column + .5) / table.size, f = std::pow(1 - nv, 5);
    EXPECT_NEAR(table.value[2 * column], 1 - f, 2e-3);
    EXPECT_NEAR(table.value[2 * column + 1], f, 2e-3);
  }
}

TEST(BrdfTable, ConservesEnergy) {
  // White furnace: F0 = 1 reflects scale + bias of white light; never more than comes in, and
  // single-scattering GGX loses energy with roughness.
  const BrdfTable& table = brdf_table();
  for (size_t i = 0; i < table.value.size(); i += 2) {
    EXPECT_GE(table.value[i], 0.0f);
    EXPECT_GE(table.value[i + 1], 0.0f);
    EXPECT_LE(table.value[i] + table.value[i + 1], 1.0f + 1e-5f);
  }
  EXPECT_GT(sample_brdf(table, 0.8f, 0.1f).scale + sample_brdf(table, 0.8f, 0.1f).bias, 0.99f);
  EXPECT_LT(sample_brdf(table, 0.8f, 1.0f).scale + sample_brdf(table, 0.8f, 1.0f).bias, 0.8f);
}

TEST(BrdfTable, DerivativesMatchDifferences) {
  const BrdfTable& table = brdf_table();
  const float h = 1e-3f;
  for (const float nv : {0.105f, 0.4f, 0.87f})
    for (const float r : {0.105f, 0.505f, 0.91f}) {
      const BrdfSample s = sample_brdf(table, nv, r);
      const BrdfSample a = sample_brdf(table, nv + h, r), b = sample_brdf(table, nv - h, r);
      EXPECT_NEAR(s.d_scale_nv, (a.scale - b.scale) / (2 * h), 1e-3f);
      EXPECT_NEAR(s.d_bias_nv, (a.bias - b.bias) / (2 * h), 1e-3f);
      const BrdfSample c = sample_brdf(table, nv, r + h), d = sample_brdf(table, nv, r - h);
      EXPECT_NEAR(s.d_scale_roughness, (c.scale - d.scale) / (2 * h), 1e-3f);
      EXPECT_NEAR(s.d_bias_roughness, (c.bias - d.bias) / (2 * h), 1e-3f);
    }
}

TEST(BrdfTable, ClampsOutside) {
  const BrdfTable& table = brdf_table();
  for (const float bad : {-3.0f, -0.0f, 2.0f, std::numeric_limits<float>::quiet_NaN()}) {
    const BrdfSample s = sample_brdf(table, bad, bad);
    EXPECT_TRUE(std::isfinite(s.scale) && std::isfinite(s.bias));
    EXPECT_EQ(s.d_scale_nv, 0.0f);
    EXPECT_EQ(s.d_bias_roughness, 0.0f);
  }
  EXPECT_FLOAT_EQ(sample_brdf(table, 1.0f, 1.0f).scale, table.value[table.value.size() - 2]);
}

}  // namespace
}  // namespace effigy
