// Scalar double-precision oracle of the Gaussian rasterizer: every pixel, every Gaussian, no tiles,
// no bounds, written from the definitions in gaussian_raster.h and sharing no code with the
// kernels.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "effigy/splat/gaussian_raster.h"

namespace effigy::gaussian_oracle {

struct Scene {
  Camera camera;
  std::vector<double> center, rotation, scale, opacity, features, background;
  size_t channels = 3;
  double near = 0.01, blur = 0.3;
  bool compensate = false;
  size_t count() const { return opacity.size(); }
};

inline Scene make_scene(const Camera& camera, const Gaussians& g,
                        const GaussianRasterOptions& options) {
  const auto wide = [](const std::vector<float>& v) {
    return std::vector<double>(v.begin(), v.end());
  };
  Scene s{camera,          wide(g.center),   wide(g.rotation),        wide(g.scale),
          wide(g.opacity), wide(g.features), wide(options.background)};
  s.channels = static_cast<size_t>(g.channels);
  s.background.resize(s.channels, 0.0);
  s.near = static_cast<double>(options.near);
  s.blur = static_cast<double>(options.blur);
  s.compensate = options.compensate;
  return s;
}

struct Image {
  std::vector<double> planes;        // (1 + channels) * height * width
  std::vector<uint8_t> on_the_edge;  // pixels with an alpha within 1e-5 of a threshold
  // Two images with equal signatures took the same decisions everywhere.
  uint64_t signature = 1469598103934665603ULL;
  int64_t pairs = 0;
  void decide(uint64_t what) { signature = (signature ^ what) * 1099511628211ULL; }
};

// A Gaussian on the screen.
struct Placed {
  double z, opacity;
  Vec2d mean;
  Eigen::Matrix2d inverse;
  size_t index;
};

// False when it cannot be drawn.
inline bool place(const Scene& scene, size_t i, Placed& placed) {
  const Camera& camera = scene.camera;
  const Vec3d center(scene.center.data() + 3 * i), scale(scene.scale.data() + 3 * i);
  const double* q = scene.rotation.data() + 4 * i;
  const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
  bool sound = center.allFinite() && scale.allFinite() && rotation.coeffs().allFinite() &&
               rotation.norm() > 0 && std::isfinite(scene.opacity[i]);
  for (size_t c = 0; c < scene.channels; ++c)
    sound = sound && std::isfinite(scene.features[scene.channels * i + c]);
  if (!sound) return false;
  const Vec3d p = camera.to_camera(center);
  if (p.z() <= scene.near) return false;
  Eigen::Matrix<double, 2, 3> jacobian;
  jacobian << camera.fx / p.z(), 0, -camera.fx * p.x() / (p.z() * p.z()), 0, camera.fy / p.z(),
      -camera.fy * p.y() / (p.z() * p.z());
  const Mat3d r = rotation.normalized().toRotationMatrix();
  const Mat3d sigma = r * scale.cwiseAbs2().asDiagonal() * r.transpose();
  const Mat3d& w = camera.camera_from_world_rotation;
  const Eigen::Matrix2d bare = jacobian * w * sigma * w.transpose() * jacobian.transpose();
  const Eigen::Matrix2d full = bare + scene.blur * Eigen::Matrix2d::Identity();
  placed.z = p.z();
  placed.mean = camera.project(center);
  placed.inverse = full.inverse();
  placed.opacity = scene.opacity[i];
  if (scene.compensate)
    placed.opacity *= std::sqrt(std::max(0.0, bare.determinant()) / full.determinant());
  placed.index = i;
  return full.determinant() > 0;
}

inline Image render(const Scene& scene) {
  const Camera& camera = scene.camera;
  const auto pixels = static_cast<size_t>(camera.width) * static_cast<size_t>(camera.height);
  Image image;
  image.planes.assign(pixels * (1 + scene.channels), 0.0);
  image.on_the_edge.assign(pixels, 0);
  std::vector<Placed> order;
  for (size_t i = 0; i < scene.count(); ++i) {
    Placed placed;
    if (place(scene, i, placed)) order.push_back(placed);
  }
  std::stable_sort(order.begin(), order.end(),
                   [](const Placed& a, const Placed& b) { return a.z < b.z; });
  for (const Placed& p : order) image.decide(p.index);
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    const auto width = static_cast<size_t>(camera.width);
    const Vec2d at(static_cast<double>(pixel % width) + 0.5,
                   static_cast<double>(pixel / width) + 0.5);
    double transmittance = 1.0;
    for (const Placed& p : order) {
      const Vec2d d = at - p.mean;
      const double power = 0.5 * d.dot(p.inverse * d);
      if (power > 10.0 + std::log(std::max(1.0, p.opacity))) continue;  // far below 1/255
      const double gaussian = p.opacity * std::exp(-power);
      const double a = std::min(0.99, gaussian);
      if (std::abs(gaussian - 0.99) < 1e-5 || std::abs(a - 1.0 / 255.0) < 1e-5)
        image.on_the_edge[pixel] = 1;
      if (a < 1.0 / 255.0) continue;
      const double after = transmittance * (1 - a);
      if (std::abs(after - 1e-4) < 1e-5 * transmittance) image.on_the_edge[pixel] = 1;
      if (after < 1e-4) {
        image.decide(pixel * 7 + 1);
        break;
      }
      const double w = a * transmittance;
      transmittance = after;
      ++image.pairs;
      image.decide((pixel * scene.count() + p.index) * 2 + (gaussian >= 0.99));
      image.planes[pixel] += w;
      for (size_t c = 0; c < scene.channels; ++c)
        image.planes[(1 + c) * pixels + pixel] += w * scene.features[scene.channels * p.index + c];
    }
    for (size_t c = 0; c < scene.channels; ++c)
      image.planes[(1 + c) * pixels + pixel] += (1 - image.planes[pixel]) * scene.background[c];
  }
  return image;
}

}  // namespace effigy::gaussian_oracle
