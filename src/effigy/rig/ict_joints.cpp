#include "effigy/rig/ict_joints.h"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/topology.h"

namespace effigy::ict {

namespace {

constexpr int kRoot = 0, kNeck = 1, kEyes = 2, kJoints = 4;

// Where ICT-FaceKit's neutral head ends and its shoulders begin, as sloping planes y = a + b z that
// fall towards the front (metres): the first runs from under the chin to the nape, the second over
// the collar bones to the nape's root.
constexpr float kHeadAbove[2] = {-0.0723f, -0.4545f};
constexpr float kShouldersBelow[2] = {-0.148f, -0.2857f};
// The joint about which the head turns: between the third and fourth neck vertebra.
const Vec3d kNeckJoint(0, -0.075, -0.012);
constexpr double kNeckBand = 0.02;  // the joint follows the skin this far above and below, metres

bool above(const Vec3f& p, const float plane[2]) {
  return p.y() > plane[0] + plane[1] * p.z();
}

std::vector<uint8_t> vertices_of(const Mesh& mesh, int part) {
  std::vector<uint8_t> out(static_cast<size_t>(mesh.vertex_count()), 0);
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    if (mesh.triangle_part[t] == part)
      for (int k = 0; k < 3; ++k) out[static_cast<size_t>(mesh.triangles[t][k])] = 1;
  return out;
}

int part_of(const Mesh& mesh, const std::string& name) {
  const auto found = std::find(mesh.parts.begin(), mesh.parts.end(), name);
  EFFIGY_CHECK(found != mesh.parts.end());
  return static_cast<int>(found - mesh.parts.begin());
}

// Changes the weights (given on `vertices`, summing to 1) as little as possible in the square sense
// so that they still sum to 1 and their mean of the positions is `target`.
void aim(const Mesh& mesh, const std::vector<int>& vertices, const Vec3d& target,
         std::vector<double>& weights) {
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Vector4d miss(target.x(), target.y(), target.z(), 1);
  std::vector<Eigen::Vector4d> rows;
  for (size_t i = 0; i < vertices.size(); ++i) {
    const Vec3d p = mesh.vertex(vertices[i]).cast<double>();
    rows.emplace_back(p.x(), p.y(), p.z(), 1);
    normal += rows.back() * rows.back().transpose();
    miss -= weights[i] * rows.back();
  }
  const Eigen::Vector4d multiplier = normal.ldlt().solve(miss);
  for (size_t i = 0; i < vertices.size(); ++i) weights[i] += rows[i].dot(multiplier);
}

void set_row(Rig& rig, int joint, const std::vector<int>& vertices,
             const std::vector<double>& weights) {
  float* row = rig.joint_regressor.data() +
               static_cast<size_t>(joint) * static_cast<size_t>(rig.mesh.vertex_count());
  for (size_t i = 0; i < vertices.size(); ++i) row[vertices[i]] = static_cast<float>(weights[i]);
}

// Centre of the sphere through the vertices that are more than 60 degrees off the gaze (the cornea
// bulges); least squares of |p|^2 = 2 c.p + k.
Vec3d sphere_center(const Mesh& mesh, const std::vector<int>& vertices) {
  Vec3d mean = Vec3d::Zero();
  for (const int v : vertices) mean += mesh.vertex(v).cast<double>();
  mean /= static_cast<double>(vertices.size());
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  for (const int v : vertices) {
    const Vec3d p = mesh.vertex(v).cast<double>() - mean;
    if (p.z() > 0.5 * p.norm()) continue;
    const Eigen::Vector4d row(2 * p.x(), 2 * p.y(), 2 * p.z(), 1);
    normal += row * row.transpose();
    right += row * p.squaredNorm();
  }
  return mean + normal.ldlt().solve(right).head<3>();
}

void add_eye(Rig& rig, int joint, const std::string& part) {
  const Mesh& mesh = rig.mesh;
  const int number = part_of(mesh, part);
  // Weights by area, so that the centre is one also of shapes that stretch the eye.
  std::vector<double> area(static_cast<size_t>(mesh.vertex_count()), 0);
  double total = 0;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (mesh.triangle_part[t] != number) continue;
    const Vec3i& f = mesh.triangles[t];
    const Vec3d a = mesh.vertex(f[0]).cast<double>();
    const double twice =
        (mesh.vertex(f[1]).cast<double>() - a).cross(mesh.vertex(f[2]).cast<double>() - a).norm();
    for (int k = 0; k < 3; ++k) area[static_cast<size_t>(f[k])] += twice;
    total += 3 * twice;
  }
  std::vector<int> vertices;
  std::vector<double> weights;
  for (size_t v = 0; v < area.size(); ++v)
    if (area[v] > 0) {
      vertices.push_back(static_cast<int>(v));
      weights.push_back(area[v] / total);
      float* row = rig.weights.data() + kJoints * v;
      std::fill(row, row + kJoints, 0.f);
      row[joint] = 1;
    }
  aim(mesh, vertices, sphere_center(mesh, vertices), weights);
  set_row(rig, joint, vertices, weights);
}

// The share of the neck joint in each vertex: 0 at the shoulders, 1 on the head, between them the
// harmonic function on the mesh (Dirichlet energy with weights 1/length), eased at both ends.
std::vector<float> neck_share(const Mesh& mesh, const std::vector<uint8_t>& skin,
                              const std::vector<int>& ring) {
  const size_t count = skin.size();
  std::vector<double> share(count, 1);
  std::vector<int> unknown(count, -1);
  for (const int v : ring) share[static_cast<size_t>(v)] = 0;
  int unknowns = 0;
  for (size_t v = 0; v < count; ++v) {
    if (!skin[v] || share[v] == 0) continue;
    const Vec3f p = mesh.vertex(static_cast<int>(v));
    if (above(p, kHeadAbove)) continue;
    if (above(p, kShouldersBelow))
      unknown[v] = unknowns++;
    else
      share[v] = 0;
  }
  std::vector<Eigen::Triplet<double>> entries;
  Eigen::VectorXd right = Eigen::VectorXd::Zero(unknowns);
  for (const auto& [a, b] : mesh_edges(mesh.triangles, mesh.vertex_count())) {
    const double w =
        1.0 / std::max(1e-6, static_cast<double>((mesh.vertex(a) - mesh.vertex(b)).norm()));
    for (const auto& [from, to] : {std::pair{a, b}, std::pair{b, a}}) {
      const int i = unknown[static_cast<size_t>(from)], j = unknown[static_cast<size_t>(to)];
      if (i < 0) continue;
      entries.emplace_back(i, i, w);
      if (j >= 0)
        entries.emplace_back(i, j, -w);
      else
        right[i] += w * share[static_cast<size_t>(to)];
    }
  }
  if (unknowns > 0) {
    Eigen::SparseMatrix<double> laplacian(unknowns, unknowns);
    laplacian.setFromTriplets(entries.begin(), entries.end());
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(laplacian);
    const Eigen::VectorXd solution = solver.solve(right);
    for (size_t v = 0; v < count; ++v)
      if (unknown[v] >= 0) {
        const double s = std::clamp(solution[unknown[v]], 0.0, 1.0);
        share[v] = s * s * (3 - 2 * s);
      }
  }
  return {share.begin(), share.end()};
}

}  // namespace

