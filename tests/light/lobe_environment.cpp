// Environments filtered by spherical Gaussians: constant light, one small lamp against the lobe
// itself, derivatives, and sums over an environment against its harmonics.
#include "effigy/light/lobe_environment.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/light/point_light.h"

namespace effigy {
namespace {

Vec3f random_direction(Random& random) {
  return Vec3f(static_cast<float>(random.normal()), static_cast<float>(random.normal()),
               static_cast<float>(random.normal()))
      .normalized();
}

Vec3f look_up(const LobeEnvironment& light, SgNorm norm, const Vec3f& q, float sigma) {
  Vec3f colour = Vec3f::Zero();
  light.add(norm, 1, q.data(), &sigma, 1, colour.data());
  return colour;
}

const LobeEnvironment& constant_light() {
  static const LobeEnvironment light = [] {
    Cubemap map(16);
    for (size_t i = 0; i < map.texels.size(); ++i) map.texels[i] = static_cast<float>(1 + i % 3);
    return LobeEnvironment(map);
  }();
  return light;
}

TEST(LobeEnvironment, ConstantLightGivesTheEnergyOfTheLobe) {
  const LobeEnvironment& light = constant_light();
  Random random(1);
  for (int k = 0; k < 40; ++k) {
    const auto sigma = static_cast<float>(std::exp(random.uniform(std::log(0.01), std::log(0.5))));
    const Vec3f q = random_direction(random);
    const Vec3f unit = look_up(light, SgNorm::kUnit, q, sigma);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(unit[c], 1.0f + static_cast<float>(c), 1e-4f);
    float constant, slope, integral;
    sg_constant(SgNorm::kCode, sigma, constant, slope);
    sg_integral(sigma, integral, slope);
    EXPECT_NEAR(look_up(light, SgNorm::kCode, q, sigma)[1],
                2.0f * constant * sigma * sigma * integral, 1e-4f);
  }
}

// One lit texel is a point of intensity radiance times solid angle.
TEST(LobeEnvironment, ASmallLampIsAPointLight) {
  constexpr int kSize = 64;
  Cubemap map(kSize);
  const int face = 2, x = 20, y = 37;
  const size_t texel = static_cast<size_t>((face * kSize + y) * kSize + x);
  map.texels[3 * texel] = 100.0f;
  const LobeEnvironment light(map);
  const Vec3f towards = cubemap_direction(face, x, y, kSize).normalized();
  const auto intensity = static_cast<float>(100.0 * cubemap_solid_angle(x, y, kSize));
  Random random(2);
  for (const float sigma : {0.1f, 0.15f, 0.3f, 0.5f}) {
    float constant, slope;
    sg_constant(SgNorm::kCode, sigma, constant, slope);
    const float peak = intensity * constant;
    for (int k = 0; k < 30; ++k) {
      const Vec3f q =
          (towards + 2.0f * sigma * static_cast<float>(random.uniform()) * random_direction(random))
              .normalized();
      float theta2, unused;
      sg_angle(0.25f * (q - towards).squaredNorm(), theta2, unused);
      const float expected = peak * std::exp(-0.5f * theta2 / (sigma * sigma));
      EXPECT_NEAR(look_up(light, SgNorm::kCode, q, sigma)[0], expected, 0.04f * peak) << sigma;
    }
  }
}

TEST(LobeEnvironment, DerivativesAgreeWithDifferences) {
  Random random(3);
  Cubemap map(16);
  for (float& x : map.texels) x = static_cast<float>(random.uniform(0, 2));
  const LobeEnvironment light(map);
  int checked = 0;
  for (int k = 0; k < 60; ++k) {
    const Vec3f q = random_direction(random);
    const auto sigma = static_cast<float>(random.uniform(0.05, 0.5));
    const Vec3f g = random_direction(random);
    float d_q[3] = {}, d_sigma = 0;
    light.add_backward(SgNorm::kCode, 1, q.data(), &sigma, 1, g.data(), d_q, &d_sigma);
    const auto value = [&](const Vec3f& at, float width) {
      return static_cast<double>(g.dot(look_up(light, SgNorm::kCode, at, width)));
    };
    const Vec3f t = q.cross(random_direction(random)).normalized();
    const float h = 2e-3f;
    const double forward = (value((q + h * t).normalized(), sigma) - value(q, sigma)) / h;
    const double backward = (value(q, sigma) - value((q - h * t).normalized(), sigma)) / h;
    if (std::abs(forward - backward) < 0.01) {  // else a texel's border lies between
      ++checked;
      EXPECT_NEAR(t.dot(Vec3f(d_q[0], d_q[1], d_q[2])), 0.5 * (forward + backward), 0.01);
    }
    const float s = 1e-3f;
    const double right = (value(q, sigma + s) - value(q, sigma)) / s;
    const double left = (value(q, sigma) - value(q, sigma - s)) / s;
    if (std::abs(right - left) < 0.03) {  // else a level lies between
      EXPECT_NEAR(d_sigma, 0.5 * (left + right), 0.02) << sigma;
    }
  }
  EXPECT_GT(checked, 20);
}

TEST(LobeEnvironment, SizesAreChecked) {
  EXPECT_THROW(LobeEnvironment(Cubemap(12)), Error);
  const float q[3] = {0, 0, 1}, sigma = -1.0f;
  float colour[3] = {};
  LobeEnvironment().add(SgNorm::kCode, 1, q, &sigma, 1, colour);
  EXPECT_EQ(colour[0], 0.0f);  // no light
  constant_light().add(SgNorm::kCode, 1, q, &sigma, 1, colour);
  EXPECT_EQ(colour[0], 0.0f);  // no width: dark
}

TEST(PointLights, AnEnvironmentOfTexelsIsASumOfPoints) {
  constexpr int kSize = 8;
  Random random(4);
  Cubemap map(kSize);
  PointLights points;
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x) {
        const auto texel = static_cast<size_t>((face * kSize + y) * kSize + x);
        PointLight light;
        light.directional = true;
        light.position = cubemap_direction(face, x, y, kSize).normalized();
        for (int c = 0; c < 3; ++c) {
          const float radiance = static_cast<float>(random.uniform());
          map.texels[3 * texel + static_cast<size_t>(c)] = radiance;
          light.intensity[c] = radiance * static_cast<float>(cubemap_solid_angle(x, y, kSize));
        }
        points.lights.push_back(light);
      }
  const std::vector<float> from_map = sh_of_cubemap(map);
  const std::vector<float> from_points = sh_of_points(points, Vec3f::Zero());
  for (size_t i = 0; i < from_map.size(); ++i) EXPECT_NEAR(from_map[i], from_points[i], 2e-6f);
  // Band 0 is the light of the whole sphere.
  double total = 0;
  for (const PointLight& light : points.lights) total += static_cast<double>(light.intensity.x());
  EXPECT_NEAR(from_map[0], total * 0.28209479, 1e-5);
}

TEST(PointLights, FalloffIsOneAtTheCentre) {
  PointLights points;
  points.falloff = true;
  points.center = Vec3f(0, 1, 0);
  points.lights.resize(1);
  points.lights[0].position = Vec3f(0, 1, 2);
  points.lights[0].intensity = Vec3f(3, 3, 3);
  const double y00 = 0.28209479;
  EXPECT_NEAR(sh_of_points(points, Vec3f(0, 1, 0))[0], 3 * y00, 1e-5);
  EXPECT_NEAR(sh_of_points(points, Vec3f(0, 1, 1))[0], 12 * y00, 1e-5);
}

}  // namespace
}  // namespace effigy
