#include "effigy/body/irradiance.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/image/colour.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

constexpr int kSide = 48;

// Adds `part`, scaled and moved, its UVs squeezed into columns [left, right] of the atlas.
void add(const Mesh& part, float scale, const Vec3f& by, float left, float right, Mesh& mesh) {
  const int vertices = mesh.vertex_count(), uvs = static_cast<int>(mesh.uvs.size());
  for (int v = 0; v < part.vertex_count(); ++v)
    for (int c = 0; c < 3; ++c) mesh.vertices.push_back(scale * part.vertex(v)[c] + by[c]);
  for (const Vec2f& uv : part.uvs) mesh.uvs.emplace_back(left + (right - left) * uv.x(), uv.y());
  for (const Vec3i& t : part.triangles) mesh.triangles.push_back(t + Vec3i::Constant(vertices));
  for (const Vec3i& t : part.uv_triangles) mesh.uv_triangles.push_back(t + Vec3i::Constant(uvs));
}

// A square of side 2 in the plane z = 0, facing +z, UVs over nearly all of it.
Mesh square() {
  Mesh mesh;
  mesh.vertices = {-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0};
  mesh.triangles = mesh.uv_triangles = {Vec3i(0, 1, 2), Vec3i(0, 2, 3)};
  mesh.uvs = {{0.01f, 0.01f}, {0.99f, 0.01f}, {0.99f, 0.99f}, {0.01f, 0.99f}};
  return mesh;
}

Mesh ball() {
  return test::ball_rig(24, 48).mesh;
}

// Three balls in a row that shadow one another.
Mesh balls() {
  Mesh mesh;
  for (int k = 0; k < 3; ++k)
    add(ball(), 1.0f, Vec3f(0.21f * static_cast<float>(k), 0, 0), static_cast<float>(k) / 3,
        static_cast<float>(k + 1) / 3, mesh);
  return mesh;
}

PointLights some_lights(int count, uint64_t seed) {
  Random random(seed);
  PointLights lights;
  for (int k = 0; k < count; ++k) {
    Vec3f at;
    for (int c = 0; c < 3; ++c) at[c] = static_cast<float>(random.normal());
    PointLight light;
    light.position = 2.0f * at.normalized();
    for (int c = 0; c < 3; ++c) light.intensity[c] = static_cast<float>(random.uniform(0.2, 2));
    lights.lights.push_back(light);
  }
  lights.lights[0].directional = true;
  lights.lights[0].position.normalize();
  return lights;
}

struct Body {
  explicit Body(const Mesh& m, int side = kSide)
      : mesh(m),
        texels(uv_texels(m, side)),
        frames(texel_frames(texels, m.vertices, m.triangles)),
        scene(m.vertices, m.triangles),
        irradiance(texels) {}

  std::vector<float> points(const PointLights& lights, int samples, uint64_t seed = 1) const {
    return irradiance.of_points(frames, scene, lights, {.samples = samples, .seed = seed});
  }
  Vec3f normal(size_t i) const {
    const float* r = &frames.rotation[9 * i];
    return {r[2], r[5], r[8]};
  }
  Vec3f position(size_t i) const { return Vec3f(&frames.position[3 * i]); }

  Mesh mesh;
  UvTexels texels;
  TexelFrames frames;
  RayScene scene;
  TexelIrradiance irradiance;
};

PointLights one(const Vec3f& position, const Vec3f& intensity = Vec3f::Ones()) {
  return {.lights = {{.position = position, .intensity = intensity}}};
}

// Hits in [0, 1] of the segment, by Moeller and Trumbore 1997; `closeness`: how near the decision
// was to the other one, in barycentric coordinates.
bool hits(const Mesh& mesh, const Vec3d& origin, const Vec3d& way, double far, double& closeness) {
  bool hit = false;
  for (const Vec3i& t : mesh.triangles) {
    const Vec3d a = mesh.vertex(t[0]).cast<double>(), e1 = mesh.vertex(t[1]).cast<double>() - a,
                e2 = mesh.vertex(t[2]).cast<double>() - a, p = way.cross(e2);
    const double det = e1.dot(p);
    if (std::abs(det) < 1e-14) continue;
    const Vec3d s = origin - a, q = s.cross(e1);
    const double u = s.dot(p) / det, v = way.dot(q) / det, distance = e2.dot(q) / det;
    if (distance < -1e-6 || distance > far) continue;
    const double inside = std::min({u, v, 1 - u - v, distance});
    closeness = std::min(closeness, std::abs(inside));
    if (inside >= 0) hit = true;
  }
  return hit;
}

