#include "effigy/body/keypoint_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <map>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr int kSteps = 30;           // of Levenberg-Marquardt, a frame
constexpr double kDone = 1e-6;       // relative decrease of the cost
constexpr double kStep = 1e-3;       // of differences: radians, units of expression, metres
constexpr double kHold = 2e-4;       // metres a radian: joints stay as in the frame before
constexpr double kHoldShape = 2e-4;  // metres a unit: expressions stay small

// The rig with only those vertices that keypoints hang on, so that a pose costs microseconds.
struct ReducedRig {
  RigShape shape;
  std::vector<Vec3i> triangles;  // one for every keypoint on the surface
  std::vector<KeypointBinding> bindings;

  explicit ReducedRig(const BodyDriver& driver) : bindings(driver.body()) {
    bindings.insert(bindings.end(), driver.face().begin(), driver.face().end());
    std::map<int, int> index;
    std::vector<int> kept;
    for (KeypointBinding& binding : bindings) {
      if (binding.triangle < 0) continue;
      const Vec3i& corners = driver.triangles()[static_cast<size_t>(binding.triangle)];
      Vec3i own;
      for (int c = 0; c < 3; ++c) {
        const auto [at, fresh] = index.emplace(corners[c], static_cast<int>(kept.size()));
        if (fresh) kept.push_back(corners[c]);
        own[c] = at->second;
      }
      binding.triangle = static_cast<int>(triangles.size());
      triangles.push_back(own);
    }
    if (kept.empty()) kept.push_back(0);
    const RigShape& all = driver.shape();
    const size_t vertices = all.rest.size() / 3;
    shape.joints = all.joints;
    shape.parents = all.parents;
    shape.rest = gather(all.rest, vertices, 3, kept);
    shape.weights = gather(all.weights, vertices, all.parents.size(), kept);
    shape.expression_basis = gather(all.expression_basis, vertices, 3, kept);
    shape.pose_basis = gather(all.pose_basis, vertices, 3, kept);
  }

  // Rows of `width` numbers a vertex, for as many whole arrays as `values` holds.
  static std::vector<float> gather(const std::vector<float>& values, size_t vertices, size_t width,
                                   const std::vector<int>& kept) {
    std::vector<float> out;
    for (size_t first = 0; first < values.size(); first += vertices * width)
      for (const int v : kept) {
        const auto from =
            values.begin() + static_cast<std::ptrdiff_t>(first + static_cast<size_t>(v) * width);
        out.insert(out.end(), from, from + static_cast<std::ptrdiff_t>(width));
      }
    return out;
  }

  Eigen::VectorXd keypoints(const RigPose& pose, std::vector<float>& vertices) const {
    pose_vertices(shape, pose, vertices);
    const std::vector<float> transforms = joint_transforms(shape, pose);
    Eigen::VectorXd all(3 * static_cast<Eigen::Index>(bindings.size()));
    for (size_t i = 0; i < bindings.size(); ++i)
      all.segment<3>(3 * static_cast<Eigen::Index>(i)) =
          keypoint_position(bindings[i], triangles, vertices, transforms).cast<double>();
    return all;
  }
};

// Parameters in one row: joint rotations, expression, translation.
float& parameter(RigPose& pose, size_t k) {
  if (k < pose.joint_rotation.size()) return pose.joint_rotation[k];
  k -= pose.joint_rotation.size();
  if (k < pose.expression.size()) return pose.expression[k];
  return pose.translation[k - pose.expression.size()];
}
size_t parameters_of(const RigPose& pose) {
  return pose.joint_rotation.size() + pose.expression.size() + 3;
}

class Fitter {
 public:
  Fitter(const ReducedRig& rig, const Rig& full) : rig_(rig), full_(full) {}

