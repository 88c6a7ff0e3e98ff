#include "effigy/splat/bind.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/splat/triangle_map.h"

namespace effigy {
namespace {

using Mat23d = Eigen::Matrix<double, 2, 3>;

constexpr size_t kTriangleGrain = 256;
// A tangent closer to the surfel's normal than this sine is replaced by the surfel's own axis.
constexpr double kSmallestTangent = 1e-4;

Vec3d load3(const float* p) {
  return {p[0], p[1], p[2]};
}

void store3(float* p, const Vec3d& v) {
  for (int k = 0; k < 3; ++k) p[k] = static_cast<float>(v[k]);
}

void add3(float* p, const Vec3d& v) {
  for (int k = 0; k < 3; ++k) p[k] += static_cast<float>(v[k]);
}

void check_inputs(const Mesh& mesh, std::span<const float> vertices, const BoundSurfels& surfels) {
  const size_t n = surfels.count();
  EFFIGY_CHECK_EQ(vertices.size(), mesh.vertices.size());
  EFFIGY_CHECK_EQ(surfels.barycentric.size(), 2 * n);
  EFFIGY_CHECK_EQ(surfels.displacement.size(), n);
  EFFIGY_CHECK_EQ(surfels.rotation.size(), 4 * n);
  EFFIGY_CHECK_EQ(surfels.log_scale.size(), 2 * n);
  EFFIGY_CHECK_EQ(surfels.opacity_logit.size(), n);
  EFFIGY_CHECK(mesh.uv_triangles.empty() || mesh.uv_triangles.size() == mesh.triangles.size());
  const auto faces = static_cast<int32_t>(mesh.triangles.size());
  for (size_t i = 0; i < n; ++i) {
    if (surfels.triangle[i] < 0 || surfels.triangle[i] >= faces)
      throw Error("Surfel " + std::to_string(i) + " is bound to triangle " +
                  std::to_string(surfels.triangle[i]) + " but the mesh has " +
                  std::to_string(faces) + "; use the surfels with the mesh they were made for.");
  }
}

// Surfels grouped by triangle, so that one thread owns a triangle and its surfels.
struct SurfelsByTriangle {
  std::vector<int32_t> begin;   // F + 1
  std::vector<int32_t> surfel;  // N

  SurfelsByTriangle(size_t faces, const std::vector<int32_t>& triangle)
      : begin(faces + 1, 0), surfel(triangle.size()) {
    for (const int32_t f : triangle) ++begin[static_cast<size_t>(f) + 1];
    for (size_t f = 0; f < faces; ++f) begin[f + 1] += begin[f];
    std::vector<int32_t> next(begin.begin(), begin.end() - 1);
    for (size_t i = 0; i < triangle.size(); ++i)
      surfel[static_cast<size_t>(next[static_cast<size_t>(triangle[i])]++)] =
          static_cast<int32_t>(i);
  }
};

TriangleCorners load_corners(const Mesh& mesh, const float* vertices, size_t face) {
  TriangleCorners corners;
  const Vec3i& f = mesh.triangles[face];
  corners.v0 = load3(vertices + 3 * f[0]);
  corners.v1 = load3(vertices + 3 * f[1]);
  corners.v2 = load3(vertices + 3 * f[2]);
  if (mesh.uv_triangles.empty()) {
    corners.uv0 = corners.uv1 = corners.uv2 = Vec2d::Zero();
  } else {
    const Vec3i& t = mesh.uv_triangles[face];
    corners.uv0 = mesh.uvs[static_cast<size_t>(t[0])].cast<double>();
    corners.uv1 = mesh.uvs[static_cast<size_t>(t[1])].cast<double>();
    corners.uv2 = mesh.uvs[static_cast<size_t>(t[2])].cast<double>();
  }
  return corners;
}

// One surfel's parameters and what pose and its backward both need.
struct SurfelPose {
  double b, c, displacement;
  double q_length;
  Eigen::Vector4d q;   // unit quaternion w x y z
  Mat3d local, world;  // R_local, R_triangle R_local
  double scale_s, scale_t;
  double opacity;
};

Mat3d rotation_of(const Eigen::Vector4d& q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  Mat3d r;
  r << 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),  //
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),   //
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y);
  return r;
}