void add_joints(Rig& rig) {
  const Mesh& mesh = rig.mesh;
  const size_t count = static_cast<size_t>(mesh.vertex_count());
  rig.joint_names = {"root", "neck", "eye_left", "eye_right"};
  rig.parents = {-1, kRoot, kNeck, kNeck};
  rig.joint_regressor.assign(kJoints * count, 0);
  rig.weights.assign(kJoints * count, 0);

  const std::vector<std::vector<int>> loops = boundary_loops(mesh.triangles, mesh.vertex_count());
  // The gums are open as well; the neck's loop is the one that goes lowest.
  float lowest = 1e30f;
  for (const std::vector<int>& loop : loops)
    for (const int v : loop)
      if (mesh.vertex(v).y() < lowest) {
        lowest = mesh.vertex(v).y();
        rig.neck_ring = loop;
      }
  EFFIGY_CHECK(rig.neck_ring.size() >= 3);

  const std::vector<uint8_t> skin = vertices_of(mesh, part_of(mesh, "skin"));
  const std::vector<float> share = neck_share(mesh, skin, rig.neck_ring);
  for (size_t v = 0; v < count; ++v) {
    rig.weights[kJoints * v + kRoot] = 1 - share[v];
    rig.weights[kJoints * v + kNeck] = share[v];
  }

  // The root stands in the middle of the ring.
  std::vector<double> weights(rig.neck_ring.size(), 0);
  double length = 0;
  for (size_t i = 0; i < rig.neck_ring.size(); ++i) {
    const size_t j = (i + 1) % rig.neck_ring.size();
    const double edge =
        static_cast<double>((mesh.vertex(rig.neck_ring[i]) - mesh.vertex(rig.neck_ring[j])).norm());
    weights[i] += 0.5 * edge;
    weights[j] += 0.5 * edge;
    length += edge;
  }
  for (double& w : weights) w /= length;
  set_row(rig, kRoot, rig.neck_ring, weights);

  std::vector<int> band;
  for (size_t v = 0; v < count; ++v) {
    const Vec3d p = mesh.vertex(static_cast<int>(v)).cast<double>() - kNeckJoint;
    const double height = p.y() - static_cast<double>(kHeadAbove[1]) * p.z();
    if (skin[v] && std::abs(height) < kNeckBand) band.push_back(static_cast<int>(v));
  }
  weights.assign(band.size(), 1.0 / static_cast<double>(band.size()));
  aim(mesh, band, kNeckJoint, weights);
  set_row(rig, kNeck, band, weights);

  add_eye(rig, kEyes, "eye_left");
  add_eye(rig, kEyes + 1, "eye_right");
}

}  // namespace effigy::ict
