// Proofs of the path tracer: energy, closed forms, convergence, linearity, visibility.

#include "effigy/synth/path_tracer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/light/brdf_table.h"
#include "effigy/light/builtin_lights.h"
#include "effigy/synth/camera_rays.h"
#include "shapes.h"
#include "support.h"

namespace effigy {
namespace {

using test::sphere;
using test::square;

std::shared_ptr<const EnvironmentSampler> even_light(float value) {
  return std::make_shared<EnvironmentSampler>(Image(8, 4, 3, value));
}

std::shared_ptr<const EnvironmentSampler> light_of(const std::string& name, double rotation = 0) {
  return std::make_shared<EnvironmentSampler>(builtin_light(name), rotation);
}

TraceScene scene_of(const Mesh& mesh, const SurfaceMaterial& material) {
  TraceScene scene;
  scene.add_mesh(mesh, scene.add_material(material, "material"), "mesh");
  scene.commit();
  return scene;
}

SurfaceMaterial lambert(const Vec3f& albedo) {
  SurfaceMaterial material = constant_material(albedo, 1, 0);
  material.specular_lobe = false;
  return material;
}

Camera front(int size, double fov = 0.5, double distance = 4) {
  return look_at(Vec3d(0, 0, distance), Vec3d::Zero(), fov, size, size);
}

TraceOptions samples(int count, int bounces = 8) {
  TraceOptions options;
  options.samples = count;
  options.bounces = bounces;
  return options;
}

Vec3d mean_colour(const Image& image) {
  Vec3d sum = Vec3d::Zero();
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      sum += Eigen::Map<const Vec3f>(image.at(x, y)).cast<double>();
  return sum / (image.width * image.height);
}

double root_mean_square(const Image& a, const Image& b) {
  double sum = 0;
  for (size_t i = 0; i < a.data.size(); ++i) sum += std::pow(a.data[i] - b.data[i], 2);
  return std::sqrt(sum / static_cast<double>(a.data.size()));
}

// White furnace, diffuse: a white surface in even light is as bright as the light, however often
// light bounces; grey multiplies.
TEST(PathTracer, WhiteLambertVanishesInEvenLight) {
  for (const float albedo : {1.0f, 0.5f}) {
    TraceScene scene = scene_of(sphere(1, 24), lambert(Vec3f::Constant(albedo)));
    scene.set_environment(even_light(0.7f));
    const Image image = trace_image(scene, front(16, 0.2), samples(64));
    for (int i = 0; i < 16 * 16; ++i) {
      ASSERT_EQ(image.data[4 * i + 3], 1);
      EXPECT_NEAR(image.data[4 * i], 0.7 * albedo, 2e-3);
    }
  }
}

// In a closed white bowl light bounces many times and nothing is lost.
TEST(PathTracer, WhiteBowlKeepsItsEnergy) {
  Mesh bowl = sphere(1, 24);
  std::erase_if(bowl.triangles, [&](const Vec3i& t) {
    return bowl.vertex(t[0]).z() > 0.3f && bowl.vertex(t[1]).z() > 0.3f;
  });
  TraceScene scene = scene_of(bowl, lambert(Vec3f::Ones()));
  scene.set_environment(even_light(1));
  const Vec3d mean = mean_colour(trace_image(scene, front(16, 0.2), samples(256, 200)));
  EXPECT_NEAR(mean.x(), 1, 5e-3);
  const Vec3d once = mean_colour(trace_image(scene, front(16, 0.2), samples(256, 1)));
  EXPECT_LT(once.x(), 0.7);
}

// White furnace, specular: a flat GGX plate with F = 1 reflects the directional albedo of the
// single-scattering lobe (the split-sum table's scale + bias), never more than arrives.
TEST(PathTracer, SpecularLobeReflectsItsDirectionalAlbedo) {
  for (const float roughness : {0.1f, 0.3f, 0.6f, 0.95f})
    for (const double slope : {0.0, 0.9, 1.4}) {
      TraceScene scene = scene_of(square(3), constant_material(Vec3f::Zero(), roughness, 1));
      scene.set_environment(even_light(1));
      const Vec3d eye = 4 * Vec3d(std::sin(slope), 0, std::cos(slope));
      const Camera camera = look_at(eye, Vec3d::Zero(), 0.004, 8, 8);
      const double seen = mean_colour(trace_image(scene, camera, samples(1024))).x();
      const BrdfSample table =
          sample_brdf(brdf_table(), static_cast<float>(std::cos(slope)), roughness);
      EXPECT_NEAR(seen, table.scale + table.bias, 4e-3) << roughness << " " << slope;
      EXPECT_LE(seen, 1 + 1e-3);
    }
}

// The same with Fresnel and a diffuse part: F0 scale + bias + albedo.
TEST(PathTracer, LobesAddAsTheModelSays) {
  for (const float roughness : {0.25f, 0.7f}) {
    TraceScene scene =
        scene_of(square(3), constant_material(Vec3f(0.2f, 0.4f, 0.6f), roughness, 0.04f));
    scene.set_environment(even_light(1));
    const Camera camera = look_at(Vec3d(2, 0, 3), Vec3d::Zero(), 0.004, 8, 8);
    const Vec3d seen = mean_colour(trace_image(scene, camera, samples(1024)));
    const BrdfSample table = sample_brdf(brdf_table(), 3 / std::sqrt(13.0f), roughness);
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(seen[c], 0.2 * (c + 1) + 0.04 * table.scale + table.bias, 3e-3);
  }
}

// Sampling and evaluation agree: the mean of f cos / density over samples of the lobe is the same
// as over uniform directions.
TEST(PathTracer, LightSamplesAndSurfaceSamplesAgree) {
  // A light that is bright in one place: light samples find it, surface samples hardly do.
  Image sun(64, 32, 3, 0.2f);
  for (int c = 0; c < 3; ++c) sun.at(60, 12)[c] = 300;
  Image plain(64, 32, 3, 0.0f);
  plain.at(60, 12)[0] = 300;
  TraceScene scene = scene_of(square(3), constant_material(Vec3f::Constant(0.5f), 0.4f, 0.2f));
  const Camera camera = look_at(Vec3d(1, 1, 3), Vec3d::Zero(), 0.004, 4, 4);
  // Reference: quadrature of the model over the sphere of texels, written out here.
  const Vec3d view = Vec3d(1, 1, 3).normalized();
  const auto model = [&](const Vec3d& light) {
    if (light.z() <= 0) return 0.0;
    const Vec3d h = (light + view).normalized();
    const double a2 = std::pow(0.16, 2), nl = light.z(), nv = view.z();
    const double d = a2 / (std::numbers::pi * std::pow(h.z() * h.z() * (a2 - 1) + 1, 2));
    const double g =
        2 * nl * nv /
        (nl * std::sqrt(a2 + (1 - a2) * nv * nv) + nv * std::sqrt(a2 + (1 - a2) * nl * nl));
    const double f = 0.2 + 0.8 * std::pow(1 - view.dot(h), 5);
    return (0.5 / std::numbers::pi + d * g * f / (4 * nl * nv)) * nl;
  };
  for (const Image* light : {&sun, &plain}) {
    double expected = 0;
    constexpr int kFine = 24;
    for (int y = 0; y < 32 * kFine; ++y)
      for (int x = 0; x < 64 * kFine; ++x) {
        const double theta = std::numbers::pi * (y + 0.5) / (32 * kFine);
        const double phi = 2 * std::numbers::pi * ((x + 0.5) / (64 * kFine) - 0.5);
        const Vec3d d(std::sin(theta) * std::sin(phi), std::cos(theta),
                      -std::sin(theta) * std::cos(phi));
        const double solid = 2 * std::pow(std::numbers::pi / (32 * kFine), 2) / 2 * std::sin(theta);
        expected += light->at(x / kFine, y / kFine)[0] * model(d) * solid;
      }
    scene.set_environment(std::make_shared<EnvironmentSampler>(*light));
    const double seen = mean_colour(trace_image(scene, camera, samples(4096))).x();
    EXPECT_NEAR(seen / expected, 1, 5e-3);
  }
}

// A Lambert patch under one point light: albedo / pi * intensity * cosine / distance^2, at every
// pixel; and a sphere, whose vertex normals are smooth.
TEST(PathTracer, PatchUnderAPointLight) {
  TraceScene scene = scene_of(square(3), lambert(Vec3f(0.8f, 0.5f, 0.2f)));
  const Vec3d lamp(0.7, 0.4, 1.5);
  scene.set_point_lights({{lamp.cast<float>(), Vec3f(2, 3, 4)}});
  const Camera camera = front(16, 0.4);
  const Image image = trace_image(scene, camera, samples(64));
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 16; ++x) {
      const Vec3d p((x + 0.5 - 8) / camera.fx * 4, -(y + 0.5 - 8) / camera.fy * 4, 0);
      const Vec3d way = lamp - p;
      const double irradiance = way.normalized().z() / way.squaredNorm();
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR(image.at(x, y)[c], (0.8 - 0.3 * c) / std::numbers::pi * (2 + c) * irradiance,
                    1e-3);
    }
}

TEST(PathTracer, SphereUnderAPointLight) {
  TraceScene scene = scene_of(sphere(1, 96), lambert(Vec3f::Ones()));
  const Vec3d lamp(6, 3, 2);
  scene.set_point_lights({{lamp.cast<float>(), Vec3f::Constant(60)}});
  const Camera camera = front(48);
  const Image image = trace_image(scene, camera, samples(16));
  const Planes gbuffer = trace_gbuffer(scene, camera);
  int lit = 0, dark = 0;
  for (int i = 0; i < 48 * 48; ++i) {
    if (gbuffer.plane(kAlpha)[i] == 0 || image.data[4 * i + 3] < 1) continue;
    const Vec3d n(gbuffer.plane(kNormal)[i], gbuffer.plane(kNormal + 1)[i],
                  gbuffer.plane(kNormal + 2)[i]);
    const Vec3d way = lamp - n;
    const double expected =
        60 / std::numbers::pi * std::max(0.0, n.dot(way.normalized())) / way.squaredNorm();
    EXPECT_NEAR(image.data[4 * i], expected, 0.006) << i;
    (expected > 0.01 ? lit : dark) += 1;
  }
  EXPECT_GT(lit, 200);
  EXPECT_GT(dark, 200);
}

// A sphere under light of spherical harmonics up to order 2: irradiance is the harmonic series with
// the clamped cosine's factors pi, 2 pi / 3, pi / 4 (Ramamoorthi and Hanrahan 2001).
TEST(PathTracer, SphereUnderHarmonicLight) {
  const auto light = [](const Vec3d& d, double band1, double band2) {
    return 1.0 + band1 * (0.4 * d.x() + 0.3 * d.y()) +
           band2 * (0.3 * (3 * d.z() * d.z() - 1) / 2 + 0.35 * d.x() * d.y());
  };
  Image image(256, 128, 3);
  for (int y = 0; y < 128; ++y)
    for (int x = 0; x < 256; ++x) {
      const double theta = std::numbers::pi * (y + 0.5) / 128,
                   phi = 2 * std::numbers::pi * ((x + 0.5) / 256 - 0.5);
      const Vec3d d(std::sin(theta) * std::sin(phi), std::cos(theta),
                    -std::sin(theta) * std::cos(phi));
      for (int c = 0; c < 3; ++c) image.at(x, y)[c] = static_cast<float>(light(d, 1, 1));
    }
  TraceScene scene = scene_of(sphere(1, 96), lambert(Vec3f::Ones()));
  scene.set_environment(std::make_shared<EnvironmentSampler>(image));
  const Camera camera = front(24, 0.3);
  const Image seen = trace_image(scene, camera, samples(512));
  const Planes gbuffer = trace_gbuffer(scene, camera);
  double worst = 0;
  for (int i = 0; i < 24 * 24; ++i) {
    if (gbuffer.plane(kAlpha)[i] == 0 || seen.data[4 * i + 3] < 1) continue;
    const Vec3d n(gbuffer.plane(kNormal)[i], gbuffer.plane(kNormal + 1)[i],
                  gbuffer.plane(kNormal + 2)[i]);
    worst = std::max(worst, std::abs(seen.data[4 * i] - light(n, 2.0 / 3, 0.25)));
  }
  EXPECT_LT(worst, 0.02);
}

// The error of N independent samples falls as 1 / sqrt(N) or faster.
TEST(PathTracer, ConvergesAsItShould) {
  TraceScene scene = scene_of(sphere(1, 32), constant_material(Vec3f::Constant(0.6f), 0.4f, 0.05f));
  scene.add_mesh(square(4, -1.2), 0, "wall");
  scene.commit();
  scene.set_environment(light_of("studio"));
  const Camera camera = front(16);
  TraceOptions options = samples(2048);
  options.seed = 77;
  const Image reference = trace_image(scene, camera, options);
  double previous = 0;
  for (const int count : {2, 8, 32, 128}) {
    const double error = root_mean_square(trace_image(scene, camera, samples(count)), reference);
    if (previous > 0) {
      EXPECT_LT(error, 0.62 * previous) << count;
    }
    previous = error;
  }
  // And to the same image: the mean over pixels is far more exact than one pixel.
  const Vec3d a = mean_colour(trace_image(scene, camera, samples(512))), b = mean_colour(reference);
  EXPECT_NEAR((a - b).norm() / b.norm(), 0, 2e-3);
}

// Lights add: the sum of one-light images is the image under all of them, sample by sample.
TEST(PathTracer, LightIsLinear) {
  TraceScene scene =
      scene_of(sphere(1, 32), constant_material(Vec3f(0.7f, 0.5f, 0.3f), 0.3f, 0.1f));
  scene.add_mesh(square(4, -1.2), 0, "wall");
  scene.commit();
  const std::vector<StageLight> lights = {{Vec3f(3, 2, 3), Vec3f(20, 10, 5)},
                                          {Vec3f(-3, 1, 2), Vec3f(4, 8, 12)},
                                          {Vec3f(0, 4, 1), Vec3f(9, 9, 9)}};
  const Camera camera = front(24, 0.7);
  scene.set_point_lights(lights);
  const Image all = trace_image(scene, camera, samples(16));
  Image sum(24, 24, 4);
  for (const StageLight& light : lights) {
    scene.set_point_lights({light});
    const Image one = trace_image(scene, camera, samples(16));
    for (size_t i = 0; i < sum.data.size(); ++i) sum.data[i] += one.data[i];
  }
  for (size_t i = 0; i < sum.data.size(); ++i)
    if (i % 4 != 3) {
      ASSERT_NEAR(sum.data[i], all.data[i], 1e-5 * (1 + all.data[i])) << i;
    }
  // Many lights: one is chosen at each point, of very many from some of them; the same image on
  // average.
  for (const int copies : {4, 17}) {
    std::vector<StageLight> many;
    for (int i = 0; i < copies; ++i)
      for (StageLight light : lights) {
        light.intensity /= static_cast<float>(copies);
        many.push_back(light);
      }
    scene.set_point_lights(many);
    const Vec3d chosen = mean_colour(trace_image(scene, camera, samples(256)));
    EXPECT_LT((chosen - mean_colour(all)).norm() / chosen.norm(), 0.01) << copies;
  }
}

// Shadows against every triangle in double precision.
TEST(PathTracer, ShadowsAreWhereTheBlockersAre) {
  TraceScene scene = scene_of(square(3), lambert(Vec3f::Ones()));
  Mesh soup;
  Random random(5);
  for (int i = 0; i < 40; ++i) {
    const Vec3d centre(random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5),
                       random.uniform(0.3, 1.0));
    for (int k = 0; k < 9; ++k)
      soup.vertices.push_back(static_cast<float>(centre[k % 3] + random.uniform(-0.4, 0.4)));
    soup.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  scene.add_mesh(soup, 0, "soup");
  scene.commit();
  const Vec3d lamp(0.4, -0.3, 3);
  scene.set_point_lights({{lamp.cast<float>(), Vec3f::Constant(9)}});
  int shadowed = 0, lit = 0;
  for (int i = 0; i < 3000; ++i) {
    const Vec3d p(random.uniform(-2, 2), random.uniform(-2, 2), 1e-4);
    bool blocked = false;
    double margin = 1;
    for (const Vec3i& t : soup.triangles) {
      const Vec3d a = soup.vertex(t[0]).cast<double>(), e1 = soup.vertex(t[1]).cast<double>() - a,
                  e2 = soup.vertex(t[2]).cast<double>() - a, d = lamp - p;
      const Vec3d q = d.cross(e2), s = p - a, r = s.cross(e1);
      const double det = e1.dot(q), b = s.dot(q) / det, c = d.dot(r) / det, w = e2.dot(r) / det;
      margin = std::min({margin, std::abs(b), std::abs(c), std::abs(1 - b - c)});
      blocked |= b > 0 && c > 0 && b + c < 1 && w > 0 && w < 1;
    }
    if (margin < 1e-5) continue;
    const Vec3d way = lamp - p;
    const float passed = scene.transmittance(p.cast<float>(), way.normalized().cast<float>(),
                                             static_cast<float>(way.norm()));
    ASSERT_EQ(passed, blocked ? 0.0f : 1.0f);
    (blocked ? shadowed : lit) += 1;
  }
  EXPECT_GT(shadowed, 200);
  EXPECT_GT(lit, 200);
  // Unshadowed transport knows no blockers: the plate behind the soup is as bright as without.
  TraceOptions plain = samples(4);
  plain.transport = Transport::kUnshadowed;
  TraceScene alone = scene_of(square(3), lambert(Vec3f::Ones()));
  alone.set_point_lights({{lamp.cast<float>(), Vec3f::Constant(9)}});
  const Image with = trace_image(scene, front(32), plain),
              without = trace_image(alone, front(32), plain);
  const Planes gbuffer = trace_gbuffer(scene, front(32));
  int compared = 0;
  for (int i = 0; i < 32 * 32; ++i) {
    const double depth = gbuffer.plane(kDepth)[i];
    if (std::abs(depth - 4) > 1e-3 || std::abs(with.data[4 * i] - without.data[4 * i]) > 1e-2)
      continue;
    ++compared;
  }
  EXPECT_GT(compared, 300);
}

// Hair cards: two half-open sheets before a white wall let a quarter of the light through.
TEST(PathTracer, OpacityDimsLightAndView) {
  SurfaceMaterial card = lambert(Vec3f::Zero());
  card.opacity = Image(1, 1, 1, 0.5f);
  TraceScene scene = scene_of(square(3), lambert(Vec3f::Ones()));
  const int half = scene.add_material(card, "card");
  scene.add_mesh(square(3, 0.5), half, "card");
  scene.add_mesh(square(3, 1.0), half, "card");
  scene.commit();
  EXPECT_FLOAT_EQ(scene.transmittance(Vec3f(0.1f, 0.2f, 0.01f), Vec3f(0, 0, 1), 10), 0.25f);
  EXPECT_FLOAT_EQ(scene.transmittance(Vec3f(0.1f, 0.2f, 0.01f), Vec3f(0, 0, 1), 0.7f), 0.5f);
  scene.set_point_lights({{Vec3f(0, 0, 3), Vec3f::Constant(9)}});
  const double open = [] {
    TraceScene wall = scene_of(square(3), lambert(Vec3f::Ones()));
    wall.set_point_lights({{Vec3f(0, 0, 3), Vec3f::Constant(9)}});
    return mean_colour(trace_image(wall, front(16, 0.3), samples(64))).x();
  }();
  const Image image = trace_image(scene, front(16, 0.3), samples(1024));
  EXPECT_NEAR(mean_colour(image).x(), open / 16, 0.01 * open);
  EXPECT_EQ(image.data[3], 1);  // the wall stands behind
}

// One seed, one image, whatever the threads; another seed, another noise.
TEST(PathTracer, TheSameBitsForAnyThreadCount) {
  TraceScene scene = scene_of(sphere(1, 16), constant_material(Vec3f::Constant(0.6f), 0.3f, 0.1f));
  scene.set_environment(light_of("sunset"));
  const int before = thread_count();
  std::vector<Image> images;
  for (const int threads : {1, 2, 5}) {
    set_thread_count(threads);
    images.push_back(trace_image(scene, front(40), samples(8)));
  }
  TraceOptions other = samples(8);
  other.seed = 2;
  images.push_back(trace_image(scene, front(40), other));
  set_thread_count(before);
  EXPECT_EQ(images[0].data, images[1].data);
  EXPECT_EQ(images[0].data, images[2].data);
  EXPECT_NE(images[0].data, images[3].data);
}

// The light turns as the prefilter's does.
TEST(PathTracer, TurningTheLightTurnsTheSphere) {
  TraceScene scene = scene_of(sphere(1, 48), lambert(Vec3f::Ones()));
  const double turn = 0.8;
  scene.set_environment(light_of("sunset"));
  const Vec3d eye(0, 0, 4);
  const Mat3d about = Eigen::AngleAxisd(turn, Vec3d::UnitY()).toRotationMatrix();
  const Image still = trace_image(
      scene, look_at(about.transpose() * eye, Vec3d::Zero(), 0.4, 24, 24), samples(256));
  scene.set_environment(light_of("sunset", turn));
  const Image turned = trace_image(scene, look_at(eye, Vec3d::Zero(), 0.4, 24, 24), samples(256));
  EXPECT_LT(root_mean_square(still, turned), 0.02);
}

// A surface in even light sees the share of it that its neighbours leave.
TEST(PathTracer, IrradianceIsTheShareOfLightThatArrives) {
  TraceScene scene = scene_of(sphere(1, 24), lambert(Vec3f::Ones()));
  scene.set_environment(even_light(2));
  for (const float value : vertex_irradiance(scene, 0, 128, 1)) EXPECT_NEAR(value, 0.5, 0.09);
  // One lamp: vertices see it or not. Two equal ones on opposite sides: half.
  scene.set_environment(nullptr);
  scene.set_point_lights({{Vec3f(50, 0, 0), Vec3f::Ones()}});
  const std::vector<float> one = vertex_irradiance(scene, 0, 1, 1);
  const std::vector<float>& p = scene.vertices(0);
  for (size_t v = 0; v < one.size(); v += 3)
    if (std::abs(p[v]) > 0.1f) {
      EXPECT_EQ(one[v], p[v] > 0 ? 1.0f : 0.0f);
    }
}

// Of very many lights only some are asked, which changes nothing on average.
TEST(PathTracer, IrradianceOfVeryManyLightsIsUnbiased) {
  TraceScene scene = scene_of(sphere(1, 24), lambert(Vec3f::Ones()));
  std::vector<StageLight> lights;
  Random random(3);
  for (int i = 0; i < 150; ++i) {
    const Vec3d d = Vec3d(random.normal(), random.normal(), random.normal()).normalized();
    lights.push_back({(40 * d).cast<float>(),
                      Vec3f::Constant(static_cast<float>(random.uniform(1, i % 10 ? 2 : 9)))});
  }
  scene.set_point_lights(lights);
  const std::vector<float> sampled = vertex_irradiance(scene, 0, 1, 1);
  const std::vector<float>&p = scene.vertices(0), &n = scene.normals(0);
  double mean = 0, worst = 0;
  for (size_t v = 0; v < p.size(); v += 3) {
    double seen = 0, sent = 0;
    for (const StageLight& light : lights) {
      const Vec3f way = light.position - Vec3f(&p[v]);
      const double amount = static_cast<double>(light.intensity.x() / way.squaredNorm());
      sent += amount;
      const Vec3f origin = Vec3f(&p[v]) + 10 * scene.offset() * Vec3f(&n[v]);
      seen +=
          amount * static_cast<double>(scene.transmittance(origin, way.normalized(), way.norm()));
    }
    const double error = static_cast<double>(sampled[v]) - seen / sent;
    mean += 3 * error / static_cast<double>(p.size());
    worst = std::max(worst, std::abs(error));
  }
  EXPECT_LT(std::abs(mean), 0.005);
  EXPECT_LT(worst, 0.2);
}

TEST(PathTracer, LayersShowWhatIsThere) {
  TraceScene scene =
      scene_of(sphere(1, 64), constant_material(Vec3f(0.1f, 0.2f, 0.3f), 0.4f, 0.05f));
  scene.add_mesh(square(4, -1), 0, "wall");
  scene.commit();
  const Camera camera = front(64);
  const SurfaceLayers layers = trace_layers(scene, camera, 64, 1);
  const size_t centre = 32 * 64 + 32, corner = 2;
  EXPECT_NEAR(layers.gbuffer.plane(kDepth)[centre], 3, 2e-3);
  EXPECT_NEAR(layers.gbuffer.plane(kDepth)[corner], 5, 1e-3);
  EXPECT_NEAR(layers.gbuffer.plane(kNormal + 2)[centre], 1, 1e-2);
  EXPECT_EQ(layers.part[centre], 1);
  EXPECT_EQ(layers.part[corner], 257);
  EXPECT_NEAR(layers.albedo.data[3 * centre + 2], 0.3, 1e-6);
  EXPECT_NEAR(layers.material.data[3 * centre], 0.4, 1e-6);
  EXPECT_NEAR(layers.material.data[3 * centre + 1], 0.05, 1e-6);
  EXPECT_NEAR(layers.material.data[3 * centre + 2], 1, 1e-6);
  // On the wall a cosine-weighted share of the sphere's solid angle is missing: below its middle,
  // a unit sphere that touches the wall hides everything; far out little.
  EXPECT_GT(layers.material.data[3 * corner + 2], 0.7);
  EXPECT_LT(layers.material.data[3 * corner + 2], 1);
}

TEST(PathTracer, RefusesWhatCannotBeTraced) {
  using test::contains;
  using test::error_of;
  TraceScene scene = scene_of(sphere(1, 8), lambert(Vec3f::Ones()));
  EXPECT_TRUE(contains(error_of([&] { trace_image(scene, front(4), samples(1)); }), "no light"));
  scene.set_environment(even_light(0));
  EXPECT_TRUE(contains(error_of([&] { trace_image(scene, front(4), samples(1)); }), "no light"));
  scene.set_environment(even_light(1));
  const Camera inside = look_at(Vec3d(0, 0, 0.3), Vec3d::Zero(), 0.5, 4, 4);
  EXPECT_TRUE(contains(error_of([&] { trace_image(scene, inside, samples(1)); }), "inside a mesh"));
  std::vector<float> broken = scene.vertices(0);
  broken[7] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(contains(error_of([&] { scene.pose(0, broken); }), "vertex 2"));
  SurfaceMaterial textured = lambert(Vec3f::Ones());
  textured.roughness = Image(4, 4, 1, 0.5f);
  const int material = scene.add_material(textured, "t");
  EXPECT_TRUE(contains(error_of([&] { scene.add_mesh(sphere(1, 4), material, "ball"); }),
                       "no texture coord"));
  textured.roughness.data[3] = 2;
  EXPECT_TRUE(contains(error_of([&] { scene.add_material(textured, "t"); }), "roughness"));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(scene.set_point_lights({{Vec3f(nan, 0, 0), Vec3f::Ones()}}), Error);
  EXPECT_THROW(TraceScene().commit(), Error);
  EXPECT_THROW(trace_image(scene, front(4), samples(0)), Error);
}

// Pixels left out are those no ray of which meets anything; hardly more are traced.
TEST(PathTracer, LeavesOutOnlyEmptyPixels) {
  TraceScene scene = scene_of(sphere(0.4, 12, Vec3d(0.1, 0, 0)), lambert(Vec3f::Ones()));
  Camera camera = front(48);
  camera.cx += 9.3;
  camera.cy -= 11.6;
  const std::vector<char> seen = scene.seen_pixels(camera);
  const CameraRays rays(camera);
  Random random(3);
  int hit = 0, traced = 0;
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 48; ++x) {
      bool meets = false;
      for (int k = 0; k < 64; ++k)
        meets |=
            scene.closest(rays.origin(), rays.direction(x + random.uniform(), y + random.uniform()))
                .triangle >= 0;
      hit += meets;
      traced += seen[static_cast<size_t>(48 * y + x)];
      ASSERT_TRUE(!meets || seen[static_cast<size_t>(48 * y + x)]) << x << " " << y;
    }
  EXPECT_GT(hit, 100);
  EXPECT_LT(traced, 1.5 * hit);
  // A surface that reaches beside and behind the camera may be anywhere; one behind it is nowhere.
  scene = scene_of(square(9), lambert(Vec3f::Ones()));
  for (const bool across : {true, false}) {
    const Camera inside = across ? look_at(Vec3d(0, 0.1, 0.5), Vec3d(9, 0.1, 0.5), 0.5, 8, 8)
                                 : look_at(Vec3d(0, 0, 4), Vec3d(0, 0, 9), 0.5, 8, 8);
    for (const char s : scene.seen_pixels(inside)) EXPECT_EQ(s != 0, across);
  }
}

}  // namespace
}  // namespace effigy
