#include "effigy/track/fit.h"

#include <ceres/problem.h>
#include <ceres/solver.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <memory>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/track/fit_box.h"
#include "effigy/track/fit_neck.h"
#include "effigy/track/fit_photo.h"
#include "effigy/track/fit_setup.h"

namespace effigy {
namespace {

constexpr int kSharedRounds = 8, kSharedIterations = 4, kKeySteps = 6, kFirstKeySteps = 15;
constexpr int kPointRounds = 6, kPhotoRounds = 4;
constexpr double kSharedTolerance = 2e-3, kFrameTolerance = 3e-3;
constexpr int kChunk = 40;  // frames that follow each other; fixed, so that threads change nothing

ceres::Solver::Options shared_options() {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = kSharedIterations;
  options.function_tolerance = 1e-4;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  return options;
}

ceres::Problem::Options borrowing() {
  ceres::Problem::Options options;
  options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  return options;
}

// Gradient of the cost with respect to the last of its parameter blocks.
Eigen::VectorXd frame_gradient(const FrameCost& cost, const std::vector<double*>& blocks,
                               Eigen::Index size) {
  Eigen::VectorXd residuals(cost.num_residuals());
  FitModel::Matrix jacobian(cost.num_residuals(), size);
  std::vector<double*> jacobians(blocks.size(), nullptr);
  jacobians.back() = jacobian.data();
  if (!cost.Evaluate(blocks.data(), residuals.data(), jacobians.data()))
    return Eigen::VectorXd::Zero(size);
  return jacobian.transpose() * residuals;
}

// One frame with everything shared fixed; `frame` is guess and result.
void solve_frame(const FitModel& model, const FrameTarget& target, double focal,
                 const FitOptions& options, int steps, Eigen::VectorXd& frame) {
  const FrameCost cost(model, target, options.robust_at, focal);
  minimise_in_box(cost, target.lower, target.upper, steps, kFrameTolerance, frame);
}

// Focal length and identity, together with the pose and expression of the key frames.
struct Shared {
  double focal = 0;
  Eigen::VectorXd identity;
};

// The key frames' own parameters at their best for the present focal length and identity.
void solve_key_frames(const FitModel& model, const Shared& shared, const FitOptions& options,
                      const std::vector<FrameTarget>& targets, int steps,
                      std::vector<Eigen::VectorXd>& frames) {
  const FitModel baked = model.with_identity(shared.identity.data());
  parallel_for(frames.size(), 1, [&](size_t begin, size_t end, int) {
    for (size_t k = begin; k < end; ++k)
      solve_frame(baked, targets[k], shared.focal, options, steps, frames[k]);
  });
}

// One Ceres problem over everything, each frame's parameters that rest on their limits held.
// Returns the share of the cost that was gained.
double solve_jointly(const FitModel& model, const Rig& rig, double typical_focal,
                     const FitOptions& options, const std::vector<FrameTarget>& targets,
                     std::vector<Eigen::VectorXd>& frames, Shared& shared) {
  ceres::Problem problem(borrowing());
  ceres::Solver::Options solver = shared_options();
  solver.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  std::vector<std::unique_ptr<ceres::CostFunction>> costs;
  std::vector<std::unique_ptr<BoxManifold>> boxes;
  // Ceres orders what it eliminates by address, and rounding follows the order: all parameters
  // stand in one array, so that the same input gives the same bits.
  const int identities = model.identity_count();
  const Eigen::Index size = model.frame_size();
  Eigen::VectorXd all(static_cast<Eigen::Index>(frames.size()) * size + 1 + identities);
  double* const log_focal = all.data() + static_cast<Eigen::Index>(frames.size()) * size;
  double* const identity = log_focal + 1;
  *log_focal = std::log(shared.focal);
  std::copy_n(shared.identity.data(), identities, identity);
  for (size_t k = 0; k < frames.size(); ++k) {
    double* const frame = all.data() + static_cast<Eigen::Index>(k) * size;
    std::copy_n(frames[k].data(), size, frame);
    auto cost = std::make_unique<FrameCost>(model, targets[k], options.robust_at, 0);
    std::vector<double*> blocks = {log_focal, frame};
    if (identities > 0) blocks.insert(blocks.begin() + 1, identity);
    boxes.push_back(std::make_unique<BoxManifold>(targets[k].lower, targets[k].upper));
    boxes[k]->hold(frames[k], frame_gradient(*cost, blocks, size));
    problem.AddResidualBlock(cost.get(), nullptr, blocks);
    problem.SetManifold(frame, boxes[k].get());
    solver.linear_solver_ordering->AddElementToGroup(frame, 0);
    costs.push_back(std::move(cost));
  }
  const auto add_prior = [&](double* block, Eigen::VectorXd mean, Eigen::VectorXd weight) {
    costs.push_back(std::make_unique<PriorCost>(std::move(mean), std::move(weight)));
    problem.AddResidualBlock(costs.back().get(), nullptr, block);
    solver.linear_solver_ordering->AddElementToGroup(block, 1);
  };
  add_prior(log_focal, Eigen::VectorXd::Constant(1, std::log(typical_focal)),
            Eigen::VectorXd::Constant(1, 1.0 / options.log_focal_sigma));
  if (identities > 0) {
    Eigen::VectorXd weight(identities);
    for (int i = 0; i < identities; ++i) weight[i] = 1.0 / std::max(rig.identity_sigma[i], 1e-6f);
    add_prior(identity, Eigen::VectorXd::Zero(identities), weight);
  }
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  log_debug("fit: " + summary.BriefReport());
  if (!summary.IsSolutionUsable())
    throw Error("The rig could not be fitted to the face in this video (" + summary.message +
                "); check that the video shows one face, upright and not mirrored by effects.");
  for (size_t k = 0; k < frames.size(); ++k)
    frames[k] = all.segment(static_cast<Eigen::Index>(k) * size, size);
  shared.focal = std::exp(*log_focal);
  std::copy_n(identity, identities, shared.identity.data());
  return (summary.initial_cost - summary.final_cost) / std::max(summary.initial_cost, 1e-12);
}

Shared solve_shared(const FitSetup& setup, const Rig& rig, const std::vector<int>& keys,
                    const FitOptions& options) {
  const FitModel& model = setup.model();
  Shared shared{setup.typical_focal(), Eigen::VectorXd::Zero(model.identity_count())};
  std::vector<FrameTarget> targets;
  std::vector<Eigen::VectorXd> frames;
  for (const int f : keys) {
    targets.push_back(setup.target(f));
    frames.push_back(setup.first_guess(f, model, shared.focal));
  }
  for (int round = 0; round < kSharedRounds; ++round) {
    throw_if_interrupted();
    solve_key_frames(model, shared, options, targets, round == 0 ? kFirstKeySteps : kKeySteps,
                     frames);
    if (solve_jointly(model, rig, setup.typical_focal(), options, targets, frames, shared) <
        kSharedTolerance)
      break;
  }
  return shared;
}

// Where each landmark lies on this person, beside the rig's point of it: the networks' points and
// the identity space differ from a face by the same millimetres in every frame, which would turn
// the head as soon as it looks elsewhere. Alternates with the key frames' own parameters.
void settle_points(const FitSetup& setup, const std::vector<int>& keys, double focal,
                   const FitOptions& options, FitModel& model) {
  const int points = model.point_count();
  std::vector<FrameTarget> targets(keys.size());
  std::vector<Eigen::VectorXd> frames(keys.size());
  for (size_t k = 0; k < keys.size(); ++k) {
    targets[k] = setup.target(keys[k]);
    frames[k] = setup.first_guess(keys[k], model, focal);
  }
  std::vector<Vec3d> shift(points, Vec3d::Zero());
  for (int round = 0; round < kPointRounds; ++round) {
    throw_if_interrupted();
    parallel_for(keys.size(), 1, [&](size_t begin, size_t end, int) {
      for (size_t k = begin; k < end; ++k)
        solve_frame(model, targets[k], focal, options, round == 0 ? kFirstKeySteps : kKeySteps,
                    frames[k]);
    });
    std::vector<Mat3d> normal(points);
    std::vector<Vec3d> right(points);
    for (int i = 0; i < points; ++i) {
      const double sigma = std::max(setup.freedom(i) * options.point_sigma, 1e-9);
      normal[i] = Mat3d::Identity() / (sigma * sigma);
      right[i] = -shift[i] / (sigma * sigma);
    }
    for (size_t k = 0; k < keys.size(); ++k) {
      FitModel::Result result;
      model.evaluate(nullptr, frames[k].data(), false, false, result);
      const Mat3d turn = model.rotation_in_world(frames[k], setup.neck());
      for (int i = 0; i < points; ++i) {
        if (setup.freedom(i) <= 0) continue;
        const Vec3d world = result.position.row(i).transpose();
        Eigen::Matrix<double, 2, 3> derivative;
        const Vec2d pixel = project_point(world, focal, &derivative);
        const Vec2d error = targets[k].weight[i] * (targets[k].seen[i] - pixel);
        const double size = error.squaredNorm() / (options.robust_at * options.robust_at);
        const double robust = 1 / std::sqrt(1 + size);  // soft-L1
        const Eigen::Matrix<double, 2, 3> d = targets[k].weight[i] * derivative * turn;
        normal[i] += robust * d.transpose() * d;
        right[i] += robust * d.transpose() * error;
      }
    }
    for (int i = 0; i < points; ++i) {
      const Vec3d step = normal[i].ldlt().solve(right[i]);
      shift[i] += step;
      model.shift_point(i, step);
    }
  }
  double sum = 0;
  for (const Vec3d& s : shift) sum += s.squaredNorm() / points;
  log_debug(format("fit: landmarks lie {:.2f} mm beside the rig's (RMS)", 1000 * std::sqrt(sum)));
}

// Pulls `target` towards `mean` as well, with 1 / sigma = `weight`.
void add_prior(FrameTarget& target, const Eigen::VectorXd& mean, const Eigen::VectorXd& weight) {
  for (Eigen::Index k = 0; k < mean.size(); ++k) {
    const double a = target.prior_weight[k] * target.prior_weight[k], b = weight[k] * weight[k];
    if (a + b <= 0) continue;
    target.prior_mean[k] = (a * target.prior_mean[k] + b * mean[k]) / (a + b);
    target.prior_weight[k] = std::sqrt(a + b);
  }
}

// All tracked frames by their landmarks, chunk by chunk in the order of time.
std::vector<Eigen::VectorXd> solve_frames(const FitSetup& setup, const FitModel& model,
                                          double focal, const FitOptions& options,
                                          std::vector<FrameTarget>& targets) {
  const std::vector<int>& tracked = setup.tracked();
  const size_t count = tracked.size();
  std::vector<Eigen::VectorXd> frames(count);
  targets.resize(count);
  const size_t chunks = (count + kChunk - 1) / kChunk;
  parallel_for(chunks, 1, [&](size_t begin, size_t end, int) {
    for (size_t chunk = begin; chunk < end; ++chunk) {
      const size_t last = std::min(count, (chunk + 1) * kChunk);
      for (size_t i = chunk * kChunk; i < last; ++i) {
        throw_if_interrupted();
        targets[i] = setup.target(tracked[i]);
        const bool follows = i > chunk * kChunk && tracked[i] == tracked[i - 1] + 1;
        frames[i] = follows ? frames[i - 1] : setup.first_guess(tracked[i], model, focal);
        solve_frame(model, targets[i], focal, options, follows ? 4 : 15, frames[i]);
      }
    }
  });
  return frames;
}

// The torso's points join the frame's targets.
void add_torso(const FitSetup& setup, const TorsoTargets& torso, size_t frame,
               const FitOptions& options, FrameTarget& target) {
  const bool seen = !torso.anchors.empty() && !torso.seen[frame].empty();
  for (size_t k = 0; k < torso.anchors.size(); ++k) {
    target.seen.push_back(seen ? torso.seen[frame][k] : Vec2d::Zero());
    target.weight.push_back(seen ? 1 / (options.torso_point_sigma * setup.pixel_sigma()) : 0.0);
    target.depth.push_back(0);
    target.depth_weight.push_back(0);
  }
  if (seen)
    target.prior_weight.segment<3>(setup.model().rotation_begin(0))
        .setConstant(1 / options.followed_torso_sigma);
}

// Every frame once more, `steps` steps from where it is; `smoothly`: towards the mean of its
// neighbours, which smooths without delay.
std::vector<Eigen::VectorXd> smooth_frames(const FitSetup& setup, const FitModel& model,
                                           double focal, const FitOptions& options,
                                           const std::vector<Eigen::VectorXd>& frames,
                                           std::vector<FrameTarget> targets, bool smoothly,
                                           int steps) {
  const std::vector<int>& tracked = setup.tracked();
  const size_t count = tracked.size();
  const Eigen::VectorXd smooth = setup.smoothness();
  std::vector<Eigen::VectorXd> result(count);
  parallel_for(count, 8, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      throw_if_interrupted();
      Eigen::VectorXd mean = Eigen::VectorXd::Zero(model.frame_size());
      double weight = 0;
      for (const int d : {-2, -1, 1, 2}) {
        const auto k = static_cast<std::ptrdiff_t>(i) + d;
        if (k < 0 || k >= static_cast<std::ptrdiff_t>(count)) continue;
        if (tracked[static_cast<size_t>(k)] != tracked[i] + d) continue;
        const double w = std::abs(d) == 1 ? 2.0 / 3.0 : -1.0 / 6.0;  // a cubic through the others
        mean += w * frames[static_cast<size_t>(k)];
        weight += w;
      }
      result[i] = frames[i];
      if (smoothly && weight > 0.9)
        add_prior(targets[i], mean / weight, smooth);  // not beside gaps
      solve_frame(model, targets[i], focal, options, steps, result[i]);
    }
  });
  return result;
}

