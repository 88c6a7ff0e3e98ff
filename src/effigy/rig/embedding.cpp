#include "effigy/rig/embedding.h"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/rig/embedding_surface.h"

namespace effigy {

namespace {

using embedding::Surface;
using embedding::SurfaceLine;
using embedding::SurfacePoint;

constexpr int kPoints = 468, kLandmarks = 68;
constexpr int kFirstBrow = 17, kFirstNose = 27, kFirstLid = 36;
constexpr double kIrisRadius = 5.85e-3;  // of an adult's visible iris, metres

// A rim of a lid or lip: MediaPipe's points along it, the landmarks along it, and which of them
// mean the same place (indices into both lists). What lies between those is put there by arc
// length.
struct Rim {
  SurfaceLine::Course course;
  std::vector<int> points, landmarks;
  std::vector<std::pair<size_t, size_t>> same;
};

const std::vector<Rim>& rims() {
  constexpr auto kEdges = SurfaceLine::Course::kEdges, kSmooth = SurfaceLine::Course::kSmooth;
  static const std::vector<Rim> all = {
      // Upper and lower lid of the right eye, then of the left.
      {kEdges, {33, 246, 161, 160, 159, 158, 157, 173, 133}, {36, 37, 38, 39}, {{0, 0}, {8, 3}}},
      {kEdges, {33, 7, 163, 144, 145, 153, 154, 155, 133}, {36, 41, 40, 39}, {{0, 0}, {8, 3}}},
      {kEdges, {362, 398, 384, 385, 386, 387, 388, 466, 263}, {42, 43, 44, 45}, {{0, 0}, {8, 3}}},
      {kEdges, {362, 382, 381, 380, 374, 373, 390, 249, 263}, {42, 47, 46, 45}, {{0, 0}, {8, 3}}},
      // Upper and lower lip: outer rim, then inner.
      {kSmooth,
       {61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291},
       {48, 49, 50, 51, 52, 53, 54},
       {{0, 0}, {4, 2}, {5, 3}, {6, 4}, {10, 6}}},
      {kSmooth,
       {61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291},
       {48, 59, 58, 57, 56, 55, 54},
       {{0, 0}, {5, 3}, {10, 6}}},
      {kSmooth,
       {78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308},
       {60, 61, 62, 63, 64},
       {{0, 0}, {5, 2}, {10, 4}}},
      {kSmooth,
       {78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308},
       {60, 67, 66, 65, 64},
       {{0, 0}, {5, 2}, {10, 4}}},
  };
  return all;
}

void check_landmarks(const Rig& rig) {
  std::vector<uint8_t> seen(kLandmarks, 0);
  for (const int i : rig.multipie.index)
    if (i >= 0 && i < kLandmarks) seen[static_cast<size_t>(i)] = 1;
  if (std::count(seen.begin(), seen.end(), 1) != kLandmarks)
    throw Error("The rig '" + rig.kind +
                "' has not all of the 68 landmarks; landmark points cannot be put on it.");
}

// The rig's 68 landmarks in order.
std::vector<SurfacePoint> landmark_points(const Rig& rig) {
  std::vector<SurfacePoint> out(kLandmarks);
  for (size_t i = 0; i < rig.multipie.size(); ++i) {
    const Vec3d b = rig.multipie.barycentric[i].cast<double>();
    out[static_cast<size_t>(rig.multipie.index[i])] = {
        rig.multipie.triangle[i], b, embedding::position_on(rig.mesh, rig.multipie.triangle[i], b)};
  }
  return out;
}

// A pair of places that shall meet; `slack` 0: exactly, else the spline may miss it (metres, the
// diagonal of the regularised spline).
struct Pair {
  Vec3d from, to;
  double slack;
};

// The points of all rims on the rig; triangle -1 elsewhere.
std::vector<SurfacePoint> rim_points(const Rig& rig, const CanonicalFace& face) {
  std::vector<SurfacePoint> out(kPoints);
  const embedding::EdgeGraph graph = embedding::edge_graph(rig.mesh, "skin");
  for (const Rim& rim : rims()) {
    const SurfaceLine line(rig, graph, rim.landmarks, rim.course);
    std::vector<double> length = {0};
    for (size_t i = 1; i < rim.points.size(); ++i)
      length.push_back(length.back() +
                       static_cast<double>((face.vertices[static_cast<size_t>(rim.points[i])] -
                                            face.vertices[static_cast<size_t>(rim.points[i - 1])])
                                               .norm()));
    for (size_t k = 1; k < rim.same.size(); ++k) {
      const auto [first, from] = rim.same[k - 1];
      const auto [last, to] = rim.same[k];
      for (size_t i = first; i <= last; ++i) {
        const double whole = length[last] - length[first];
        const double s = whole > 0 ? (length[i] - length[first]) / whole : 0;
        out[static_cast<size_t>(rim.points[i])] =
            line.at((1 - s) * line.length_at(from) + s * line.length_at(to));
      }
    }
  }
  return out;
}

// Least-squares similarity to = s R from + t (Umeyama 1991), applied to `points`.
void apply_similarity(const std::vector<Pair>& pairs, std::vector<Vec3d>& points) {
  Eigen::Matrix3Xd from(3, pairs.size()), to(3, pairs.size());
  for (size_t i = 0; i < pairs.size(); ++i) {
    from.col(static_cast<Eigen::Index>(i)) = pairs[i].from;
    to.col(static_cast<Eigen::Index>(i)) = pairs[i].to;
  }
  const Mat4d m = Eigen::umeyama(from, to, true);
  for (Vec3d& p : points) p = (m.topLeftCorner<3, 3>() * p + m.topRightCorner<3, 1>()).eval();
}

// Regularised biharmonic spline in 3D: f(x) = sum_i w_i (-|x - p_i|) + affine (Bookstein 1989, with
// the kernel of three dimensions).
void apply_spline(const std::vector<Pair>& pairs, std::vector<Vec3d>& points) {
  const Eigen::Index n = static_cast<Eigen::Index>(pairs.size());
  Eigen::MatrixXd system = Eigen::MatrixXd::Zero(n + 4, n + 4);
  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(n + 4, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Pair& a = pairs[static_cast<size_t>(i)];
    for (Eigen::Index j = 0; j < n; ++j)
      system(i, j) = -(a.from - pairs[static_cast<size_t>(j)].from).norm();
    system(i, i) += a.slack;
    system.block<1, 4>(i, n) << 1, a.from.x(), a.from.y(), a.from.z();
    system.block<4, 1>(n, i) = system.block<1, 4>(i, n).transpose();
    right.row(i) = (a.to - a.from).transpose();
  }
  const Eigen::MatrixXd weights = system.fullPivLu().solve(right);
  for (Vec3d& p : points) {
    Eigen::RowVector3d move = weights.row(n);
    for (int k = 0; k < 3; ++k) move += p[k] * weights.row(n + 1 + k);
    for (Eigen::Index i = 0; i < n; ++i)
      move -= (p - pairs[static_cast<size_t>(i)].from).norm() * weights.row(i);
    p += move.transpose();
  }
}

std::vector<Vec3d> normals_of(const std::vector<Vec3d>& points,
                              const std::vector<Vec3i>& triangles) {
  std::vector<Vec3d> normals(points.size(), Vec3d::Zero());
  for (const Vec3i& f : triangles) {
    const Vec3d& a = points[static_cast<size_t>(f[0])];
    const Vec3d n =
        (points[static_cast<size_t>(f[1])] - a).cross(points[static_cast<size_t>(f[2])] - a);
    for (int k = 0; k < 3; ++k) normals[static_cast<size_t>(f[k])] += n;
  }
  for (Vec3d& n : normals) n.normalize();
  return normals;
}

// Draws the points onto the surface: repeated closest points, with a displacement from where they
// stand now that is smooth over the canonical mesh. `fixed` points (triangle >= 0) go where they
// belong.
void draw_onto(const Surface& surface, const std::vector<Vec3i>& triangles,
               const std::vector<SurfacePoint>& fixed, std::vector<Vec3d>& points) {
  constexpr int kRounds = 12;
  constexpr double kLeastCosine = 0.5, kFarthest = 0.03, kFixedWeight = 1e4;
  const std::vector<Vec3d> start = points;
  const Eigen::Index n = static_cast<Eigen::Index>(points.size());
  const std::vector<std::pair<int, int>> edges = mesh_edges(triangles, static_cast<int>(n));
  for (int round = 0; round < kRounds; ++round) {
    // Stiff at first, then looser.
    const double stiffness = 6 * std::pow(0.75, round);
    const std::vector<Vec3d> normals = normals_of(points, triangles);
    std::vector<Eigen::Triplet<double>> entries;
    Eigen::MatrixXd right = Eigen::MatrixXd::Zero(n, 3);
    for (const auto& [a, b] : edges) {
      entries.emplace_back(a, a, stiffness);
      entries.emplace_back(b, b, stiffness);
      entries.emplace_back(a, b, -stiffness);
      entries.emplace_back(b, a, -stiffness);
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      const size_t v = static_cast<size_t>(i);
      double weight = 1e-6;  // keeps the system definite where nothing is found
      Vec3d target = points[v];
      if (fixed[v].triangle >= 0) {
        weight = kFixedWeight;
        target = fixed[v].position;
      } else {
        const SurfacePoint hit = surface.closest(points[v], normals[v], kLeastCosine);
        if (hit.triangle >= 0 && (hit.position - points[v]).norm() < kFarthest) {
          weight = 1;
          target = hit.position;
        }
      }
      entries.emplace_back(i, i, weight);
      right.row(i) += weight * (target - start[v]).transpose();
    }
    Eigen::SparseMatrix<double> system(n, n);
    system.setFromTriplets(entries.begin(), entries.end());
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(system);
    const Eigen::MatrixXd move = solver.solve(right);
    for (size_t v = 0; v < points.size(); ++v)
      points[v] = start[v] + move.row(static_cast<Eigen::Index>(v)).transpose();
  }
}

void append(LandmarkEmbedding& out, int index, const SurfacePoint& point) {
  out.index.push_back(index);
  out.triangle.push_back(point.triangle);
  const Vec3d b = point.barycentric.cwiseMax(0.0);
  out.barycentric.emplace_back((b / b.sum()).cast<float>());
}

// Centre and limbus of both irises, for eyes that look to +z.
void append_irises(const Rig& rig, LandmarkEmbedding& out) {
  const std::vector<std::string>& parts = rig.mesh.parts;
  for (const auto& [part, first] : {std::pair{"eye_right", 468}, std::pair{"eye_left", 473}}) {
    if (std::find(parts.begin(), parts.end(), part) == parts.end()) continue;
    const Surface eye(rig.mesh, part);
    if (eye.empty()) continue;
    Vec3d center = eye.centroid();
    const int joint = rig.joint(part);
    if (joint >= 0) {
      center.setZero();
      const size_t count = static_cast<size_t>(rig.mesh.vertex_count());
      for (size_t v = 0; v < count; ++v)
        center += static_cast<double>(rig.joint_regressor[static_cast<size_t>(joint) * count + v]) *
                  rig.mesh.vertex(static_cast<int>(v)).cast<double>();
    }
    const Vec3d offsets[5] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}};
    for (int k = 0; k < 5; ++k) {
      const SurfacePoint hit = eye.last_hit(center + kIrisRadius * offsets[k], Vec3d::UnitZ());
      if (hit.triangle >= 0) append(out, first + k, hit);
    }
  }
}

}  // namespace

