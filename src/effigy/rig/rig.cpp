#include "effigy/rig/rig.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <span>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/rig/rig_kernels.h"

namespace effigy {
namespace {

using rig_detail::kBlock;

// out[i] += c[0..3] . basis rows; four rows at a time halve the traffic on `out`.
EFFIGY_CLONES void add_rows4(const float* r0, const float* r1, const float* r2, const float* r3,
                             const float* c, float* __restrict out, size_t count) {
  const float c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3];
  for (size_t i = 0; i < count; ++i)
    out[i] += (c0 * r0[i] + c1 * r1[i]) + (c2 * r2[i] + c3 * r3[i]);
}
EFFIGY_CLONES void add_row(const float* row, float c, float* __restrict out, size_t count) {
  for (size_t i = 0; i < count; ++i) out[i] += c * row[i];
}

// Adds sum_k c[k] row_k[begin3, begin3 + count) to out; rows are `stride` apart; zero coefficients
// cost nothing.
void add_basis(const std::vector<float>& basis, size_t stride, const float* c, size_t rows,
               size_t begin3, size_t count, float* out) {
  const float* group[4] = {};
  float factors[4] = {};
  size_t waiting = 0;
  for (size_t k = 0; k < rows; ++k) {
    if (c[k] == 0) continue;
    group[waiting] = basis.data() + k * stride + begin3;
    factors[waiting] = c[k];
    if (++waiting == 4) {
      add_rows4(group[0], group[1], group[2], group[3], factors, out, count);
      waiting = 0;
    }
  }
  for (size_t k = 0; k < waiting; ++k) add_row(group[k], factors[k], out, count);
}

// Linear blend skinning of `count` (<= kBlock) vertices: out = (sum_j w_j M_j) [p; 1] + t. Works on
// one coordinate at a time, so that the loops over vertices vectorise.
EFFIGY_CLONES void skin_block(const float* __restrict points, const float* __restrict weights,
                              const float* __restrict matrices, size_t joints, const float* t,
                              float* __restrict out, size_t count) {
  float x[kBlock], y[kBlock], z[kBlock], w[kBlock];
  float ox[kBlock], oy[kBlock], oz[kBlock];
  for (size_t i = 0; i < count; ++i) {
    x[i] = points[3 * i];
    y[i] = points[3 * i + 1];
    z[i] = points[3 * i + 2];
    ox[i] = t[0];
    oy[i] = t[1];
    oz[i] = t[2];
  }
  for (size_t j = 0; j < joints; ++j) {
    const float* m = matrices + 12 * j;
    const float m0 = m[0], m1 = m[1], m2 = m[2], m3 = m[3], m4 = m[4], m5 = m[5];
    const float m6 = m[6], m7 = m[7], m8 = m[8], m9 = m[9], m10 = m[10], m11 = m[11];
    float largest = 0;
    for (size_t i = 0; i < count; ++i) {
      w[i] = weights[i * joints + j];
      const float size = w[i] < 0 ? -w[i] : w[i];
      largest = size > largest ? size : largest;
    }
    if (largest == 0) continue;  // most blocks know only a few joints
    for (size_t i = 0; i < count; ++i) {
      ox[i] += w[i] * ((m0 * x[i] + m1 * y[i]) + (m2 * z[i] + m3));
      oy[i] += w[i] * ((m4 * x[i] + m5 * y[i]) + (m6 * z[i] + m7));
      oz[i] += w[i] * ((m8 * x[i] + m9 * y[i]) + (m10 * z[i] + m11));
    }
  }
  for (size_t i = 0; i < count; ++i) {
    out[3 * i] = ox[i];
    out[3 * i + 1] = oy[i];
    out[3 * i + 2] = oz[i];
  }
}

int find_name(const std::vector<std::string>& names, const std::string& name) {
  const auto found = std::find(names.begin(), names.end(), name);
  return found == names.end() ? -1 : static_cast<int>(found - names.begin());
}

}  // namespace