TEST(Irradiance, ConvexBodyIsLitWhereItFacesTheLight) {
  const Body body{ball()};
  const Vec3f lamp(0.5f, 1.0f, 2.0f);
  const std::vector<float> picture = body.points(one(lamp), 1);
  ASSERT_EQ(picture.size(), static_cast<size_t>(kSide * kSide));
  double mean = 0;
  int decided = 0;
  for (size_t i = 0; i < body.texels.count(); ++i) {
    const float value = picture[static_cast<size_t>(body.texels.texel[i])];
    const float cosine = body.normal(i).dot((lamp - body.position(i)).normalized());
    // Near the terminator a faceted ball may shade itself.
    if (std::abs(cosine) < 0.12f) continue;
    EXPECT_EQ(value, cosine > 0 ? 1.0f : 0.0f) << i;
    mean += value;
    ++decided;
  }
  EXPECT_GT(decided, 1000);
  EXPECT_NEAR(mean / decided, 0.5, 0.08);  // about half the atlas, which is not equal-area
}

TEST(Irradiance, OneForAPlaneInFrontOfItsLightsAndZeroBehind) {
  const Body body{square()};
  PointLights lights = one(Vec3f(0.3f, 0.1f, 1));
  lights.lights.push_back({.position = Vec3f(2, 0, 0.5f), .intensity = Vec3f(5, 1, 0)});
  for (const int samples : {1, 2, 9})
    for (const float value : body.points(lights, samples)) EXPECT_EQ(value, 1.0f);
  for (PointLight& light : lights.lights) light.position.z() *= -1;
  for (const float value : body.points(lights, 2)) EXPECT_EQ(value, 0.0f);
}

TEST(Irradiance, ABlockerHidesOneOfTwoLights) {
  Mesh mesh;
  add(square(), 1.0f, Vec3f::Zero(), 0.0f, 0.5f, mesh);
  // Hides (3, 0, 3) from all of the lower square, the light above from none of it.
  add(square(), 1.5f, Vec3f(1.5f, 0, 1.5f), 0.5f, 1.0f, mesh);
  const Body body{mesh};
  PointLights lights;
  lights.lights = {{.position = Vec3f(3, 0, 3), .intensity = Vec3f(0, 1, 0)},
                   {.position = Vec3f(-3, 0, 0.2f), .intensity = Vec3f(0, 1, 0)}};
  const std::vector<float> picture = body.points(lights, 2);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide / 2; ++x)
      EXPECT_EQ(picture[static_cast<size_t>(y * kSide + x)], 0.5f) << x << ' ' << y;
  // The strengths count by their luminance: a blue lamp as strong as the green one lights less.
  lights.lights[1].intensity = Vec3f(0, 0, 1);
  const float green = luminance(0, 1, 0), blue = luminance(0, 0, 1);
  EXPECT_NEAR(body.points(lights, 2)[0], blue / (green + blue), 1e-6);
  // What stands behind a light hides nothing.
  EXPECT_EQ(body.points(one(Vec3f(1.5f, 0, 1)), 1)[0], 1.0f);
}

TEST(Irradiance, FalloffWeighsNearLightsMore) {
  Mesh mesh;
  add(square(), 1.0f, Vec3f::Zero(), 0.0f, 0.5f, mesh);
  add(square(), 1.5f, Vec3f(1.5f, 0, 1.5f), 0.5f, 1.0f, mesh);
  const Body body{mesh};
  PointLights lights;
  lights.falloff = true;
  lights.center = Vec3f(0, 0, 1);
  const Vec3f hidden(3, 0, 3), seen(-3, 0, 0.2f);
  lights.lights = {{.position = hidden, .intensity = Vec3f::Ones()},
                   {.position = seen, .intensity = 2 * Vec3f::Ones()}};
  const std::vector<float> picture = body.points(lights, 2);
  for (size_t i = 0; i < body.texels.count(); ++i) {
    if (body.texels.texel[i] % kSide >= kSide / 2) continue;
    const Vec3f at = body.position(i) + 2e-3f * body.normal(i);
    const double a = (hidden - lights.center).squaredNorm() / (hidden - at).squaredNorm(),
                 b = 2 * (seen - lights.center).squaredNorm() / (seen - at).squaredNorm();
    EXPECT_NEAR(picture[static_cast<size_t>(body.texels.texel[i])], b / (a + b), 1e-5);
  }
}

