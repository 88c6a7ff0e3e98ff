// Radiance transfer against a double-precision oracle: forward, derivatives by finite differences,
// and what must not change when light and body turn together.
#include "effigy/shade/transfer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;

Vec3d random_direction(Random& random) {
  return Vec3d(random.normal(), random.normal(), random.normal()).normalized();
}

Mat3d random_rotation(Random& random) {
  const Vec3d a = random_direction(random), b = a.cross(random_direction(random)).normalized();
  Mat3d r;
  r << a, b, a.cross(b);
  return r;
}

struct Scene {
  size_t n = 0;
  std::vector<float> axes, position, zonal;
  DiffuseLight light;
  TransferView view() const { return {n, axes, position, zonal}; }
};

Scene random_scene(size_t n, int points, bool falloff, bool environment, uint64_t seed) {
  Random random(seed);
  Scene s;
  s.n = n;
  s.axes.resize(9 * n);
  s.position.resize(3 * n);
  s.zonal.resize(kZonalCoefficients * n);
  for (size_t i = 0; i < n; ++i) {
    const Mat3d r = random_rotation(random);
    for (size_t k = 0; k < 9; ++k)
      s.axes[k * n + i] = static_cast<float>(r(static_cast<int>(k % 3), static_cast<int>(k / 3)));
    for (size_t k = 0; k < 3; ++k)
      s.position[k * n + i] = static_cast<float>(0.4 * random.normal());
    for (size_t k = 0; k < kZonalCoefficients; ++k)
      s.zonal[k * n + i] = static_cast<float>(random.normal());
  }
  for (int j = 0; j < points; ++j) {
    PointLight p;
    p.directional = j % 3 == 2;
    p.position = (random_direction(random) * (p.directional ? 1.0 : 2.75)).cast<float>();
    for (int c = 0; c < 3; ++c) p.intensity[c] = static_cast<float>(random.uniform(0.2, 2));
    s.light.points.lights.push_back(p);
  }
  s.light.points.falloff = falloff;
  s.light.points.center = Vec3f(0.1f, 0.2f, -0.1f);
  if (environment)
    for (size_t k = 0; k < 3 * sh_count(kZonalOrder); ++k)
      s.light.sh.push_back(static_cast<float>(random.normal()));
  return s;
}

// Everything in double precision, written from the definitions.
struct Oracle {
  size_t n;
  std::vector<double> axes, position, zonal, intensity;
  const DiffuseLight& light;

  explicit Oracle(const Scene& s)
      : n(s.n),
        axes(s.axes.begin(), s.axes.end()),
        position(s.position.begin(), s.position.end()),
        zonal(s.zonal.begin(), s.zonal.end()),
        light(s.light) {
    for (const PointLight& p : s.light.points.lights)
      for (int c = 0; c < 3; ++c) intensity.push_back(static_cast<double>(p.intensity[c]));
  }

  std::vector<double> colour() const {
    std::vector<double> out(3 * n, 0.0);
    for (size_t i = 0; i < n; ++i)
      for (size_t axis = 0; axis < 3; ++axis) {
        const auto component = [&](size_t k) { return axes[(3 * axis + k) * n + i]; };
        const Vec3d a(component(0), component(1), component(2));
        const auto z = [&](size_t l, size_t c) { return zonal[zonal_index(axis, l, c) * n + i]; };
        for (size_t j = 0; j < light.points.lights.size(); ++j) {
          const PointLight& p = light.points.lights[j];
          Vec3d w = p.position.cast<double>();
          double strength = 1;
          if (!p.directional) {
            w -= Vec3d(position[i], position[n + i], position[2 * n + i]);
            if (light.points.falloff)
              strength =
                  (p.position - light.points.center).cast<double>().squaredNorm() / w.squaredNorm();
            w.normalize();
          }
          for (unsigned l = 0; l < kZonalBands; ++l)
            for (size_t c = 0; c < 3; ++c)
              out[c * n + i] += strength * intensity[3 * j + c] * z(l, c) * (2 * l + 1) /
                                (4 * kPi) * polynomial(l, a.dot(w));
        }
        if (light.sh.empty()) continue;
        for_each_sh(kZonalOrder, a.data(), [&](int l, int m, double value, const double*) {
          for (size_t c = 0; c < 3; ++c)
            out[c * n + i] +=
                static_cast<double>(light.sh[3 * static_cast<size_t>(l * l + l + m) + c]) * value *
                z(static_cast<size_t>(l), c);
        });
      }
    return out;
  }

