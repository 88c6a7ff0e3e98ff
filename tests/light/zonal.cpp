// Zonal harmonics and spherical Gaussians against brute force: rotation, the addition theorem, the
// Lambertian lobe, integrals, angles at the centre of a lobe.
#include "effigy/light/zonal.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "effigy/base/random.h"
#include "effigy/geometry/types.h"
#include "effigy/light/spherical_gaussian.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr size_t kCount = sh_count(kZonalOrder);

Vec3d random_direction(Random& random) {
  return Vec3d(random.normal(), random.normal(), random.normal()).normalized();
}

// Nodes and weights of Gauss-Legendre quadrature on [-1, 1] (Newton on the Legendre polynomial).
void gauss_legendre(int n, std::vector<double>& nodes, std::vector<double>& weights) {
  for (int k = 0; k < n; ++k) {
    double x = std::cos(kPi * (k + 0.75) / (n + 0.5)), slope = 0;
    for (int step = 0; step < 60; ++step) {
      const double p = std::legendre(static_cast<unsigned>(n), x);
      const double before = std::legendre(static_cast<unsigned>(n - 1), x);
      slope = n * (x * p - before) / (x * x - 1);
      x -= p / slope;
    }
    nodes.push_back(x);
    weights.push_back(2 / ((1 - x * x) * slope * slope));
  }
}

// The harmonics of a function on the sphere, by quadrature that is exact up to degree 2 * 8.
template <class F>
std::vector<double> project(const F& f) {
  std::vector<double> nodes, weights, sh(kCount, 0.0);
  gauss_legendre(12, nodes, weights);
  constexpr int kColumns = 24;
  for (size_t r = 0; r < nodes.size(); ++r)
    for (int c = 0; c < kColumns; ++c) {
      const double phi = 2 * kPi * c / kColumns, s = std::sqrt(1 - nodes[r] * nodes[r]);
      const Vec3d d(s * std::cos(phi), s * std::sin(phi), nodes[r]);
      double basis[kCount];
      evaluate_sh(kZonalOrder, d.data(), basis);
      const double value = f(d) * weights[r] * 2 * kPi / kColumns;
      for (size_t i = 0; i < kCount; ++i) sh[i] += value * basis[i];
    }
  return sh;
}

TEST(Zonal, RotationAgreesWithBruteForce) {
  Random random(1);
  for (int k = 0; k < 20; ++k) {
    const Vec3d axis = random_direction(random);
    double z[kZonalBands];
    for (double& x : z) x = random.normal();
    // The lobe itself, from the standard library's Legendre polynomials.
    const std::vector<double> expected = project([&](const Vec3d& d) {
      double sum = 0;
      for (unsigned l = 0; l < kZonalBands; ++l)
        sum += z[l] * (2 * l + 1) / (4 * kPi) * std::legendre(l, axis.dot(d));
      return sum;
    });
    double sh[kCount], largest = 0;
    zonal_to_sh(z, axis.data(), sh);
    for (size_t i = 0; i < kCount; ++i) {
      EXPECT_NEAR(sh[i], expected[i], 1e-12);
      largest = std::max(largest, std::abs(expected[i]));
    }
    float zf[kZonalBands], shf[kCount];
    for (size_t l = 0; l < kZonalBands; ++l) zf[l] = static_cast<float>(z[l]);
    const Vec3f axis_f = axis.cast<float>().normalized();
    zonal_to_sh(zf, axis_f.data(), shf);
    double error = 0, size = 0;
    for (size_t i = 0; i < kCount; ++i) {
      error += std::pow(static_cast<double>(shf[i]) - expected[i], 2);
      size += expected[i] * expected[i];
    }
    EXPECT_LT(std::sqrt(error / size), 1e-6);
  }
}

TEST(Zonal, AdditionTheorem) {
  Random random(2);
  for (int k = 0; k < 50; ++k) {
    const Vec3d axis = random_direction(random), d = random_direction(random);
    double z[kZonalBands], sh[kCount], basis[kCount], sum = 0;
    for (double& x : z) x = random.normal();
    zonal_to_sh(z, axis.data(), sh);
    evaluate_sh(kZonalOrder, d.data(), basis);
    for (size_t i = 0; i < kCount; ++i) sum += sh[i] * basis[i];
    EXPECT_NEAR(zonal_value(z, axis.dot(d)), sum, 1e-12);
  }
}

TEST(Zonal, LegendreDerivativesAtTheEndsToo) {
  for (const double x : {-1.0, -0.7, 0.0, 0.3, 0.999, 1.0}) {
    double p[kZonalBands], dp[kZonalBands];
    legendre(x, p, dp);
    for (unsigned l = 0; l < kZonalBands; ++l) {
      EXPECT_NEAR(p[l], std::legendre(l, x), 1e-14);
      if (std::abs(x) == 1.0) {
        EXPECT_NEAR(dp[l], std::pow(x, l + 1) * l * (l + 1) / 2.0, 1e-12);
      } else {
        const double h = 1e-6;
        EXPECT_NEAR(dp[l], (std::legendre(l, x + h) - std::legendre(l, x - h)) / (2 * h), 1e-7);
      }
    }
  }
}

