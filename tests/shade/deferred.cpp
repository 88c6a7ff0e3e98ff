// Deferred shading against the double-precision oracle, finite differences, and what physics asks.
#include "effigy/shade/deferred.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_raster.h"
#include "hwy/targets.h"
#include "shade/oracle.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr std::array<int, 9> kPlanes = {kAlpha,        kAlbedo,           kAlbedo + 1,
                                        kAlbedo + 2,   kRoughness,        kSpecular,
                                        kMappedNormal, kMappedNormal + 1, kMappedNormal + 2};

Cubemap random_cubemap(int n, Random& random, double high) {
  Cubemap cubemap(n);
  for (float& value : cubemap.texels) value = static_cast<float>(random.uniform(0.02, high));
  return cubemap;
}

PrefilteredEnvironment random_light(uint64_t seed, double high = 1.2) {
  Random random(seed);
  PrefilteredEnvironment light;
  light.diffuse = random_cubemap(3, random, high);
  for (const int n : {5, 4, 2, 1}) light.specular.push_back(random_cubemap(n, random, high));
  light.roughness = {0.0f, 0.25f, 0.6f, 1.0f};
  return light;
}

Camera test_camera(int width, int height) {
  Camera camera = look_at({0.4, 0.3, 1.1}, {0.05, 0.02, 0.0}, 0.7, width, height);
  camera.cx += 1.3;  // principal point off the centre, pixels not square
  camera.fy *= 1.07;
  return camera;
}