  // P_l, also a little beyond [-1, 1].
  static double polynomial(unsigned l, double x) {
    double before = 0, p = 1;
    for (unsigned k = 0; k < l; ++k) {
      const double next = ((2 * k + 1) * x * p - k * before) / (k + 1);
      before = p;
      p = next;
    }
    return p;
  }
};

double relative(const std::vector<double>& expected, const std::vector<float>& actual) {
  EXPECT_EQ(expected.size(), actual.size());
  double error = 0, size = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    EXPECT_TRUE(std::isfinite(actual[i]));
    error += std::pow(expected[i] - static_cast<double>(actual[i]), 2);
    size += expected[i] * expected[i];
  }
  return std::sqrt(error / std::max(size, 1e-30));
}

std::vector<float> shade(const Scene& s) {
  std::vector<float> colour(3 * s.n);
  shade_diffuse(s.light, s.view(), colour);
  return colour;
}

TEST(Diffuse, ForwardAgreesWithTheOracle) {
  for (const bool falloff : {false, true})
    for (const bool environment : {false, true})
      for (const int points : {0, 1, 7}) {
        const Scene s = random_scene(77, points, falloff, environment, 1);
        EXPECT_LT(relative(Oracle(s).colour(), shade(s)), 2e-6);
      }
}

TEST(Diffuse, GradientsAgreeWithFiniteDifferences) {
  const Scene s = random_scene(37, 5, true, true, 2);
  Random random(3);
  std::vector<float> d_colour(3 * s.n);
  for (float& x : d_colour) x = static_cast<float>(random.normal());
  std::vector<float> axes(9 * s.n), position(3 * s.n), zonal(kZonalCoefficients * s.n),
      intensity(15);
  shade_diffuse_backward(s.light, s.view(), d_colour, {axes, position, zonal, intensity});
  Oracle oracle(s);
  const auto differences = [&](std::vector<double>& x) {
    std::vector<double> g;
    for (double& at : x) {
      const double was = at, h = 1e-5;
      double value[2];
      for (const int side : {0, 1}) {
        at = was + (side ? h : -h);
        const std::vector<double> colour = oracle.colour();
        value[side] = 0;
        for (size_t i = 0; i < colour.size(); ++i)
          value[side] += colour[i] * static_cast<double>(d_colour[i]);
      }
      at = was;
      g.push_back((value[1] - value[0]) / (2 * h));
    }
    return g;
  };
  EXPECT_LT(relative(differences(oracle.axes), axes), 1e-5);
  EXPECT_LT(relative(differences(oracle.position), position), 1e-5);
  EXPECT_LT(relative(differences(oracle.zonal), zonal), 1e-5);
  EXPECT_LT(relative(differences(oracle.intensity), intensity), 1e-5);
}

// The same directional lights as points and as spherical harmonics.
TEST(Diffuse, ThePointPathIsTheEnvironmentPath) {
  Scene s = random_scene(64, 12, false, false, 4);
  for (PointLight& p : s.light.points.lights) {
    p.directional = true;
    p.position.normalize();
  }
  const std::vector<float> points = shade(s);
  s.light.sh = sh_of_points(s.light.points, Vec3f::Zero());
  s.light.points.lights.clear();
  s.position.clear();
  const std::vector<float> environment = shade(s);
  const std::vector<double> wide(points.begin(), points.end());
  EXPECT_LT(relative(wide, environment), 2e-6);
}

