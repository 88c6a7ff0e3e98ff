#include "effigy/people/body_rig.h"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "effigy/base/error.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

using Sparse = Eigen::SparseMatrix<double>;

Vec3d between(const Vec3d& a, const Vec3d& b, double t) {
  return a + t * (b - a);
}

double segment_distance(const Vec3d& p, const Vec3d& a, const Vec3d& b) {
  const Vec3d ab = b - a;
  const double t =
      ab.squaredNorm() > 0 ? std::clamp((p - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0) : 0.0;
  return (p - a - t * ab).norm();
}

class BoneMaker {
 public:
  BoneMaker(const BodyForm& form, const Rig& head, const Vec3d& offset)
      : j_(form.joints()), k_(form.build().stature), head_(head), offset_(offset) {}

  std::vector<BodyBone> make() {
    trunk();
    for (const int side : {1, -1}) limbs(side);
    return std::move(bones_);
  }

 private:
  int add(const std::string& name, int parent, const Vec3d& joint,
          std::vector<std::pair<Vec3d, Vec3d>> segments, double radius) {
    bones_.push_back({name, parent, joint, std::move(segments), radius});
    return static_cast<int>(bones_.size()) - 1;
  }

  void trunk() {
    const double k = k_;
    const auto off = [&](const Vec3d& p, double x) { return Vec3d(x, p.y(), p.z()); };
    // Three strands side by side stand for the breadth of the trunk.
    const auto strands = [&](const Vec3d& a, const Vec3d& b, double wide) {
      return std::vector<std::pair<Vec3d, Vec3d>>{
          {a, b}, {off(a, wide), off(b, wide)}, {off(a, -wide), off(b, -wide)}};
    };
    hips_ = add("hips", -1, j_.hips,
                strands(between(j_.hips, Vec3d(0, j_.upper_leg.y(), 0), 0.6), j_.spine, 70 * k),
                95 * k);
    const int spine = add("spine", hips_, j_.spine, strands(j_.spine, j_.chest, 55 * k), 95 * k);
    const int chest =
        add("chest", spine, j_.chest, strands(j_.chest, j_.upper_chest, 60 * k), 95 * k);
    upper_chest_ =
        add("upper_chest", chest, j_.upper_chest,
            strands(j_.upper_chest, between(j_.upper_chest, j_.neck, 0.72), 60 * k), 95 * k);
    const int neck = add("neck", upper_chest_, j_.neck, {{j_.neck, j_.head}}, 58 * k);
    const auto head_joint = [&](const char* name) {
      const int i = head_.joint(name);
      if (i < 0) throw Error(std::string("The head rig has no joint '") + name + "'.");
      Vec3d p = Vec3d::Zero();
      const size_t count = head_.mesh.vertices.size() / 3;
      for (size_t v = 0; v < count; ++v)
        p += 1e3 * static_cast<double>(head_.joint_regressor[static_cast<size_t>(i) * count + v]) *
             head_.mesh.vertex(static_cast<int>(v)).cast<double>();
      return Vec3d(p + offset_);
    };
    const int head = add("head", neck, head_joint("neck"), {}, 1);
    add("jaw", head, head_joint("jaw"), {}, 1);
    add("eye_left", head, head_joint("eye_left"), {}, 1);
    add("eye_right", head, head_joint("eye_right"), {}, 1);
  }

  void limbs(int side) {
    const double k = k_;
    const std::string suffix = side > 0 ? "_left" : "_right";
    const auto at = [&](const Vec3d& p) { return Vec3d(side * p.x(), p.y(), p.z()); };
    const Vec3d upper = at(j_.upper_arm), elbow = at(j_.lower_arm), wrist = at(j_.hand);
    const int shoulder = add(
        "shoulder" + suffix, upper_chest_, at(j_.shoulder),
        {{between(at(j_.shoulder), upper, 0.45), between(at(j_.shoulder), upper, 0.92)}}, 42 * k);
    const int arm =
        add("upper_arm" + suffix, shoulder, upper, {{between(upper, elbow, 0.42), elbow}}, 46 * k);
    add("upper_arm_twist" + suffix, arm, upper, {{upper, between(upper, elbow, 0.42)}}, 46 * k);
    const int fore =
        add("lower_arm" + suffix, arm, elbow, {{elbow, between(elbow, wrist, 0.45)}}, 40 * k);
    add("lower_arm_twist" + suffix, fore, between(elbow, wrist, 0.5),
        {{between(elbow, wrist, 0.45), wrist}}, 34 * k);
    std::vector<std::pair<Vec3d, Vec3d>> palm;
    for (const auto& finger : j_.fingers) palm.emplace_back(wrist, at(finger[0]));
    palm.erase(palm.begin());
    const int hand = add("hand" + suffix, fore, wrist, palm, 16 * k);
    static constexpr const char* kFingers[5] = {"thumb", "index", "middle", "ring", "little"};
    static constexpr const char* kBones[3] = {"_proximal", "_intermediate", "_distal"};
    static constexpr const char* kThumb[3] = {"_metacarpal", "_proximal", "_distal"};
    for (size_t f = 0; f < 5; ++f) {
      int parent = hand;
      for (size_t b = 0; b < 3; ++b) {
        const auto& finger = j_.fingers[f];
        parent = add(std::string(kFingers[f]) + (f == 0 ? kThumb[b] : kBones[b]) + suffix, parent,
                     at(finger[b]), {{at(finger[b]), at(finger[b + 1])}},
                     (f == 0 && b == 0 ? 15 : 9) * k);
      }
    }
    const Vec3d hip = at(j_.upper_leg), knee = at(j_.lower_leg), ankle = at(j_.foot);
    const int thigh =
        add("upper_leg" + suffix, hips_, hip, {{between(hip, knee, 0.4), knee}}, 78 * k);
    add("upper_leg_twist" + suffix, thigh, hip,
        {{between(hip, knee, 0.08), between(hip, knee, 0.4)}}, 78 * k);
    const int shank = add("lower_leg" + suffix, thigh, knee, {{knee, ankle}}, 52 * k);
    const int foot = add("foot" + suffix, shank, ankle,
                         {{ankle, at(j_.toes)}, {ankle, ankle + Vec3d(0, -50, -30) * k}}, 36 * k);
    add("toes" + suffix, foot, at(j_.toes), {{at(j_.toes), at(j_.toe_tip)}}, 30 * k);
  }

  const BodyJoints& j_;
  double k_;
  const Rig& head_;
  Vec3d offset_;
  std::vector<BodyBone> bones_;
  int hips_ = 0, upper_chest_ = 0;
};

// Distance to a bone in thicknesses of it.
double bone_distance(const BodyBone& bone, const Vec3d& p) {
  double best = std::numeric_limits<double>::infinity();
  for (const auto& [a, b] : bone.segments) best = std::min(best, segment_distance(p, a, b));
  return best / bone.radius;
}

// Cotangent weights and a third of the areas around each vertex, millimetres.
void surface_operator(const std::vector<Vec3d>& p, const std::vector<Vec3i>& triangles,
                      std::vector<Eigen::Triplet<double>>& entries, std::vector<double>& area) {
  for (const Vec3i& t : triangles) {
    const double whole = 0.5 * (p[t[1]] - p[t[0]]).cross(p[t[2]] - p[t[0]]).norm();
    for (int k = 0; k < 3; ++k) {
      const int i = t[(k + 1) % 3], j = t[(k + 2) % 3];
      const Vec3d a = p[i] - p[t[k]], b = p[j] - p[t[k]];
      const double w = 0.5 * std::clamp(a.dot(b) / std::max(a.cross(b).norm(), 1e-9), 0.01, 10.0);
      entries.emplace_back(i, i, w);
      entries.emplace_back(j, j, w);
      entries.emplace_back(i, j, -w);
      entries.emplace_back(j, i, -w);
      area[static_cast<size_t>(t[k])] += whole / 3;
    }
  }
}

// Heat weights of the body's own vertices and the ring: rows for `local` points.
Eigen::MatrixXd heat_weights(const std::vector<Vec3d>& points, const std::vector<Vec3i>& triangles,
                             const std::vector<BodyBone>& bones) {
  const auto n = static_cast<Eigen::Index>(points.size());
  std::vector<Eigen::Triplet<double>> entries;
  std::vector<double> area(points.size(), 0);
  surface_operator(points, triangles, entries, area);
  Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(n, static_cast<Eigen::Index>(bones.size()));
  for (Eigen::Index i = 0; i < n; ++i) {
    const Vec3d& p = points[static_cast<size_t>(i)];
    size_t nearest = 0;
    double best = std::numeric_limits<double>::infinity();
    for (size_t b = 0; b < bones.size(); ++b) {
      const double d = bone_distance(bones[b], p);
      if (d < best) {
        best = d;
        nearest = b;
      }
    }
    // Heat enters over about the thickness of the limb: faster, the insides of knees and elbows
    // fold over when they bend; slower, they lose their form.
    const double reach = bones[nearest].radius * std::clamp(best, 0.6, 2.0);
    const double heat = area[static_cast<size_t>(i)] * 2.0 / (reach * reach);
    entries.emplace_back(i, i, heat);
    rhs(i, static_cast<Eigen::Index>(nearest)) = heat;
  }
  Sparse a(n, n);
  a.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SimplicialLDLT<Sparse> solver(a);
  return solver.solve(rhs);
}

}  // namespace