namespace rig_detail {

void check_pose(const RigShape& shape, const RigPose& pose) {
  const size_t v3 = shape.rest.size(), joints = shape.parents.size();
  EFFIGY_CHECK(v3 > 0 && v3 % 3 == 0 && joints > 0);
  EFFIGY_CHECK_EQ(shape.expression_basis.size(), pose.expression.size() * v3);
  EFFIGY_CHECK_EQ(shape.joints.size(), 3 * joints);
  EFFIGY_CHECK_EQ(shape.weights.size(), v3 / 3 * joints);
  EFFIGY_CHECK_EQ(pose.joint_rotation.size(), 3 * joints);
  EFFIGY_CHECK(shape.pose_basis.empty() || shape.pose_basis.size() == 9 * (joints - 1) * v3);
}

Chain joint_chain(const RigShape& shape, const RigPose& pose) {
  const size_t joints = shape.parents.size();
  Chain chain;
  chain.matrices.resize(12 * joints);
  for (size_t j = 0; j < joints; ++j) {
    const auto rest = [&](size_t joint) {
      return Vec3d(static_cast<double>(shape.joints[3 * joint]),
                   static_cast<double>(shape.joints[3 * joint + 1]),
                   static_cast<double>(shape.joints[3 * joint + 2]));
    };
    const float* w = pose.joint_rotation.data() + 3 * j;
    chain.local.push_back(rotation_matrix(Vec3d(w[0], w[1], w[2])));
    const int parent = shape.parents[j];
    EFFIGY_CHECK(parent < static_cast<int>(j) && (parent >= 0) == (j > 0));
    if (j == 0) {
      chain.rotation.push_back(chain.local[0]);
      chain.position.push_back(rest(0));
    } else {
      const size_t p = static_cast<size_t>(parent);
      chain.rotation.push_back(chain.rotation[p] * chain.local[j]);
      chain.position.push_back(chain.position[p] + chain.rotation[p] * (rest(j) - rest(p)));
    }
    chain.offset.push_back(chain.position[j] - chain.rotation[j] * rest(j));
    float* m = chain.matrices.data() + 12 * j;
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column)
        m[4 * row + column] = static_cast<float>(chain.rotation[j](row, column));
      m[4 * row + 3] = static_cast<float>(chain.offset[j][row]);
    }
  }
  return chain;
}

std::vector<float> pose_features(const RigShape& shape, const Chain& chain) {
  std::vector<float> features;
  if (shape.pose_basis.empty()) return features;
  for (size_t j = 1; j < chain.local.size(); ++j)
    for (int row = 0; row < 3; ++row)
      for (int column = 0; column < 3; ++column)
        features.push_back(
            static_cast<float>(chain.local[j](row, column) - (row == column ? 1 : 0)));
  return features;
}

void shape_block(const RigShape& shape, const RigPose& pose, const std::vector<float>& features,
                 size_t begin, size_t end, float* out) {
  const size_t v3 = shape.rest.size(), begin3 = 3 * begin, count = 3 * (end - begin);
  std::copy_n(shape.rest.data() + begin3, count, out);
  add_basis(shape.expression_basis, v3, pose.expression.data(), pose.expression.size(), begin3,
            count, out);
  add_basis(shape.pose_basis, v3, features.data(), features.size(), begin3, count, out);
}

}  // namespace rig_detail

int Rig::joint(const std::string& name) const {
  return find_name(joint_names, name);
}
int Rig::expression(const std::string& name) const {
  return find_name(expression_names, name);
}

RigPose RigPose::rest(const Rig& rig) {
  RigPose pose;
  pose.expression.assign(static_cast<size_t>(rig.expression_count), 0.0f);
  pose.joint_rotation.assign(3 * rig.parents.size(), 0.0f);
  return pose;
}