TEST(Diffuse, TurningBodyAndLightTogetherChangesNothing) {
  for (const bool environment : {false, true}) {
    Scene s = random_scene(50, 9, true, false, 5);
    const auto with_environment = [&](Scene& scene) {
      if (!environment) return;
      for (PointLight& p : scene.light.points.lights) p.directional = true;
      scene.light.sh = sh_of_points(scene.light.points, Vec3f::Zero());
      scene.light.points.lights.clear();
    };
    Scene turned = s;
    Random random(6);
    const Mat3f r = random_rotation(random).cast<float>();
    const auto turn = [&](std::vector<float>& planes, size_t first) {
      for (size_t i = 0; i < s.n; ++i) {
        const Vec3f v(planes[first * s.n + i], planes[(first + 1) * s.n + i],
                      planes[(first + 2) * s.n + i]);
        const Vec3f w = r * v;
        for (size_t k = 0; k < 3; ++k) planes[(first + k) * s.n + i] = w[static_cast<int>(k)];
      }
    };
    for (const size_t axis : {0, 3, 6}) turn(turned.axes, axis);
    turn(turned.position, 0);
    for (PointLight& p : turned.light.points.lights) p.position = r * p.position;
    turned.light.points.center = r * turned.light.points.center;
    with_environment(s);
    with_environment(turned);
    const std::vector<float> before = shade(s);
    EXPECT_LT(relative({before.begin(), before.end()}, shade(turned)), 2e-6);
  }
}

// The initial lobe: a Lambertian surface about the third axis.
TEST(Diffuse, LambertianLobesShadeLikeACosine) {
  Scene s = random_scene(200, 1, false, false, 7);
  std::fill(s.zonal.begin(), s.zonal.end(), 0.0f);
  for (size_t l = 0; l < kZonalBands; ++l)
    for (size_t c = 0; c < 3; ++c)
      for (size_t i = 0; i < s.n; ++i)
        s.zonal[zonal_index(2, l, c) * s.n + i] = static_cast<float>(lambert_zonal()[l]);
  const PointLight& light = s.light.points.lights[0];
  const std::vector<float> colour = shade(s);
  for (size_t i = 0; i < s.n; ++i) {
    const Vec3f to =
        (light.position - Vec3f(s.position[i], s.position[s.n + i], s.position[2 * s.n + i]))
            .normalized();
    const Vec3f normal(s.axes[6 * s.n + i], s.axes[7 * s.n + i], s.axes[8 * s.n + i]);
    const double cosine = std::max(0.0f, normal.dot(to));
    for (size_t c = 0; c < 3; ++c) {
      const auto strength = static_cast<double>(light.intensity[static_cast<int>(c)]) / kPi;
      EXPECT_NEAR(colour[c * s.n + i], strength * cosine, 0.034 * strength);
    }
  }
}

TEST(Diffuse, ThreadsDoNotChangeTheBits) {
  const Scene s = random_scene(5000, 4, true, true, 8);
  Random random(9);
  std::vector<float> d_colour(3 * s.n);
  for (float& x : d_colour) x = static_cast<float>(random.normal());
  const int before = thread_count();
  std::vector<std::vector<float>> results;
  for (const int threads : {1, 3}) {
    set_thread_count(threads);
    results.push_back(shade(s));
    std::vector<float> axes(9 * s.n), position(3 * s.n), zonal(kZonalCoefficients * s.n);
    shade_diffuse_backward(s.light, s.view(), d_colour, {axes, position, zonal, {}});
    results.push_back(axes);
    results.push_back(zonal);
  }
  set_thread_count(before);
  for (size_t k = 0; k < 3; ++k) EXPECT_EQ(results[k], results[k + 3]);
}

struct LobeScene {
  size_t n = 0;
  std::vector<float> lobe, sigma, position;
  SpecularLight light;
  LobeView view() const { return {n, lobe, sigma, position}; }
};

