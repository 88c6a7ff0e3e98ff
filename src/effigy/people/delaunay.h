// Planar Delaunay triangulation of a few thousand points, and edge flips towards good triangles in
// space. Used by head_mesh.cpp only.
#pragma once

#include <utility>
#include <vector>

#include "effigy/geometry/types.h"

namespace effigy::people {

// Counter-clockwise triangles of the convex hull (Bowyer 1981, Watson 1981). Points are distinct.
std::vector<Vec3i> delaunay(const std::vector<Vec2d>& points);

// Flips edges until the triangulation contains all `edges` (Sloan 1993). They must not cross each
// other.
void recover_edges(std::vector<Vec3i>& triangles, const std::vector<Vec2d>& points,
                   const std::vector<std::pair<int, int>>& edges);

// Flips interior edges whose opposite angles in space exceed 180 degrees together, where both new
// triangles stay counter-clockwise in `uv`.
void flip_towards_delaunay(std::vector<Vec3i>& triangles, const std::vector<Vec3d>& positions,
                           const std::vector<Vec2d>& uv);

// Whether p is inside the closed polygon (even-odd).
bool inside_polygon(const std::vector<Vec2d>& polygon, const Vec2d& p);

}  // namespace effigy::people
