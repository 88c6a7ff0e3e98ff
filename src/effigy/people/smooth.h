// Small smooth functions that shapes are made of.
#pragma once

#include <algorithm>
#include <cmath>

#include "effigy/geometry/types.h"

namespace effigy::people {

// 0 at a and before it, 1 at b and beyond, smooth between; a and b in either order.
inline double smooth_step(double a, double b, double x) {
  const double t = std::clamp((x - a) / (b - a), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}
// exp(-|(p - centre) / radii|^2).
inline double bump(const Vec3d& p, const Vec3d& centre, const Vec3d& radii) {
  return std::exp(-(p - centre).cwiseQuotient(radii).squaredNorm());
}

// Signed distances of solids (negative inside), and their smooth unions.
inline double ellipsoid(const Vec3d& p, const Vec3d& centre, const Vec3d& radii) {
  const Vec3d q = p - centre;
  const double k0 = q.cwiseQuotient(radii).norm();
  const double k1 = q.cwiseQuotient(radii.cwiseProduct(radii)).norm();
  return k1 > 1e-9 ? k0 * (k0 - 1.0) / k1 : -radii.minCoeff();
}
// A capsule whose radius goes from ra at a to rb at b.
inline double limb(const Vec3d& p, const Vec3d& a, const Vec3d& b, double ra, double rb) {
  const Vec3d ab = b - a;
  const double t = std::clamp((p - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0);
  return (p - a - t * ab).norm() - (ra + t * (rb - ra));
}
// Smooth union, blending over about k.
inline double join(double a, double b, double k) {
  const double h = std::max(k - std::abs(a - b), 0.0) / k;
  return std::min(a, b) - h * h * k * 0.25;
}
// Smooth intersection.
inline double meet(double a, double b, double k) {
  return -join(-a, -b, k);
}
// Smooth difference a - b.
inline double carve(double a, double b, double k) {
  return -join(-a, b, k);
}
inline double mix(double a, double b, double t) {
  return a + (b - a) * t;
}

}  // namespace effigy::people
