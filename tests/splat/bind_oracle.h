// Double-precision oracle of pose_surfels, written from the formulas of GTAvatar sections 3.3-3.5
// and sharing no code with src/effigy/splat.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <vector>

#include "effigy/splat/bind.h"

namespace effigy::oracle {

struct BoundParameters {
  std::vector<double> barycentric, displacement, rotation, log_scale, opacity_logit, vertices;
};

inline BoundParameters to_double(const BoundSurfels& surfels, const std::vector<float>& vertices) {
  const auto copy = [](const std::vector<float>& v) {
    return std::vector<double>(v.begin(), v.end());
  };
  return {copy(surfels.barycentric), copy(surfels.displacement),  copy(surfels.rotation),
          copy(surfels.log_scale),   copy(surfels.opacity_logit), copy(vertices)};
}

struct Posed {
  std::vector<double> center, s, t, opacity, uv, uv_per_st, frame;
};

inline std::vector<Vec3d> unit_vertex_normals(const Mesh& mesh, const std::vector<double>& v) {
  std::vector<Vec3d> n(v.size() / 3, Vec3d::Zero());
  for (const Vec3i& f : mesh.triangles) {
    const auto at = [&](int k) { return Vec3d(v.data() + 3 * f[k]); };
    const Vec3d area = 0.5 * (at(1) - at(0)).cross(at(2) - at(0));
    for (int k = 0; k < 3; ++k) n[static_cast<size_t>(f[k])] += area;
  }
  for (Vec3d& x : n) x.normalize();
  return n;
}

// `jacobian_vertices`: the vertices that the pseudo-inverse is made of (p.vertices, or frozen ones
// to see the gradient without that path).
inline Posed pose(const Mesh& mesh, const std::vector<int32_t>& triangle, const BoundParameters& p,
                  const std::vector<double>& jacobian_vertices, const BindOptions& options) {
  Posed out;
  std::vector<Vec3d> normals;
  if (options.interpolated_normals) normals = unit_vertex_normals(mesh, p.vertices);
  const auto append = [](std::vector<double>& to, const Vec3d& x) {
    to.insert(to.end(), x.data(), x.data() + 3);
  };
  for (size_t i = 0; i < triangle.size(); ++i) {
    const auto f = static_cast<size_t>(triangle[i]);
    const Vec3i face = mesh.triangles[f], uv_face = mesh.uv_triangles[f];
    Vec3d v[3], jv[3];
    Vec2d uv[3];
    for (int k = 0; k < 3; ++k) {
      v[k] = Vec3d(p.vertices.data() + 3 * face[k]);
      jv[k] = Vec3d(jacobian_vertices.data() + 3 * face[k]);
      uv[k] = mesh.uvs[static_cast<size_t>(uv_face[k])].cast<double>();
    }
    const double b = p.barycentric[2 * i], c = p.barycentric[2 * i + 1], a = 1 - b - c;
    const Vec3d t1 = (v[1] - v[0]).normalized();
    const Vec3d n1 = t1.cross(v[2] - v[0]).normalized();
    Mat3d frame;
    frame << t1, n1.cross(t1), n1;
    const double* q = p.rotation.data() + 4 * i;
    const Mat3d world =
        frame * Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized().toRotationMatrix();
    Vec3d direction = n1;
    if (options.interpolated_normals)
      direction = a * normals[static_cast<size_t>(face[0])] +
                  b * normals[static_cast<size_t>(face[1])] +
                  c * normals[static_cast<size_t>(face[2])];
    append(out.center, a * v[0] + b * v[1] + c * v[2] + p.displacement[i] * direction);
    Eigen::Matrix<double, 3, 2> st;
    st << world.col(0) * std::exp(p.log_scale[2 * i]),
        world.col(1) * std::exp(p.log_scale[2 * i + 1]);
    append(out.s, st.col(0));
    append(out.t, st.col(1));
    out.opacity.push_back(1 / (1 + std::exp(-p.opacity_logit[i])));
    const Vec2d uv0 = a * uv[0] + b * uv[1] + c * uv[2];
    out.uv.insert(out.uv.end(), uv0.data(), uv0.data() + 2);
    Eigen::Matrix<double, 3, 2> jacobian, live;
    jacobian << jv[1] - jv[0], jv[2] - jv[0];
    live << v[1] - v[0], v[2] - v[0];
    Eigen::Matrix2d uv_jacobian;
    uv_jacobian << uv[1] - uv[0], uv[2] - uv[0];
    const Eigen::MatrixXd dense = jacobian;
    const Eigen::Matrix2d m =
        uv_jacobian * dense.completeOrthogonalDecomposition().pseudoInverse() * st;
    for (const double x : {m(0, 0), m(0, 1), m(1, 0), m(1, 1)}) out.uv_per_st.push_back(x);
    const Vec3d n = world.col(2);
    Vec3d tangent = world.col(0), bitangent = world.col(1);
    if (!options.splat_normal_frame) {
      const Vec3d raw = (live * uv_jacobian.inverse()).col(0);
      tangent = (raw - n * n.dot(raw)).normalized();
      bitangent = (uv_jacobian.determinant() < 0 ? -1.0 : 1.0) * n.cross(tangent);
    }
    append(out.frame, tangent);
    append(out.frame, bitangent);
    append(out.frame, n);
  }
  return out;
}

}  // namespace effigy::oracle