// Premultiplied random G-buffer: covered, partly covered, uncovered and nearly uncovered pixels;
// normals mostly towards the camera.
Planes random_gbuffer(const Camera& camera, uint64_t seed) {
  Random random(seed);
  Planes g(camera.width, camera.height, kGBufferPlanes);
  for (float& value : g.data) value = static_cast<float>(random.uniform(-1, 1));
  for (size_t i = 0; i < g.pixels(); ++i) {
    const double choice = random.uniform();
    double alpha = choice < .2 ? 0 : choice < .25 ? 5e-5 : choice < .5 ? 1 : random.uniform(.01, 1);
    g.plane(kAlpha)[i] = static_cast<float>(alpha);
    for (int c = 0; c < 3; ++c)
      g.plane(kAlbedo + c)[i] = static_cast<float>(alpha * random.uniform(0, 1));
    const double roughness = random.uniform(-0.05, 1.05);
    g.plane(kRoughness)[i] = static_cast<float>(alpha * roughness);
    g.plane(kSpecular)[i] = static_cast<float>(alpha * random.uniform(0, 0.9));
    Vec3d n;
    do {
      n = {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    } while (n.norm() > 1 || n.norm() < .1 || (n.z() < 0.1 * n.norm() && random.uniform() < .9));
    n *= std::max(alpha, 1e-3);
    for (int c = 0; c < 3; ++c) {
      g.plane(kMappedNormal + c)[i] = static_cast<float>(n[c]);
      g.plane(kNormal + c)[i] = static_cast<float>(-n[(c + 1) % 3]);
    }
  }
  return g;
}

oracle::Pixel pixel_of(const Planes& g, size_t i, const std::array<int, 9>& planes = kPlanes) {
  oracle::Pixel p;
  for (size_t k = 0; k < 9; ++k) p[k] = g.plane(planes[k])[i];
  return p;
}

std::vector<ShadeOptions> all_options() {
  std::vector<ShadeOptions> all(4);
  all[0].background = {0.2f, 0.5f, 0.9f};
  all[1].display = DisplayTransform::kReinhardSrgb;
  all[2].divide_by_alpha = false;
  all[3].mapped_normal = false;
  all[3].display = DisplayTransform::kReinhardSrgb;
  return all;
}

class EveryTarget : public ::testing::Test {
 protected:
  static void for_targets(const std::function<void()>& body) {
    for (const int64_t target : hwy::SupportedAndGeneratedTargets()) {
      SCOPED_TRACE(hwy::TargetName(target));
      hwy::SetSupportedTargetsForTest(target);
      body();
    }
    hwy::SetSupportedTargetsForTest(0);
  }
};

using Deferred = EveryTarget;

TEST_F(Deferred, MatchesTheOracle) {
  const Camera camera = test_camera(45, 33);
  const Planes g = random_gbuffer(camera, 1);
  const PrefilteredEnvironment light = random_light(2, 1.5);
  const oracle::Light exact(light);
  for_targets([&] {
    for (const ShadeOptions& options : all_options()) {
      Planes colour, radiance;
      shade_deferred(g, camera, light, options, colour, &radiance);
      ASSERT_EQ(colour.count, 3);
      auto planes = kPlanes;
      for (size_t c = 0; c < 3; ++c)
        if (!options.mapped_normal) planes[6 + c] = kNormal + static_cast<int>(c);
      double worst = 0, worst_radiance = 0;
      for (size_t i = 0; i < g.pixels(); ++i) {
        const oracle::Pixel p = pixel_of(g, i, planes);
        const double x = static_cast<double>(i % 45), y = static_cast<double>(i / 45);
        const Vec3d expected = oracle::colour(p, x, y, camera, exact, options);
        for (int c = 0; c < 3; ++c)
          worst = std::max(worst, std::abs(colour.plane(c)[i] - expected[c]));
        if (p[0] <= 0) {
          EXPECT_EQ(radiance.plane(1)[i], 0.0f);
          continue;
        }
        const Vec3d linear = oracle::radiance(p, x, y, camera, exact, options);
        for (int c = 0; c < 3; ++c)
          worst_radiance = std::max(worst_radiance, std::abs(radiance.plane(c)[i] - linear[c]));
      }
      EXPECT_LT(worst, 2e-5);
      EXPECT_LT(worst_radiance, 2e-5);
    }
  });
}

TEST_F(Deferred, GradientsOfTheGBufferMatchDifferences) {
  const Camera camera = test_camera(37, 21);
  const Planes g = random_gbuffer(camera, 3);
  const PrefilteredEnvironment light = random_light(4);
  const oracle::Light exact(light);
  Random random(5);
  Planes weight(37, 21, 3);
  for (float& value : weight.data) value = static_cast<float>(random.uniform(-1, 1));
  for_targets([&] {
    for (const ShadeOptions& options : all_options()) {
      Planes d(37, 21, kGBufferPlanes, 0.5f);  // backward adds
      shade_deferred_backward(g, camera, light, options, weight, d, nullptr);
      auto planes = kPlanes;
      for (size_t c = 0; c < 3; ++c)
        if (!options.mapped_normal) planes[6 + c] = kNormal + static_cast<int>(c);
      int checked = 0, off = 0;
      for (size_t i = 0; i < g.pixels(); ++i) {
        const oracle::Pixel p = pixel_of(g, i, planes);
        const double x = static_cast<double>(i % 37), y = static_cast<double>(i / 37);
        const auto loss = [&](const oracle::Pixel& q) {
          const Vec3d value = oracle::colour(q, x, y, camera, exact, options);
          double sum = 0;
          for (int c = 0; c < 3; ++c) sum += weight.plane(c)[i] * value[c];
          return sum;
        };
        // Scale of a pixel's gradients, for the absolute part of the tolerance.
        const double scale = options.divide_by_alpha ? 1.0 : 1.0 / std::max(p[0], 1e-3);
        for (size_t k = 0; k < 9; ++k) {
          const double found = d.plane(planes[k])[i] - 0.5;
          if (p[0] <= 0) {
            EXPECT_EQ(found, 0.0);
            continue;
          }
          const double h = 1e-6 * std::max(std::abs(p[0]), 1e-4);
          oracle::Pixel a = p, b = p;
          a[k] += h;
          b[k] -= h;
          const double expected = (loss(a) - loss(b)) / (2 * h);
          ++checked;
          const double tolerance = 2e-3 * std::abs(expected) + 2e-4 * scale;
          // A difference across a texel border (a kink) is not a derivative: allow very few.
          if (!(std::abs(found - expected) < tolerance)) {
            ++off;
            if (off > 6)
              ADD_FAILURE() << "input " << k << " pixel " << i << " alpha " << p[0] << ": " << found
                            << " vs " << expected;
          }
        }
      }
      EXPECT_GT(checked, 4000);
      EXPECT_LE(off, 6);
      // Planes that shading does not read keep what they held.
      for (const int plane : {int{kDepth}, int{kUv}, int{kUvDistortion},
                              options.mapped_normal ? int{kNormal} : int{kMappedNormal}})
        for (size_t i = 0; i < g.pixels(); ++i) ASSERT_EQ(d.plane(plane)[i], 0.5f);
    }
  });
}

TEST_F(Deferred, GradientsOfTheLightMatchDifferences) {
  const Camera camera = test_camera(13, 9);
  const Planes g = random_gbuffer(camera, 6);
  PrefilteredEnvironment light = random_light(7);
  Random random(8);
  Planes weight(13, 9, 3);
  for (float& value : weight.data) value = static_cast<float>(random.uniform(-1, 1));
  for_targets([&] {
    for (const ShadeOptions& options : all_options()) {
      Planes d(13, 9, kGBufferPlanes);
      PrefilteredEnvironment d_light = light;
      const auto zero = [](Cubemap& map) {
        std::fill(map.texels.begin(), map.texels.end(), 0.25f);
      };
      zero(d_light.diffuse);
      for (Cubemap& level : d_light.specular) zero(level);
      shade_deferred_backward(g, camera, light, options, weight, d, &d_light);
      auto planes = kPlanes;
      for (size_t c = 0; c < 3; ++c)
        if (!options.mapped_normal) planes[6 + c] = kNormal + static_cast<int>(c);
      oracle::Light exact(light);
      const auto loss = [&] {
        double sum = 0;
        for (size_t i = 0; i < g.pixels(); ++i) {
          const Vec3d value = oracle::colour(pixel_of(g, i, planes), static_cast<double>(i % 13),
                                             static_cast<double>(i / 13), camera, exact, options);
          for (int c = 0; c < 3; ++c) sum += weight.plane(c)[i] * value[c];
        }
        return sum;
      };
      const auto check = [&](oracle::Map& map, const Cubemap& gradient) {
        for (size_t i = 0; i < map.texel.size(); i += 1 + i % 3) {
          const int c = static_cast<int>(i % 3);
          const double keep = map.texel[i][c], h = 1e-5;
          map.texel[i][c] = keep + h;
          const double up = loss();
          map.texel[i][c] = keep - h;
          const double down = loss();
          map.texel[i][c] = keep;
          const double expected = (up - down) / (2 * h);
          EXPECT_NEAR(gradient.texels[3 * i + static_cast<size_t>(c)] - 0.25, expected,
                      2e-4 + 1e-3 * std::abs(expected));
        }
      };
      check(exact.diffuse, d_light.diffuse);
      for (size_t k = 0; k < exact.specular.size(); ++k)
        check(exact.specular[k], d_light.specular[k]);
    }
  });
}

TEST_F(Deferred, DegenerateInputsStayFinite) {
  const Camera camera = test_camera(16, 4);
  Planes g(16, 4, kGBufferPlanes);
  const float inf = std::numeric_limits<float>::infinity();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (size_t i = 0; i < g.pixels(); ++i) {
    g.plane(kAlpha)[i] = i % 2 ? 1.0f : 1e-12f;
    g.plane(kAlbedo)[i] = i % 3 ? 0.5f : 1e6f;
    g.plane(kRoughness)[i] = i % 5 ? 0.3f : -7.0f;
    g.plane(kSpecular)[i] = i % 7 ? 0.04f : 0.0f;
  }
  // Normals: zero, tiny, huge, along the axes and the cube's edges and corners, not finite.
  const float normals[][3] = {{0, 0, 0},  {1e-9f, 0, 0}, {1e20f, 1e20f, 0}, {1, 0, 0},
                              {0, -1, 0}, {1, 1, 0},     {1, 1, 1},         {-1, 1, -1},
                              {0, 0, -1}, {nan, 0, 1},   {inf, 0, 1}};
  for (size_t i = 0; i < g.pixels(); ++i)
    for (int c = 0; c < 3; ++c) g.plane(kMappedNormal + c)[i] = normals[i % 11][c];
  PrefilteredEnvironment light = random_light(9, 1000.0), d_light = light;
  for_targets([&] {
    for (const ShadeOptions& options : all_options()) {
      Planes colour, d(16, 4, kGBufferPlanes), weight(16, 4, 3, 1.0f);
      shade_deferred(g, camera, light, options, colour);
      for (const float value : colour.data) ASSERT_TRUE(std::isfinite(value));
      shade_deferred_backward(g, camera, light, options, weight, d, &d_light);
      for (const float value : d.data) ASSERT_TRUE(std::isfinite(value));
      for (const float value : d_light.diffuse.texels) ASSERT_TRUE(std::isfinite(value));
    }
  });
}

TEST_F(Deferred, ClippedHighlightsHaveNoGradient) {
  const Camera camera = test_camera(8, 8);
  Planes g(8, 8, kGBufferPlanes, 0.0f);
  for (size_t i = 0; i < 64; ++i) {
    for (int k : {int{kAlpha}, kAlbedo + 0, kAlbedo + 1, kAlbedo + 2, kMappedNormal + 2})
      g.plane(k)[i] = 1.0f;
    g.plane(kRoughness)[i] = 0.5f;
  }
  const PrefilteredEnvironment light = Prefilter(4).forward(Cubemap(4, 3.0f));
  Planes colour, d(8, 8, kGBufferPlanes), weight(8, 8, 3, 1.0f);
  PrefilteredEnvironment d_light = Prefilter(4).zero_like();
  shade_deferred(g, camera, light, {}, colour);
  shade_deferred_backward(g, camera, light, {}, weight, d, &d_light);
  for (const float value : colour.data) EXPECT_NEAR(value, 1.0f, 1e-6f);
  for (size_t i = 0; i < 64; ++i) {
    EXPECT_EQ(d.plane(kAlbedo)[i], 0.0f);
    EXPECT_EQ(d.plane(kMappedNormal)[i], 0.0f);
    EXPECT_NEAR(d.plane(kAlpha)[i], 3.0f, 1e-5f);  // only compositing: 1 - background
  }
  for (const float value : d_light.diffuse.texels) EXPECT_EQ(value, 0.0f);
}

TEST_F(Deferred, WhiteFurnace) {
  // Under constant light a white mirror-coloured lobe reflects scale + bias, never more than 1, and
  // a white diffuse lobe exactly 1.
  const Camera camera = test_camera(32, 32);
  const PrefilteredEnvironment light = Prefilter(8).forward(Cubemap(8, 1.0f));
  Planes g = random_gbuffer(camera, 10), radiance, colour;
  for (size_t i = 0; i < g.pixels(); ++i) {
    g.plane(kAlpha)[i] = 1.0f;
    for (int c = 0; c < 3; ++c) g.plane(kAlbedo + c)[i] = 0.0f;
    g.plane(kSpecular)[i] = 1.0f;
  }
  shade_deferred(g, camera, light, {}, colour, &radiance);
  for (const float value : radiance.data) {
    EXPECT_LE(value, 1.0f + 1e-5f);
    EXPECT_GT(value, 0.3f);
  }
  Planes with_diffuse;
  for (size_t i = 0; i < g.pixels(); ++i) g.plane(kAlbedo)[i] = 1.0f;
  shade_deferred(g, camera, light, {}, colour, &with_diffuse);
  for (size_t i = 0; i < g.pixels(); ++i)
    EXPECT_NEAR(with_diffuse.plane(0)[i] - radiance.plane(0)[i], 1.0f, 1e-5f);
}

TEST_F(Deferred, IsLinearInTheLight) {
  const Camera camera = test_camera(20, 20);
  const Planes g = random_gbuffer(camera, 11);
  const PrefilteredEnvironment a = random_light(12), b = random_light(13);
  PrefilteredEnvironment sum = a;
  const auto add = [](Cubemap& out, const Cubemap& x) {
    for (size_t i = 0; i < out.texels.size(); ++i) out.texels[i] = 2 * out.texels[i] + x.texels[i];
  };
  add(sum.diffuse, b.diffuse);
  for (size_t k = 0; k < sum.specular.size(); ++k) add(sum.specular[k], b.specular[k]);
  Planes colour, ra, rb, rs;
  shade_deferred(g, camera, a, {}, colour, &ra);
  shade_deferred(g, camera, b, {}, colour, &rb);
  shade_deferred(g, camera, sum, {}, colour, &rs);
  for (size_t i = 0; i < rs.data.size(); ++i)
    EXPECT_NEAR(rs.data[i], 2 * ra.data[i] + rb.data[i], 1e-5f);
}

TEST_F(Deferred, TurningEverythingChangesNothing) {
  // Light, normals and camera turned together about y by a quarter turn: the same picture.
  const Mat3d turn = (Mat3d() << 0, 0, 1, 0, 1, 0, -1, 0, 0).finished();  // +z to +x
  Random random(14);
  const Cubemap source = random_cubemap(16, random, 1.0);
  Cubemap turned(16);
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < 16; ++y)
      for (int x = 0; x < 16; ++x)
        Eigen::Map<Vec3f>(&turned.texels[static_cast<size_t>(3 * ((f * 16 + y) * 16 + x))]) =
            sample_cubemap(source, turn.transpose().cast<float>() * cubemap_direction(f, x, y, 16));
  const Camera camera = test_camera(24, 24);
  Camera turned_camera = camera;
  turned_camera.camera_from_world_rotation = camera.camera_from_world_rotation * turn.transpose();
  Planes g = random_gbuffer(camera, 15), a, b;
  Planes turned_g = g;
  for (size_t i = 0; i < g.pixels(); ++i) {
    const Vec3d n(g.plane(kMappedNormal)[i], g.plane(kMappedNormal + 1)[i],
                  g.plane(kMappedNormal + 2)[i]);
    const Vec3d m = turn * n;
    for (int c = 0; c < 3; ++c) turned_g.plane(kMappedNormal + c)[i] = static_cast<float>(m[c]);
  }
  shade_deferred(g, camera, Prefilter(16).forward(source), {}, a);
  shade_deferred(turned_g, turned_camera, Prefilter(16).forward(turned), {}, b);
  for (size_t i = 0; i < a.data.size(); ++i) EXPECT_NEAR(a.data[i], b.data[i], 2e-3f);
}

