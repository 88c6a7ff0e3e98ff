// What every surfel of one triangle shares: its frame, its map from world to UV, and its UV-aligned
// tangent, with the derivatives of each. Internal to splat/.
#pragma once

#include "effigy/geometry/types.h"

namespace effigy {

// Three corners, in world space and in UV space.
struct TriangleCorners {
  Vec3d v0, v1, v2;
  Vec2d uv0, uv1, uv2;
};

struct TriangleMap {
  // Columns: T = norm(v1 - v0), B = N x T, N (GTAvatar section 3.3). A triangle without area gets
  // some rotation that is finite, and passes no gradient.
  Mat3d rotation = Mat3d::Identity();
  // J_uv pinv(J_v) of Eq. 1: UV per world displacement. Zero when the triangle has no area.
  Eigen::Matrix<double, 2, 3> uv_per_world = Eigen::Matrix<double, 2, 3>::Zero();
  // Direction of increasing u (column 0 of J_v J_uv^-1), unit; zero when there is none, because
  // the triangle has no area in space or in UV.
  Vec3d tangent = Vec3d::Zero();
  // Sign of det(J_uv): -1 where the atlas mirrors the triangle.
  double handedness = 1.0;

  // Kept for backward.
  double edge_length = 0.0, cross_length = 0.0, tangent_length = 0.0;
  Eigen::Matrix<double, 2, 3> pseudo_inverse = Eigen::Matrix<double, 2, 3>::Zero();
  Eigen::Matrix2d uv_jacobian = Eigen::Matrix2d::Zero();
  Eigen::Matrix2d inverse_gram = Eigen::Matrix2d::Zero();
  Vec2d tangent_weights = Vec2d::Zero();
};

TriangleMap map_triangle(const TriangleCorners& corners);

// Derivatives of the loss with respect to the fields of TriangleMap.
struct TriangleMapGradient {
  Mat3d rotation = Mat3d::Zero();
  Eigen::Matrix<double, 2, 3> uv_per_world = Eigen::Matrix<double, 2, 3>::Zero();
  Vec3d tangent = Vec3d::Zero();
};

// Adds the derivatives with respect to the corners to `d_vertices` (columns v0, v1, v2). The
// pseudo-inverse passes its gradient only when `through_pseudo_inverse`.
void map_triangle_backward(const TriangleCorners& corners, const TriangleMap& map,
                           const TriangleMapGradient& gradient, bool through_pseudo_inverse,
                           Mat3d& d_vertices);

}  // namespace effigy
