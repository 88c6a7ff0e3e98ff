// Smooth deterministic noise for paint.
#pragma once

#include <cmath>
#include <cstdint>

#include "effigy/geometry/types.h"

namespace effigy::people {

inline double lattice(int64_t x, int64_t y, int64_t z) {
  uint64_t h = static_cast<uint64_t>(x) * 0x9e3779b97f4a7c15ULL ^
               static_cast<uint64_t>(y) * 0xbf58476d1ce4e5b9ULL ^
               static_cast<uint64_t>(z) * 0x94d049bb133111ebULL;
  h = (h ^ (h >> 31)) * 0xd6e8feb86659fd93ULL;
  h ^= h >> 32;
  return static_cast<double>(h >> 11) * 0x1.0p-52 - 1.0;
}

// Value noise in about [-1, 1], one feature per unit length.
inline double noise(const Vec3d& p) {
  const Vec3d base(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
  const auto x = static_cast<int64_t>(base.x()), y = static_cast<int64_t>(base.y()),
             z = static_cast<int64_t>(base.z());
  Vec3d f = p - base;
  f = f.cwiseProduct(f).cwiseProduct(Vec3d::Constant(3) - 2 * f);
  auto row = [&](int64_t j, int64_t k) {
    const double a = lattice(x, y + j, z + k), b = lattice(x + 1, y + j, z + k);
    return a + f.x() * (b - a);
  };
  const double near = row(0, 0) + f.y() * (row(1, 0) - row(0, 0));
  const double far = row(0, 1) + f.y() * (row(1, 1) - row(0, 1));
  return near + f.z() * (far - near);
}

// Noise of decreasing size, about [-1, 1].
inline double cloud(const Vec3d& p) {
  return 0.55 * noise(p) + 0.28 * noise(2.1 * p) + 0.17 * noise(4.3 * p);
}

}  // namespace effigy::people