  // Rest pose, turned and moved as a whole onto the keypoints (Kabsch).
  RigPose aligned(const Eigen::VectorXd& wanted) {
    RigPose pose = RigPose::rest(full_);
    const Eigen::VectorXd flat = rig_.keypoints(pose, vertices_);
    using Points = Eigen::Map<const Eigen::Matrix3Xd>;
    const Points from(flat.data(), 3, flat.size() / 3), to(wanted.data(), 3, wanted.size() / 3);
    const Vec3d mean_from = from.rowwise().mean(), mean_to = to.rowwise().mean();
    const Mat3d product = (to.colwise() - mean_to) * (from.colwise() - mean_from).transpose();
    const Eigen::JacobiSVD<Mat3d> svd(product, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Vec3d signs(1, 1, svd.matrixU().determinant() * svd.matrixV().determinant() < 0 ? -1 : 1);
    const Mat3d turn = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
    const Eigen::AngleAxisd root(turn);
    for (int c = 0; c < 3; ++c)
      pose.joint_rotation[static_cast<size_t>(c)] =
          static_cast<float>(root.angle() * root.axis()[c]);
    const Eigen::VectorXd turned = rig_.keypoints(pose, vertices_);
    const Vec3d shift = mean_to - Points(turned.data(), 3, turned.size() / 3).rowwise().mean();
    for (int c = 0; c < 3; ++c)
      pose.translation[static_cast<size_t>(c)] += static_cast<float>(shift[c]);
    return pose;
  }

  void fit(const Eigen::VectorXd& wanted, RigPose& pose) {
    const RigPose before = pose;
    double damping = 1e-3, cost = cost_of(pose, before, wanted);
    for (int step = 0; step < kSteps; ++step) {
      Eigen::MatrixXd normal;
      Eigen::VectorXd slope;
      linearise(pose, before, wanted, normal, slope);
      bool better = false;
      const double last = cost;
      for (int attempt = 0; attempt < 8 && !better; ++attempt) {
        Eigen::MatrixXd damped = normal;
        damped.diagonal() += damping * normal.diagonal();
        const Eigen::VectorXd change = damped.ldlt().solve(-slope);
        RigPose next = pose;
        for (size_t k = 0; k < parameters_of(next); ++k)
          parameter(next, k) += static_cast<float>(change[static_cast<Eigen::Index>(k)]);
        bound_expression(next);
        const double found = cost_of(next, before, wanted);
        better = std::isfinite(found) && found < cost;
        damping = better ? std::max(damping * 0.3, 1e-9) : damping * 4;
        if (!better) continue;
        pose = next;
        cost = found;
      }
      if (!better || last - cost < kDone * last) break;
    }
  }

  double mean_distance(const RigPose& pose, const Eigen::VectorXd& wanted) {
    const Eigen::VectorXd off = rig_.keypoints(pose, vertices_) - wanted;
    return Eigen::Map<const Eigen::Matrix3Xd>(off.data(), 3, off.size() / 3)
        .colwise()
        .norm()
        .mean();
  }

 private:
  static double hold_of(const RigPose& pose, size_t k) {
    const size_t turns = pose.joint_rotation.size();
    return k < turns ? kHold : (k < turns + pose.expression.size() ? kHoldShape : 0.0);
  }
  // What a parameter is held to: the frame before; expressions to none.
  static double held_to(const RigPose& pose, RigPose& before, size_t k) {
    return k < pose.joint_rotation.size() ? static_cast<double>(parameter(before, k)) : 0.0;
  }

  void bound_expression(RigPose& pose) const {
    for (size_t e = 0; e < pose.expression.size(); ++e)
      pose.expression[e] =
          std::clamp(pose.expression[e], full_.expression_low[e], full_.expression_high[e]);
  }

  double cost_of(RigPose& pose, RigPose before, const Eigen::VectorXd& wanted) {
    double cost = (rig_.keypoints(pose, vertices_) - wanted).squaredNorm();
    for (size_t k = 0; k < parameters_of(pose); ++k) {
      const double off = static_cast<double>(parameter(pose, k)) - held_to(pose, before, k);
      cost += hold_of(pose, k) * hold_of(pose, k) * off * off;
    }
    return cost;
  }

  void linearise(RigPose& pose, RigPose before, const Eigen::VectorXd& wanted,
                 Eigen::MatrixXd& normal, Eigen::VectorXd& slope) {
    const auto count = static_cast<Eigen::Index>(parameters_of(pose));
    const Eigen::VectorXd now = rig_.keypoints(pose, vertices_);
    Eigen::MatrixXd jacobian(now.size(), count);
    for (Eigen::Index k = 0; k < count; ++k) {
      RigPose moved = pose;
      float& value = parameter(moved, static_cast<size_t>(k));
      const float start = value;
      value += static_cast<float>(kStep);
      const double step = static_cast<double>(value) - static_cast<double>(start);
      const Eigen::VectorXd ahead = rig_.keypoints(moved, vertices_);
      value = static_cast<float>(static_cast<double>(start) - step);
      jacobian.col(k) = (ahead - rig_.keypoints(moved, vertices_)) / (2 * step);
    }
    normal = jacobian.transpose() * jacobian;
    slope = jacobian.transpose() * (now - wanted);
    for (Eigen::Index k = 0; k < count; ++k) {
      const auto i = static_cast<size_t>(k);
      const double hold = hold_of(pose, i) * hold_of(pose, i);
      normal(k, k) += hold + 1e-12;
      slope[k] += hold * (static_cast<double>(parameter(pose, i)) - held_to(pose, before, i));
    }
  }

  const ReducedRig& rig_;
  const Rig& full_;
  std::vector<float> vertices_;
};

int64_t frames_in(const TensorFile& file, const std::string& name) {
  const std::vector<int64_t>& shape = file.shape(name);
  return shape.empty() ? 0 : shape[0];
}

}  // namespace

