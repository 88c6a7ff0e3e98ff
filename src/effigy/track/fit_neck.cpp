#include "effigy/track/fit_neck.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "effigy/base/log.h"

namespace effigy {
namespace {

constexpr double kLeastSeen = 0.5;  // of the frames, else the torso is left to the head
constexpr int kShiftRounds = 6, kTurnSteps = 4;
constexpr double kRobustAt = 3;  // sigmas
// Frames differ from the model in the same ways: all of them count no more than these many would.
constexpr double kTrustedViews = 20;

Vec2d apply(const PlaneSimilarity& m, const Vec2d& p) {
  return {m.a * p.x() - m.b * p.y() + m.u, m.b * p.x() + m.a * p.y() + m.v};
}

// The front and both sides of the neck ring, which lie on the torso's silhouette.
std::vector<Vec3d> choose_anchors(const std::vector<Vec3d>& ring) {
  if (ring.size() < 3) return {};
  const auto by = [&](auto value) {
    return *std::max_element(ring.begin(), ring.end(),
                             [&](const Vec3d& a, const Vec3d& b) { return value(a) < value(b); });
  };
  return {by([](const Vec3d& p) { return p.z(); }), by([](const Vec3d& p) { return p.x(); }),
          by([](const Vec3d& p) { return -p.x(); })};
}

// One frame's head, as the landmarks place it.
struct Head {
  Mat3d root, turn;  // rotation of the root; of the head (root times neck)
  Vec3d pivot;       // the neck joint in the world
  const PlaneSimilarity* torso = nullptr;
};

class NeckFit {
 public:
  NeckFit(const FitSetup& setup, double focal, const FitOptions& options, const FitModel& model,
          std::vector<Vec3d> anchors)
      : setup_(setup),
        focal_(focal),
        sigma_(setup.pixel_sigma() * options.torso_point_sigma),
        options_(options),
        root_(model.joint_position(0)),
        neck_(model.joint_position(setup.neck())),
        anchors_(std::move(anchors)) {}

  void add(const Eigen::VectorXd& frame, const PlaneSimilarity* torso, const FitModel& model) {
    Head head;
    head.root = model.rotation_in_world(frame, 0);
    head.turn = model.rotation_in_world(frame, setup_.neck());
    head.pivot = frame.head<3>() + root_ + head.root * (neck_ - root_);
    head.torso = torso;
    heads_.push_back(head);
  }

  // Shift of the joint and places of the anchors in the first view, jointly: robust Gauss-Newton.
  Vec3d solve_shift() {
    const Eigen::Index unknowns = 3 + 2 * static_cast<Eigen::Index>(anchors_.size());
    Eigen::VectorXd x = Eigen::VectorXd::Zero(unknowns);
    double views = 0;
    for (const Head& head : heads_) views += head.torso != nullptr ? 1 : 0;
    for (int round = 0; round < kShiftRounds; ++round) {
      Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(unknowns, unknowns);
      Eigen::VectorXd right = Eigen::VectorXd::Zero(unknowns);
      for (int c = 0; c < 3; ++c) {
        const double sigma = c == 0 ? options_.neck_side_sigma : options_.neck_shift_sigma;
        const double w = views / (kTrustedViews * sigma * sigma);
        normal(c, c) += w;
        right[c] -= w * x[c];
      }
      for (const Head& head : heads_)
        if (head.torso != nullptr) add_frame(head, x, round > 0, normal, right);
      x += normal.ldlt().solve(right);
    }
    shift_ = x.head<3>();
    for (size_t k = 0; k < anchors_.size(); ++k)
      places_.push_back(x.segment<2>(3 + 2 * static_cast<Eigen::Index>(k)));
    return shift_;
  }

  std::vector<Vec2d> seen(size_t i) const {
    std::vector<Vec2d> points;
    if (heads_[i].torso != nullptr)
      for (const Vec2d& place : places_)
        points.push_back(apply(*heads_[i].torso, place) - setup_.center());
    return points;
  }

