#include "effigy/people/builtin_head.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/people/head_fields.h"
#include "effigy/people/head_landmarks.h"
#include "effigy/people/head_mesh.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/head_subject.h"
#include "effigy/people/smooth.h"
#include "effigy/rig/embedding.h"

namespace effigy {
namespace {

using people::HeadMesh;
using people::HeadVertex;
using people::Region;
using people::Shape;
using people::smooth_step;

enum Joint { kRoot, kNeck, kJaw, kEyeLeft, kEyeRight, kJoints };
const Vec3d kRootJoint(0, -10, 0);

// Weights on the chosen vertices that give `joint` exactly (and sum to 1), nearest to equal ones:
// w = w0 + A^T (A A^T)^-1 (b - A w0), A = [positions; ones].
std::vector<double> regressor_row(const HeadMesh& head, const std::vector<int>& chosen,
                                  const Vec3d& joint) {
  const auto n = static_cast<Eigen::Index>(chosen.size());
  Eigen::MatrixXd a(4, n);
  for (Eigen::Index i = 0; i < n; ++i)
    a.col(i) << 0.01 * head.vertices[static_cast<size_t>(chosen[static_cast<size_t>(i)])].p, 1.0;
  const Eigen::VectorXd even = Eigen::VectorXd::Constant(n, 1.0 / static_cast<double>(n));
  Eigen::Vector4d wanted;
  wanted << 0.01 * joint, 1.0;
  const Eigen::Matrix4d square = a * a.transpose();
  const Eigen::VectorXd w =
      even + a.transpose() * square.ldlt().solve(Eigen::Vector4d(wanted - a * even));
  std::vector<double> row(head.vertices.size(), 0.0);
  for (Eigen::Index i = 0; i < n; ++i)
    row[static_cast<size_t>(chosen[static_cast<size_t>(i)])] = w[i];
  return row;
}

template <typename Rule>
std::vector<int> choose(const HeadMesh& head, Rule rule) {
  std::vector<int> chosen;
  for (size_t i = 0; i < head.vertices.size(); ++i)
    if (rule(head.vertices[i])) chosen.push_back(static_cast<int>(i));
  return chosen;
}

void add_joints(const HeadMesh& head, Rig& rig) {
  rig.joint_names = {"root", "neck", "jaw", "eye_left", "eye_right"};
  rig.parents = {-1, kRoot, kNeck, kNeck, kNeck};
  auto skin_at = [&](double low, double high) {
    return choose(head, [&](const HeadVertex& v) {
      return v.region == Region::kSkin && v.p.y() > low && v.p.y() < high;
    });
  };
  auto eye = [&](int side) {
    return choose(
        head, [&](const HeadVertex& v) { return v.region == Region::kEyeball && v.side == side; });
  };
  const auto hinge = choose(head, [](const HeadVertex& v) {
    return v.region == Region::kSkin && std::abs(v.p.x()) > 40 && std::abs(v.p.y() + 20) < 25 &&
           std::abs(v.p.z() - 6) < 35;
  });
  const Vec3d left(people::kEyeX, people::kEyeY, people::kEyeZ);
  const std::vector<std::vector<double>> rows = {
      regressor_row(head, skin_at(-60, 40), kRootJoint),
      regressor_row(head, skin_at(-135, -90), people::kNeckJoint),
      regressor_row(head, hinge, people::kJawHinge), regressor_row(head, eye(1), left),
      regressor_row(head, eye(-1), Vec3d(-left.x(), left.y(), left.z()))};
  for (const auto& row : rows)
    for (const double w : row) rig.joint_regressor.push_back(static_cast<float>(w));
}

void add_weights(const HeadMesh& head, Rig& rig) {
  const std::vector<double> jaw = people::jaw_weights(head);
  for (size_t i = 0; i < head.vertices.size(); ++i) {
    const HeadVertex& v = head.vertices[i];
    std::array<double, kJoints> w{};
    if (v.region == Region::kEyeball) {
      w[v.side > 0 ? kEyeLeft : kEyeRight] = 1;
    } else {
      // The open ring follows the root, the head, chin included, the neck joint.
      const double level = v.p.y() + 0.35 * (v.p.z() + 28);
      const double neck =
          smooth_step(-172, -98, level) * smooth_step(people::kNeckBottom + 1, -140, v.p.y());
      w[kJaw] = neck * jaw[i];
      w[kNeck] = neck - w[kJaw];
      w[kRoot] = 1 - neck;
    }
    float sum = 0;
    for (int j = 1; j < kJoints; ++j) sum += static_cast<float>(w[static_cast<size_t>(j)]);
    rig.weights.push_back(1.0f - sum);
    for (int j = 1; j < kJoints; ++j)
      rig.weights.push_back(static_cast<float>(w[static_cast<size_t>(j)]));
  }
}

void append(std::vector<float>& basis, const std::vector<Vec3d>& offsets) {
  for (const Vec3d& d : offsets)
    for (int c = 0; c < 3; ++c) basis.push_back(static_cast<float>(d[c] * 1e-3));
}

Rig make_rig() {
  const HeadMesh& head = people::shared_head_mesh();
  Rig rig;
  rig.kind = "builtin";
  rig.licence = "Apache-2.0";
  rig.mesh = head.mesh;
  for (const Shape& shape : people::identity_shapes(head)) {
    append(rig.identity_basis, shape.offsets);
    rig.identity_sigma.push_back(1.0f);
  }
  rig.identity_count = static_cast<int>(rig.identity_sigma.size());
  for (const Shape& shape : people::expression_shapes(head)) {
    append(rig.expression_basis, shape.offsets);
    rig.expression_names.push_back(shape.name);
    rig.expression_low.push_back(0.0f);
    rig.expression_high.push_back(1.0f);
  }
  rig.expression_count = static_cast<int>(rig.expression_names.size());
  add_joints(head, rig);
  add_weights(head, rig);
  std::vector<std::array<double, 3>> weights;
  for (size_t i = 0; i < rig.weights.size(); i += kJoints)
    weights.push_back({rig.weights[i + kRoot], rig.weights[i + kNeck], rig.weights[i + kJaw]});
  for (const auto& shape : people::pose_shapes(head, weights)) append(rig.pose_basis, shape);
  rig.neck_ring = head.neck_ring;
  rig.multipie = people::multipie_landmarks(head);
  rig.mediapipe = embed_corresponding(rig);
  check_rig(rig, "built-in head");
  return rig;
}

// What a subject adds to the mean head: its identity, and its hair as a shell along the normals.
std::vector<float> subject_offsets(const people::Subject& who) {
  const HeadMesh& head = people::shared_head_mesh();
  static const std::vector<Shape> modes = people::identity_shapes(head);
  std::vector<Vec3d> offset(head.vertices.size(), Vec3d::Zero());
  for (const auto& [name, value] : who.identity) {
    const auto mode = std::find_if(modes.begin(), modes.end(),
                                   [&, n = name](const Shape& s) { return s.name == n; });
    EFFIGY_CHECK(mode != modes.end());
    for (size_t i = 0; i < offset.size(); ++i) offset[i] += value * mode->offsets[i];
  }
  const std::vector<float> normals = vertex_normals(head.mesh.vertices, head.mesh.triangles);
  std::vector<float> out;
  for (size_t i = 0; i < offset.size(); ++i) {
    const HeadVertex& v = head.vertices[i];
    if (v.region == Region::kSkin)
      offset[i] +=
          people::hair_thickness(v.p, who.hair) * Vec3f(normals.data() + 3 * i).cast<double>();
    for (int c = 0; c < 3; ++c) out.push_back(static_cast<float>(offset[i][c] * 1e-3));
  }
  return out;
}

}  // namespace

Rig builtin_head_rig(uint64_t subject) {
  static const Rig mean = make_rig();
  const people::Subject who = people::make_subject(subject);
  Rig rig = mean;
  const std::vector<float> own = subject_offsets(who);
  for (size_t i = 0; i < own.size(); ++i) rig.mesh.vertices[i] += own[i];
  return rig;
}

LandmarkEmbedding builtin_head_network_points() {
  static const LandmarkEmbedding points = [] {
    LandmarkEmbedding all = people::network_landmarks(people::shared_head_mesh());
    const LandmarkEmbedding some = builtin_head_rig().mediapipe;
    for (size_t i = 0; i < some.size(); ++i)
      if (some.index[i] >= 468) {
        all.index.push_back(some.index[i]);
        all.triangle.push_back(some.triangle[i]);
        all.barycentric.push_back(some.barycentric[i]);
      }
    return all;
  }();
  return points;
}

}  // namespace effigy
