#include "effigy/body/losses.h"

#include <cmath>

#include "effigy/base/random.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

TEST(BodyLosses, BoundsCostWhatTheAppendixSays) {
  EXPECT_EQ(bound_cost(0.005, 1e-4, 1e-2, true).cost, 0.0);
  EXPECT_DOUBLE_EQ(bound_cost(0.03, 1e-4, 1e-2, true).cost, 4e-4);
  EXPECT_DOUBLE_EQ(bound_cost(0.03, 1e-4, 1e-2, true).slope, 0.04);
  EXPECT_DOUBLE_EQ(bound_cost(5e-5, 1e-4, 1e-2, true).cost, 2.0);
  EXPECT_DOUBLE_EQ(bound_cost(5e-5, 1e-4, 1e-2, false).cost, 2e4);
  EXPECT_DOUBLE_EQ(bound_cost(0.0, 1e-4, 1e-2, false).cost, 1e7);
  for (const double value : {2e-5, 7e-5, 0.02, 0.5})
    for (const bool relative : {true, false}) {
      const double step = 1e-3 * value;
      const double measured = (bound_cost(value + step, 1e-4, 1e-2, relative).cost -
                               bound_cost(value - step, 1e-4, 1e-2, relative).cost) /
                              (2 * step);
      const double slope = bound_cost(value, 1e-4, 1e-2, relative).slope;
      EXPECT_NEAR(measured, slope, 1e-4 * std::abs(slope));
    }
}

// A drawn ball and what it should have been.
struct Scene {
  Mesh mesh = test::ball_rig().mesh;
  UvTexels texels = uv_texels(mesh, 6);
  BodySurface surface;
  std::vector<float> decoded;
  Camera camera = look_at(Vec3d(0, 0, 0.6), Vec3d::Zero(), 0.5, 24, 24);
  BodyLight light;
  BodyTarget target;
  CameraColour colour{{1.1f, 0.9f, 1.0f}, {0.02f, -0.01f, 0.0f}};
  BodyTrainSettings settings = BodyTrainSettings::from_preset("quick");

  Scene() {
    Random random(4, 1);
    const size_t n = texels.count();
    decoded.resize(n * GaussianChannels::kCount);
    for (float& value : decoded) value = static_cast<float>(0.1 * random.normal());
    place_gaussians(texels, texel_frames(texels, mesh.vertices, mesh.triangles), decoded,
                    surface.placed);
    for (float& s : surface.placed.scale) s = 0.2f;
    for (float& o : surface.placed.opacity) o = 0.2f;
    surface.albedo.assign(3 * n, 0.5f);
    surface.roughness.assign(n, 0.2f);
    surface.visibility.assign(n, 0.3f);
    surface.shadow.assign(n, 0.8f);
    PointLights points;
    points.lights = {{Vec3f(1, 2, 3), Vec3f(1.5f, 1.4f, 1.2f), false}};
    light = body_light(points);
    target.image = Planes(24, 24, 3);
    for (float& v : target.image.data) v = static_cast<float>(random.uniform());
    target.mask.assign(24 * 24, 0.0f);
    for (size_t p = 0; p < target.mask.size(); ++p) target.mask[p] = p % 24 > 8 ? 1.0f : 0.0f;
    target.background = Planes(24, 24, 3, 0.1f);
    settings.weights.alpha_sparsity = 0.3;
    settings.perceptual = "vgg";
    settings.weights.lpips = 2;
  }

  double total(const BodyLossValues& values) const {
    const BodyWeights& w = settings.weights;
    const std::map<std::string, double> weights = {{"l1", w.l1},
                                                   {"dssim", w.dssim},
                                                   {"pyramid", w.pyramid},
                                                   {"lpips", w.lpips},
                                                   {"features", w.features},
                                                   {"mask", w.mask},
                                                   {"alpha_sparsity", w.alpha_sparsity},
                                                   {"scale", w.scale},
                                                   {"offset", w.offset},
                                                   {"normal", 0.7},
                                                   {"bound", w.bound},
                                                   {"transfer", w.transfer},
                                                   {"albedo", w.albedo},
                                                   {"neg_color", w.neg_color}};
    double sum = 0;
    for (const auto& [name, value] : values) sum += weights.at(name) * value;
    return sum;
  }
};

struct Result {
  double loss = 0;
  BodySurfaceGradients surface;
  BodyImageGradients image;
  std::vector<float> decoded;
};

// Stands for a network: mean of the squared differences of neighbouring pixels' differences.
double edge_distance(const Planes& drawn, const Planes& target, float weight, Planes& d_drawn) {
  double sum = 0;
  const size_t count = drawn.data.size() - 1;
  for (size_t i = 0; i < count; ++i) {
    const float edge = drawn.data[i + 1] - drawn.data[i] - target.data[i + 1] + target.data[i];
    sum += static_cast<double>(edge * edge) / static_cast<double>(count);
    d_drawn.data[i + 1] += 2 * weight * edge / static_cast<float>(count);
    d_drawn.data[i] -= 2 * weight * edge / static_cast<float>(count);
  }
  return sum;
}

