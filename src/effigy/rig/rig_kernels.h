// What the forward and backward passes of posing share: rotations, the joint chain, blocks.
// Private to rig/.
#pragma once

#include <array>
#include <cmath>
#include <vector>

#include "effigy/rig/rig.h"

namespace effigy::rig_detail {

// Vertices are handled in blocks that stay in the first-level cache.
constexpr size_t kBlock = 256;

// sin(t)/t, (1 - cos t)/t^2 and their derivatives divided by t, from t^2; series near 0, so that
// everything is smooth and exact there.
struct RotationTerms {
  double a, b;    // sin(t)/t, (1 - cos t)/t^2
  double da, db;  // (1/t) d/dt of a and b
};
inline RotationTerms rotation_terms(double t2) {
  if (t2 < 1e-2) {
    return {1 - t2 / 6 * (1 - t2 / 20 * (1 - t2 / 42)),
            0.5 - t2 / 24 * (1 - t2 / 30 * (1 - t2 / 56)),
            -1.0 / 3 + t2 / 30 * (1 - t2 / 28 * (1 - t2 / 54)),
            -1.0 / 12 + t2 / 180 * (1 - t2 * 3 / 112 * (1 - t2 * 2 / 135))};
  }
  const double t = std::sqrt(t2), s = std::sin(t), c = std::cos(t);
  return {s / t, (1 - c) / t2, (t * c - s) / (t2 * t), (t * s - 2 * (1 - c)) / (t2 * t2)};
}

inline Mat3d skew(const Vec3d& w) {
  Mat3d k;
  k << 0, -w.z(), w.y(), w.z(), 0, -w.x(), -w.y(), w.x(), 0;
  return k;
}

// Rodrigues' formula R = I + a K + b K^2.
inline Mat3d rotation_matrix(const Vec3d& w) {
  const RotationTerms terms = rotation_terms(w.squaredNorm());
  const Mat3d k = skew(w);
  return Mat3d::Identity() + terms.a * k + terms.b * (k * k);
}

// Everything that depends on the pose alone.
struct Chain {
  std::vector<Mat3d> local;     // R_j
  std::vector<Mat3d> rotation;  // of joint j in the world
  std::vector<Vec3d> position;  // posed joint, without the translation
  std::vector<Vec3d> offset;    // position - rotation * rest joint
  std::vector<float> matrices;  // [J][12], 3x4 row-major rotation | offset
};
Chain joint_chain(const RigShape& shape, const RigPose& pose);

// 9 (J - 1) numbers R_j - I, row-major, j >= 1; empty without a pose basis.
std::vector<float> pose_features(const RigShape& shape, const Chain& chain);

// Shaped positions of vertices [begin, end) into `out` (3 per vertex).
void shape_block(const RigShape& shape, const RigPose& pose, const std::vector<float>& features,
                 size_t begin, size_t end, float* out);

void check_pose(const RigShape& shape, const RigPose& pose);

}  // namespace effigy::rig_detail
