// Flattening a chart of a mesh into the plane with little distortion.
#pragma once

#include <vector>

#include "effigy/geometry/types.h"

namespace effigy::people {

// Planar positions for the points of a connected chart with a boundary: least-squares conformal
// (Levy et al. 2002), then as-rigid-as-possible steps (Liu et al. 2008) as long as no triangle
// turns over. Units of the input, counter-clockwise as the triangles. Where the conformal map
// itself folds, a map with convex boundary, which cannot, is returned (Tutte 1963).
std::vector<Vec2d> flatten(const std::vector<Vec3d>& points, const std::vector<Vec3i>& triangles);

}  // namespace effigy::people
