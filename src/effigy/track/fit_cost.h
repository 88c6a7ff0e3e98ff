// Residuals of the landmark fit for Ceres. Private to track/.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/manifold.h>

#include <Eigen/Core>
#include <vector>

#include "effigy/track/fit_model.h"
#include "effigy/track/photo.h"

namespace effigy {

// What one frame contributes.
struct FrameTarget {
  std::vector<Vec2d> seen;     // per point of the model, pixels from the principal point
  std::vector<double> weight;  // 1 / sigma in pixels; 0 leaves the point out
  // Per point: distance towards the camera, pixels, from any plane; 1 / sigma, or 0.
  std::vector<double> depth, depth_weight;
  double depth_scale = 0;  // pixels a metre, for the depths
  // Points of the model from seen.size() on are not landmarks: the picture's contrast there is
  // expected to be photo_value, 1 / sigma, or 0. No such points when `photo` is null.
  const PhotoWindow* photo = nullptr;
  Vec2d center = Vec2d::Zero();  // the principal point, for the window
  std::vector<float> photo_value, photo_weight;
  Eigen::VectorXd prior_mean;         // frame_size: where each parameter is expected
  Eigen::VectorXd prior_weight;       // 1 / sigma; 0 for none
  Eigen::VectorXd lower, upper;       // frame_size: limits of each parameter
  double eye_weight = 0;              // 1 / sigma of the difference of the two eyes' rotations
  int eye_left = -1, eye_right = -1;  // joints
};

// Reprojection of all points (2 residuals each, robust by the square root of soft-L1, so that
// Gauss-Newton sees the true cost), then the prior (frame_size), then the eyes' difference (3),
// then the points' depths beside their weighted mean (1 each).
//
// Parameter blocks: [log focal, identity (left out when the model has none), frame], or, with a
// fixed focal length, [frame]; the model then has its identity folded in. Points behind the camera
// make the evaluation fail.
class FrameCost : public ceres::CostFunction {
 public:
  // Both outlive the cost. fixed_focal > 0: the focal length is no parameter.
  FrameCost(const FitModel& model, const FrameTarget& target, double robust_at, double fixed_focal);
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  void evaluate_photo(const FitModel::Result& result, double focal, double* residuals,
                      double* d_frame) const;
  void evaluate_depths(const FitModel::Result& result, double* residuals, double* d_frame,
                       double* d_identity) const;

  const FitModel& model_;
  const FrameTarget& target_;
  double robust_at_, fixed_focal_;
  int landmarks_, photos_;  // points of the model of each kind, in this order
  int identity_block_ = -1, frame_block_ = 0;
};

// (x - mean) * weight, element by element.
class PriorCost : public ceres::CostFunction {
 public:
  PriorCost(Eigen::VectorXd mean, Eigen::VectorXd weight);
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  Eigen::VectorXd mean_, weight_;
};

// A box: parameters that rest on a limit and are pushed outwards are left out of the step, the
// others stop at their limits. Ceres' own bounds search along every step instead, which takes ten
// times as long here.
class BoxManifold : public ceres::Manifold {
 public:
  BoxManifold(const Eigen::VectorXd& lower, const Eigen::VectorXd& upper);
  // Decides which parameters are held, from the gradient of the cost at x.
  void hold(const Eigen::VectorXd& x, const Eigen::VectorXd& gradient);

  int AmbientSize() const override { return static_cast<int>(lower_.size()); }
  int TangentSize() const override { return static_cast<int>(free_.size()); }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override;
  bool PlusJacobian(const double* x, double* jacobian) const override;
  bool Minus(const double* y, const double* x, double* y_minus_x) const override;
  bool MinusJacobian(const double* x, double* jacobian) const override;

 private:
  Eigen::VectorXd lower_, upper_;
  std::vector<int> free_;
};

}  // namespace effigy
