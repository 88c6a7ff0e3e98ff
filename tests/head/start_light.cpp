// The light that training starts from, told from brightness and normals.
#include "effigy/head/start_light.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/random.h"

namespace effigy {
namespace {

constexpr int kPatches = 400, kSize = 32;

// Bright from one side over a dim sky, some colour, mean radiance 1 in each channel.
Cubemap side_light() {
  Cubemap light(kSize);
  std::array<double, 3> mean{};
  double all = 0;
  const Vec3f key = Vec3f(0.7f, 0.5f, 0.5f).normalized();
  for (int face = 0, i = 0; face < 6; ++face)
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x, i += 3) {
        const float towards = std::max(0.0f, key.dot(cubemap_direction(face, x, y, kSize)));
        const double solid = cubemap_solid_angle(x, y, kSize);
        for (int c = 0; c < 3; ++c) {
          const float value =
              0.3f + (1.0f + 0.2f * static_cast<float>(c)) * std::pow(towards, 8.0f) * 6;
          light.texels[static_cast<size_t>(i + c)] = value;
          mean[c] += solid * value;
        }
        all += solid;
      }
  for (size_t i = 0; i < light.texels.size(); ++i)
    light.texels[i] = static_cast<float>(light.texels[i] * all / mean[i % 3]);
  return light;
}

// A ball of skin that turns a little from frame to frame, with dark hair on its upper fifth and
// freckles, seen from +z in `light`.
std::vector<SurfaceSample> ball(const Cubemap& light, bool hair) {
  const Cubemap response = diffuse_response(light);
  Random random(7);
  std::vector<Vec3f> normals;
  std::vector<std::array<float, 3>> albedo;
  for (int p = 0; p < kPatches; ++p) {
    const float z = 1 - 2 * (static_cast<float>(p) + 0.5f) / kPatches,
                a = 2.39996f * static_cast<float>(p);
    const float r = std::sqrt(1 - z * z);
    normals.emplace_back(r * std::cos(a), r * std::sin(a), z);
    const float tone = hair && normals.back().y() > 0.6f ? 0.1f : 1.0f;
    const float freckle = std::exp(0.08f * static_cast<float>(random.normal()));
    albedo.push_back({0.55f * tone * freckle, 0.38f * tone * freckle, 0.28f * tone * freckle});
  }
  std::vector<SurfaceSample> samples;
  for (int frame = 0; frame < 24; ++frame) {
    const float turn = 0.5f * std::sin(0.7f * static_cast<float>(frame));
    const Eigen::AngleAxisf rotation(turn, Vec3f::UnitY());
    for (int p = 0; p < kPatches; ++p) {
      const Vec3f normal = rotation * normals[static_cast<size_t>(p)];
      if (normal.z() < 0.2f) continue;
      const Vec3f shading = sample_cubemap(response, normal);
      SurfaceSample sample{normal, {}, p};
      for (size_t c = 0; c < 3; ++c)
        sample.radiance[c] =
            0.4f * albedo[static_cast<size_t>(p)][c] * shading[static_cast<int>(c)];
      samples.push_back(sample);
    }
  }
  return samples;
}

// Largest relative difference between the responses of two lights over the normals of `samples`,
// after the scale of each channel that albedo leaves free.
double response_error(const Cubemap& a, const Cubemap& b,
                      const std::vector<SurfaceSample>& samples) {
  const Cubemap ra = diffuse_response(a), rb = diffuse_response(b);
  double worst = 0;
  for (int c = 0; c < 3; ++c) {
    double mean = 0;
    for (const SurfaceSample& s : samples)
      mean += std::log(sample_cubemap(ra, s.normal)[c] / sample_cubemap(rb, s.normal)[c]) /
              static_cast<double>(samples.size());
    for (const SurfaceSample& s : samples)
      worst = std::max(worst, std::abs(std::log(sample_cubemap(ra, s.normal)[c] /
                                                sample_cubemap(rb, s.normal)[c]) -
                                       mean));
  }
  return worst;
}

TEST(StartLight, FindsALightFromTheSide) {
  const Cubemap truth = side_light();
  const std::vector<SurfaceSample> samples = ball(truth, false);
  const Cubemap found = start_light(samples, kPatches, kSize);
  EXPECT_GT(response_error(Cubemap(kSize, 1.0f), truth, samples), 0.5);  // an even light is far off
  EXPECT_LT(response_error(found, truth, samples), 0.12);
}

TEST(StartLight, TakesDarkHairForHair) {
  const Cubemap truth = side_light();
  const std::vector<SurfaceSample> samples = ball(truth, true);
  EXPECT_LT(response_error(start_light(samples, kPatches, kSize), truth, samples), 0.27);
}

TEST(StartLight, AnEvenLightStaysEvenAndWhite) {
  const std::vector<SurfaceSample> samples = ball(Cubemap(kSize, 1.0f), false);
  const Cubemap found = start_light(samples, kPatches, kSize);
  EXPECT_LT(response_error(found, Cubemap(kSize, 1.0f), samples), 0.05);
  double mean[3] = {};
  for (int face = 0, i = 0; face < 6; ++face)
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x)
        for (double& m : mean)
          m += cubemap_solid_angle(x, y, kSize) * found.texels[static_cast<size_t>(i++)] /
               (4 * std::acos(-1.0));
  for (const double m : mean) EXPECT_NEAR(m, 1, 0.01);
}

TEST(StartLight, NothingToSeeIsAnEvenLight) {
  for (const float x : start_light({}, 1, 4).texels) EXPECT_EQ(x, 1.0f);
  const SurfaceSample black{Vec3f(0, 0, 1), {0, 0, 0}, 0};
  for (const float x : start_light({black, black}, 1, 4).texels) EXPECT_EQ(x, 1.0f);
  const float nan = std::nanf("");
  const SurfaceSample broken{Vec3f(0, 0, 1), {nan, nan, nan}, 0};
  for (const float x : start_light({broken}, 1, 4).texels) EXPECT_EQ(x, 1.0f);
}

}  // namespace
}  // namespace effigy