RigShape shape_rig(const Rig& rig, std::span<const float> identity) {
  EFFIGY_CHECK(identity.size() <= static_cast<size_t>(rig.identity_count));
  const size_t v3 = rig.mesh.vertices.size(), vertices = v3 / 3;
  RigShape shape;
  shape.rest = rig.mesh.vertices;
  for (size_t begin = 0; begin < v3; begin += 3 * kBlock)
    add_basis(rig.identity_basis, v3, identity.data(), identity.size(), begin,
              std::min(3 * kBlock, v3 - begin), shape.rest.data() + begin);
  shape.expression_basis = rig.expression_basis;
  shape.pose_basis = rig.pose_basis;
  shape.weights = rig.weights;
  shape.parents = rig.parents;
  for (size_t j = 0; j < rig.parents.size(); ++j) {
    Vec3d joint = Vec3d::Zero();
    const float* row = rig.joint_regressor.data() + j * vertices;
    for (size_t v = 0; v < vertices; ++v)
      if (row[v] != 0)
        for (int axis = 0; axis < 3; ++axis)
          joint[axis] += static_cast<double>(row[v]) *
                         static_cast<double>(shape.rest[3 * v + static_cast<size_t>(axis)]);
    for (int axis = 0; axis < 3; ++axis) shape.joints.push_back(static_cast<float>(joint[axis]));
  }
  return shape;
}

void shift_joint(Rig& rig, std::span<const float> identity, int joint, const Vec3d& shift) {
  EFFIGY_CHECK(joint >= 0 && joint < rig.joint_count());
  const std::vector<float> rest = shape_rig(rig, identity).rest;
  const size_t vertices = rest.size() / 3;
  const auto row_of = [&](size_t v) {
    return Eigen::Vector4d(1, rest[3 * v], rest[3 * v + 1], rest[3 * v + 2]);
  };
  // Minimum of |change|^2 with sum(change) = 0 and sum(change v) = shift.
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  for (size_t v = 0; v < vertices; ++v) normal += row_of(v) * row_of(v).transpose();
  const Eigen::Vector4d multiplier =
      normal.ldlt().solve(Eigen::Vector4d(0, shift.x(), shift.y(), shift.z()));
  float* row = rig.joint_regressor.data() + static_cast<size_t>(joint) * vertices;
  for (size_t v = 0; v < vertices; ++v) row[v] += static_cast<float>(row_of(v).dot(multiplier));
}

void pose_vertices(const RigShape& shape, const RigPose& pose, std::vector<float>& vertices) {
  rig_detail::check_pose(shape, pose);
  const size_t count = shape.rest.size() / 3, joints = shape.parents.size();
  const rig_detail::Chain chain = rig_detail::joint_chain(shape, pose);
  const std::vector<float> features = rig_detail::pose_features(shape, chain);
  vertices.resize(3 * count);
  constexpr size_t kBlocksTogether = 8;
  parallel_for((count + kBlock - 1) / kBlock, kBlocksTogether, [&](size_t from, size_t to, int) {
    float shaped[3 * kBlock];
    for (size_t begin = from * kBlock; begin < std::min(to * kBlock, count); begin += kBlock) {
      const size_t end = std::min(begin + kBlock, count);
      rig_detail::shape_block(shape, pose, features, begin, end, shaped);
      skin_block(shaped, shape.weights.data() + begin * joints, chain.matrices.data(), joints,
                 pose.translation.data(), vertices.data() + 3 * begin, end - begin);
    }
  });
}

std::vector<float> joint_transforms(const RigShape& shape, const RigPose& pose) {
  EFFIGY_CHECK_EQ(pose.joint_rotation.size(), 3 * shape.parents.size());
  EFFIGY_CHECK_EQ(shape.joints.size(), 3 * shape.parents.size());
  std::vector<float> transforms = rig_detail::joint_chain(shape, pose).matrices;
  for (size_t j = 0; j < shape.parents.size(); ++j)
    for (size_t row = 0; row < 3; ++row) transforms[12 * j + 4 * row + 3] += pose.translation[row];
  return transforms;
}

std::vector<float> landmark_positions(const LandmarkEmbedding& embedding,
                                      const std::vector<Vec3i>& triangles,
                                      std::span<const float> vertices) {
  std::vector<float> positions(3 * embedding.size());
  for (size_t i = 0; i < embedding.size(); ++i) {
    const Vec3i& t = triangles[static_cast<size_t>(embedding.triangle[i])];
    for (size_t axis = 0; axis < 3; ++axis)
      for (int corner = 0; corner < 3; ++corner)
        positions[3 * i + axis] +=
            embedding.barycentric[i][corner] * vertices[3 * static_cast<size_t>(t[corner]) + axis];
  }
  return positions;
}

}  // namespace effigy
