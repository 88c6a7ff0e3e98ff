// Scalar double-precision oracle of the surfel rasterizer: every pixel, every surfel, no tiles, no
// bounds, written from the definitions in surfel_raster.h and sharing no code with the kernels.
#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "effigy/splat/surfel_raster.h"

namespace effigy::oracle {

struct Surfels {
  std::vector<double> center, s, t, opacity, uv, uv_per_st, frame;
  size_t count() const { return opacity.size(); }
};

struct Scene {
  Camera camera;
  Surfels surfels;
  int texture_width = 0, texture_height = 0;
  std::vector<double> texels;  // 8 a texel
  SurfelRasterOptions options;
};

inline Scene make_scene(const Camera& camera, const PosedSurfels& p, const MaterialTexture& texture,
                        const SurfelRasterOptions& options) {
  const auto wide = [](const std::vector<float>& v) {
    return std::vector<double>(v.begin(), v.end());
  };
  return {camera,
          {wide(p.center), wide(p.s), wide(p.t), wide(p.opacity), wide(p.uv), wide(p.uv_per_st),
           wide(p.frame)},
          texture.width,
          texture.height,
          wide(texture.texels),
          options};
}

struct Image {
  std::vector<double> planes;  // kGBufferPlanes * height * width
  // Distance of the nearest decision (thresholds, clamps, texel borders) from flipping is not
  // known, but two images with equal signatures took the same decisions everywhere.
  uint64_t signature = 1469598103934665603ULL;
  int64_t pairs = 0;