// Lobes around the first light, from its centre to four widths away.
LobeScene lobe_scene(size_t n, uint64_t seed) {
  Random random(seed);
  LobeScene s;
  s.n = n;
  s.lobe.resize(3 * n);
  s.position.resize(3 * n);
  for (int j = 0; j < 4; ++j) {
    PointLight p;
    p.directional = j == 3;
    p.position = (random_direction(random) * (p.directional ? 1.0 : 2.5)).cast<float>();
    for (int c = 0; c < 3; ++c) p.intensity[c] = static_cast<float>(random.uniform(0.2, 2));
    s.light.points.lights.push_back(p);
  }
  s.light.points.falloff = true;
  for (size_t i = 0; i < n; ++i) {
    const double sigma = std::exp(random.uniform(std::log(0.02), std::log(0.5)));
    s.sigma.push_back(static_cast<float>(sigma));
    Vec3d p(0.3 * random.normal(), 0.3 * random.normal(), 0.3 * random.normal());
    const PointLight& light = s.light.points.lights[i % 4];
    Vec3d w = light.position.cast<double>();
    if (!light.directional) w -= p;
    const Vec3d q =
        (w.normalized() + sigma * random.uniform(0, 3) * random_direction(random)).normalized();
    for (size_t k = 0; k < 3; ++k) {
      s.lobe[k * n + i] = static_cast<float>(q[static_cast<int>(k)]);
      s.position[k * n + i] = static_cast<float>(p[static_cast<int>(k)]);
    }
  }
  return s;
}

struct LobeOracle {
  size_t n;
  std::vector<double> lobe, sigma, intensity;
  const LobeScene& scene;
  SgNorm norm;

  LobeOracle(const LobeScene& s, SgNorm which)
      : n(s.n),
        lobe(s.lobe.begin(), s.lobe.end()),
        sigma(s.sigma.begin(), s.sigma.end()),
        scene(s),
        norm(which) {
    for (const PointLight& p : s.light.points.lights)
      for (int c = 0; c < 3; ++c) intensity.push_back(static_cast<double>(p.intensity[c]));
  }
  std::vector<double> colour() const {
    std::vector<double> out(3 * n, 0.0);
    for (size_t i = 0; i < n; ++i) {
      const Vec3d q = Vec3d(lobe[i], lobe[n + i], lobe[2 * n + i]).normalized();
      const double s = sigma[i];
      double constant = 1 / (std::sqrt(2) * std::pow(kPi, 2.0 / 3) * s), unused;
      if (norm == SgNorm::kPi32) constant = 1 / (std::sqrt(2) * std::pow(kPi, 1.5) * s);
      if (norm == SgNorm::kUnit) sg_constant(norm, s, constant, unused);
      for (size_t j = 0; j < scene.light.points.lights.size(); ++j) {
        const PointLight& p = scene.light.points.lights[j];
        Vec3d w = p.position.cast<double>();
        double strength = 1;
        if (!p.directional) {
          for (int k = 0; k < 3; ++k)
            w[k] -= static_cast<double>(scene.position[static_cast<size_t>(k) * n + i]);
          strength = p.position.cast<double>().squaredNorm() / w.squaredNorm();
        }
        w.normalize();
        const double theta = std::atan2(q.cross(w).norm(), q.dot(w));
        for (size_t c = 0; c < 3; ++c)
          out[c * n + i] +=
              intensity[3 * j + c] * strength * constant * std::exp(-0.5 * theta * theta / (s * s));
      }
    }
    return out;
  }
};