TEST(Irradiance, AgreesWithBruteForce) {
  const Body body{balls(), 24};
  PointLights lights = some_lights(6, 3);
  lights.falloff = true;
  const std::vector<float> picture = body.points(lights, 6);
  int compared = 0, shadowed = 0;
  for (size_t i = 0; i < body.texels.count(); ++i) {
    const Vec3f from = body.position(i) + 2e-3f * body.normal(i);
    const Vec3d origin = from.cast<double>(), normal = body.normal(i).cast<double>();
    double all = 0, lit = 0, closeness = 1;
    for (const PointLight& light : lights.lights) {
      Vec3d way = light.position.cast<double>();
      double strength = luminance(light.intensity.x(), light.intensity.y(), light.intensity.z());
      if (!light.directional) {
        strength *= way.squaredNorm() / (way - origin).squaredNorm();
        way -= origin;
      }
      all += strength;
      closeness = std::min(closeness, std::abs(way.normalized().dot(normal)));
      if (way.dot(normal) <= 0) continue;
      if (hits(body.mesh, origin, way, light.directional ? 1e30 : 1.0, closeness))
        ++shadowed;
      else
        lit += strength;
    }
    if (closeness < 1e-4) continue;
    ++compared;
    EXPECT_NEAR(picture[static_cast<size_t>(body.texels.texel[i])], lit / all, 1e-5) << i;
  }
  EXPECT_GT(compared, static_cast<int>(body.texels.count() * 9 / 10));
  EXPECT_GT(shadowed, 50);
}

// The mean over many seeds of few samples is the sum over all lights, texel by texel.
TEST(Irradiance, FewSamplesAreUnbiased) {
  const Body body{balls(), 16};
  PointLights lights = some_lights(12, 5);
  lights.falloff = true;
  const std::vector<float> exact = body.points(lights, 12);
  for (const int samples : {1, 3}) {
    constexpr int kSeeds = 4000;
    std::vector<double> mean(exact.size()), square(exact.size());
    for (int seed = 0; seed < kSeeds; ++seed) {
      const std::vector<float> drawn = body.points(lights, samples, 1000 + seed);
      for (size_t i = 0; i < exact.size(); ++i) {
        ASSERT_GE(drawn[i], 0.0f);
        ASSERT_LE(drawn[i], 1.0f);
        mean[i] += drawn[i] / kSeeds;
        square[i] += drawn[i] * static_cast<double>(drawn[i]) / kSeeds;
      }
    }
    double deviations = 0;
    int random = 0;
    for (size_t i = 0; i < exact.size(); ++i) {
      const double variance = square[i] - mean[i] * mean[i];
      const double error = mean[i] - exact[i];
      if (variance < 1e-9) {
        EXPECT_NEAR(mean[i], exact[i], 1e-5);
        continue;
      }
      const double standard = std::sqrt(variance / kSeeds);
      EXPECT_LT(std::abs(error), 5 * standard + 1e-6) << i;
      deviations += error * error / (standard * standard);
      ++random;
    }
    ASSERT_GT(random, 40);
    // Systematic samples are no worse than independent ones, so about 1 per texel (texels of the
    // gutter repeat others).
    EXPECT_LT(deviations / random, 1.8);
    EXPECT_GT(deviations / random, 0.4);
  }
}

TEST(Irradiance, EvenEnvironmentLightsHalfOfABall) {
  const Body body{ball(), 16};
  Cubemap even(8, 0.7f);
  const EnvironmentSampler light(even, EnvironmentDraw::kLuminance);
  const std::vector<float> picture = body.irradiance.of_environment(
      body.frames, body.scene, light, {.samples = 4096, .seed = 3, .offset = 5e-3f});
  for (const float value : picture) EXPECT_NEAR(value, 0.5f, 0.02f);
  // One sample: half of the texels, and every value a decision.
  double mean = 0;
  for (uint64_t seed = 0; seed < 200; ++seed)
    for (const float value :
         body.irradiance.of_environment(body.frames, body.scene, light, {.seed = seed})) {
      ASSERT_TRUE(value == 0.0f || value == 1.0f);
      mean += value;
    }
  EXPECT_NEAR(mean / (200.0 * static_cast<double>(picture.size())), 0.5, 0.02);
}