TEST_F(Deferred, PackedLightGivesTheSamePicture) {
  const Camera camera = test_camera(20, 20);
  const Planes g = random_gbuffer(camera, 16);
  const PrefilteredEnvironment light = random_light(17);
  Planes a, b;
  shade_deferred(g, camera, light, {}, a);
  shade_deferred(g, camera, pack_environment(light), {}, b);
  EXPECT_EQ(a.data, b.data);
}

TEST_F(Deferred, SameBitsEveryTime) {
  const Camera camera = test_camera(70, 50);
  const Planes g = random_gbuffer(camera, 18);
  const PrefilteredEnvironment light = random_light(19);
  Planes weight(70, 50, 3, 0.3f);
  PrefilteredEnvironment first_light = random_light(20), second_light = first_light;
  Planes first(70, 50, kGBufferPlanes), second = first;
  shade_deferred_backward(g, camera, light, {}, weight, first, &first_light);
  shade_deferred_backward(g, camera, light, {}, weight, second, &second_light);
  EXPECT_EQ(first.data, second.data);
  EXPECT_EQ(first_light.diffuse.texels, second_light.diffuse.texels);
  EXPECT_EQ(first_light.specular[1].texels, second_light.specular[1].texels);
}

// The reflected radiance of one surface point by brute force over the light's texels: diffuse and
// the whole GGX lobe, no split.
double reflected(const Cubemap& light, const Vec3d& n, const Vec3d& v, double roughness, double f0,
                 double albedo, int grid) {
  const double a2 = std::pow(roughness, 4), nv = n.dot(v);
  double sum = 0;
  const int m = light.size * grid;
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < m; ++y)
      for (int x = 0; x < m; ++x) {
        const Vec3d p = oracle::cube_surface(f, -1 + (2. * x + 1) / m, -1 + (2. * y + 1) / m);
        const Vec3d l = p.normalized();
        const double nl = n.dot(l);
        if (nl <= 0) continue;
        const double solid_angle = 4.0 / m / m / std::pow(p.norm(), 3);
        const Vec3d h = (l + v).normalized();
        const double nh = n.dot(h), q = nh * nh * (a2 - 1) + 1;
        const double vis = 0.5 / (nl * std::sqrt(nv * nv * (1 - a2) + a2) +
                                  nv * std::sqrt(nl * nl * (1 - a2) + a2));
        const double fresnel = f0 + (1 - f0) * std::pow(1 - v.dot(h), 5);
        const double brdf = a2 / (kPi * q * q) * vis * fresnel + albedo / kPi;
        const size_t texel =
            (static_cast<size_t>(f) * light.size + y / grid) * light.size + x / grid;
        sum += solid_angle * nl * brdf * light.texels[3 * texel + 1];
      }
  return sum;
}