// Derivative of rotation_of with respect to q (as four free numbers) against d_r.
Eigen::Vector4d rotation_backward(const Eigen::Vector4d& q, const Mat3d& g) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  Eigen::Vector4d d;
  d[0] = 2 * (x * (g(2, 1) - g(1, 2)) + y * (g(0, 2) - g(2, 0)) + z * (g(1, 0) - g(0, 1)));
  d[1] = 2 * (y * (g(0, 1) + g(1, 0)) + z * (g(0, 2) + g(2, 0)) + w * (g(2, 1) - g(1, 2)) -
              2 * x * (g(1, 1) + g(2, 2)));
  d[2] = 2 * (x * (g(0, 1) + g(1, 0)) + z * (g(1, 2) + g(2, 1)) + w * (g(0, 2) - g(2, 0)) -
              2 * y * (g(0, 0) + g(2, 2)));
  d[3] = 2 * (x * (g(0, 2) + g(2, 0)) + y * (g(1, 2) + g(2, 1)) + w * (g(1, 0) - g(0, 1)) -
              2 * z * (g(0, 0) + g(1, 1)));
  return d;
}

SurfelPose load_surfel(const BoundSurfels& surfels, size_t i, const TriangleMap& map) {
  SurfelPose pose;
  pose.b = surfels.barycentric[2 * i];
  pose.c = surfels.barycentric[2 * i + 1];
  pose.displacement = surfels.displacement[i];
  const float* q = surfels.rotation.data() + 4 * i;
  pose.q = Eigen::Vector4d(q[0], q[1], q[2], q[3]);
  pose.q_length = pose.q.norm();
  if (pose.q_length > 0.0) {
    pose.q /= pose.q_length;
  } else {
    pose.q = Eigen::Vector4d(1, 0, 0, 0);
  }
  pose.local = rotation_of(pose.q);
  pose.world = map.rotation * pose.local;
  pose.scale_s = std::exp(static_cast<double>(surfels.log_scale[2 * i]));
  pose.scale_t = std::exp(static_cast<double>(surfels.log_scale[2 * i + 1]));
  pose.opacity = 1.0 / (1.0 + std::exp(-static_cast<double>(surfels.opacity_logit[i])));
  return pose;
}

// The UV-aligned tangent frame of a surfel: the triangle's direction of increasing u,
// orthonormalised against the surfel's normal; the bitangent points to increasing v.
struct TangentFrame {
  bool own_axes = false;  // Eq. 7, or no direction of increasing u
  double length = 1.0;
  Vec3d tangent, bitangent;

  TangentFrame(const SurfelPose& pose, const TriangleMap& map, const BindOptions& options) {
    const Vec3d normal = pose.world.col(2);
    const Vec3d across = map.tangent - normal * normal.dot(map.tangent);
    length = across.norm();
    own_axes = options.splat_normal_frame || !(length > kSmallestTangent);
    if (own_axes) {
      tangent = pose.world.col(0);
      bitangent = pose.world.col(1);
    } else {
      tangent = across / length;
      bitangent = map.handedness * normal.cross(tangent);
    }
  }
};

// Unit vertex normals (area-weighted) and the lengths before normalisation, for
// BindOptions::interpolated_normals.
struct VertexNormals {
  std::vector<Vec3d> normal;
  std::vector<double> length;

  VertexNormals(const Mesh& mesh, const float* vertices)
      : normal(mesh.vertices.size() / 3, Vec3d::Zero()), length(normal.size(), 0.0) {
    for (const Vec3i& f : mesh.triangles) {
      const Vec3d a = load3(vertices + 3 * f[0]);
      const Vec3d cross = (load3(vertices + 3 * f[1]) - a).cross(load3(vertices + 3 * f[2]) - a);
      for (int k = 0; k < 3; ++k) normal[static_cast<size_t>(f[k])] += cross;
    }
    for (size_t v = 0; v < normal.size(); ++v) {
      length[v] = normal[v].norm();
      if (length[v] > 0.0) normal[v] /= length[v];
    }
  }

