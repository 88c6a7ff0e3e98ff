#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/image/colour.h"
#include "effigy/light/cubemap_layout.h"
#include "effigy/light/environment.h"

namespace effigy {

const CubeFace& cube_face(int face) {
  static const std::array<CubeFace, 6> faces = {{
      {{1, 0, 0}, {0, 0, -1}, {0, -1, 0}},
      {{-1, 0, 0}, {0, 0, 1}, {0, -1, 0}},
      {{0, 1, 0}, {1, 0, 0}, {0, 0, 1}},
      {{0, -1, 0}, {1, 0, 0}, {0, 0, -1}},
      {{0, 0, 1}, {1, 0, 0}, {0, -1, 0}},
      {{0, 0, -1}, {-1, 0, 0}, {0, -1, 0}},
  }};
  return faces[static_cast<size_t>(face)];
}

CubePoint cube_point(const Vec3d& d) {
  const double ax = std::abs(d.x()), ay = std::abs(d.y()), az = std::abs(d.z());
  int face;
  if (ax >= ay && ax >= az) {
    face = d.x() < 0 ? 1 : 0;
  } else if (ay >= az) {
    face = d.y() < 0 ? 3 : 2;
  } else {
    face = d.z() < 0 ? 5 : 4;
  }
  const CubeFace& f = cube_face(face);
  const double major = f.normal.dot(d);
  return {face, f.s.dot(d) / major, f.t.dot(d) / major};
}

double cube_solid_angle(double s0, double s1, double t0, double t1) {
  // Solid angle of [0, s] x [0, t] at distance 1 is atan(s t / sqrt(1 + s^2 + t^2)).
  const auto corner = [](double s, double t) {
    return std::atan2(s * t, std::sqrt(1.0 + s * s + t * t));
  };
  return corner(s0, t0) - corner(s0, t1) - corner(s1, t0) + corner(s1, t1);
}

size_t cubemap_texel_across(int face, int x, int y, int n) {
  const auto index = [n](int f, int tx, int ty) {
    return (static_cast<size_t>(f) * n + ty) * n + tx;
  };
  const bool outside_x = x < 0 || x >= n, outside_y = y < 0 || y >= n;
  if (!outside_x && !outside_y) return index(face, x, y);
  // Fold the outside texel's centre over the edge: the neighbour's normal is the direction in which
  // we left, and "half a texel outside" becomes half a texel below this face.
  const CubeFace& f = cube_face(face);
  const double s = -1.0 + (2.0 * x + 1.0) / n, t = -1.0 + (2.0 * y + 1.0) / n;
  const double inside = 1.0 - 1.0 / n;
  const Vec3d p = outside_x ? Vec3d(f.s * (x < 0 ? -1.0 : 1.0) + f.t * t + f.normal * inside)
                            : Vec3d(f.t * (y < 0 ? -1.0 : 1.0) + f.s * s + f.normal * inside);
  const CubePoint q = cube_point(p);
  const auto texel = [n](double c) {
    return std::clamp(static_cast<int>((c + 1.0) * 0.5 * n), 0, n - 1);
  };
  return index(q.face, texel(q.s), texel(q.t));
}

void cubemap_corner_texels(int face, bool right, bool bottom, int n, size_t texels[3]) {
  const int x = right ? n - 1 : 0, y = bottom ? n - 1 : 0;
  texels[0] = cubemap_texel_across(face, x, y, n);
  texels[1] = cubemap_texel_across(face, right ? n : -1, y, n);
  texels[2] = cubemap_texel_across(face, x, bottom ? n : -1, n);
}

Vec3f cubemap_direction(int face, int x, int y, int size) {
  const CubeFace& f = cube_face(face);
  const double s = -1.0 + (2.0 * x + 1.0) / size, t = -1.0 + (2.0 * y + 1.0) / size;
  return (f.normal + f.s * s + f.t * t).normalized().cast<float>();
}

double cubemap_solid_angle(int x, int y, int size) {
  const double step = 2.0 / size;
  return cube_solid_angle(-1.0 + step * x, -1.0 + step * (x + 1), -1.0 + step * y,
                          -1.0 + step * (y + 1));
}

double mean_radiance(const Cubemap& cubemap) {
  const int n = cubemap.size;
  EFFIGY_CHECK(n > 0);
  double sum = 0.0;
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      double value = 0.0;
      for (int face = 0; face < 6; ++face) {
        const float* c = &cubemap.texels[3 * ((static_cast<size_t>(face) * n + y) * n + x)];
        value += luminance(c[0], c[1], c[2]);
      }
      sum += value * cubemap_solid_angle(x, y, n);
    }
  }
  return sum / (4.0 * std::numbers::pi);
}

// Bilinear on a face widened by one texel over each edge; where three faces meet, the missing
// fourth texel is their mean. Both sides of an edge then blend the same texels with the same
// weights, so the lookup is continuous.
Vec3f sample_cubemap(const Cubemap& cubemap, const Vec3f& direction) {
  const int n = cubemap.size;
  EFFIGY_CHECK(n > 0);
  const CubePoint p = cube_point(direction.cast<double>());
  const double u = (p.s + 1.0) * 0.5 * n - 0.5, v = (p.t + 1.0) * 0.5 * n - 0.5;
  const int x = std::clamp(static_cast<int>(std::floor(u)), -1, n - 1);
  const int y = std::clamp(static_cast<int>(std::floor(v)), -1, n - 1);
  const auto texel = [&](size_t index) {
    return Eigen::Map<const Vec3f>(&cubemap.texels[3 * index]);
  };
  const auto fetch = [&](int tx, int ty) -> Vec3f {
    const bool outside_x = tx < 0 || tx >= n, outside_y = ty < 0 || ty >= n;
    if (!(outside_x && outside_y)) return texel(cubemap_texel_across(p.face, tx, ty, n));
    size_t corner[3];
    cubemap_corner_texels(p.face, tx >= n, ty >= n, n, corner);
    return (texel(corner[0]) + texel(corner[1]) + texel(corner[2])) / 3.0f;
  };
  const float a = static_cast<float>(u - x), b = static_cast<float>(v - y);
  return (1 - b) * ((1 - a) * fetch(x, y) + a * fetch(x + 1, y)) +
         b * ((1 - a) * fetch(x, y + 1) + a * fetch(x + 1, y + 1));
}

Image equirectangular_from_cubemap(const Cubemap& cubemap, int width, int height) {
  EFFIGY_CHECK(width > 0 && height > 0 && cubemap.size > 0);
  constexpr int kSub = 4;  // samples a side of each pixel
  Image image(width, height, 3);
  parallel_for(static_cast<size_t>(height), 4, [&](size_t begin, size_t end, int) {
    for (size_t row = begin; row < end; ++row) {
      for (int x = 0; x < width; ++x) {
        Vec3f sum = Vec3f::Zero();
        double weights = 0.0;
        for (int i = 0; i < kSub * kSub; ++i) {
          const double v = (static_cast<double>(row) + (i / kSub + 0.5) / kSub) / height;
          const double u = (x + (i % kSub + 0.5) / kSub) / width;
          const double theta = v * std::numbers::pi, phi = (u - 0.5) * 2.0 * std::numbers::pi;
          const double w = std::sin(theta);
          const Vec3d d(w * std::sin(phi), std::cos(theta), -w * std::cos(phi));
          sum += static_cast<float>(w) * sample_cubemap(cubemap, d.cast<float>());
          weights += w;
        }
        Eigen::Map<Vec3f>(image.at(x, static_cast<int>(row))) = sum / static_cast<float>(weights);
      }
    }
  });
  return image;
}

}  // namespace effigy
