#include "effigy/rig/surface_fit.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/laplacian.h"
#include "effigy/rig/embedding_surface.h"

namespace effigy {
namespace {

using embedding::Surface;
using embedding::SurfacePoint;

constexpr int kLandmarks = 68, kFirstInner = 17, kFewest = 4;
constexpr double kLeastCosine = 0.5;

Vec3d point(std::span<const float> values, int i) {
  return Vec3f(values.data() + 3 * static_cast<size_t>(i)).cast<double>();
}

std::vector<int> part_vertices(const Mesh& mesh, const std::string& name) {
  const auto it = std::find(mesh.parts.begin(), mesh.parts.end(), name);
  const int part = it == mesh.parts.end() ? -1 : static_cast<int>(it - mesh.parts.begin());
  std::vector<char> used(static_cast<size_t>(mesh.vertex_count()), 0);
  for (int f = 0; f < mesh.triangle_count(); ++f)
    if (part < 0 || mesh.triangle_part[f] == part)
      for (int k = 0; k < 3; ++k) used[mesh.triangles[f][k]] = 1;
  std::vector<int> out;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (used[v] != 0) out.push_back(v);
  return out;
}

// The landmarks of the target that are known, of those that do not slide. Throws Error.
std::vector<int> known_landmarks(const Rig& rig, std::span<const float> landmarks) {
  if (rig.multipie.size() != kLandmarks || landmarks.size() != 3 * kLandmarks)
    throw Error("Fitting a surface needs the 68 landmarks of the rig and of the target.");
  std::vector<int> known;
  for (int i = kFirstInner; i < kLandmarks; ++i)
    if (point(landmarks, i).allFinite()) known.push_back(i);
  if (known.size() < kFewest)
    throw Error("Fitting a surface needs at least four known landmarks of the target.");
  return known;
}

// target_from_rig by the landmarks alone.
Eigen::Matrix4d landmark_pose(const Rig& rig, std::span<const float> landmarks,
                              const std::vector<int>& known, bool scale) {
  const auto from = landmark_positions(rig.multipie, rig.mesh.triangles, rig.mesh.vertices);
  const auto count = static_cast<Eigen::Index>(known.size());
  Eigen::Matrix3Xd a(3, count), b(3, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    a.col(i) = point(from, known[static_cast<size_t>(i)]);
    b.col(i) = point(landmarks, known[static_cast<size_t>(i)]);
  }
  return Eigen::umeyama(a, b, scale);
}

class Fitter {
 public:
  Fitter(const Rig& rig, const Mesh& target, std::span<const float> landmarks,
         const SurfaceFitOptions& options)
      : rig_(rig),
        target_(target),
        landmarks_(landmarks),
        options_(options),
        surface_(target, "skin"),
        skin_(part_vertices(rig.mesh, "skin")),
        known_(known_landmarks(rig, landmarks)) {
    if (surface_.empty()) throw Error("The surface to fit to has no triangles.");
    fit_.identity.assign(static_cast<size_t>(rig.identity_count), 0.0f);
    fit_.offsets.assign(rig.mesh.vertices.size(), 0.0f);
  }

  SurfaceFit run() {
    start();
    for (int i = 0; i < options_.mode_iterations; ++i) step_modes();
    measure(fit_.identity_distance, fit_.identity_landmark_distance);
    for (int i = 0; i < options_.offset_iterations; ++i)
      step_offsets(options_.stiffness * std::pow(0.5, i));
    measure(fit_.distance, fit_.landmark_distance);
    return fit_;
  }

 private:
  // A rig vertex, where it should go, and the target's normal there.
  struct Pair {
    int vertex;
    Vec3d to, normal;
  };

  std::vector<float> vertices() const { return fitted_vertices(rig_, fit_, true); }

  // Landmarks give the first pose.
  void start() {
    const Eigen::Matrix4d pose = landmark_pose(rig_, landmarks_, known_, false);
    fit_.rotation = pose.topLeftCorner<3, 3>();
    fit_.translation = pose.topRightCorner<3, 1>();
  }

  std::vector<Pair> pairs(std::span<const float> now, double least_cosine) const {
    const auto normals = vertex_normals(now, rig_.mesh.triangles);
    std::vector<Pair> out;
    for (const int v : skin_) {
      const SurfacePoint hit = surface_.closest(point(now, v), point(normals, v), least_cosine);
      if (hit.triangle < 0 || (hit.position - point(now, v)).norm() > options_.furthest) continue;
      const Vec3i& t = target_.triangles[hit.triangle];
      const Vec3d a = point(target_.vertices, t[0]);
      const Vec3d normal =
          (point(target_.vertices, t[1]) - a).cross(point(target_.vertices, t[2]) - a);
      out.push_back({v, hit.position, normal.normalized()});
    }
    return out;
  }