std::vector<BodyBone> body_bones(const BodyForm& form, const Rig& head, const Vec3d& offset) {
  return BoneMaker(form, head, offset).make();
}

std::vector<float> body_weights(const BodyMesh& body, const Rig& head,
                                const std::vector<BodyBone>& bones) {
  const size_t count = static_cast<size_t>(body.mesh.vertex_count()), joints = bones.size();
  std::vector<int> local(count, -1), global;
  std::vector<Vec3d> points;
  std::vector<Vec3i> triangles;
  for (size_t f = static_cast<size_t>(body.head_triangles); f < body.mesh.triangles.size(); ++f) {
    Vec3i mapped;
    for (int k = 0; k < 3; ++k) {
      const int v = body.mesh.triangles[f][k];
      if (local[static_cast<size_t>(v)] < 0) {
        local[static_cast<size_t>(v)] = static_cast<int>(points.size());
        points.push_back(1e3 * body.mesh.vertex(v).cast<double>());
        global.push_back(v);
      }
      mapped[k] = local[static_cast<size_t>(v)];
    }
    triangles.push_back(mapped);
  }
  const Eigen::MatrixXd heat = heat_weights(points, triangles, bones);
  Eigen::MatrixXd rows =
      Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(count), static_cast<Eigen::Index>(joints));
  for (size_t i = 0; i < global.size(); ++i)
    rows.row(global[i]) = heat.row(static_cast<Eigen::Index>(i));

  // The head: what its own rig leaves to the root follows the ring below.
  const auto joint_of = [&](const std::string& name) {
    for (size_t b = 0; b < joints; ++b)
      if (bones[b].name == name) return static_cast<Eigen::Index>(b);
    throw Error("The body has no joint '" + name + "'.");
  };
  const size_t head_joints = head.parents.size();
  const auto ring_rows = rows;
  for (int v = 0; v < body.head_vertices; ++v) {
    const Vec3f p = body.mesh.vertex(v);
    int nearest = head.neck_ring[0];
    for (const int r : head.neck_ring) {
      const Vec3f d = body.mesh.vertex(r) - p, e = body.mesh.vertex(nearest) - p;
      if (d.squaredNorm() < e.squaredNorm()) nearest = r;
    }
    const float* own = head.weights.data() + static_cast<size_t>(v) * head_joints;
    const double root = own[0];
    Eigen::RowVectorXd row = root * ring_rows.row(nearest);
    for (size_t j = 1; j < head_joints; ++j) {
      const std::string& name = head.joint_names[j];
      row[joint_of(name == "neck" ? "head" : name)] += own[j];
    }
    rows.row(v) = row;
  }

  std::vector<float> weights(count * joints);
  for (size_t v = 0; v < count; ++v) {
    Eigen::RowVectorXd row = rows.row(static_cast<Eigen::Index>(v)).cwiseMax(0.0);
    const double x = 1e3 * static_cast<double>(body.mesh.vertex(static_cast<int>(v)).x());
    for (Eigen::Index j = 0; j < row.size(); ++j) {
      // A limb reaches a little beyond the middle.
      const double own = bones[static_cast<size_t>(j)].joint.x();
      if (std::abs(own) > 1) row[j] *= smooth_step(-120, -30, own > 0 ? x : -x);
      if (row[j] < 0.004) row[j] = 0;
    }
    row /= row.sum();
    for (size_t j = 0; j < joints; ++j)
      weights[v * joints + j] = static_cast<float>(row[static_cast<Eigen::Index>(j)]);
  }
  return weights;
}

