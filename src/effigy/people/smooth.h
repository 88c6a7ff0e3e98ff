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
inline double mix(double a, double b, double t) {
  return a + (b - a) * t;
}

}  // namespace effigy::people