  // How the point made of three vertices moves with rotation, translation and modes.
  Eigen::Matrix3Xd slope(const Vec3i& corners, const Vec3d& weights, const Vec3d& at) const {
    Eigen::Matrix3Xd j(3, 6 + rig_.identity_count);
    j.leftCols<3>() << 0, at.z(), -at.y(), -at.z(), 0, at.x(), at.y(), -at.x(), 0;
    j.middleCols<3>(3).setIdentity();
    const size_t stride = rig_.mesh.vertices.size();
    for (int m = 0; m < rig_.identity_count; ++m) {
      Vec3d move = Vec3d::Zero();
      const std::span<const float> basis(rig_.identity_basis.data() + m * stride, stride);
      for (int k = 0; k < 3; ++k) move += weights[k] * point(basis, corners[k]);
      j.col(6 + m) = fit_.rotation * move;
    }
    return j;
  }

  void step_modes() {
    const auto now = vertices();
    const int n = 6 + rig_.identity_count;
    Eigen::MatrixXd a = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd b = Eigen::VectorXd::Zero(n);
    const auto found = pairs(now, kLeastCosine);
    const double share = 1e6 / std::max<double>(1, static_cast<double>(found.size()));  // per mm^2
    for (const Pair& pair : found) {
      const Vec3d at = point(now, pair.vertex), gap = pair.to - at;
      const auto j = slope({pair.vertex, pair.vertex, pair.vertex}, {1, 0, 0}, at);
      // Along the normal, and a tenth of it in all directions.
      const Eigen::RowVectorXd along = pair.normal.transpose() * j;
      a += share * (along.transpose() * along + 0.1 * j.transpose() * j);
      b += share * (along.transpose() * pair.normal.dot(gap) + 0.1 * j.transpose() * gap);
    }
    const auto marks = landmark_positions(rig_.multipie, rig_.mesh.triangles, now);
    for (const int i : known_) {
      const auto k = static_cast<size_t>(i);
      const auto j = slope(rig_.mesh.triangles[rig_.multipie.triangle[k]],
                           rig_.multipie.barycentric[k].cast<double>(), point(marks, i));
      const double weight = 1e6 * options_.landmark_weight;
      a += weight * j.transpose() * j;
      b += weight * j.transpose() * (point(landmarks_, i) - point(marks, i));
    }
    for (int m = 0; m < rig_.identity_count; ++m) {
      const double sigma = rig_.identity_sigma[m];
      const double weight = options_.prior_weight / (sigma * sigma);
      a(6 + m, 6 + m) += weight;
      b[6 + m] -= weight * fit_.identity[m];
    }
    const Eigen::VectorXd step = a.ldlt().solve(b);
    const Vec3d turn = step.head<3>();
    const Eigen::Matrix3d more =
        turn.norm() > 0 ? Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix()
                        : Eigen::Matrix3d::Identity();
    fit_.rotation = more * fit_.rotation;
    fit_.translation = more * fit_.translation + Vec3d(step.segment<3>(3));
    for (int m = 0; m < rig_.identity_count; ++m)
      fit_.identity[m] += static_cast<float>(step[6 + m]);
  }