TEST_F(Deferred, SplitSumIsCloseToTheFullIntegral) {
  // A smooth sky with a lamp. Seen along the normal split-sum is nearly exact (what is left is
  // roughness interpolation and the table); at 60 degrees the lobe is no longer that of N = V = R:
  // up to about a fifth of the specular part, as is known of split-sum.
  const int n = 32;
  Cubemap light(n);
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        const Vec3d d = cubemap_direction(f, x, y, n).cast<double>();
        const double value = 0.6 + 0.4 * d.y() + 4 * std::exp(6 * (d.dot(Vec3d(.6, .64, .48)) - 1));
        for (int c = 0; c < 3; ++c)
          light.texels[static_cast<size_t>(3 * ((f * n + y) * n + x) + c)] =
              static_cast<float>(value);
      }
  const PrefilteredEnvironment prefiltered = Prefilter(n).forward(light);
  Camera camera = look_at({0, 0, 1}, {0, 0, 0}, 0.01, 1, 1);
  double worst_straight = 0, worst_tilted = 0;
  for (const double roughness : {0.3, 0.45, 0.7, 1.0})
    for (const double tilt : {0.0, 0.5, 1.05})
      for (const double side : {0.3, 2.0}) {
        const Vec3d normal(std::sin(tilt) * std::cos(side), std::sin(tilt) * std::sin(side),
                           std::cos(tilt));
        Planes g(1, 1, kGBufferPlanes), colour, radiance;
        g.plane(kAlpha)[0] = 1;
        for (int c = 0; c < 3; ++c) {
          g.plane(kAlbedo + c)[0] = 0.2f;
          g.plane(kMappedNormal + c)[0] = static_cast<float>(normal[c]);
        }
        g.plane(kRoughness)[0] = static_cast<float>(roughness);
        g.plane(kSpecular)[0] = 0.5f;
        shade_deferred(g, camera, prefiltered, {}, colour, &radiance);
        const double expected = reflected(light, normal, {0, 0, 1}, roughness, 0.5, 0.2, 6);
        const double error = std::abs(radiance.plane(1)[0] - expected) / expected;
        (tilt == 0.0 ? worst_straight : worst_tilted) =
            std::max(tilt == 0.0 ? worst_straight : worst_tilted, error);
      }
  std::printf("  split-sum against the full integral: %.4f seen straight, %.4f tilted\n",
              worst_straight, worst_tilted);
  EXPECT_LT(worst_straight, 0.03);
  EXPECT_LT(worst_tilted, 0.2);
}