  // Adds the derivatives with respect to the vertices, given those of the unit normals.
  void backward(const Mesh& mesh, const float* vertices, std::vector<Vec3d>& d_normal,
                std::vector<float>& d_vertices) const {
    for (size_t v = 0; v < normal.size(); ++v) {
      if (length[v] > 0.0)
        d_normal[v] = (d_normal[v] - normal[v] * normal[v].dot(d_normal[v])) / length[v];
      else
        d_normal[v].setZero();
    }
    for (const Vec3i& f : mesh.triangles) {
      const Vec3d a = load3(vertices + 3 * f[0]);
      const Vec3d e1 = load3(vertices + 3 * f[1]) - a, e2 = load3(vertices + 3 * f[2]) - a;
      const Vec3d d_cross = d_normal[static_cast<size_t>(f[0])] +
                            d_normal[static_cast<size_t>(f[1])] +
                            d_normal[static_cast<size_t>(f[2])];
      const Vec3d d_e1 = e2.cross(d_cross), d_e2 = d_cross.cross(e1);
      add3(d_vertices.data() + 3 * f[0], -(d_e1 + d_e2));
      add3(d_vertices.data() + 3 * f[1], d_e1);
      add3(d_vertices.data() + 3 * f[2], d_e2);
    }
  }
};

void pose_one(const BoundSurfels& surfels, size_t i, const TriangleCorners& corners,
              const TriangleMap& map, const Vec3i& face, const VertexNormals* normals,
              const BindOptions& options, PosedSurfels& posed) {
  const SurfelPose pose = load_surfel(surfels, i, map);
  const double a = 1.0 - pose.b - pose.c;
  Vec3d direction = map.rotation.col(2);
  if (normals)
    direction = a * normals->normal[static_cast<size_t>(face[0])] +
                pose.b * normals->normal[static_cast<size_t>(face[1])] +
                pose.c * normals->normal[static_cast<size_t>(face[2])];
  const Vec3d center =
      a * corners.v0 + pose.b * corners.v1 + pose.c * corners.v2 + pose.displacement * direction;
  const Vec3d s = pose.scale_s * pose.world.col(0), t = pose.scale_t * pose.world.col(1);
  const Vec2d uv = a * corners.uv0 + pose.b * corners.uv1 + pose.c * corners.uv2;
  const Vec2d uv_s = map.uv_per_world * s, uv_t = map.uv_per_world * t;
  const TangentFrame frame(pose, map, options);

  store3(posed.center.data() + 3 * i, center);
  store3(posed.s.data() + 3 * i, s);
  store3(posed.t.data() + 3 * i, t);
  posed.opacity[i] = static_cast<float>(pose.opacity);
  posed.uv[2 * i] = static_cast<float>(uv.x());
  posed.uv[2 * i + 1] = static_cast<float>(uv.y());
  posed.uv_per_st[4 * i] = static_cast<float>(uv_s.x());
  posed.uv_per_st[4 * i + 1] = static_cast<float>(uv_t.x());
  posed.uv_per_st[4 * i + 2] = static_cast<float>(uv_s.y());
  posed.uv_per_st[4 * i + 3] = static_cast<float>(uv_t.y());
  store3(posed.frame.data() + 9 * i, frame.tangent);
  store3(posed.frame.data() + 9 * i + 3, frame.bitangent);
  store3(posed.frame.data() + 9 * i + 6, pose.world.col(2));
}

// Derivatives that the surfels of one triangle hand to the triangle.
struct TriangleSums {
  TriangleMapGradient map;
  Mat3d corners = Mat3d::Zero();         // columns v0, v1, v2
  Mat3d vertex_normals = Mat3d::Zero();  // columns of the three corners' unit normals
};

