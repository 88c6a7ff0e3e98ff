// Translucent surfaces: energy, closed forms, quadrature.

#include "effigy/synth/subsurface.h"

#include <gtest/gtest.h>

#include "effigy/base/error.h"
#include "effigy/synth/path_tracer.h"
#include "shapes.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
const Vec3f kRadius(0.03f, 0.02f, 0.01f);
const Vec3f kAlbedo(0.8f, 0.5f, 0.3f);

SurfaceMaterial translucent(const Vec3f& radius) {
  SurfaceMaterial material = constant_material(kAlbedo, 1, 0);
  material.specular_lobe = false;
  material.scatter_radius = radius;
  return material;
}

TraceScene scene_of(const Mesh& mesh, const SurfaceMaterial& material) {
  TraceScene scene;
  scene.add_mesh(mesh, scene.add_material(material, "material"), "mesh");
  scene.commit();
  return scene;
}

// Mean colour of a narrow view from `eye` on `target`.
Vec3d seen(const TraceScene& scene, const Vec3d& eye, const Vec3d& target, int samples = 1024) {
  TraceOptions options;
  options.samples = samples;
  options.bounces = 1;
  const Image image = trace_image(scene, look_at(eye, target, 1e-4, 8, 8), options);
  Vec3d sum = Vec3d::Zero();
  for (size_t i = 0; i < 64; ++i) sum += Eigen::Map<const Vec3f>(&image.data[4 * i]).cast<double>();
  return sum / 64;
}

// A light so far away that its irradiance along its direction is 1.
StageLight far_light(const Vec3f& towards) {
  return {1000 * towards, Vec3f::Constant(1e6f)};
}

double profile(double r, double d) {
  return (std::exp(-r / d) + std::exp(-r / (3 * d))) / (8 * kPi * d * r);
}

TEST(ScatterProfile, IntegratesToOneAndIsSampledByItsDensity) {
  const ScatterProfile scatter(kRadius);
  Vec3d sum = Vec3d::Zero();
  const int steps = 200000;
  const double step = scatter.reach() / steps;
  for (int i = 0; i < steps; ++i) {
    const double r = (i + 0.5) * step;
    sum += 2 * kPi * r * step * scatter.value(static_cast<float>(r)).cast<double>();
    if (i % 20000 == 0) {
      EXPECT_NEAR(scatter.value(static_cast<float>(r))[1], profile(r, kRadius[1]),
                  1e-4 * profile(r, kRadius[1]));
    }
  }
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c], 1, 1e-3);
  // The share of samples within a radius is the density's integral over the disc.
  int within = 0;
  const int grid = 512;
  for (int i = 0; i < grid; ++i)
    for (int k = 0; k < grid; ++k)
      within += scatter.sample({(i + 0.5f) / grid, (k + 0.5f) / grid}) < 0.03f;
  double expected = 0;
  for (int c = 0; c < 3; ++c)
    expected += (1 - 0.25 * std::exp(-0.03 / kRadius[c]) - 0.75 * std::exp(-0.01 / kRadius[c])) / 3;
  EXPECT_NEAR(within / double(grid * grid), expected, 2e-3);
}

// On a sphere the area within a chord's length is that of the plane's disc, so that nothing is lost
// to curvature: even light gives albedo times the light.
TEST(Subsurface, KeepsItsEnergyInEvenLight) {
  TraceScene scene = scene_of(test::sphere(1, 96), translucent(kRadius));
  scene.set_environment(std::make_shared<EnvironmentSampler>(Image(8, 4, 3, 0.7f)));
  const Vec3d colour = seen(scene, {0, 0, 4}, Vec3d::Zero());
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(colour[c], 0.7 * kAlbedo[c], 4e-3);
}

