// A triangle mesh of the zero level of a signed distance function.
#pragma once

#include <functional>
#include <vector>

#include "effigy/geometry/types.h"

namespace effigy::people {

struct Surface {
  std::vector<Vec3d> points;
  std::vector<Vec3i> triangles;  // counter-clockwise from outside
};

// Surface nets (Gibson 1998), one point a sheet of the surface and cube, on cubes of side `cell` in
// [low, high], where `distance` grows no faster than `steepness`; blocks that cannot hold the
// surface are skipped. The result is closed when the surface stays inside the box. Deterministic.
Surface surface_nets(const std::function<double(const Vec3d&)>& distance, const Vec3d& low,
                     const Vec3d& high, double cell, double steepness = 1.5);

}  // namespace effigy::people
