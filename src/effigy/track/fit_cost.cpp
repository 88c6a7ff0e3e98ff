#include "effigy/track/fit_cost.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "effigy/base/error.h"

namespace effigy {
namespace {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Soft-L1 of a residual r with s = |r|^2: rho(s) = 2 d^2 (sqrt(1 + s / d^2) - 1) = |factor r|^2.
struct SoftL1 {
  double factor, d_factor;  // sqrt(2 / (1 + q)) with q = sqrt(1 + s / d^2), and its slope in s
};
SoftL1 soft_l1(double s, double d) {
  const double q = std::sqrt(1.0 + s / (d * d));
  const double factor = std::sqrt(2.0 / (1.0 + q));
  return {factor, -factor / (4.0 * (1.0 + q) * q * d * d)};
}

}  // namespace

FrameCost::FrameCost(const FitModel& model, const FrameTarget& target, double robust_at,
                     double fixed_focal)
    : model_(model),
      target_(target),
      robust_at_(robust_at),
      fixed_focal_(fixed_focal),
      landmarks_(static_cast<int>(target.seen.size())),
      photos_(target.photo != nullptr ? model.point_count() - landmarks_ : 0) {
  EFFIGY_CHECK(photos_ == 0 || fixed_focal > 0);
  set_num_residuals(3 * landmarks_ + model.frame_size() + 3 + photos_);
  if (fixed_focal <= 0) {
    mutable_parameter_block_sizes()->push_back(1);
    if (model.identity_count() > 0) {
      identity_block_ = 1;
      mutable_parameter_block_sizes()->push_back(model.identity_count());
    }
    frame_block_ = identity_block_ < 0 ? 1 : 2;
  }
  EFFIGY_CHECK(fixed_focal <= 0 || model.identity_count() == 0);
  mutable_parameter_block_sizes()->push_back(model.frame_size());
}

bool FrameCost::Evaluate(double const* const* parameters, double* residuals,
                         double** jacobians) const {
  const bool has_focal = fixed_focal_ <= 0, has_identity = identity_block_ >= 0;
  const double* identity = has_identity ? parameters[identity_block_] : nullptr;
  const double* frame = parameters[frame_block_];
  const double focal = has_focal ? std::exp(parameters[0][0]) : fixed_focal_;
  double* d_focal = jacobians != nullptr && has_focal ? jacobians[0] : nullptr;
  double* d_identity = jacobians != nullptr && has_identity ? jacobians[identity_block_] : nullptr;
  double* d_frame = jacobians != nullptr ? jacobians[frame_block_] : nullptr;
  const int rows = num_residuals(), size = model_.frame_size();
  const int points = landmarks_;

  thread_local FitModel::Result result;
  model_.evaluate(identity, frame, d_frame != nullptr, d_identity != nullptr, result);
  if (d_focal != nullptr) std::fill_n(d_focal, rows, 0.0);
  if (d_identity != nullptr) std::fill_n(d_identity, rows * model_.identity_count(), 0.0);
  if (d_frame != nullptr) std::fill_n(d_frame, static_cast<size_t>(rows) * size, 0.0);
  Eigen::Map<RowMatrix> to_identity(d_identity, d_identity != nullptr ? rows : 0,
                                    model_.identity_count());
  Eigen::Map<RowMatrix> to_frame(d_frame, d_frame != nullptr ? rows : 0, size);

  for (int i = 0; i < points; ++i) {
    Eigen::Map<Vec2d> residual(residuals + 2 * i);
    const double weight = target_.weight[i];
    if (weight == 0) {
      residual.setZero();
      continue;
    }
    const Vec3d world = result.position.row(i).transpose();
    if (!(world.z() < -1e-3)) return false;
    Eigen::Matrix<double, 2, 3> d_pixel;
    const Vec2d pixel = project_point(world, focal, jacobians != nullptr ? &d_pixel : nullptr);
    const Vec2d raw = weight * (pixel - target_.seen[i]);
    const SoftL1 soft = soft_l1(raw.squaredNorm(), robust_at_);
    residual = soft.factor * raw;
    if (jacobians == nullptr) continue;
    const Eigen::Matrix2d robust = weight * (soft.factor * Eigen::Matrix2d::Identity() +
                                             2.0 * soft.d_factor * raw * raw.transpose());
    const Eigen::Matrix<double, 2, 3> chain = robust * d_pixel;
    if (d_focal != nullptr) {
      const Vec2d change = robust * pixel;  // d pixel / d log focal = pixel
      d_focal[2 * i] = change.x();
      d_focal[2 * i + 1] = change.y();
    }
    if (d_identity != nullptr)
      to_identity.middleRows<2>(2 * i) = chain.lazyProduct(result.d_identity.middleRows<3>(3 * i));
    if (d_frame != nullptr)
      to_frame.middleRows<2>(2 * i) = chain.lazyProduct(result.d_frame.middleRows<3>(3 * i));
  }
  const int prior = 2 * points;
  for (int k = 0; k < size; ++k) {
    residuals[prior + k] = target_.prior_weight[k] * (frame[k] - target_.prior_mean[k]);
    if (d_frame != nullptr) to_frame(prior + k, k) = target_.prior_weight[k];
  }
  const int eyes = prior + size;
  for (int c = 0; c < 3; ++c) {
    residuals[eyes + c] = 0;
    if (target_.eye_left < 0 || target_.eye_right < 0) continue;
    const int left = model_.rotation_begin(target_.eye_left) + c;
    const int right = model_.rotation_begin(target_.eye_right) + c;
    residuals[eyes + c] = target_.eye_weight * (frame[left] - frame[right]);
    if (d_frame != nullptr) {
      to_frame(eyes + c, left) = target_.eye_weight;
      to_frame(eyes + c, right) = -target_.eye_weight;
    }
  }
  evaluate_depths(result, residuals + eyes + 3,
                  d_frame != nullptr ? d_frame + static_cast<size_t>(eyes + 3) * size : nullptr,
                  d_identity != nullptr
                      ? d_identity + static_cast<size_t>(eyes + 3) * model_.identity_count()
                      : nullptr);
  if (photos_ > 0) {
    const int begin = eyes + 3 + points;
    evaluate_photo(result, focal, residuals + begin,
                   d_frame != nullptr ? d_frame + static_cast<size_t>(begin) * size : nullptr);
  }
  return true;
}

void FrameCost::evaluate_photo(const FitModel::Result& result, double focal, double* residuals,
                               double* d_frame) const {
  Eigen::Map<RowMatrix> to_frame(d_frame, d_frame != nullptr ? photos_ : 0, model_.frame_size());
  for (int k = 0; k < photos_; ++k) {
    residuals[k] = 0;
    const double weight = target_.photo_weight[k];
    const Eigen::Index i = landmarks_ + k;
    const Vec3d world = result.position.row(i).transpose();
    if (weight == 0 || !(world.z() < -1e-3)) continue;
    Eigen::Matrix<double, 2, 3> d_pixel;
    const Vec2d pixel = project_point(world, focal, &d_pixel);
    double value = 0;
    Vec2d slope;
    if (!target_.photo->sample(pixel + target_.center, &value, &slope)) continue;
    const double raw = weight * (value - target_.photo_value[k]);
    const SoftL1 soft = soft_l1(raw * raw, robust_at_);
    residuals[k] = soft.factor * raw;
    if (d_frame == nullptr) continue;
    const double d_raw = soft.factor + 2.0 * raw * raw * soft.d_factor;
    const Eigen::RowVector3d chain = d_raw * weight * slope.transpose() * d_pixel;
    to_frame.row(k) = chain.lazyProduct(result.d_frame.middleRows<3>(3 * i));
  }
}

void FrameCost::evaluate_depths(const FitModel::Result& result, double* residuals, double* d_frame,
                                double* d_identity) const {
  const int points = landmarks_;
  std::fill_n(residuals, points, 0.0);
  double sum = 0, mean_z = 0, mean_seen = 0;
  for (int i = 0; i < points; ++i) {
    const double w = target_.depth_weight[i];
    sum += w;
    mean_z += w * result.position(i, 2);
    mean_seen += w * target_.depth[i];
  }
  if (sum <= 0) return;
  mean_z /= sum;
  mean_seen /= sum;
  const double scale = target_.depth_scale;
  const auto rows = [&](double* jacobian, const FitModel::Matrix& positions) {
    if (jacobian == nullptr || positions.cols() == 0) return;
    const Eigen::Index columns = positions.cols();
    Eigen::RowVectorXd mean = Eigen::RowVectorXd::Zero(columns);
    for (int i = 0; i < points; ++i)
      if (target_.depth_weight[i] != 0)
        mean += target_.depth_weight[i] / sum * positions.row(3 * i + 2);
    Eigen::Map<RowMatrix> to(jacobian, points, columns);
    for (int i = 0; i < points; ++i)
      if (target_.depth_weight[i] != 0)
        to.row(i) = target_.depth_weight[i] * scale * (positions.row(3 * i + 2) - mean);
  };
  for (int i = 0; i < points; ++i)
    residuals[i] = target_.depth_weight[i] *
                   (scale * (result.position(i, 2) - mean_z) - (target_.depth[i] - mean_seen));
  rows(d_frame, result.d_frame);
  rows(d_identity, result.d_identity);
}

PriorCost::PriorCost(Eigen::VectorXd mean, Eigen::VectorXd weight)
    : mean_(std::move(mean)), weight_(std::move(weight)) {
  set_num_residuals(static_cast<int>(mean_.size()));
  mutable_parameter_block_sizes()->push_back(static_cast<int>(mean_.size()));
}

bool PriorCost::Evaluate(double const* const* parameters, double* residuals,
                         double** jacobians) const {
  const int size = num_residuals();
  for (int i = 0; i < size; ++i) residuals[i] = weight_[i] * (parameters[0][i] - mean_[i]);
  if (jacobians != nullptr && jacobians[0] != nullptr)
    for (int i = 0; i < size; ++i)
      for (int k = 0; k < size; ++k) jacobians[0][i * size + k] = i == k ? weight_[i] : 0.0;
  return true;
}

BoxManifold::BoxManifold(const Eigen::VectorXd& lower, const Eigen::VectorXd& upper)
    : lower_(lower), upper_(upper), free_(static_cast<size_t>(lower.size())) {
  std::iota(free_.begin(), free_.end(), 0);
}

void BoxManifold::hold(const Eigen::VectorXd& x, const Eigen::VectorXd& gradient) {
  free_.clear();
  for (int k = 0; k < AmbientSize(); ++k) {
    const bool held =
        (x[k] <= lower_[k] && gradient[k] > 0) || (x[k] >= upper_[k] && gradient[k] < 0);
    if (!held) free_.push_back(k);
  }
}

bool BoxManifold::Plus(const double* x, const double* delta, double* x_plus_delta) const {
  std::copy_n(x, AmbientSize(), x_plus_delta);
  for (size_t i = 0; i < free_.size(); ++i) {
    const int k = free_[i];
    x_plus_delta[k] = std::clamp(x[k] + delta[i], lower_[k], upper_[k]);
  }
  return true;
}

bool BoxManifold::PlusJacobian(const double*, double* jacobian) const {
  Eigen::Map<RowMatrix> selection(jacobian, AmbientSize(), TangentSize());
  selection.setZero();
  for (size_t i = 0; i < free_.size(); ++i) selection(free_[i], static_cast<int>(i)) = 1;
  return true;
}

bool BoxManifold::Minus(const double* y, const double* x, double* y_minus_x) const {
  for (size_t i = 0; i < free_.size(); ++i) y_minus_x[i] = y[free_[i]] - x[free_[i]];
  return true;
}

bool BoxManifold::MinusJacobian(const double*, double* jacobian) const {
  Eigen::Map<RowMatrix> selection(jacobian, TangentSize(), AmbientSize());
  selection.setZero();
  for (size_t i = 0; i < free_.size(); ++i) selection(static_cast<int>(i), free_[i]) = 1;
  return true;
}

}  // namespace effigy