  // Turns the root about the neck so that the anchors lie where they are seen.
  void turn_root(size_t i, const FitModel& model, Eigen::VectorXd& frame) const {
    const Head& head = heads_[i];
    const Vec3d pivot = head.pivot + head.turn * shift_, joint = neck_ + shift_;
    Vec3d turn = frame.segment<3>(model.rotation_begin(0));
    const std::vector<Vec2d> target = seen(i);
    for (int step = 0; step < kTurnSteps && !target.empty(); ++step) {
      Mat3d derivative[3];
      const Mat3d root = rotation_of(turn, derivative);
      Mat3d normal = Mat3d::Identity() / std::pow(options_.followed_torso_sigma, 2);
      Vec3d right = (setup_.torso() - turn) / std::pow(options_.followed_torso_sigma, 2);
      for (size_t k = 0; k < anchors_.size(); ++k) {
        const Vec3d arm = anchors_[k] - joint;
        Eigen::Matrix<double, 2, 3> d_pixel;
        const Vec2d error = target[k] - project_point(pivot + root * arm, focal_, &d_pixel);
        Mat3d d_arm;
        for (int c = 0; c < 3; ++c) d_arm.col(c) = derivative[c] * arm;
        const Eigen::Matrix<double, 2, 3> d = d_pixel * d_arm / sigma_;
        normal += d.transpose() * d;
        right += d.transpose() * error / sigma_;
      }
      turn += normal.ldlt().solve(right);
    }
    const Mat3d root = rotation_of(turn, nullptr);
    frame.segment<3>(model.rotation_begin(0)) = turn;
    frame.segment<3>(model.rotation_begin(setup_.neck())) =
        axis_angle_of(root.transpose() * head.turn);
    frame.head<3>() = pivot - root_ - root * (joint - root_);
  }

 private:
  void add_frame(const Head& head, const Eigen::VectorXd& x, bool robust, Eigen::MatrixXd& normal,
                 Eigen::VectorXd& right) const {
    const Vec3d shift = x.head<3>();
    const Mat3d torso = rotation_of(setup_.torso(), nullptr);
    const Vec3d pivot = head.pivot + head.turn * shift, joint = neck_ + shift;
    const double a = head.torso->a, b = head.torso->b;
    for (size_t k = 0; k < anchors_.size(); ++k) {
      const Eigen::Index at = 3 + 2 * static_cast<Eigen::Index>(k);
      Eigen::Matrix<double, 2, 3> d_pixel;
      const Vec2d pixel = project_point(pivot + torso * (anchors_[k] - joint), focal_, &d_pixel);
      const Vec2d place = x.segment<2>(at);
      const Vec2d error = apply(*head.torso, place) - setup_.center() - pixel;
      // Far from the solution every frame counts alike.
      const double size = error.norm() / (kRobustAt * sigma_);
      const double w = (robust ? 1 / std::sqrt(1 + size * size) : 1.0) / (sigma_ * sigma_);
      Eigen::MatrixXd row = Eigen::MatrixXd::Zero(2, x.size());
      row.leftCols<3>() = d_pixel * (head.turn - torso);
      row.middleCols<2>(at) << -a, b, -b, -a;
      normal += w * row.transpose() * row;
      right += w * row.transpose() * error;
    }
  }

  const FitSetup& setup_;
  double focal_, sigma_;
  FitOptions options_;
  Vec3d root_, neck_;  // rest positions
  std::vector<Vec3d> anchors_;
  std::vector<Head> heads_;
  Vec3d shift_ = Vec3d::Zero();
  std::vector<Vec2d> places_;
};

}  // namespace

TorsoTargets follow_torso(const FitSetup& setup, const std::vector<TorsoMotion>& torso,
                          const std::vector<Vec3d>& ring, double focal, const FitOptions& options,
                          FitModel& model, std::vector<Eigen::VectorXd>& frames) {
  TorsoTargets targets;
  std::vector<Vec3d> anchors = choose_anchors(ring);
  size_t seen = 0;
  for (const int f : setup.tracked())
    if (static_cast<size_t>(f) < torso.size() && torso[f].found) ++seen;
  if (setup.neck() == 0 || anchors.empty() ||
      static_cast<double>(seen) < kLeastSeen * static_cast<double>(frames.size()))
    return targets;
  NeckFit fit(setup, focal, options, model, anchors);
  for (size_t i = 0; i < frames.size(); ++i) {
    const TorsoMotion& motion = torso[setup.tracked()[i]];
    fit.add(frames[i], motion.found ? &motion.here_from_start : nullptr, model);
  }
  targets.neck_shift = fit.solve_shift();
  log_debug(format("torso seen in {} of {} frames; neck moved by {:.1f} {:.1f} {:.1f} mm", seen,
                   frames.size(), 1000 * targets.neck_shift.x(), 1000 * targets.neck_shift.y(),
                   1000 * targets.neck_shift.z()));
  for (size_t i = 0; i < frames.size(); ++i) {
    fit.turn_root(i, model, frames[i]);
    targets.seen.push_back(fit.seen(i));
  }
  model.shift_joint(setup.neck(), targets.neck_shift);
  for (const Vec3d& anchor : anchors) model.add_point(0, anchor);
  targets.anchors = std::move(anchors);
  return targets;
}

}  // namespace effigy