// The surfel's tangent frame: adds to the derivatives of its rotation and of the triangle's
// tangent.
void frame_backward(const float* d_frame, const SurfelPose& pose, const TriangleMap& map,
                    const TangentFrame& frame, Mat3d& d_world, TriangleSums& sums) {
  Vec3d d_tangent = load3(d_frame);
  const Vec3d d_bitangent = load3(d_frame + 3);
  d_world.col(2) += load3(d_frame + 6);
  if (frame.own_axes) {
    d_world.col(0) += d_tangent;
    d_world.col(1) += d_bitangent;
    return;
  }
  const Vec3d normal = pose.world.col(2);
  d_world.col(2) += map.handedness * frame.tangent.cross(d_bitangent);
  d_tangent += map.handedness * d_bitangent.cross(normal);
  const Vec3d d_across = (d_tangent - frame.tangent * frame.tangent.dot(d_tangent)) / frame.length;
  sums.map.tangent += d_across - normal * normal.dot(d_across);
  d_world.col(2) -= normal.dot(map.tangent) * d_across + normal.dot(d_across) * map.tangent;
}

void pose_one_backward(const BoundSurfels& surfels, size_t i, const TriangleCorners& corners,
                       const TriangleMap& map, const Vec3i& face, const VertexNormals* normals,
                       const BindOptions& options, const PosedSurfels& d_posed,
                       BoundSurfelGradients& gradients, TriangleSums& sums) {
  const SurfelPose pose = load_surfel(surfels, i, map);
  const double a = 1.0 - pose.b - pose.c;
  Mat3d d_world = Mat3d::Zero();

  // Centre and uv.
  const Vec3d d_center = load3(d_posed.center.data() + 3 * i);
  const Vec2d d_uv(d_posed.uv[2 * i], d_posed.uv[2 * i + 1]);
  double d_b = d_center.dot(corners.v1 - corners.v0) + d_uv.dot(corners.uv1 - corners.uv0);
  double d_c = d_center.dot(corners.v2 - corners.v0) + d_uv.dot(corners.uv2 - corners.uv0);
  double d_displacement;
  if (normals) {
    const Vec3d& n0 = normals->normal[static_cast<size_t>(face[0])];
    const Vec3d& n1 = normals->normal[static_cast<size_t>(face[1])];
    const Vec3d& n2 = normals->normal[static_cast<size_t>(face[2])];
    d_displacement = d_center.dot(a * n0 + pose.b * n1 + pose.c * n2);
    d_b += pose.displacement * d_center.dot(n1 - n0);
    d_c += pose.displacement * d_center.dot(n2 - n0);
    sums.vertex_normals.col(0) += a * pose.displacement * d_center;
    sums.vertex_normals.col(1) += pose.b * pose.displacement * d_center;
    sums.vertex_normals.col(2) += pose.c * pose.displacement * d_center;
  } else {
    d_displacement = d_center.dot(map.rotation.col(2));
    sums.map.rotation.col(2) += pose.displacement * d_center;
  }
  sums.corners.col(0) += a * d_center;
  sums.corners.col(1) += pose.b * d_center;
  sums.corners.col(2) += pose.c * d_center;

  // Axes, and the UV Jacobian that is made of them.
  const Vec3d s = pose.scale_s * pose.world.col(0), t = pose.scale_t * pose.world.col(1);
  const float* d_j = d_posed.uv_per_st.data() + 4 * i;
  const Vec2d d_uv_s(d_j[0], d_j[2]), d_uv_t(d_j[1], d_j[3]);
  const Vec3d d_s = load3(d_posed.s.data() + 3 * i) + map.uv_per_world.transpose() * d_uv_s;
  const Vec3d d_t = load3(d_posed.t.data() + 3 * i) + map.uv_per_world.transpose() * d_uv_t;
  sums.map.uv_per_world += d_uv_s * s.transpose() + d_uv_t * t.transpose();
  d_world.col(0) += pose.scale_s * d_s;
  d_world.col(1) += pose.scale_t * d_t;

  const TangentFrame frame(pose, map, options);
  frame_backward(d_posed.frame.data() + 9 * i, pose, map, frame, d_world, sums);

  sums.map.rotation += d_world * pose.local.transpose();
  const Mat3d d_local = map.rotation.transpose() * d_world;
  Eigen::Vector4d d_q = Eigen::Vector4d::Zero();
  if (pose.q_length > 0.0) {
    d_q = rotation_backward(pose.q, d_local);
    d_q = ((d_q - pose.q * pose.q.dot(d_q)) / pose.q_length).eval();
  }

  gradients.barycentric[2 * i] += static_cast<float>(d_b);
  gradients.barycentric[2 * i + 1] += static_cast<float>(d_c);
  gradients.displacement[i] += static_cast<float>(d_displacement);
  for (int k = 0; k < 4; ++k)
    gradients.rotation[4 * i + static_cast<size_t>(k)] += static_cast<float>(d_q[k]);
  gradients.log_scale[2 * i] += static_cast<float>(s.dot(d_s));
  gradients.log_scale[2 * i + 1] += static_cast<float>(t.dot(d_t));
  gradients.opacity_logit[i] += static_cast<float>(static_cast<double>(d_posed.opacity[i]) *
                                                   pose.opacity * (1.0 - pose.opacity));
}

}  // namespace

