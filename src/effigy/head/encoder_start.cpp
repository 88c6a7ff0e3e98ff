#include "effigy/head/encoder_start.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/head/frames.h"

namespace effigy {
namespace {

constexpr size_t kMostFrames = 600;   // that decide the components
constexpr double kLeastShare = 1e-5;  // of the first component's variance

// All landmarks that both the rig and the networks know.
std::vector<int32_t> known_landmarks(const Capture& capture) {
  std::vector<int32_t> entries;
  for (size_t l = 0; l < capture.rig.mediapipe.size(); ++l)
    if (capture.rig.mediapipe.index[l] < capture.landmark_count)
      entries.push_back(static_cast<int32_t>(l));
  return entries;
}

// What each input is multiplied by, so that every kind of input varies by 1 in all.
Eigen::VectorXd balance(const FrameEncoder& encoder, const Eigen::MatrixXd& centred) {
  const auto joints = static_cast<Eigen::Index>(encoder.joint_count);
  const Eigen::Index kinds[] = {encoder.expression_count, 3 * joints, 3, encoder.score_count,
                                2 * static_cast<Eigen::Index>(encoder.landmarks.size())};
  Eigen::VectorXd scale = Eigen::VectorXd::Zero(centred.cols());
  Eigen::Index at = 0;
  for (const Eigen::Index width : kinds) {
    const double spread = std::sqrt(centred.middleCols(at, width).squaredNorm() /
                                    static_cast<double>(centred.rows()));
    if (spread > 1e-12) scale.segment(at, width).setConstant(1 / spread);
    at += width;
  }
  return scale;
}

}  // namespace

FrameEncoder start_encoder(const Capture& capture, const std::vector<int>& frames, int codes,
                           double reach) {
  EFFIGY_CHECK(frames.size() >= 2 && codes >= 1);
  FrameEncoder encoder;
  encoder.expression_count = capture.rig.expression_count;
  encoder.joint_count = capture.rig.joint_count();
  encoder.score_count = capture.score_count;
  encoder.landmarks = known_landmarks(capture);
  const std::vector<int> used = spread_frames(frames, kMostFrames);
  const auto rows = static_cast<Eigen::Index>(used.size());
  const auto columns = static_cast<Eigen::Index>(encoder.input_size());
  Eigen::MatrixXd x(rows, columns);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const std::vector<float> inputs = encoder.inputs(capture, used[static_cast<size_t>(i)]);
    for (Eigen::Index d = 0; d < columns; ++d) x(i, d) = inputs[static_cast<size_t>(d)];
  }
  const Eigen::VectorXd mean = x.colwise().mean().transpose();
  x.rowwise() -= mean.transpose();
  const Eigen::VectorXd scale = balance(encoder, x);
  x = x * scale.asDiagonal();
  // Principal components by the frames' Gram matrix, which is smaller than the inputs' covariance.
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(x * x.transpose() /
                                                              static_cast<double>(rows));
  const auto variance = [&](Eigen::Index k) { return solver.eigenvalues()[rows - 1 - k]; };
  for (Eigen::Index k = 0; k < std::min<Eigen::Index>(codes, rows - 1); ++k) {
    if (k > 0 && !(variance(k) > kLeastShare * variance(0))) break;
    // Unit variance over the frames, times the root of the component's share.
    const double spread = variance(0) > 0 ? std::pow(variance(k) / variance(0), 0.25) : 1.0;
    const Eigen::VectorXd direction =
        x.transpose() * solver.eigenvectors().col(rows - 1 - k) *
        (variance(0) > 0 ? spread / (variance(k) * std::sqrt(static_cast<double>(rows))) : 0.0);
    for (Eigen::Index d = 0; d < columns; ++d)
      encoder.projection.push_back(static_cast<float>(direction[d] * scale[d]));
    encoder.limit.push_back(static_cast<float>(reach * spread));
  }
  encoder.mean.resize(encoder.input_size());
  for (Eigen::Index d = 0; d < columns; ++d)
    encoder.mean[static_cast<size_t>(d)] = static_cast<float>(mean[d]);
  encoder.weights.assign(encoder.pose_size() * encoder.code_size(), 0.0f);
  return encoder;
}

}  // namespace effigy