void joint_row(const Mesh& mesh, const Vec3d& joint, float* row) {
  const Eigen::Index around = std::min<Eigen::Index>(40, mesh.vertex_count());
  std::vector<int> order(static_cast<size_t>(mesh.vertex_count()));
  std::iota(order.begin(), order.end(), 0);
  const auto far = [&](int v) { return (mesh.vertex(v).cast<double>() - joint).squaredNorm(); };
  std::partial_sort(order.begin(), order.begin() + around, order.end(), [&](int x, int y) {
    const double dx = far(x), dy = far(y);
    return dx < dy || (dx == dy && x < y);
  });
  Eigen::MatrixXd a(4, around);
  for (Eigen::Index i = 0; i < around; ++i)
    a.col(i) << 10 * (mesh.vertex(order[static_cast<size_t>(i)]).cast<double>() - joint), 1.0;
  const Eigen::VectorXd even = Eigen::VectorXd::Constant(around, 1.0 / static_cast<double>(around));
  const Eigen::Vector4d missing = Eigen::Vector4d(0, 0, 0, 1) - a * even;
  const Eigen::Matrix4d square = a * a.transpose() + 1e-9 * Eigen::Matrix4d::Identity();
  const Eigen::VectorXd w = even + a.transpose() * square.ldlt().solve(missing);
  for (Eigen::Index i = 0; i < around; ++i)
    row[order[static_cast<size_t>(i)]] = static_cast<float>(w[i]);
}

std::vector<float> body_regressor(const BodyMesh& body, const Rig& head,
                                  const std::vector<BodyBone>& bones) {
  const size_t count = static_cast<size_t>(body.mesh.vertex_count());
  const size_t head_count = static_cast<size_t>(body.head_vertices);
  std::vector<float> regressor(bones.size() * count, 0.0f);
  for (size_t b = 0; b < bones.size(); ++b) {
    float* row = regressor.data() + b * count;
    const std::string name = bones[b].name == "head" ? "neck" : bones[b].name;
    const bool of_head = bones[b].segments.empty();
    if (of_head) {
      const int j = head.joint(name);
      std::copy_n(head.joint_regressor.data() + static_cast<size_t>(j) * head_count, head_count,
                  row);
      continue;
    }
    joint_row(body.mesh, 1e-3 * bones[b].joint, row);
  }
  return regressor;
}

}  // namespace effigy::people
