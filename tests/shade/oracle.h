// Deferred shading in double precision, pixel by pixel, straight from the formulas of
// shade/deferred.h. Shares no code with the library: faces are written out from the OpenGL table,
// neighbours over a cube edge are found by comparing edge midpoints in space.
#pragma once

#include <array>
#include <cmath>
#include <map>
#include <vector>

#include "effigy/light/brdf_table.h"
#include "effigy/light/environment.h"
#include "effigy/shade/deferred.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy::oracle {

// Point of the cube's surface for (s, t) of a face: OpenGL 4.6 table 8.19.
inline Vec3d cube_surface(int face, double s, double t) {
  switch (face) {
    case 0:
      return {1, -t, -s};
    case 1:
      return {-1, -t, s};
    case 2:
      return {s, 1, t};
    case 3:
      return {s, -1, -t};
    case 4:
      return {s, -t, 1};
    default:
      return {-s, -t, -1};
  }
}

// A cubemap in double with a border of one texel.
struct Map {
  int n = 0;
  std::vector<Vec3d> texel;                 // [6][n][n]
  std::vector<std::vector<size_t>> border;  // [6][n+2][n+2]: texels whose mean stands there

  size_t index(int f, int x, int y) const { return (static_cast<size_t>(f) * n + y) * n + x; }
  explicit Map(const Cubemap& cubemap) : n(cubemap.size) {
    for (size_t i = 0; i + 2 < cubemap.texels.size(); i += 3)
      texel.emplace_back(cubemap.texels[i], cubemap.texels[i + 1], cubemap.texels[i + 2]);
    using Key = std::array<int64_t, 3>;
    const auto key = [](const Vec3d& p) {
      return Key{std::llround(p.x() * 1e6), std::llround(p.y() * 1e6), std::llround(p.z() * 1e6)};
    };
    std::map<Key, std::vector<size_t>> edges, vertices;
    const auto at = [this](int f, double x, double y) {
      return cube_surface(f, -1 + 2 * x / n, -1 + 2 * y / n);
    };
    for (int f = 0; f < 6; ++f)
      for (int i = 0; i < n; ++i) {
        edges[key(at(f, 0, i + .5))].push_back(index(f, 0, i));
        edges[key(at(f, n, i + .5))].push_back(index(f, n - 1, i));
        edges[key(at(f, i + .5, 0))].push_back(index(f, i, 0));
        edges[key(at(f, i + .5, n))].push_back(index(f, i, n - 1));
      }
    for (int f = 0; f < 6; ++f)
      for (int c = 0; c < 4; ++c)
        vertices[key(at(f, c % 2 ? n : 0, c / 2 ? n : 0))].push_back(
            index(f, c % 2 ? n - 1 : 0, c / 2 ? n - 1 : 0));
    for (int f = 0; f < 6; ++f)
      for (int y = -1; y <= n; ++y)
        for (int x = -1; x <= n; ++x) {
          const bool ox = x < 0 || x >= n, oy = y < 0 || y >= n;
          if (ox && oy) {
            border.push_back(vertices[key(at(f, x < 0 ? 0 : n, y < 0 ? 0 : n))]);
          } else if (ox || oy) {
            const int ix = std::clamp(x, 0, n - 1), iy = std::clamp(y, 0, n - 1);
            const Vec3d middle = ox ? at(f, x < 0 ? 0 : n, iy + .5) : at(f, ix + .5, y < 0 ? 0 : n);
            // The two texels at this edge midpoint: the one that is not ours.
            std::vector<size_t> other;
            for (const size_t t : edges[key(middle)])
              if (t / (static_cast<size_t>(n) * n) != static_cast<size_t>(f)) other.push_back(t);
            border.push_back(other);
          } else {
            border.push_back({index(f, x, y)});
          }
        }
  }
  Vec3d fetch(int f, int x, int y) const {
    Vec3d sum = Vec3d::Zero();
    const auto& from = border[(static_cast<size_t>(f) * (n + 2) + (y + 1)) * (n + 2) + x + 1];
    for (const size_t t : from) sum += texel[t];
    return sum / static_cast<double>(from.size());
  }
  Vec3d sample(const Vec3d& d) const {
    const Vec3d a = d.cwiseAbs();
    const int axis = a.x() >= a.y() && a.x() >= a.z() ? 0 : a.y() >= a.z() ? 1 : 2;
    const int f = 2 * axis + (d[axis] < 0);
    const Vec3d p = d / a[axis];
    const Vec3d zero = cube_surface(f, 0, 0);
    const double s = (cube_surface(f, 1, 0) - zero).dot(p),
                 t = (cube_surface(f, 0, 1) - zero).dot(p);
    const double u = (s + 1) / 2 * n - .5, v = (t + 1) / 2 * n - .5;
    const int x = static_cast<int>(std::floor(u)), y = static_cast<int>(std::floor(v));
    const double fx = u - x, fy = v - y;
    return (1 - fx) * (1 - fy) * fetch(f, x, y) + fx * (1 - fy) * fetch(f, x + 1, y) +
           (1 - fx) * fy * fetch(f, x, y + 1) + fx * fy * fetch(f, x + 1, y + 1);
  }
};

