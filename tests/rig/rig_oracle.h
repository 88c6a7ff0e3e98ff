// Random rigs, and posing written a second time: in double precision, with homogeneous matrices and
// no shortcuts.
#pragma once

#include <cmath>
#include <random>
#include <vector>

#include "effigy/rig/rig.h"

namespace effigy::oracle {

// A rig of random numbers with joints root, neck, jaw, eye_left, eye_right; triangles are a strip.
inline Rig random_rig(int vertices, int identities, int expressions, bool pose_basis,
                      unsigned seed) {
  std::mt19937 engine(seed);
  const auto uniform = [&](float low, float high) {
    return std::uniform_real_distribution<float>(low, high)(engine);
  };
  const auto fill = [&](std::vector<float>& values, size_t count, float size) {
    values.resize(count);
    for (float& value : values) value = uniform(-size, size);
  };
  Rig rig;
  rig.kind = "random";
  rig.licence = "none";
  const size_t v = static_cast<size_t>(vertices);
  fill(rig.mesh.vertices, 3 * v, 0.1f);
  for (int i = 0; i + 2 < vertices; ++i) rig.mesh.triangles.emplace_back(i, i + 1, i + 2);
  rig.identity_count = identities;
  rig.expression_count = expressions;
  fill(rig.identity_basis, static_cast<size_t>(identities) * 3 * v, 0.01f);
  fill(rig.expression_basis, static_cast<size_t>(expressions) * 3 * v, 0.01f);
  if (pose_basis) fill(rig.pose_basis, 36 * 3 * v, 0.01f);
  for (int k = 0; k < expressions; ++k) rig.expression_names.push_back("e" + std::to_string(k));
  rig.identity_sigma.assign(static_cast<size_t>(identities), 1.0f);
  rig.expression_low.assign(static_cast<size_t>(expressions), -1.0f);
  rig.expression_high.assign(static_cast<size_t>(expressions), 1.0f);
  rig.joint_names = {"root", "neck", "jaw", "eye_left", "eye_right"};
  rig.parents = {-1, 0, 1, 1, 1};
  rig.joint_regressor.resize(5 * v);
  rig.weights.resize(5 * v);
  for (size_t j = 0; j < 5; ++j) {
    double sum = 0;
    for (size_t i = 0; i < v; ++i) {
      rig.joint_regressor[j * v + i] = i % 5 == j ? uniform(0.1f, 1) : 0.0f;
      sum += static_cast<double>(rig.joint_regressor[j * v + i]);
    }
    for (size_t i = 0; i < v; ++i) rig.joint_regressor[j * v + i] /= static_cast<float>(sum);
  }
  for (size_t i = 0; i < v; ++i) {
    float sum = 0;
    for (size_t j = 0; j < 5; ++j)
      sum += rig.weights[5 * i + j] = (i / 64 + j) % 3 == 0 ? 0.0f : uniform(0.05f, 1);
    for (size_t j = 0; j < 5; ++j) rig.weights[5 * i + j] /= sum;
  }
  return rig;
}

inline RigPose random_pose(const Rig& rig, float angle, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> uniform(-1, 1);
  RigPose pose = RigPose::rest(rig);
  for (float& value : pose.expression) value = uniform(engine);
  if (pose.expression.size() > 2) pose.expression[1] = 0;  // zero coefficients take another path
  for (float& value : pose.joint_rotation) value = angle * uniform(engine);
  for (float& value : pose.translation) value = uniform(engine);
  return pose;
}

// RigShape and RigPose in double.
struct Parameters {
  std::vector<double> rest, expression_basis, pose_basis, weights, joints;
  std::vector<double> expression, joint_rotation, translation;
  std::vector<int> parents;
};

inline Parameters parameters(const RigShape& shape, const RigPose& pose) {
  const auto wide = [](const auto& values) {
    return std::vector<double>(values.begin(), values.end());
  };
  return {wide(shape.rest),          wide(shape.expression_basis), wide(shape.pose_basis),
          wide(shape.weights),       wide(shape.joints),           wide(pose.expression),
          wide(pose.joint_rotation), wide(pose.translation),       shape.parents};
}

// Rotation by axis and angle through a quaternion: another route than Rodrigues' formula.
inline Mat3d rotation(const double* w) {
  const double angle = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
  const double half = angle < 1e-8 ? 0.5 - angle * angle / 48 : std::sin(angle / 2) / angle;
  return Eigen::Quaterniond(std::cos(angle / 2), half * w[0], half * w[1], half * w[2])
      .toRotationMatrix();
}

inline std::vector<double> pose_vertices(const Parameters& p) {
  const size_t joints = p.parents.size(), v3 = p.rest.size();
  std::vector<Mat4d> world(joints), skin(joints);
  std::vector<double> features;
  const auto joint = [&](size_t j) {
    return Vec3d(p.joints[3 * j], p.joints[3 * j + 1], p.joints[3 * j + 2]);
  };
  for (size_t j = 0; j < joints; ++j) {
    const Mat3d r = rotation(p.joint_rotation.data() + 3 * j);
    Mat4d local = Mat4d::Identity();
    local.topLeftCorner<3, 3>() = r;
    const size_t parent = static_cast<size_t>(std::max(p.parents[j], 0));
    local.topRightCorner<3, 1>() = j == 0 ? joint(0) : Vec3d(joint(j) - joint(parent));
    world[j] = j == 0 ? local : Mat4d(world[parent] * local);
    Mat4d to_joint = Mat4d::Identity();
    to_joint.topRightCorner<3, 1>() = -joint(j);
    skin[j] = world[j] * to_joint;
    if (j > 0)
      for (int i = 0; i < 9; ++i) features.push_back(r(i / 3, i % 3) - (i % 4 == 0 ? 1 : 0));
  }
  std::vector<double> out(v3);
  for (size_t v = 0; v < v3 / 3; ++v) {
    Eigen::Vector4d s(0, 0, 0, 1);
    for (size_t axis = 0; axis < 3; ++axis) {
      const size_t i = 3 * v + axis;
      double value = p.rest[i];
      for (size_t k = 0; k < p.expression.size(); ++k)
        value += p.expression[k] * p.expression_basis[k * v3 + i];
      if (!p.pose_basis.empty())
        for (size_t m = 0; m < features.size(); ++m)
          value += features[m] * p.pose_basis[m * v3 + i];
      s[static_cast<int>(axis)] = value;
    }
    Eigen::Vector4d sum = Eigen::Vector4d::Zero();
    for (size_t j = 0; j < joints; ++j) sum += p.weights[v * joints + j] * (skin[j] * s);
    for (size_t axis = 0; axis < 3; ++axis)
      out[3 * v + axis] = sum[static_cast<int>(axis)] + p.translation[axis];
  }
  return out;
}

}  // namespace effigy::oracle
