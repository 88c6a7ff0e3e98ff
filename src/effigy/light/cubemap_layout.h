// Geometry of a cubemap in OpenGL face order and orientation (OpenGL 4.6 specification,
// table 8.19), for code that walks over texels. Face coordinates (s, t) run over [-1, 1]; texel (x,
// y) of a face of n texels covers s in [-1 + 2x/n, -1 + 2(x+1)/n], t likewise, row 0 at t = -1.
#pragma once

#include <cstddef>

#include "effigy/geometry/types.h"

namespace effigy {

// A face's outward axis and the world directions in which s and t grow.
struct CubeFace {
  Vec3d normal, s, t;
};
const CubeFace& cube_face(int face);

// Where a direction (any length but zero) leaves the cube.
struct CubePoint {
  int face;
  double s, t;
};
CubePoint cube_point(const Vec3d& direction);

// Solid angle of the rectangle [s0, s1] x [t0, t1] of a face.
double cube_solid_angle(double s0, double s1, double t0, double t1);

// Index f n^2 + y n + x of the texel at (x, y) of `face`, where one of x and y may be one texel
// outside the face (-1 or n): then the texel across that edge.
size_t cubemap_texel_across(int face, int x, int y, int n);

// The three texels that meet at the cube's vertex at corner (right, bottom) of `face`.
void cubemap_corner_texels(int face, bool right, bool bottom, int n, size_t texels[3]);

}  // namespace effigy
