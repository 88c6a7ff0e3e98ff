#include "effigy/splat/triangle_map.h"

#include <cmath>

namespace effigy {
namespace {

// A triangle whose sine between its edges is below this has no usable plane.
constexpr double kSmallestSine = 1e-6;

Vec3d any_perpendicular(const Vec3d& unit) {
  const Vec3d axis = std::abs(unit.x()) < 0.5 ? Vec3d::UnitX() : Vec3d::UnitY();
  return unit.cross(axis).normalized();
}

}  // namespace

TriangleMap map_triangle(const TriangleCorners& corners) {
  TriangleMap map;
  const Vec3d e1 = corners.v1 - corners.v0;
  const Vec3d e2 = corners.v2 - corners.v0;
  const double length1 = e1.norm();
  const double length2 = e2.norm();
  const Vec3d tangent = length1 > 0.0 ? Vec3d(e1 / length1) : Vec3d(Vec3d::UnitX());
  map.edge_length = length1;

  const Vec3d cross = tangent.cross(e2);
  const double cross_length = cross.norm();
  const bool has_area = length1 > 0.0 && cross_length > kSmallestSine * length2;
  map.cross_length = has_area ? cross_length : 0.0;
  const Vec3d normal = has_area ? Vec3d(cross / cross_length) : any_perpendicular(tangent);
  map.rotation.col(0) = tangent;
  map.rotation.col(1) = normal.cross(tangent);
  map.rotation.col(2) = normal;

  map.uv_jacobian.col(0) = corners.uv1 - corners.uv0;
  map.uv_jacobian.col(1) = corners.uv2 - corners.uv0;
  if (!has_area) return map;

  // pinv(J) = (J^T J)^-1 J^T; det(J^T J) = |e1 x e2|^2, which does not cancel.
  const double area2 = cross_length * length1;
  const double determinant = area2 * area2;
  const double a = e1.squaredNorm(), b = e1.dot(e2), c = e2.squaredNorm();
  map.inverse_gram << c, -b, -b, a;
  map.inverse_gram /= determinant;
  map.pseudo_inverse.row(0) = ((c * e1 - b * e2) / determinant).transpose();
  map.pseudo_inverse.row(1) = ((a * e2 - b * e1) / determinant).transpose();
  map.uv_per_world = map.uv_jacobian * map.pseudo_inverse;

  const double du1 = map.uv_jacobian(0, 0), du2 = map.uv_jacobian(0, 1);
  const double dv1 = map.uv_jacobian(1, 0), dv2 = map.uv_jacobian(1, 1);
  const double uv_area = du1 * dv2 - du2 * dv1;
  const double uv_scale = (du1 * du1 + dv1 * dv1 + du2 * du2 + dv2 * dv2);
  if (!(std::abs(uv_area) > kSmallestSine * uv_scale)) return map;
  map.handedness = uv_area < 0.0 ? -1.0 : 1.0;
  map.tangent_weights = Vec2d(dv2, -dv1) / uv_area;
  const Vec3d along_u = map.tangent_weights.x() * e1 + map.tangent_weights.y() * e2;
  map.tangent_length = along_u.norm();
  map.tangent = along_u / map.tangent_length;
  return map;
}

void map_triangle_backward(const TriangleCorners& corners, const TriangleMap& map,
                           const TriangleMapGradient& gradient, bool through_pseudo_inverse,
                           Mat3d& d_vertices) {
  if (map.cross_length == 0.0) return;
  const Vec3d e2 = corners.v2 - corners.v0;
  const Vec3d tangent = map.rotation.col(0), normal = map.rotation.col(2);
  Vec3d d_tangent = gradient.rotation.col(0);
  const Vec3d d_bitangent = gradient.rotation.col(1);
  Vec3d d_normal = gradient.rotation.col(2);

  // B = N x T, N = c / |c|, c = T x e2, T = e1 / |e1|.
  d_normal += tangent.cross(d_bitangent);
  d_tangent += d_bitangent.cross(normal);
  const Vec3d d_cross = (d_normal - normal * normal.dot(d_normal)) / map.cross_length;
  d_tangent += e2.cross(d_cross);
  Vec3d d_e2 = d_cross.cross(tangent);
  Vec3d d_e1 = (d_tangent - tangent * tangent.dot(d_tangent)) / map.edge_length;

  if (map.tangent_length > 0.0) {
    const Vec3d d_along_u =
        (gradient.tangent - map.tangent * map.tangent.dot(gradient.tangent)) / map.tangent_length;
    d_e1 += map.tangent_weights.x() * d_along_u;
    d_e2 += map.tangent_weights.y() * d_along_u;
  }

  if (through_pseudo_inverse) {
    // P = pinv(J): dP = -P dJ P + (J^T J)^-1 dJ^T (I - J P)   (Golub and Pereyra 1973).
    const Eigen::Matrix<double, 2, 3> d_inverse =
        map.uv_jacobian.transpose() * gradient.uv_per_world;
    const Eigen::Matrix<double, 2, 3>& p = map.pseudo_inverse;
    const Mat3d off_plane = normal * normal.transpose();  // I - J P
    const Eigen::Matrix<double, 3, 2> d_jacobian =
        -p.transpose() * d_inverse * p.transpose() +
        off_plane * d_inverse.transpose() * map.inverse_gram;
    d_e1 += d_jacobian.col(0);
    d_e2 += d_jacobian.col(1);
  }
  d_vertices.col(0) -= d_e1 + d_e2;
  d_vertices.col(1) += d_e1;
  d_vertices.col(2) += d_e2;
}

}  // namespace effigy