  void decide(uint64_t what) { signature = (signature ^ what) * 1099511628211ULL; }
};

// Bilinear lookup with edge clamping; returns 7 channels.
inline void lookup(const Scene& scene, double u, double v, double* out, Image& image) {
  const int w = scene.texture_width, h = scene.texture_height;
  const double x = u * w - 0.5, y = v * h - 0.5;
  const double x0 = std::floor(x), y0 = std::floor(y), fx = x - x0, fy = y - y0;
  const auto column = [&](double k) { return static_cast<int>(std::clamp(k, 0.0, w - 1.0)); };
  const auto row = [&](double k) { return static_cast<int>(std::clamp(k, 0.0, h - 1.0)); };
  image.decide(static_cast<uint64_t>(row(y0) * w + column(x0)) * 4 + (x0 < 0) * 2 + (y0 < 0));
  for (int c = 0; c < 7; ++c) {
    const auto at = [&](double r, double k) {
      return scene.texels[static_cast<size_t>(row(r) * w + column(k)) * 8 + static_cast<size_t>(c)];
    };
    out[c] = (1 - fy) * ((1 - fx) * at(y0, x0) + fx * at(y0, x0 + 1)) +
             fy * ((1 - fx) * at(y0 + 1, x0) + fx * at(y0 + 1, x0 + 1));
  }
}

struct Contribution {
  double weight, u, v;
};

// A surfel in camera space.
struct Placed {
  Vec3d p, s, t, n;
  double ss, st, tt;
  double x = 0, y = 0;  // projected centre, when in front
};

inline Placed place(const Scene& scene, size_t i) {
  const Camera& camera = scene.camera;
  const auto vec = [&](const std::vector<double>& v) { return Vec3d(v.data() + 3 * i); };
  Placed placed;
  placed.p = camera.to_camera(vec(scene.surfels.center));
  placed.s = camera.camera_from_world_rotation * vec(scene.surfels.s);
  placed.t = camera.camera_from_world_rotation * vec(scene.surfels.t);
  placed.n = placed.s.cross(placed.t);
  placed.ss = placed.s.dot(placed.s);
  placed.st = placed.s.dot(placed.t);
  placed.tt = placed.t.dot(placed.t);
  placed.x = camera.fx * placed.p.x() / placed.p.z() + camera.cx;
  placed.y = camera.fy * placed.p.y() / placed.p.z() + camera.cy;
  return placed;
}

// Where a pixel's ray meets a surfel.
struct Meeting {
  bool seen = false, filtered = false;
  double u = 0, v = 0, z = 0, rho = 0;
};

inline Meeting meet(const Scene& scene, const Placed& placed, double px, double py) {
  const Camera& camera = scene.camera;
  const Vec3d ray((px - camera.cx) / camera.fx, (py - camera.cy) / camera.fy, 1.0);
  Meeting m;
  const double facing = placed.n.dot(ray);
  const double near = scene.options.near;
  bool plane = facing != 0.0;
  if (plane) {
    m.z = placed.n.dot(placed.p) / facing;
    const Vec3d local = m.z * ray - placed.p;  // = u s + v t
    // Cramer in the plane's own metric; the axes need not be orthogonal.
    const double det = placed.ss * placed.tt - placed.st * placed.st;
    const double ls = local.dot(placed.s), lt = local.dot(placed.t);
    m.u = (placed.tt * ls - placed.st * lt) / det;
    m.v = (placed.ss * lt - placed.st * ls) / det;
    m.rho = m.u * m.u + m.v * m.v;
    plane = m.z > near && std::isfinite(m.rho);
  }
  if (scene.options.low_pass && placed.p.z() > near) {
    const double dx = px - placed.x, dy = py - placed.y;
    const double rho = 2.0 * (dx * dx + dy * dy);
    if (!plane || rho < m.rho) {
      m.filtered = true;
      m.u = m.v = 0;
      m.z = placed.p.z();
      m.rho = rho;
      plane = true;
    }
  }
  m.seen = plane;
  return m;
}

inline Image render(const Scene& scene) {
  const Camera& camera = scene.camera;
  const Surfels& surfels = scene.surfels;
  const size_t n = surfels.count();
  const auto pixels = static_cast<size_t>(camera.width) * static_cast<size_t>(camera.height);
  Image image;
  image.planes.assign(pixels * kGBufferPlanes, 0.0);
  std::vector<double> z(n), sign(n);
  std::vector<Vec3d> normal(n);
  std::vector<size_t> order;
  for (size_t i = 0; i < n; ++i) {
    const Vec3d center(surfels.center.data() + 3 * i), s(surfels.s.data() + 3 * i),
        t(surfels.t.data() + 3 * i);
    const Vec3d p = camera.to_camera(center);
    z[i] = p.z();
    normal[i] = s.cross(t).normalized();
    sign[i] = (camera.camera_from_world_rotation * normal[i]).dot(p) <= 0 ? 1.0 : -1.0;
    bool sound = std::isfinite(surfels.opacity[i]) && s.cross(t).norm() > 0;
    for (size_t k = 0; k < 3; ++k)
      sound = sound && std::isfinite(center[static_cast<int>(k)]) &&
              std::isfinite(s[static_cast<int>(k)]) && std::isfinite(t[static_cast<int>(k)]);
    for (size_t k = 0; k < 2; ++k) sound = sound && std::isfinite(surfels.uv[2 * i + k]);
    for (size_t k = 0; k < 4; ++k) sound = sound && std::isfinite(surfels.uv_per_st[4 * i + k]);
    for (size_t k = 0; k < 9; ++k) sound = sound && std::isfinite(surfels.frame[9 * i + k]);
    if (sound) order.push_back(i);
    image.decide(sign[i] > 0);
  }
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return z[a] < z[b]; });
  for (const size_t i : order) image.decide(i);

  std::vector<Placed> placed;
  for (size_t i = 0; i < n; ++i) placed.push_back(place(scene, i));
  std::vector<Contribution> list;
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const auto pixel =
          static_cast<size_t>(y) * static_cast<size_t>(camera.width) + static_cast<size_t>(x);
      const auto out = [&](int plane) -> double& {
        return image.planes[static_cast<size_t>(plane) * pixels + pixel];
      };
      double transmittance = 1.0;
      bool open = true;  // distortion list
      list.clear();
      for (const size_t i : order) {
        const Meeting m = meet(scene, placed[i], x + 0.5, y + 0.5);
        // exp(-6) < 1/255: out of reach whatever the opacity.
        if (!m.seen || m.rho > 12.0) continue;
        const double gaussian = surfels.opacity[i] * std::exp(-0.5 * m.rho);
        const double a = std::min(0.99, gaussian);
        if (a < 1.0 / 255.0) continue;
        if (transmittance * (1 - a) < 1e-4) {
          image.decide(pixel * 7 + 1);
          break;
        }
        const double w = a * transmittance;
        transmittance *= 1 - a;
        ++image.pairs;
        image.decide((pixel * n + i) * 8 + (gaussian >= 0.99) * 2 + m.filtered);
        const double* j = surfels.uv_per_st.data() + 4 * i;
        const double u = surfels.uv[2 * i] + j[0] * m.u + j[1] * m.v;
        const double v = surfels.uv[2 * i + 1] + j[2] * m.u + j[3] * m.v;
        double texel[7];
        lookup(scene, u, v, texel, image);
        out(kAlpha) += w;
        out(kDepth) += w * m.z;
        for (int c = 0; c < 5; ++c) out(kAlbedo + c) += w * texel[c];
        const double rest = 1 - texel[5] * texel[5] - texel[6] * texel[6];
        image.decide(rest > 0);
        const double* frame = surfels.frame.data() + 9 * i;
        for (int c = 0; c < 3; ++c) {
          out(kNormal + c) += w * sign[i] * normal[i][c];
          out(kMappedNormal + c) += w * sign[i] *
                                    (texel[5] * frame[c] + texel[6] * frame[3 + c] +
                                     std::sqrt(std::max(0.0, rest)) * frame[6 + c]);
        }
        out(kUv) += w * u;
        out(kUv + 1) += w * v;
        const double threshold = scene.options.uv_distortion_threshold;
        if (open && !list.empty() && threshold > 0 &&
            std::hypot(u - list[0].u, v - list[0].v) > threshold) {
          open = false;
          image.decide(pixel * n + i);
        }
        if (open) list.push_back({w, u, v});
      }
      if (scene.options.uv_distortion == UvDistortion::kOff) continue;
      for (const Contribution& a : list) {
        for (const Contribution& b : list) {
          const double d2 = (a.u - b.u) * (a.u - b.u) + (a.v - b.v) * (a.v - b.v);
          out(kUvDistortion) +=
              a.weight * b.weight *
              (scene.options.uv_distortion == UvDistortion::kNorm ? std::sqrt(d2) : d2);
        }
      }
    }
  }
  return image;
}

}  // namespace effigy::oracle