bool is_keypoint_track(const Path& path) {
  const TensorFile file = read_safetensors(path);
  return file.has("body_keypoints") && !file.has("joint_rotation");
}

KeypointTrack read_keypoint_track(const Path& path, const BodyDriver& driver) {
  const TensorFile file = read_safetensors(path);
  KeypointTrack track;
  const int64_t frames = frames_in(file, "body_keypoints");
  if (frames < 1)
    throw Error(path.string() + ": 'body_keypoints' holds no frames; give [F, " +
                std::to_string(driver.body().size()) + ", 3] numbers.");
  track.frames = static_cast<size_t>(frames);
  track.body =
      file.floats("body_keypoints", {frames, static_cast<int64_t>(driver.body().size()), 3});
  track.face =
      file.floats("face_keypoints", {frames, static_cast<int64_t>(driver.face().size()), 3});
  const auto rate = file.metadata.find("frames_per_second");
  if (rate == file.metadata.end()) return track;
  char* end = nullptr;
  track.frames_per_second = std::strtod(rate->second.c_str(), &end);
  if (end == rate->second.c_str() || *end != 0 || !(track.frames_per_second > 0) ||
      !(track.frames_per_second <= 1000))
    throw Error(path.string() + ": frames_per_second is '" + rate->second +
                "'; give a number above 0, at most 1000.");
  return track;
}

std::vector<RigPose> fit_keypoints(const BodyDriver& driver, const Rig& rig,
                                   const KeypointTrack& track, double& left_mean,
                                   const std::function<void(size_t)>& progress) {
  const ReducedRig reduced(driver);
  const size_t body = 3 * driver.body().size(), face = 3 * driver.face().size();
  EFFIGY_CHECK_EQ(track.body.size(), track.frames * body);
  EFFIGY_CHECK_EQ(track.face.size(), track.frames * face);
  Fitter fitter(reduced, rig);
  std::vector<RigPose> poses;
  left_mean = 0;
  for (size_t f = 0; f < track.frames; ++f) {
    Eigen::VectorXd wanted(static_cast<Eigen::Index>(body + face));
    for (size_t i = 0; i < body; ++i)
      wanted[static_cast<Eigen::Index>(i)] = static_cast<double>(track.body[f * body + i]);
    for (size_t i = 0; i < face; ++i)
      wanted[static_cast<Eigen::Index>(body + i)] = static_cast<double>(track.face[f * face + i]);
    RigPose pose = poses.empty() ? fitter.aligned(wanted) : poses.back();
    fitter.fit(wanted, pose);
    left_mean += fitter.mean_distance(pose, wanted) / static_cast<double>(track.frames);
    poses.push_back(std::move(pose));
    if (progress) progress(f + 1);
  }
  return poses;
}

}  // namespace effigy
