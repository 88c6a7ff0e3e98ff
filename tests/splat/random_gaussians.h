// Random scenes for the Gaussian rasterizer's tests, one builder per kind of trouble.
#pragma once

#include "effigy/splat/gaussian_raster.h"
#include "splat/random_scenes.h"

namespace effigy {

struct GaussianScene3d {
  Camera camera;
  Gaussians gaussians;
  GaussianRasterOptions options;
};

// A Gaussian with a quaternion of random length and random features.
inline void add_gaussian(Gaussians& g, const Vec3d& center, const Mat3d& rotation,
                         const Vec3d& scale, double opacity, Random& random) {
  append3(g.center, center);
  const Eigen::Quaterniond q(rotation);
  const double length = std::exp(random.normal()) * (random.uniform() < 0.5 ? -1 : 1);
  for (const double x : {q.w(), q.x(), q.y(), q.z()})
    g.rotation.push_back(static_cast<float>(length * x));
  append3(g.scale, scale);
  g.opacity.push_back(static_cast<float>(opacity));
  for (int c = 0; c < g.channels; ++c) g.features.push_back(static_cast<float>(random.normal()));
}

inline Mat3d random_rotation(Random& random) {
  const Vec3d a = random_unit(random), b = a.cross(random_unit(random)).normalized();
  Mat3d r;
  r << a, b, a.cross(b);
  return r;
}

// `count` Gaussians in view, about `pixels` pixels a standard deviation, their three scales a
// factor of exp(+-spread) apart.
inline GaussianScene3d gaussian_soup(int width, int height, int count, double pixels, double spread,
                                     int channels, uint64_t seed) {
  Random random(seed, 5);
  GaussianScene3d scene;
  scene.camera = random_camera(width, height, random);
  scene.gaussians.channels = channels;
  for (int i = 0; i < count; ++i) {
    const double z = random.uniform(2, 4);
    const Vec3d center =
        world_at(scene.camera, random.uniform(0, width), random.uniform(0, height), z);
    const double unit = pixels * z / scene.camera.fx;
    const auto size = [&] { return unit * std::exp(spread * random.normal()); };
    const double a = size(), b = size(), c = size();
    add_gaussian(scene.gaussians, center, random_rotation(random), {a, b, c},
                 random.uniform(0.1, 1.0), random);
  }
  return scene;
}

inline GaussianScene3d plain_gaussians() {
  return gaussian_soup(27, 22, 14, 2.5, 0.5, 3, 1);
}
inline GaussianScene3d ten_channels() {
  return gaussian_soup(33, 18, 14, 2.5, 0.5, 10, 2);
}
inline GaussianScene3d odd_channels() {  // the kernels for any number
  return gaussian_soup(21, 19, 10, 2.5, 0.5, 7, 3);
}
inline GaussianScene3d one_channel() {
  GaussianScene3d scene = gaussian_soup(21, 19, 10, 2.5, 0.5, 1, 4);
  scene.options.background = {0.7f};
  return scene;
}
inline GaussianScene3d edge_on_gaussians() {  // flat ones whose normal is square to the view
  GaussianScene3d scene = gaussian_soup(26, 24, 0, 4, 0, 3, 5);
  Random random(55);
  for (int i = 0; i < 14; ++i) {
    const Vec3d center =
        world_at(scene.camera, random.uniform(3, 23), random.uniform(3, 21), random.uniform(2, 4));
    const Vec3d view = (center - scene.camera.center()).normalized();
    const Vec3d normal = (view.cross(random_unit(random)).normalized() + 0.02 * view).normalized();
    const Vec3d side = normal.cross(random_unit(random)).normalized();
    Mat3d r;
    r << side, normal.cross(side), normal;
    add_gaussian(scene.gaussians, center, r, {0.5, 0.35, 1e-4}, 0.8, random);
  }
  return scene;
}
inline GaussianScene3d needles() {  // a thousand times as long as thick
  GaussianScene3d scene = gaussian_soup(30, 28, 12, 1, 0, 3, 6);
  for (size_t i = 0; i < scene.gaussians.count(); ++i) scene.gaussians.scale[3 * i] *= 25.0f;
  for (size_t i = 0; i < scene.gaussians.count(); ++i) scene.gaussians.scale[3 * i + 1] *= 0.025f;
  return scene;
}
inline GaussianScene3d tiny_gaussians() {  // only the blur shows them
  return gaussian_soup(26, 22, 24, 0.05, 0.3, 3, 7);
}
inline GaussianScene3d stacked_gaussians() {  // opaque layers: the clamp, and pixels that finish
  GaussianScene3d scene = gaussian_soup(22, 20, 26, 6, 0.2, 3, 8);
  for (float& o : scene.gaussians.opacity) o = o < 0.5f ? 1.0f : 0.97f;
  scene.options.background = {0.2f, -0.5f, 1.5f};
  return scene;
}
inline GaussianScene3d off_screen_gaussians() {
  GaussianScene3d scene = gaussian_soup(33, 31, 0, 0, 0, 3, 9);
  Random random(99);
  for (int i = 0; i < 16; ++i) {
    const Vec3d center = world_at(scene.camera, 16 + 26 * std::cos(0.4 * i),
                                  15 + 26 * std::sin(0.4 * i), random.uniform(2, 3));
    add_gaussian(scene.gaussians, center, random_rotation(random), {0.5, 0.4, 0.2}, 0.7, random);
  }
  return scene;
}
inline GaussianScene3d huge_gaussians() {  // some much larger than the image, close to the camera
  GaussianScene3d scene = gaussian_soup(26, 22, 6, 60, 0.3, 3, 10);
  Random random(110);
  for (int i = 0; i < 3; ++i)
    add_gaussian(scene.gaussians,
                 world_at(scene.camera, random.uniform(0, 26), random.uniform(0, 22), 0.3),
                 random_rotation(random), {1e4, 1e3, 0.1}, 0.4, random);
  return scene;
}
inline GaussianScene3d behind_gaussians() {
  GaussianScene3d scene = gaussian_soup(32, 30, 8, 3, 0.3, 3, 11);
  Random random(111);
  for (int i = 0; i < 8; ++i)
    add_gaussian(scene.gaussians,
                 world_at(scene.camera, random.uniform(-20, 50), random.uniform(-20, 50),
                          i % 2 ? 0.0099 : -random.uniform(0.1, 1.0)),
                 random_rotation(random), {1.5, 1.2, 1.0}, 0.9, random);
  return scene;
}
inline GaussianScene3d compensated_gaussians() {
  GaussianScene3d scene = gaussian_soup(26, 26, 16, 0.9, 0.5, 3, 12);
  scene.options.compensate = true;
  return scene;
}
inline GaussianScene3d sharp_gaussians() {  // no blur at all
  GaussianScene3d scene = gaussian_soup(26, 26, 12, 1.5, 0.4, 3, 13);
  scene.options.blur = 0.0f;
  return scene;
}
inline GaussianScene3d no_gaussians() {
  GaussianScene3d scene = gaussian_soup(20, 18, 0, 1, 0, 3, 14);
  scene.options.background = {0.2f, 0.3f, 0.4f};
  return scene;
}
inline GaussianScene3d broken_gaussians() {  // sound ones between ones that must be left out
  GaussianScene3d scene = gaussian_soup(24, 22, 22, 3, 0.3, 3, 15);
  Gaussians& g = scene.gaussians;
  const float nan = std::nanf(""), infinity = std::numeric_limits<float>::infinity();
  g.center[3] = nan;
  g.center[3 * 2 + 2] = infinity;
  g.rotation[4 * 3 + 1] = nan;
  for (size_t k = 0; k < 4; ++k) g.rotation[4 * 4 + k] = 0.0f;
  g.rotation[4 * 5] = -infinity;
  g.scale[3 * 6 + 1] = nan;
  g.scale[3 * 7] = infinity;
  g.opacity[8] = nan;
  g.opacity[9] = 0.0f;
  g.opacity[10] = 0.003f;
  g.opacity[11] = -0.5f;
  g.features[3 * 12 + 2] = nan;
  g.features[3 * 13] = infinity;
  for (size_t k = 0; k < 3; ++k) g.scale[3 * 14 + k] = 0.0f;  // drawn: the blur gives it an area
  return scene;
}

struct GaussianCase {
  const char* name;
  GaussianScene3d (*make)();
};

inline constexpr GaussianCase kGaussianCases[] = {
    {"Plain", plain_gaussians},
    {"TenChannels", ten_channels},
    {"OddChannels", odd_channels},
    {"OneChannel", one_channel},
    {"EdgeOn", edge_on_gaussians},
    {"Needles", needles},
    {"Tiny", tiny_gaussians},
    {"Stacked", stacked_gaussians},
    {"OffScreen", off_screen_gaussians},
    {"Huge", huge_gaussians},
    {"Behind", behind_gaussians},
    {"Compensated", compensated_gaussians},
    {"Sharp", sharp_gaussians},
    {"Empty", no_gaussians},
    {"Broken", broken_gaussians},
};

}  // namespace effigy