std::vector<Vec3d> neck_ring_at_rest(const Rig& rig, const std::vector<float>& identity) {
  const RigShape shape = shape_rig(rig, identity);
  std::vector<Vec3d> ring;
  for (const int v : rig.neck_ring)
    ring.push_back(Vec3f(&shape.rest[3 * static_cast<size_t>(v)]).cast<double>());
  return ring;
}

// Mean distance of the chosen points to where the network saw them.
double mean_error(const FitSetup& setup, const Rig& rig, const FitModel::Result& result,
                  const std::vector<bool>& chosen, double focal, int frame) {
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < chosen.size(); ++i) {
    if (!chosen[i]) continue;
    const Vec3d p = result.position.row(static_cast<Eigen::Index>(i)).transpose();
    sum += (project_point(p, focal, nullptr) - setup.seen(frame, rig.mediapipe.index[i])).norm();
    ++count;
  }
  return count > 0 ? sum / count : 0.0;
}

}  // namespace

Camera fit_camera(double focal, int width, int height) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = focal;
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  camera.camera_from_world_rotation = Vec3d(1, -1, -1).asDiagonal();
  return camera;
}

FitResult fit_rig(const Rig& rig, const std::vector<FaceObservation>& frames, const FitViews& views,
                  int width, int height, const FitOptions& options) {
  const FitSetup setup(rig, frames, width, height, options);
  FitResult fit;
  fit.key_frames = setup.choose_key_frames(options.key_frames);
  const Shared shared = solve_shared(setup, rig, fit.key_frames, options);
  fit.focal = shared.focal;
  for (const double value : shared.identity) fit.identity.push_back(static_cast<float>(value));
  FitModel model = setup.model().with_identity(shared.identity.data());
  if (options.point_sigma > 0) settle_points(setup, fit.key_frames, shared.focal, options, model);
  std::vector<FrameTarget> targets;
  std::vector<Eigen::VectorXd> solved = solve_frames(setup, model, shared.focal, options, targets);
  const TorsoTargets below = follow_torso(setup, views.torso, neck_ring_at_rest(rig, fit.identity),
                                          shared.focal, options, model, solved);
  for (size_t i = 0; i < targets.size(); ++i) add_torso(setup, below, i, options, targets[i]);
  solved = smooth_frames(setup, model, shared.focal, options, solved, targets, true, 2);
  FitModel all_points = setup.all_points().with_identity(shared.identity.data());
  all_points.shift_joint(setup.neck(), below.neck_shift);
  if (options.photo_sigma > 0 && views.photos.size() == frames.size()) {
    const PhotoFit photo(rig, fit.identity, setup, views.photos, shared.focal, options, model);
    for (int round = 0; round < kPhotoRounds; ++round) {
      std::vector<FrameTarget> seen = targets;
      photo.expect(solved, seen);
      solved = smooth_frames(setup, model, shared.focal, options, solved, seen,
                             round + 1 == kPhotoRounds, 1);
    }
  }
  fit.neck_shift = below.neck_shift;

  fit.error.assign(frames.size(), -1.0);
  fit.heldout_error.assign(frames.size(), -1.0);
  fit.poses.assign(frames.size(), setup.pose_of(solved[0]));
  for (const bool held : setup.held_out()) fit.heldout_points += held ? 1 : 0;
  const std::vector<int>& tracked = setup.tracked();
  for (size_t i = 0; i < tracked.size(); ++i) {
    const int f = tracked[i];
    FitModel::Result result;
    all_points.evaluate(nullptr, solved[i].data(), false, false, result);
    fit.error[f] = mean_error(setup, rig, result, setup.inner(), shared.focal, f);
    fit.heldout_error[f] = mean_error(setup, rig, result, setup.held_out(), shared.focal, f);
    // Frames without a face keep the pose of the last one with a face.
    const size_t next =
        i + 1 < tracked.size() ? static_cast<size_t>(tracked[i + 1]) : frames.size();
    for (size_t k = static_cast<size_t>(f); k < next; ++k) fit.poses[k] = setup.pose_of(solved[i]);
  }
  return fit;
}

}  // namespace effigy