TEST(Specular, ForwardAndGradientsAgreeWithTheOracle) {
  for (const SgNorm norm : {SgNorm::kCode, SgNorm::kPi32, SgNorm::kUnit}) {
    const LobeScene s = lobe_scene(150, 11);
    LobeOracle oracle(s, norm);
    std::vector<float> colour(3 * s.n);
    shade_specular(s.light, norm, s.view(), colour);
    EXPECT_LT(relative(oracle.colour(), colour), 1e-5);

    Random random(12);
    std::vector<float> d_colour(3 * s.n), lobe(3 * s.n), sigma(s.n), intensity(12);
    for (float& x : d_colour) x = static_cast<float>(random.normal());
    shade_specular_backward(s.light, norm, s.view(), d_colour, {lobe, sigma, intensity});
    const auto differences = [&](std::vector<double>& x) {
      std::vector<double> g;
      for (double& at : x) {
        const double was = at, h = 1e-6;
        double value[2];
        for (const int side : {0, 1}) {
          at = was + (side ? h : -h);
          const std::vector<double> shaded = oracle.colour();
          value[side] = 0;
          for (size_t i = 0; i < shaded.size(); ++i)
            value[side] += shaded[i] * static_cast<double>(d_colour[i]);
        }
        at = was;
        g.push_back((value[1] - value[0]) / (2 * h));
      }
      return g;
    };
    EXPECT_LT(relative(differences(oracle.sigma), sigma), 1e-4);
    EXPECT_LT(relative(differences(oracle.intensity), intensity), 1e-4);
    // The oracle normalises the lobe, so only the part along the sphere can be compared.
    std::vector<float> along = lobe;
    for (size_t i = 0; i < s.n; ++i) {
      float dot = 0;
      for (size_t k = 0; k < 3; ++k) dot += lobe[k * s.n + i] * s.lobe[k * s.n + i];
      for (size_t k = 0; k < 3; ++k) along[k * s.n + i] -= dot * s.lobe[k * s.n + i];
    }
    EXPECT_LT(relative(differences(oracle.lobe), along), 1e-4);
  }
}

// Within a thousandth of a width of the centre the derivative is that of the parabola there.
TEST(Specular, DerivativesAtTheCentreOfTheLobe) {
  for (const float sigma : {0.01f, 0.1f, 0.4f})
    for (const float offset : {0.0f, 1e-3f, 0.1f}) {
      SpecularLight light;
      light.points.lights.push_back({Vec3f(0, 0, 1), Vec3f(1, 1, 1), true});
      const float angle = offset * sigma;
      const float q[3] = {std::sin(angle), 0, std::cos(angle)}, g[3] = {1, 0, 0};
      float d_q[3] = {}, d_sigma = 0;
      shade_specular_backward(light, SgNorm::kCode, {1, q, {&sigma, 1}, {}}, g,
                              {d_q, {&d_sigma, 1}, {}});
      const double peak = 1 / (3.03352966508 * static_cast<double>(sigma));
      const double value = peak * std::exp(-0.5 * static_cast<double>(offset * offset));
      // Along increasing angle: -value angle / sigma^2.
      const double slope = static_cast<double>(d_q[0] * std::cos(angle) - d_q[2] * std::sin(angle));
      const double expected = -value * static_cast<double>(angle / (sigma * sigma));
      EXPECT_NEAR(slope, expected, 1e-4 * std::abs(expected) + 1e-6 * value) << sigma << offset;
      EXPECT_TRUE(std::isfinite(d_sigma));
    }
}

TEST(Specular, OppositeLobesAndWidthsOfNothingAreHarmless) {
  SpecularLight light;
  light.points.lights.push_back({Vec3f(0, 0, 1), Vec3f(1, 1, 1), true});
  const float q[6] = {0, 0, 0, 0, -1, 1}, sigma[2] = {0.3f, 0.0f}, g[6] = {1, 1, 1, 1, 1, 1};
  float colour[6], d_q[6] = {}, d_sigma[2] = {};
  const LobeView view{2, q, sigma, {}};
  shade_specular(light, SgNorm::kCode, view, colour);
  EXPECT_NEAR(colour[0], 0.0f, 1e-6f);
  EXPECT_EQ(colour[1], 0.0f);
  shade_specular_backward(light, SgNorm::kCode, view, g, {d_q, d_sigma, {}});
  for (const float x : d_q) EXPECT_TRUE(std::isfinite(x));
  for (const float x : d_sigma) EXPECT_TRUE(std::isfinite(x));
  EXPECT_EQ(d_sigma[1], 0.0f);
}