TEST_F(Deferred, Speed) {
  const int size = 512;
  const Camera camera = look_at({0, 0, 1}, {0, 0, 0}, 0.5, size, size);
  Planes g(size, size, kGBufferPlanes);
  size_t covered = 0;
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const double u = (x - 256) / 224.0, v = (256 - y) / 224.0, z2 = 1 - u * u - v * v;
      if (z2 <= 0) continue;
      ++covered;
      const size_t i = static_cast<size_t>(y) * size + x;
      g.plane(kAlpha)[i] = 0.97f;
      for (int c = 0; c < 3; ++c) g.plane(kAlbedo + c)[i] = 0.4f;
      g.plane(kRoughness)[i] = 0.4f + 0.1f * static_cast<float>(std::sin(40 * u));
      g.plane(kSpecular)[i] = 0.04f;
      g.plane(kMappedNormal)[i] = static_cast<float>(u);
      g.plane(kMappedNormal + 1)[i] = static_cast<float>(v);
      g.plane(kMappedNormal + 2)[i] = static_cast<float>(std::sqrt(z2));
    }
  Random random(21);
  const PrefilteredEnvironment light = Prefilter(32).forward(random_cubemap(32, random, 1.0));
  PrefilteredEnvironment d_light = Prefilter(32).zero_like();
  const PackedEnvironment packed = pack_environment(light);
  Planes colour, weight(size, size, 3, 0.1f), d(size, size, kGBufferPlanes);
  const auto milliseconds = [](const auto& body) {
    double best = 1e9;
    for (int i = 0; i < 12; ++i) {
      const auto start = std::chrono::steady_clock::now();
      body();
      best = std::min(
          best, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
                    .count());
    }
    return best;
  };
  const double forward = milliseconds([&] { shade_deferred(g, camera, light, {}, colour); });
  const double playback = milliseconds([&] { shade_deferred(g, camera, packed, {}, colour); });
  const double backward =
      milliseconds([&] { shade_deferred_backward(g, camera, light, {}, weight, d, &d_light); });
  std::printf(
      "  512^2, %.0f %% covered: forward %.2f ms (light packed before: %.2f), backward %.2f ms, "
      "%d threads\n",
      100.0 * static_cast<double>(covered) / size / size, forward, playback, backward,
      thread_count());
  EXPECT_LT(forward, 500.0);  // far above the expected time: guards against a change of order
}

}  // namespace
}  // namespace effigy