void PosedSurfels::resize(size_t n) {
  center.resize(3 * n);
  s.resize(3 * n);
  t.resize(3 * n);
  opacity.resize(n);
  uv.resize(2 * n);
  uv_per_st.resize(4 * n);
  frame.resize(9 * n);
}

void BoundSurfelGradients::clear(const BoundSurfels& surfels, size_t vertex_floats) {
  barycentric.assign(surfels.barycentric.size(), 0.0f);
  displacement.assign(surfels.displacement.size(), 0.0f);
  rotation.assign(surfels.rotation.size(), 0.0f);
  log_scale.assign(surfels.log_scale.size(), 0.0f);
  opacity_logit.assign(surfels.opacity_logit.size(), 0.0f);
  vertices.assign(vertex_floats, 0.0f);
}

BoundSurfels sample_surfels(const Mesh& mesh, int count, uint64_t seed,
                            std::span<const float> triangle_weight, float opacity) {
  if (count < 1)
    throw Error("The number of surfels must be at least 1, got " + std::to_string(count) + ".");
  if (!(opacity > 0.0f && opacity < 1.0f))
    throw Error("The initial opacity must lie between 0 and 1, got " + std::to_string(opacity) +
                ".");
  const size_t faces = mesh.triangles.size();
  EFFIGY_CHECK(triangle_weight.empty() || triangle_weight.size() == faces);
  std::vector<double> cumulative(faces);
  double total = 0.0;
  for (size_t f = 0; f < faces; ++f) {
    const Vec3i& t = mesh.triangles[f];
    const Vec3d a = mesh.vertex(t[0]).cast<double>();
    const Vec3d cross =
        (mesh.vertex(t[1]).cast<double>() - a).cross(mesh.vertex(t[2]).cast<double>() - a);
    const double weight = triangle_weight.empty() ? 1.0 : std::max(0.0f, triangle_weight[f]);
    total += 0.5 * cross.norm() * weight;
    cumulative[f] = total;
  }
  if (!(total > 0.0) || !std::isfinite(total))
    throw Error(
        "No triangle to put surfels on: every weighted area is zero or not finite; check "
        "the mesh and the triangle weights.");

  BoundSurfels out;
  const auto n = static_cast<size_t>(count);
  out.triangle.resize(n);
  out.barycentric.resize(2 * n);
  out.displacement.assign(n, 0.0f);
  out.rotation.assign(4 * n, 0.0f);
  out.log_scale.resize(2 * n);
  out.opacity_logit.assign(n, std::log(opacity / (1.0f - opacity)));
  Random random(seed, 0x5u);
  // Systematic sampling over the cumulative area: every triangle gets its share, rounded up or
  // down.
  const double step = total / count, offset = random.uniform();
  size_t f = 0;
  for (size_t i = 0; i < n; ++i) {
    const double at = (static_cast<double>(i) + offset) * step;
    while (f + 1 < faces && cumulative[f] <= at) ++f;
    out.triangle[i] = static_cast<int32_t>(f);
    const double root = std::sqrt(random.uniform()), along = random.uniform();
    out.barycentric[2 * i] = static_cast<float>(root * (1.0 - along));
    out.barycentric[2 * i + 1] = static_cast<float>(root * along);
    out.rotation[4 * i] = 1.0f;
    // Standard deviation 0.7 times the spacing of surfels at this density: no holes between
    // randomly placed surfels, and little more than the overlap that training settles at.
    const double weight = triangle_weight.empty() ? 1.0 : triangle_weight[f];
    const auto log_scale = static_cast<float>(std::log(0.7 * std::sqrt(step / weight)));
    out.log_scale[2 * i] = out.log_scale[2 * i + 1] = log_scale;
  }
  return out;
}