TEST(Zonal, LambertIsACosineLobe) {
  double worst = 0;
  for (int k = 0; k <= 2000; ++k) {
    const double x = -1.0 + k / 1000.0;
    worst =
        std::max(worst, std::abs(kPi * zonal_value(lambert_zonal().data(), x) - std::max(0.0, x)));
  }
  EXPECT_LT(worst, 0.034);
  EXPECT_GT(worst, 0.02);  // order 8 does no better
  // By its definition: integral of max(0, cosine) / pi times P_l.
  for (unsigned l = 0; l < kZonalBands; ++l) {
    double sum = 0;
    for (int k = 0; k < 20000; ++k) {
      const double x = (k + 0.5) / 20000;
      sum += 2 * kPi * x / kPi * std::legendre(l, x) / 20000;
    }
    EXPECT_NEAR(lambert_zonal()[l], sum, 1e-8);
  }
  EXPECT_NEAR(zonal_from_sloan(0), 3.5449, 1e-4);
  EXPECT_NEAR(zonal_from_sloan(8), 0.8598, 1e-4);
}

double sg_quadrature(double sigma) {
  constexpr int kSteps = 200000;
  double sum = 0;
  for (int k = 0; k < kSteps; ++k) {
    const double theta = kPi * (k + 0.5) / kSteps;
    sum += std::exp(-0.5 * theta * theta / (sigma * sigma)) * std::sin(theta);
  }
  return 2 * kPi * kPi / kSteps * sum;
}

TEST(SphericalGaussian, IntegralsAreThoseOfTheTable) {
  struct Row {
    double sigma, code, pi32, peak_code, peak_unit;
  };
  for (const Row& row :
       {Row{0.01, 0.0207, 0.0080, 33.0, 1592}, Row{0.02, 0.0414, 0.0160, 16.5, 398},
        Row{0.05, 0.1035, 0.0399, 6.6, 63.7}, Row{0.10, 0.2064, 0.0795, 3.3, 16.0},
        Row{0.25, 0.5072, 0.1954, 1.32, 2.60}, Row{0.40, 0.7857, 0.3027, 0.82, 1.05}}) {
    const double integral = sg_quadrature(row.sigma);
    double value, slope, constant, unused;
    sg_integral(row.sigma, value, slope);
    EXPECT_NEAR(row.sigma * row.sigma * value, integral, 1e-6 * integral);
    sg_constant(SgNorm::kCode, row.sigma, constant, unused);
    EXPECT_NEAR(constant * integral, row.code, 6e-5);
    EXPECT_NEAR(constant, row.peak_code, 6e-3 * row.peak_code);
    sg_constant(SgNorm::kPi32, row.sigma, constant, unused);
    EXPECT_NEAR(constant * integral, row.pi32, 6e-5);
    sg_constant(SgNorm::kUnit, row.sigma, constant, unused);
    EXPECT_NEAR(constant * integral, 1.0, 1e-6);
    EXPECT_NEAR(constant, row.peak_unit, 5e-3 * row.peak_unit);
  }
  double constant, unused;
  sg_constant(SgNorm::kCode, 1.0, constant, unused);
  EXPECT_NEAR(1.0 / constant, 3.03352966508, 1e-10);
  EXPECT_EQ(sg_norm_named("pi32"), SgNorm::kPi32);
  EXPECT_THROW(sg_norm_named("pi"), Error);
}

TEST(SphericalGaussian, DerivativesBySigma) {
  for (const SgNorm norm : {SgNorm::kCode, SgNorm::kPi32, SgNorm::kUnit})
    for (const double sigma : {0.01, 0.1, 0.4}) {
      const double h = 1e-6 * sigma;
      double up, down, value, slope, unused;
      sg_constant(norm, sigma + h, up, unused);
      sg_constant(norm, sigma - h, down, unused);
      sg_constant(norm, sigma, value, slope);
      EXPECT_NEAR(slope, (up - down) / (2 * h), 1e-6 * std::abs(slope));
      sg_integral(sigma + h, up, unused);
      sg_integral(sigma - h, down, unused);
      sg_integral(sigma, value, slope);
      EXPECT_NEAR(slope, (up - down) / (2 * h), 1e-6 * std::abs(slope) + 1e-7);
    }
}

TEST(SphericalGaussian, AnglesAreExactAtTheCentreToo) {
  for (const double theta : {1e-7, 1e-4, 0.01, 0.3, 1.2, kPi / 2, 2.0, 3.0, 3.14}) {
    const double h = std::pow(std::sin(theta / 2), 2);
    double theta2, over_sine;
    sg_angle(h, theta2, over_sine);
    EXPECT_NEAR(theta2, theta * theta, 1e-7 * theta * theta);
    EXPECT_NEAR(over_sine, theta / std::sin(theta), 1e-6 * over_sine);
    float single2, single_over;
    sg_angle(static_cast<float>(h), single2, single_over);
    if (theta < 3.1) {
      EXPECT_NEAR(single2, theta * theta, 2e-6 * theta * theta);
      EXPECT_NEAR(single_over, theta / std::sin(theta), 1e-5 * over_sine);
    }
  }
  double theta2, over_sine;
  sg_angle(0.0, theta2, over_sine);
  EXPECT_EQ(theta2, 0.0);
  EXPECT_NEAR(over_sine, 1.0, 1e-8);
  sg_angle(1.0, theta2, over_sine);  // opposite: held, finite
  EXPECT_TRUE(std::isfinite(over_sine));
  EXPECT_NEAR(theta2, kPi * kPi, 0.01);
}

}  // namespace
}  // namespace effigy