struct Light {
  Map diffuse;
  std::vector<Map> specular;
  std::vector<double> roughness;
  explicit Light(const PrefilteredEnvironment& e) : diffuse(e.diffuse) {
    for (const Cubemap& level : e.specular) specular.emplace_back(level);
    roughness.assign(e.roughness.begin(), e.roughness.end());
  }
  Vec3d sample_specular(const Vec3d& d, double r) const {
    if (specular.size() == 1) return specular[0].sample(d);
    size_t k = 0;
    while (k + 2 < roughness.size() && r >= roughness[k + 1]) ++k;
    const double f = std::clamp((r - roughness[k]) / (roughness[k + 1] - roughness[k]), 0.0, 1.0);
    return (1 - f) * specular[k].sample(d) + f * specular[k + 1].sample(d);
  }
};

inline double srgb(double x) {
  const double a = std::abs(x);
  return std::copysign(a <= 0.0031308 ? 12.92 * a : 1.055 * std::pow(a, 1 / 2.4) - 0.055, x);
}
inline double display(double x, DisplayTransform transform) {
  if (transform == DisplayTransform::kReinhardSrgb) return srgb(x / (1 + std::abs(x)));
  return srgb(std::clamp(x, -1.0, 1.0));
}

// The nine inputs of a pixel: alpha, albedo 3, roughness, F0, normal 3.
using Pixel = std::array<double, 9>;

inline Vec3d radiance(const Pixel& g, double px, double py, const Camera& camera,
                      const Light& light, const ShadeOptions& options) {
  const double inverse = options.divide_by_alpha ? 1 / std::max(g[0], double{1e-4f}) : 1;
  const Vec3d world =
      camera.camera_from_world_rotation.transpose() *
      Vec3d((px + .5 - camera.cx) / camera.fx, (py + .5 - camera.cy) / camera.fy, 1);
  const Vec3d v = -world.normalized();
  Vec3d n(g[6], g[7], g[8]);
  n = n.norm() < 1e-6 ? v : Vec3d(n.normalized());
  const double nv = n.dot(v);
  const double r = std::clamp(g[4] * inverse, 0.0, 1.0);
  const BrdfTable& table = brdf_table();
  const auto clamp = [&](double x) {
    return std::clamp(x * table.size - .5, 0.0, table.size - 1.0);
  };
  const double cx = clamp(nv), cy = clamp(r);
  const int ix = std::min(static_cast<int>(cx), table.size - 2);
  const int iy = std::min(static_cast<int>(cy), table.size - 2);
  double brdf[2];
  for (int k = 0; k < 2; ++k) {
    const auto at = [&](int x, int y) { return double{table.value[2 * (y * table.size + x) + k]}; };
    const double fx = cx - ix, fy = cy - iy;
    brdf[k] = (1 - fx) * (1 - fy) * at(ix, iy) + fx * (1 - fy) * at(ix + 1, iy) +
              (1 - fx) * fy * at(ix, iy + 1) + fx * fy * at(ix + 1, iy + 1);
  }
  const double reflectance = g[5] * inverse * brdf[0] + brdf[1];
  const Vec3d albedo = Vec3d(g[1], g[2], g[3]) * inverse;
  return albedo.cwiseProduct(light.diffuse.sample(n)) +
         reflectance * light.sample_specular(2 * nv * n - v, r);
}

inline Vec3d colour(const Pixel& g, double px, double py, const Camera& camera, const Light& light,
                    const ShadeOptions& options) {
  Vec3d out;
  const Vec3d l = g[0] > 0 ? radiance(g, px, py, camera, light, options) : Vec3d(Vec3d::Zero());
  for (int c = 0; c < 3; ++c) {
    const double background = options.background[static_cast<size_t>(c)];
    out[c] =
        g[0] > 0 ? g[0] * display(l[c], options.display) + (1 - g[0]) * background : background;
  }
  return out;
}

}  // namespace effigy::oracle