void pose_surfels(const Mesh& mesh, std::span<const float> vertices, const BoundSurfels& surfels,
                  const BindOptions& options, PosedSurfels& posed) {
  check_inputs(mesh, vertices, surfels);
  posed.resize(surfels.count());
  const size_t faces = mesh.triangles.size();
  const SurfelsByTriangle groups(faces, surfels.triangle);
  std::unique_ptr<VertexNormals> normals;
  if (options.interpolated_normals)
    normals = std::make_unique<VertexNormals>(mesh, vertices.data());
  parallel_for(faces, kTriangleGrain, [&](size_t begin, size_t end, int) {
    for (size_t f = begin; f < end; ++f) {
      const int32_t first = groups.begin[f], last = groups.begin[f + 1];
      if (first == last) continue;
      const TriangleCorners corners = load_corners(mesh, vertices.data(), f);
      const TriangleMap map = map_triangle(corners);
      for (int32_t k = first; k < last; ++k)
        pose_one(surfels, static_cast<size_t>(groups.surfel[static_cast<size_t>(k)]), corners, map,
                 mesh.triangles[f], normals.get(), options, posed);
    }
  });
}

void pose_surfels_backward(const Mesh& mesh, std::span<const float> vertices,
                           const BoundSurfels& surfels, const BindOptions& options,
                           const PosedSurfels& d_posed, BoundSurfelGradients& gradients) {
  check_inputs(mesh, vertices, surfels);
  EFFIGY_CHECK_EQ(d_posed.count(), surfels.count());
  EFFIGY_CHECK_EQ(gradients.barycentric.size(), surfels.barycentric.size());
  EFFIGY_CHECK_EQ(gradients.vertices.size(), vertices.size());
  const size_t faces = mesh.triangles.size();
  const SurfelsByTriangle groups(faces, surfels.triangle);
  std::unique_ptr<VertexNormals> normals;
  if (options.interpolated_normals)
    normals = std::make_unique<VertexNormals>(mesh, vertices.data());
  // Each triangle writes its own three corners; the sums over triangles are then taken in the order
  // of the triangles, so the result does not depend on the number of threads at all.
  std::vector<Mat3d> corner_sums(faces), normal_sums(normals ? faces : 0);
  parallel_for(faces, kTriangleGrain, [&](size_t begin, size_t end, int) {
    for (size_t f = begin; f < end; ++f) {
      const int32_t first = groups.begin[f], last = groups.begin[f + 1];
      TriangleSums sums;
      if (first != last) {
        const TriangleCorners corners = load_corners(mesh, vertices.data(), f);
        const TriangleMap map = map_triangle(corners);
        for (int32_t k = first; k < last; ++k)
          pose_one_backward(surfels, static_cast<size_t>(groups.surfel[static_cast<size_t>(k)]),
                            corners, map, mesh.triangles[f], normals.get(), options, d_posed,
                            gradients, sums);
        map_triangle_backward(corners, map, sums.map, options.jacobian_to_vertices, sums.corners);
      }
      corner_sums[f] = sums.corners;
      if (normals) normal_sums[f] = sums.vertex_normals;
    }
  });
  for (size_t f = 0; f < faces; ++f) {
    if (groups.begin[f] == groups.begin[f + 1]) continue;
    for (int k = 0; k < 3; ++k)
      add3(gradients.vertices.data() + 3 * mesh.triangles[f][k], corner_sums[f].col(k));
  }
  if (normals) {
    std::vector<Vec3d> d_normal(vertices.size() / 3, Vec3d::Zero());
    for (size_t f = 0; f < faces; ++f) {
      for (int k = 0; k < 3; ++k)
        d_normal[static_cast<size_t>(mesh.triangles[f][k])] += normal_sums[f].col(k);
    }
    normals->backward(mesh, vertices.data(), d_normal, gradients.vertices);
  }
}

}  // namespace effigy