// The edge of a sphere's lit half is blurred as the double integral says.
TEST(Subsurface, BlursTheTerminator) {
  TraceScene scene = scene_of(test::sphere(1, 192), translucent(kRadius));
  scene.set_point_lights({far_light(Vec3f::UnitX())});
  for (const double angle : {60.0, 85.0, 92.0}) {  // between light and normal
    const double theta = angle * kPi / 180;
    const Vec3d normal(std::cos(theta), 0, std::sin(theta));
    const Vec3d colour = seen(scene, 3 * normal, Vec3d::Zero(), 4096);
    for (int c = 0; c < 3; ++c) {
      double sum = 0;
      const int steps = 3000, turns = 180;
      const double most = 0.66;
      for (int i = 0; i < steps; ++i) {
        const double g = (i + 0.5) * most / steps;
        double lit = 0;
        for (int k = 0; k < turns; ++k)
          lit += std::max(0.0, std::cos(g) * std::cos(theta) +
                                   std::sin(g) * std::sin(theta) * std::cos(2 * kPi * k / turns));
        sum += profile(2 * std::sin(g / 2), kRadius[c]) * std::sin(g) * (most / steps) *
               (2 * kPi / turns) * lit;
      }
      const double expected = kAlbedo[c] / kPi * sum;
      EXPECT_NEAR(colour[c], expected, 0.015 * expected + 3e-4) << angle << " " << c;
    }
  }
}

// A sheet lit from behind glows by the profile's integral beyond its thickness.
TEST(Subsurface, ShinesThroughAThinSheet) {
  const float thickness = 0.03f, half = 2;
  Mesh sheet;
  for (const float z : {0.0f, -thickness})
    for (const auto& [x, y] : {std::pair{-half, -half}, {half, -half}, {half, half}, {-half, half}})
      for (const float v : {x, y, z}) sheet.vertices.push_back(v);
  sheet.triangles = {{0, 1, 2}, {0, 2, 3}, {4, 6, 5}, {4, 7, 6}};
  TraceScene scene = scene_of(sheet, translucent(kRadius));
  scene.set_point_lights({far_light(-Vec3f::UnitZ())});
  const Vec3d colour = seen(scene, {0.1, 0, 2}, {0.1, 0, 0}, 4096);
  for (int c = 0; c < 3; ++c) {
    const double t = thickness / kRadius[c];
    const double expected = kAlbedo[c] / kPi * (0.25 * std::exp(-t) + 0.75 * std::exp(-t / 3));
    EXPECT_NEAR(colour[c], expected, 0.02 * expected + 1e-4) << c;
  }
  // Opaque, it is black.
  scene = scene_of(sheet, translucent(Vec3f::Zero()));
  scene.set_point_lights({far_light(-Vec3f::UnitZ())});
  EXPECT_EQ(seen(scene, {0.1, 0, 2}, {0.1, 0, 0}, 16).maxCoeff(), 0);
}

// A map says where; a short radius is Lambert; nonsense is refused.
TEST(Subsurface, ScatterMapAndLimits) {
  const Mesh ball = test::sphere(1, 48);
  SurfaceMaterial masked = translucent(kRadius);
  masked.scatter = Image(1, 1, 1, 0.0f);
  Vec3d colours[3];
  int k = 0;
  for (const SurfaceMaterial& material :
       {translucent(Vec3f::Zero()), translucent(Vec3f::Constant(1e-4f)), masked}) {
    TraceScene scene = scene_of(ball, material);
    scene.set_point_lights({far_light(Vec3f(0.6f, 0, 0.8f))});
    colours[k++] = seen(scene, {0, 0, 4}, Vec3d::Zero());
  }
  EXPECT_LT((colours[1] - colours[0]).norm(), 0.01 * colours[0].norm());
  EXPECT_LT((colours[2] - colours[0]).norm(), 1e-6);
  TraceScene scene;
  EXPECT_THROW(scene.add_material(translucent({0.1f, 0, 0.1f}), "x"), Error);
  EXPECT_THROW(scene.add_material(translucent({-1, 1, 1}), "x"), Error);
  masked.scatter = Image(1, 1, 1, 2.0f);
  EXPECT_THROW(scene.add_material(masked, "x"), Error);
}

}  // namespace
}  // namespace effigy