const std::array<int, 68>& mediapipe_of_multipie() {
  static const std::array<int, 68> points = {
      127, 234, 93,  132, 172, 150, 149, 148, 152,                 // jaw, right to chin
      377, 378, 379, 397, 361, 323, 454, 356,                      // chin to left
      70,  63,  105, 66,  107, 336, 296, 334, 293, 300,            // brows
      168, 197, 195, 4,   98,  97,  2,   326, 327,                 // nose
      33,  160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,  // eyes
      61,  39,  37,  0,   267, 269, 291, 321, 314, 17,  84,  91,   // outer lip
      78,  81,  13,  311, 308, 402, 14,  178};                     // inner lip
  return points;
}

LandmarkEmbedding embed_canonical(const Rig& rig, const CanonicalFace& face) {
  if (face.vertices.size() != kPoints)
    throw Error(
        "The canonical face is empty; give face_landmarker.task or the packed_assets.data "
        "of @mediapipe/face_mesh.");
  check_landmarks(rig);
  const std::vector<SurfacePoint> landmarks = landmark_points(rig);
  const std::vector<SurfacePoint> rim = rim_points(rig, face);

  std::vector<Vec3d> points;
  for (const Vec3f& v : face.vertices) points.push_back(v.cast<double>());
  std::vector<Pair> pairs;
  for (size_t i = 0; i < rim.size(); ++i)
    if (rim[i].triangle >= 0) pairs.push_back({points[i], rim[i].position, 0});
  // Brow points and the jaw line are marked with some freedom, and differently by people and by the
  // network: there the canonical face's own proportions are the better guide.
  for (size_t i = 0; i < static_cast<size_t>(kFirstLid); ++i) {
    const double slack = i < kFirstBrow ? 0.05 : i < kFirstNose ? 0.2 : 0.015;
    pairs.push_back(
        {points[static_cast<size_t>(mediapipe_of_multipie()[i])], landmarks[i].position, slack});
  }
  std::vector<Vec3d> sources;
  for (const Pair& pair : pairs) sources.push_back(pair.from);
  apply_similarity(pairs, points);
  apply_similarity(pairs, sources);
  for (size_t i = 0; i < pairs.size(); ++i) pairs[i].from = sources[i];
  apply_spline(pairs, points);

  const Surface skin(rig.mesh, "skin");
  draw_onto(skin, face.triangles, rim, points);
  const std::vector<Vec3d> normals = normals_of(points, face.triangles);
  LandmarkEmbedding out;
  for (size_t i = 0; i < points.size(); ++i) {
    SurfacePoint place = rim[i];
    for (const double cosine : {0.3, -1.0})
      if (place.triangle < 0) place = skin.closest(points[i], normals[i], cosine);
    EFFIGY_CHECK(place.triangle >= 0);
    append(out, static_cast<int>(i), place);
  }
  append_irises(rig, out);
  return out;
}

LandmarkEmbedding embed_corresponding(const Rig& rig) {
  check_landmarks(rig);
  const std::vector<SurfacePoint> landmarks = landmark_points(rig);
  LandmarkEmbedding out;
  for (size_t i = 0; i < landmarks.size(); ++i)
    append(out, mediapipe_of_multipie()[i], landmarks[i]);
  append_irises(rig, out);
  return out;
}

}  // namespace effigy