// An environment of a few bright texels lights as the directional lights there, times their area.
TEST(Irradiance, EnvironmentAgreesWithDirectionalLights) {
  const Body body{balls(), 16};
  constexpr int kHeight = 64;
  Image image(2 * kHeight, kHeight, 3, 0.0f);
  const Image directions = [&] {  // where the pixels are
    Image d(2 * kHeight, kHeight, 3);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < 2 * kHeight; ++x) {
        const double v = M_PI * (y + 0.5) / kHeight, u = M_PI * ((x + 0.5) / kHeight - 1);
        Eigen::Map<Vec3f>(d.at(x, y)) =
            Vec3d(std::sin(v) * std::sin(u), std::cos(v), -std::sin(v) * std::cos(u)).cast<float>();
      }
    return d;
  }();
  PointLights lights;
  for (int k = 0; k < 7; ++k) {
    const int x = 11 + 17 * k, y = 9 + 7 * k;
    const double area = std::cos(M_PI * y / kHeight) - std::cos(M_PI * (y + 1) / kHeight);
    const Vec3f rgb(static_cast<float>(k + 1), 2, 1);
    Eigen::Map<Vec3f>(image.at(x, y)) = rgb;
    lights.lights.push_back({.position = Vec3f(directions.at(x, y)),
                             .intensity = static_cast<float>(area) * rgb,
                             .directional = true});
  }
  const std::vector<float> exact = body.points(lights, 7);
  const EnvironmentSampler light(image, 0.0, EnvironmentDraw::kLuminance);
  const std::vector<float> drawn =
      body.irradiance.of_environment(body.frames, body.scene, light, {.samples = 2048, .seed = 5});
  double error = 0;
  for (size_t i = 0; i < exact.size(); ++i) error += std::abs(exact[i] - drawn[i]);
  EXPECT_LT(error / static_cast<double>(exact.size()), 0.02);
}

TEST(Irradiance, TheGutterShowsTheNearestTexel) {
  const Body body{balls(), 32};
  const std::vector<float> picture = body.points(some_lights(5, 9), 5);
  std::vector<uint8_t> valid(picture.size());
  for (const int32_t t : body.texels.texel) valid[static_cast<size_t>(t)] = 1;
  int gutter = 0;
  for (int i = 0; i < 32 * 32; ++i) {
    if (valid[static_cast<size_t>(i)]) continue;
    ++gutter;
    int nearest = 1000;
    bool found = false;
    for (const bool compare : {false, true})
      for (const int32_t t : body.texels.texel) {
        const int steps = std::abs(t % 32 - i % 32) + std::abs(t / 32 - i / 32);
        if (!compare) nearest = std::min(nearest, steps);
        if (compare && steps == nearest)
          found |= picture[static_cast<size_t>(t)] == picture[static_cast<size_t>(i)];
      }
    EXPECT_TRUE(found) << i;
  }
  EXPECT_GT(gutter, 30);
}

TEST(Irradiance, SameBitsForEveryThreadCountAndAfterAMove) {
  Body body{balls()};
  const PointLights lights = some_lights(15, 2);
  const EnvironmentSampler light(Image(16, 8, 3, 1.0f), 0.0, EnvironmentDraw::kLuminance);
  const int before = thread_count();
  std::vector<std::vector<float>> results;
  for (const int threads : {1, 2, 5}) {
    set_thread_count(threads);
    results.push_back(body.points(lights, 1));
    results.push_back(body.irradiance.of_environment(body.frames, body.scene, light, {.seed = 4}));
  }
  set_thread_count(before);
  for (size_t k = 2; k < results.size(); ++k) EXPECT_EQ(results[k], results[k % 2]);
  EXPECT_NE(body.points(lights, 1, 2), results[0]);
  // The body turned with its light: refitted rays find the same.
  const Mat3f turn = Eigen::AngleAxisf(0.7f, Vec3f(1, 2, 3).normalized()).toRotationMatrix();
  Mesh turned = body.mesh;
  for (int v = 0; v < turned.vertex_count(); ++v)
    Eigen::Map<Vec3f>(&turned.vertices[3 * static_cast<size_t>(v)]) = turn * body.mesh.vertex(v);
  PointLights turned_lights = lights;
  for (PointLight& l : turned_lights.lights) l.position = turn * l.position;
  const std::vector<float> still = body.points(lights, 15);
  body.scene.move(turned.vertices);
  body.frames = texel_frames(body.texels, turned.vertices, turned.triangles);
  const std::vector<float> moved = body.points(turned_lights, 15);
  int same = 0;
  for (size_t i = 0; i < still.size(); ++i) same += std::abs(still[i] - moved[i]) < 1e-5f;
  EXPECT_GT(same, static_cast<int>(still.size() * 98 / 100));
}

TEST(Irradiance, NoLightIsDarkAndNegativeLightAnError) {
  const Body body{ball(), 16};
  for (const float value : body.points({}, 1)) EXPECT_EQ(value, 0.0f);
  for (const float value : body.points(one(Vec3f(0, 0, 2), Vec3f::Zero()), 1))
    EXPECT_EQ(value, 0.0f);
  EXPECT_THROW(body.points(one(Vec3f(0, 0, 2), Vec3f(1, -1, 1)), 1), Error);
  EXPECT_THROW(body.points(one(Vec3f(0, 0, 2), Vec3f(1, NAN, 1)), 1), Error);
}

}  // namespace
}  // namespace effigy