// One lit texel, as an environment and as a point.
TEST(Specular, ThePointPathIsTheEnvironmentPath) {
  constexpr int kSize = 64;
  Cubemap map(kSize);
  const size_t texel = (static_cast<size_t>(4) * kSize + 30) * kSize + 21;
  for (size_t c = 0; c < 3; ++c) map.texels[3 * texel + c] = 50.0f + static_cast<float>(c);
  const LobeEnvironment environment(map);
  SpecularLight filtered, points;
  filtered.environment = &environment;
  const Vec3f towards = cubemap_direction(4, 21, 30, kSize).normalized();
  const auto area = static_cast<float>(cubemap_solid_angle(21, 30, kSize));
  points.points.lights.push_back({towards, area * Vec3f(50, 51, 52), true});
  LobeScene s = lobe_scene(200, 13);
  Random random(14);
  float largest = 0;
  for (size_t i = 0; i < s.n; ++i) {
    s.sigma[i] = static_cast<float>(random.uniform(0.15, 0.5));
    const Vec3f q = (towards + static_cast<float>(random.uniform(0, 1)) *
                                   random_direction(random).cast<float>())
                        .normalized();
    for (size_t k = 0; k < 3; ++k) s.lobe[k * s.n + i] = q[static_cast<int>(k)];
  }
  std::vector<float> a(3 * s.n), b(3 * s.n);
  shade_specular(filtered, SgNorm::kCode, s.view(), a);
  shade_specular(points, SgNorm::kCode, s.view(), b);
  for (const float x : b) largest = std::max(largest, x);
  for (size_t i = 0; i < a.size(); ++i) EXPECT_NEAR(a[i], b[i], 0.04f * largest);
}

TEST(Specular, ReflectionAndItsDerivatives) {
  constexpr size_t kN = 20;
  Random random(15);
  std::vector<float> normal(3 * kN), wo(3 * kN), d_lobe(3 * kN), lobe(3 * kN);
  for (size_t i = 0; i < kN; ++i) {
    const Vec3d n = random_direction(random), w = random_direction(random);
    for (size_t k = 0; k < 3; ++k) {
      normal[k * kN + i] = static_cast<float>(n[static_cast<int>(k)]);
      wo[k * kN + i] = static_cast<float>(w[static_cast<int>(k)]);
      d_lobe[k * kN + i] = static_cast<float>(random.normal());
    }
  }
  reflect_views(kN, normal, wo, lobe);
  for (size_t i = 0; i < kN; ++i) {
    const auto at = [&](const std::vector<float>& v) {
      return Vec3f(v[i], v[kN + i], v[2 * kN + i]);
    };
    EXPECT_NEAR(at(lobe).norm(), 1.0f, 1e-5f);
    EXPECT_NEAR(at(lobe).dot(at(normal)), at(wo).dot(at(normal)), 1e-5f);
  }
  std::vector<float> d_normal(3 * kN), d_wo(3 * kN);
  reflect_views_backward(kN, normal, wo, d_lobe, d_normal, d_wo);
  const auto difference = [&](std::vector<float>& x, size_t k) {
    const float was = x[k], h = 1e-2f;  // the formula is quadratic: no truncation error
    double value[2];
    for (const int side : {0, 1}) {
      x[k] = was + (side ? h : -h);
      reflect_views(kN, normal, wo, lobe);
      value[side] = 0;
      for (size_t i = 0; i < lobe.size(); ++i)
        value[side] += static_cast<double>(lobe[i] * d_lobe[i]);
    }
    x[k] = was;
    return (value[1] - value[0]) / (2 * static_cast<double>(h));
  };
  for (size_t k = 0; k < 3 * kN; ++k) {
    EXPECT_NEAR(d_normal[k], difference(normal, k), 1e-3);
    EXPECT_NEAR(d_wo[k], difference(wo, k), 1e-3);
  }
}

}  // namespace
}  // namespace effigy
