#include "effigy/body/keypoint_fit.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <charconv>
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

// A pose as one row of parameters: joint rotations, expression, translation.
Eigen::VectorXd row_of(const RigPose& pose) {
  std::vector<float> all = pose.joint_rotation;
  all.insert(all.end(), pose.expression.begin(), pose.expression.end());
  all.insert(all.end(), pose.translation.begin(), pose.translation.end());
  return Eigen::Map<const Eigen::VectorXf>(all.data(), static_cast<Eigen::Index>(all.size()))
      .cast<double>();
}
void set_row(const double* row, RigPose& pose) {
  const auto take = [&row](auto& values) {
    for (float& value : values) value = static_cast<float>(*row++);
  };
  take(pose.joint_rotation);
  take(pose.expression);
  take(pose.translation);
}

// Distances from the wanted keypoints. Derivatives by central differences with steps that fit the
// rig's single precision, where Ceres' own would be too small.
class KeypointCost : public ceres::CostFunction {
 public:
  KeypointCost(const ReducedRig& rig, const RigPose& pose, const Eigen::VectorXd& wanted)
      : rig_(rig), pose_(pose), wanted_(wanted) {
    set_num_residuals(static_cast<int>(wanted.size()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(row_of(pose).size()));
  }
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Index count = parameter_block_sizes()[0];
    Eigen::VectorXd row = Eigen::Map<const Eigen::VectorXd>(parameters[0], count);
    const auto keypoints = [&] {
      set_row(row.data(), pose_);
      return rig_.keypoints(pose_, vertices_);
    };
    Eigen::Map<Eigen::VectorXd>(residuals, wanted_.size()) = keypoints() - wanted_;
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    Eigen::Map<Rows> jacobian(jacobians[0], wanted_.size(), count);
    for (Eigen::Index k = 0; k < count; ++k) {
      const double start = row[k];
      row[k] = start + kStep;
      const Eigen::VectorXd ahead = keypoints();
      row[k] = start - kStep;
      jacobian.col(k) = (ahead - keypoints()) / (2 * kStep);
      row[k] = start;
    }
    return true;
  }

 private:
  const ReducedRig& rig_;
  mutable RigPose pose_;  // scratch: frames are fitted by one thread
  const Eigen::VectorXd& wanted_;
  mutable std::vector<float> vertices_;
};

// Rest pose, turned and moved as a whole onto the keypoints.
RigPose aligned(const ReducedRig& reduced, const Rig& rig, const Eigen::VectorXd& wanted) {
  std::vector<float> vertices;
  RigPose pose = RigPose::rest(rig);
  const auto points = [](const Eigen::VectorXd& row) {
    return Eigen::Matrix3Xd(Eigen::Map<const Eigen::Matrix3Xd>(row.data(), 3, row.size() / 3));
  };
  const Eigen::Matrix3Xd to = points(wanted);
  const Eigen::Matrix4d moved =
      Eigen::umeyama(points(reduced.keypoints(pose, vertices)), to, false);
  const Eigen::AngleAxisd root(Mat3d(moved.topLeftCorner<3, 3>()));
  const Vec3f turn = (root.angle() * root.axis()).cast<float>();
  std::copy_n(turn.data(), 3, pose.joint_rotation.data());
  // The root turns about its joint, not about the origin.
  const Vec3d shift =
      to.rowwise().mean() - points(reduced.keypoints(pose, vertices)).rowwise().mean();
  for (int c = 0; c < 3; ++c)
    pose.translation[static_cast<size_t>(c)] += static_cast<float>(shift[c]);
  return pose;
}

void fit_frame(const ReducedRig& reduced, const Rig& rig, const Eigen::VectorXd& wanted,
               RigPose& pose) {
  Eigen::VectorXd row = row_of(pose);
  const auto joints = static_cast<Eigen::Index>(pose.joint_rotation.size());
  const auto shapes = static_cast<Eigen::Index>(pose.expression.size());
  Eigen::VectorXd held_to = row, hold = Eigen::VectorXd::Zero(row.size());
  held_to.segment(joints, shapes).setZero();
  hold.head(joints).setConstant(kHold);
  hold.segment(joints, shapes).setConstant(kHoldShape);
  ceres::Problem problem;
  problem.AddResidualBlock(new KeypointCost(reduced, pose, wanted), nullptr, row.data());
  problem.AddResidualBlock(new ceres::NormalPrior(Eigen::MatrixXd(hold.asDiagonal()), held_to),
                           nullptr, row.data());
  for (Eigen::Index e = 0; e < shapes; ++e) {
    const auto at = static_cast<int>(joints + e);
    const auto i = static_cast<size_t>(e);
    problem.SetParameterLowerBound(row.data(), at, static_cast<double>(rig.expression_low[i]));
    problem.SetParameterUpperBound(row.data(), at, static_cast<double>(rig.expression_high[i]));
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.max_num_iterations = kSteps;
  options.function_tolerance = kDone;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  set_row(row.data(), pose);
}

double mean_distance(const ReducedRig& reduced, const RigPose& pose,
                     const Eigen::VectorXd& wanted) {
  std::vector<float> vertices;
  const Eigen::VectorXd off = reduced.keypoints(pose, vertices) - wanted;
  return Eigen::Map<const Eigen::Matrix3Xd>(off.data(), 3, off.size() / 3).colwise().norm().mean();
}

}  // namespace

std::optional<KeypointTrack> read_keypoint_track(const Path& path, const BodyDriver& driver) {
  const TensorFile file = read_safetensors(path);
  if (!file.has("body_keypoints") || file.has("joint_rotation")) return {};
  KeypointTrack track;
  const std::vector<int64_t>& shape = file.shape("body_keypoints");
  const int64_t frames = shape.empty() ? 0 : shape[0];
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
  const std::string& text = rate->second;
  const auto [end, code] =
      std::from_chars(text.data(), text.data() + text.size(), track.frames_per_second);
  if (code != std::errc() || end != text.data() + text.size() || !(track.frames_per_second > 0) ||
      !(track.frames_per_second <= 1000))
    throw Error(path.string() + ": frames_per_second is '" + text +
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
  std::vector<RigPose> poses;
  left_mean = 0;
  for (size_t f = 0; f < track.frames; ++f) {
    Eigen::VectorXd wanted(static_cast<Eigen::Index>(body + face));
    for (size_t i = 0; i < body; ++i)
      wanted[static_cast<Eigen::Index>(i)] = static_cast<double>(track.body[f * body + i]);
    for (size_t i = 0; i < face; ++i)
      wanted[static_cast<Eigen::Index>(body + i)] = static_cast<double>(track.face[f * face + i]);
    RigPose pose = poses.empty() ? aligned(reduced, rig, wanted) : poses.back();
    fit_frame(reduced, rig, wanted, pose);
    left_mean += mean_distance(reduced, pose, wanted) / static_cast<double>(track.frames);
    poses.push_back(std::move(pose));
    if (progress) progress(f + 1);
  }
  return poses;
}

}  // namespace effigy