  // min over d of sum w |x + d - y|^2 + stiffness |L d|^2 + landmarks; d in the target's frame.
  void step_offsets(double stiffness) {
    const auto base = fitted_vertices(rig_, fit_, false), now = vertices();
    const int n = rig_.mesh.vertex_count();
    const UniformLaplacian graph(rig_.mesh.triangles, n);
    std::vector<Eigen::Triplet<double>> entries, laplacian;
    Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(n, 3);
    for (int v = 0; v < n; ++v) {
      const auto ring = graph.neighbours(v);
      laplacian.emplace_back(v, v, 1.0);
      for (const int u : ring)
        laplacian.emplace_back(v, u, -1.0 / static_cast<double>(ring.size()));
      entries.emplace_back(v, v, 1e-6);  // pieces without data stay
    }
    for (const Pair& pair : pairs(now, 0.3)) {
      entries.emplace_back(pair.vertex, pair.vertex, 1.0);
      rhs.row(pair.vertex) += (pair.to - point(base, pair.vertex)).transpose();
    }
    const auto marks = landmark_positions(rig_.multipie, rig_.mesh.triangles, base);
    for (const int i : known_) {
      const auto k = static_cast<size_t>(i);
      const Vec3i& corners = rig_.mesh.triangles[rig_.multipie.triangle[k]];
      const Vec3d w = rig_.multipie.barycentric[k].cast<double>();
      for (int p = 0; p < 3; ++p) {
        rhs.row(corners[p]) += w[p] * (point(landmarks_, i) - point(marks, i)).transpose();
        for (int q = 0; q < 3; ++q) entries.emplace_back(corners[p], corners[q], w[p] * w[q]);
      }
    }
    Eigen::SparseMatrix<double> data(n, n), l(n, n);
    data.setFromTriplets(entries.begin(), entries.end());
    l.setFromTriplets(laplacian.begin(), laplacian.end());
    const Eigen::SparseMatrix<double> system =
        data + stiffness * Eigen::SparseMatrix<double>(l.transpose() * l);
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(system);
    EFFIGY_CHECK(solver.info() == Eigen::Success);
    const Eigen::MatrixXd d = solver.solve(rhs) * fit_.rotation;  // rows: R^T d
    for (int v = 0; v < n; ++v)
      for (int c = 0; c < 3; ++c)
        fit_.offsets[3 * static_cast<size_t>(v) + c] = static_cast<float>(d(v, c));
  }

  // From the target's points above the fitted neck to the fitted surface.
  void measure(double& surface, double& landmark) const {
    Mesh fitted = rig_.mesh;
    fitted.vertices = vertices();
    const Surface own(fitted, "skin");
    double neck = -1e9;
    for (const int v : rig_.neck_ring) neck = std::max(neck, point(fitted.vertices, v).y());
    const auto normals = vertex_normals(target_.vertices, target_.triangles);
    double sum = 0;
    int count = 0;
    for (const int v : part_vertices(target_, "skin")) {
      const Vec3d p = point(target_.vertices, v);
      if (p.y() < neck) continue;
      const SurfacePoint hit = own.closest(p, point(normals, v), 0.0);
      if (hit.triangle < 0) continue;
      sum += (hit.position - p).norm();
      ++count;
    }
    surface = sum / std::max(count, 1);
    const auto marks = landmark_positions(rig_.multipie, rig_.mesh.triangles, fitted.vertices);
    landmark = 0;
    for (const int i : known_)
      landmark +=
          (point(marks, i) - point(landmarks_, i)).norm() / static_cast<double>(known_.size());
  }

  const Rig& rig_;
  const Mesh& target_;
  std::span<const float> landmarks_;
  SurfaceFitOptions options_;
  Surface surface_;
  std::vector<int> skin_, known_;  // vertices; landmarks
  SurfaceFit fit_;
};

}  // namespace

std::vector<float> fitted_vertices(const Rig& rig, const SurfaceFit& fit, bool with_offsets) {
  std::vector<float> out = shape_rig(rig, fit.identity).rest;
  for (size_t i = 0; i + 2 < out.size(); i += 3) {
    Vec3d p = Vec3f(&out[i]).cast<double>();
    if (with_offsets) p += Vec3f(&fit.offsets[i]).cast<double>();
    const Vec3d q = fit.scale * (fit.rotation * p) + fit.translation;
    for (int c = 0; c < 3; ++c) out[i + static_cast<size_t>(c)] = static_cast<float>(q[c]);
  }
  return out;
}

SurfaceFit fit_surface(const Rig& rig, const Mesh& target, std::span<const float> landmarks,
                       const SurfaceFitOptions& options) {
  if (!options.scale) return Fitter(rig, target, landmarks, options).run();
  // The fit counts in metres: the landmarks bring the target near them.
  const double unit = landmark_pose(rig, landmarks, known_landmarks(rig, landmarks), true)
                          .topLeftCorner<3, 3>()
                          .col(0)
                          .norm();
  const auto in_metres = [&](std::span<const float> values) {
    std::vector<float> out(values.begin(), values.end());
    for (float& value : out) value = static_cast<float>(value / unit);
    return out;
  };
  Mesh scaled = target;
  scaled.vertices = in_metres(target.vertices);
  SurfaceFit fit = Fitter(rig, scaled, in_metres(landmarks), options).run();
  fit.scale = unit;
  fit.translation *= unit;
  return fit;
}

}  // namespace effigy