Result run(const Scene& scene) {
  BodyPicture picture;
  BodyDrawOptions options;
  picture.draw(scene.camera, scene.surface, scene.light, options);
  Result result;
  const size_t n = scene.texels.count();
  result.surface.clear(n);
  result.decoded.assign(n * GaussianChannels::kCount, 0.0f);
  std::vector<float> d_diffuse(3 * n);
  BodyLossValues values =
      body_image_losses(scene.settings, scene.target, scene.colour, picture, result.image,
                        scene.settings.perceptual == "none" ? PictureDistance() : edge_distance);
  values.merge(body_texel_losses(scene.settings, 0.7, scene.decoded, scene.surface,
                                 picture.diffuse(), result.decoded, result.surface, d_diffuse));
  picture.backward(scene.camera, scene.surface, scene.light, options,
                   {&result.image.radiance, result.image.alpha, d_diffuse, 0}, result.surface);
  result.loss = scene.total(values);
  return result;
}

void check(const char* name, const std::function<std::vector<float>&(Scene&)>& values,
           const std::function<const std::vector<float>&(const Result&)>& gradient, float step) {
  const Scene scene;
  const Result result = run(scene);
  Random random(8, 3);
  for (int trial = 0; trial < 3; ++trial) {
    Scene ends[2] = {scene, scene};
    double along = 0, size = 0;
    for (size_t i = 0; i < values(ends[0]).size(); ++i) {
      const auto d = static_cast<float>(random.normal());
      values(ends[0])[i] -= step * d;
      values(ends[1])[i] += step * d;
      const double part = static_cast<double>(d) * static_cast<double>(gradient(result)[i]);
      along += part;
      size += std::abs(part);
    }
    const double measured =
        (run(ends[1]).loss - run(ends[0]).loss) / (2 * static_cast<double>(step));
    EXPECT_NEAR(measured, along, 0.02 * size + 1e-4) << name;
  }
}

TEST(BodyLosses, GradientsAgainstDifferences) {
  check(
      "albedo", [](Scene& s) -> std::vector<float>& { return s.surface.albedo; },
      [](const Result& r) -> const std::vector<float>& { return r.surface.albedo; }, 1e-3f);
  check(
      "opacity", [](Scene& s) -> std::vector<float>& { return s.surface.placed.opacity; },
      [](const Result& r) -> const std::vector<float>& { return r.surface.opacity; }, 3e-4f);
  check(
      "roughness", [](Scene& s) -> std::vector<float>& { return s.surface.roughness; },
      [](const Result& r) -> const std::vector<float>& { return r.surface.roughness; }, 3e-4f);
  check(
      "scale", [](Scene& s) -> std::vector<float>& { return s.surface.placed.scale; },
      [](const Result& r) -> const std::vector<float>& { return r.surface.scale; }, 3e-4f);
}

TEST(BodyLosses, CameraColoursAgainstDifferences) {
  const Scene scene;
  const Result result = run(scene);
  for (size_t c = 0; c < 3; ++c)
    for (const bool gain : {true, false}) {
      constexpr float kStep = 1e-3f;
      Scene up = scene, down = scene;
      (gain ? up.colour.gain : up.colour.offset)[c] += kStep;
      (gain ? down.colour.gain : down.colour.offset)[c] -= kStep;
      const double measured = (run(up).loss - run(down).loss) / (2 * static_cast<double>(kStep));
      const double slope = (gain ? result.image.gain : result.image.offset)[c];
      EXPECT_NEAR(measured, slope, 2e-3 + 0.01 * std::abs(slope));
    }
}

// Lambert's lobe is nowhere far below zero; one turned upside down is.
TEST(BodyLosses, DarkLobes) {
  Scene scene;
  const Vec3f direction = Vec3f(0.3f, 0.5f, 0.8f).normalized();
  BodySurfaceGradients gradients;
  gradients.clear(scene.texels.count());
  std::vector<float> zeros(scene.decoded.size());
  place_gaussians(scene.texels,
                  texel_frames(scene.texels, scene.mesh.vertices, scene.mesh.triangles), zeros,
                  scene.surface.placed);
  EXPECT_LT(dark_lobe_loss(scene.surface, direction, 1, gradients), 2e-4);
  for (float& z : scene.surface.placed.zonal) z = -z;
  gradients.clear(scene.texels.count());
  const double loss = dark_lobe_loss(scene.surface, direction, 3, gradients);
  EXPECT_GT(loss, 0.01);
  Random random(3, 3);
  BodySurface up = scene.surface, down = scene.surface;
  double along = 0;
  for (size_t i = 0; i < up.placed.zonal.size(); ++i) {
    const auto d = static_cast<float>(random.normal());
    up.placed.zonal[i] += 1e-3f * d;
    down.placed.zonal[i] -= 1e-3f * d;
    along += static_cast<double>(d) * static_cast<double>(gradients.zonal[i]);
  }
  BodySurfaceGradients unused;
  unused.clear(scene.texels.count());
  const double measured =
      3 * (dark_lobe_loss(up, direction, 1, unused) - dark_lobe_loss(down, direction, 1, unused)) /
      2e-3;
  EXPECT_NEAR(measured, along, 0.01 * std::abs(along) + 1e-5);
}

// Around the mask's edge alpha is free.
TEST(BodyLosses, NoMaskLossAtTheEdge) {
  Scene scene;
  scene.settings.weights.l1 = scene.settings.weights.dssim = scene.settings.weights.pyramid = 0;
  scene.settings.weights.alpha_sparsity = 0;
  scene.settings.perceptual = "none";
  const Result result = run(scene);
  for (size_t p = 0; p < 24 * 24; ++p) {
    const auto x = p % 24;
    const bool edge = x >= 7 && x <= 10;
    EXPECT_EQ(result.image.alpha[p] == 0.0f, edge) << x;
  }
}

}  // namespace
}  // namespace effigy
