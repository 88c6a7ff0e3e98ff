// The derivative of posing. Forward, for vertex v with shaped position s_v and weights w_vj:
//   s_v = rest_v + sum_k psi_k B_kv + sum_m f_m P_mv,      f = vec(R_j - I), j >= 1
//   y_v = sum_j w_vj (G_j s_v + t_j) + translation,         t_j = p_j - G_j J_j
//   G_j = G_parent R_j,  p_j = p_parent + G_parent (J_j - J_parent),  R_j = exp(omega_j)
// Given g_v = dL/dy_v, with A_v = sum_j w_vj G_j:
//   dL/ds_v = A_v^T g_v,  dL/dw_vj = g_v . (G_j s_v + t_j)
//   dL/dG_j += w_vj g_v s_v^T,  dL/dt_j += w_vj g_v,        and the chain is walked back to front.
// The rest joints J are held (they are frozen at the rest shape, see RigShape).
#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/rig/rig_kernels.h"

namespace effigy {
namespace {

using rig_detail::Chain;
using rig_detail::kBlock;

// One coordinate per array, so that the loops over the vertices of a block vectorise.
struct Block {
  float x[kBlock], y[kBlock], z[kBlock];     // shaped positions
  float gx[kBlock], gy[kBlock], gz[kBlock];  // dL/dy
  float sx[kBlock], sy[kBlock], sz[kBlock];  // dL/ds
  float w[kBlock];
};

EFFIGY_CLONES void load_block(const float* __restrict shaped, const float* __restrict d_vertices,
                              size_t count, Block& block) {
  for (size_t i = 0; i < count; ++i) {
    block.x[i] = shaped[3 * i];
    block.y[i] = shaped[3 * i + 1];
    block.z[i] = shaped[3 * i + 2];
    block.gx[i] = d_vertices[3 * i];
    block.gy[i] = d_vertices[3 * i + 1];
    block.gz[i] = d_vertices[3 * i + 2];
    block.sx[i] = block.sy[i] = block.sz[i] = 0;
  }
}

EFFIGY_CLONES void store_block(const Block& block, size_t count, float* __restrict d_shaped) {
  for (size_t i = 0; i < count; ++i) {
    d_shaped[3 * i] = block.sx[i];
    d_shaped[3 * i + 1] = block.sy[i];
    d_shaped[3 * i + 2] = block.sz[i];
  }
}

// Sums of products over up to kBlock elements in kLanes independent partial sums: the compiler may
// vectorise them without reordering a sum, so the result does not depend on optimisation flags.
constexpr size_t kLanes = 16;
inline float lane_sum(const float* lanes) {
  float sum = 0;
  for (size_t i = 0; i < kLanes; ++i) sum += lanes[i];
  return sum;
}

EFFIGY_CLONES float dot(const float* __restrict a, const float* __restrict b, size_t count) {
  float lanes[kLanes] = {};
  size_t i = 0;
  for (; i + kLanes <= count; i += kLanes)
    for (size_t lane = 0; lane < kLanes; ++lane) lanes[lane] += a[i + lane] * b[i + lane];
  for (size_t lane = 0; i < count; ++i, ++lane) lanes[lane] += a[i] * b[i];
  return lane_sum(lanes);
}

EFFIGY_CLONES void add_scaled(const float* __restrict in, float factor, float* __restrict out,
                              size_t count) {
  for (size_t i = 0; i < count; ++i) out[i] += factor * in[i];
}

// Adds joint j's part of dL/ds; w holds its weights.
EFFIGY_CLONES void add_shaped_gradient(Block& b, const float* m, size_t count) {
  const float m0 = m[0], m1 = m[1], m2 = m[2], m4 = m[4], m5 = m[5], m6 = m[6];
  const float m8 = m[8], m9 = m[9], m10 = m[10];
  for (size_t i = 0; i < count; ++i) {
    const float hx = b.w[i] * b.gx[i], hy = b.w[i] * b.gy[i], hz = b.w[i] * b.gz[i];
    b.sx[i] += m0 * hx + m4 * hy + m8 * hz;
    b.sy[i] += m1 * hx + m5 * hy + m9 * hz;
    b.sz[i] += m2 * hx + m6 * hy + m10 * hz;
  }
}

// dL/dw of joint j.
EFFIGY_CLONES void add_weight_gradient(const Block& b, const float* m, size_t joint, size_t joints,
                                       size_t count, float* __restrict d_weights) {
  float value[kBlock];
  for (size_t i = 0; i < count; ++i)
    value[i] = b.gx[i] * (m[0] * b.x[i] + m[1] * b.y[i] + m[2] * b.z[i] + m[3]) +
               b.gy[i] * (m[4] * b.x[i] + m[5] * b.y[i] + m[6] * b.z[i] + m[7]) +
               b.gz[i] * (m[8] * b.x[i] + m[9] * b.y[i] + m[10] * b.z[i] + m[11]);
  for (size_t i = 0; i < count; ++i) d_weights[i * joints + joint] += value[i];
}

// Adds dL/d(G_j | t_j) (3x4 row-major) of the block to `sums`.
EFFIGY_CLONES void add_matrix_gradient(const Block& b, size_t count, double* sums) {
  float lanes[12][kLanes] = {};
  for (size_t begin = 0; begin < count; begin += kLanes) {
    const size_t length = std::min(kLanes, count - begin);
    for (size_t lane = 0; lane < length; ++lane) {
      const size_t i = begin + lane;
      const float x = b.x[i], y = b.y[i], z = b.z[i];
      const float hx = b.w[i] * b.gx[i], hy = b.w[i] * b.gy[i], hz = b.w[i] * b.gz[i];
      lanes[0][lane] += hx * x, lanes[1][lane] += hx * y, lanes[2][lane] += hx * z;
      lanes[4][lane] += hy * x, lanes[5][lane] += hy * y, lanes[6][lane] += hy * z;
      lanes[8][lane] += hz * x, lanes[9][lane] += hz * y, lanes[10][lane] += hz * z;
      lanes[3][lane] += hx, lanes[7][lane] += hy, lanes[11][lane] += hz;
    }
  }
  for (size_t k = 0; k < 12; ++k) sums[k] += static_cast<double>(lane_sum(lanes[k]));
}

// Collects joint j's weights; false when all are zero.
EFFIGY_CLONES bool load_weights(const float* __restrict weights, size_t joint, size_t joints,
                                size_t count, Block& b) {
  float largest = 0;
  for (size_t i = 0; i < count; ++i) {
    b.w[i] = weights[i * joints + joint];
    const float size = b.w[i] < 0 ? -b.w[i] : b.w[i];
    largest = size > largest ? size : largest;
  }
  return largest > 0;
}

// d R / d omega contracted with dL/dR. Exact at omega = 0 (see rotation_terms).
Vec3d rotation_gradient(const Vec3d& w, const Mat3d& d_r) {
  const rig_detail::RotationTerms terms = rig_detail::rotation_terms(w.squaredNorm());
  const Mat3d k = rig_detail::skew(w), k2 = k * k;
  const double along_k = (d_r.array() * k.array()).sum();
  const double along_k2 = (d_r.array() * k2.array()).sum();
  Vec3d gradient;
  for (int axis = 0; axis < 3; ++axis) {
    const Mat3d e = rig_detail::skew(Vec3d::Unit(axis));
    const Mat3d direct = terms.a * e + terms.b * (e * k + k * e);
    gradient[axis] =
        (d_r.array() * direct.array()).sum() + w[axis] * (terms.da * along_k + terms.db * along_k2);
  }
  return gradient;
}

Vec3d rest_joint(const RigShape& shape, size_t j) {
  return Eigen::Map<const Vec3f>(shape.joints.data() + 3 * j).cast<double>();
}

// Walks the chain from the leaves to the root. `sums` holds dL/d(G_j | t_j); `d_features` dL/df.
void chain_backward(const RigShape& shape, const RigPose& pose, const Chain& chain,
                    const std::vector<double>& sums, const std::vector<double>& d_features,
                    std::vector<float>& d_rotation) {
  const size_t joints = shape.parents.size();
  std::vector<Mat3d> d_g(joints);
  std::vector<Vec3d> d_p(joints);
  for (size_t j = 0; j < joints; ++j) {
    const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> m(sums.data() + 12 * j);
    d_p[j] = m.col(3);  // t = p - G J
    d_g[j] = m.leftCols<3>() - d_p[j] * rest_joint(shape, j).transpose();
  }
  for (size_t j = joints; j-- > 0;) {
    Mat3d d_local = d_g[j];
    if (j > 0) {
      const size_t p = static_cast<size_t>(shape.parents[j]);
      d_local = chain.rotation[p].transpose() * d_g[j];
      d_g[p] += d_g[j] * chain.local[j].transpose() +
                d_p[j] * (rest_joint(shape, j) - rest_joint(shape, p)).transpose();
      d_p[p] += d_p[j];
      if (!d_features.empty())
        d_local += Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(
            d_features.data() + 9 * (j - 1));
    }
    const Vec3d omega = Eigen::Map<const Vec3f>(pose.joint_rotation.data() + 3 * j).cast<double>();
    Eigen::Map<Vec3f>(d_rotation.data() + 3 * j) += rotation_gradient(omega, d_local).cast<float>();
  }
}

void check_gradient(const RigShape& shape, const RigPose& pose, const RigGradient& gradient) {
  const auto fits = [](const std::vector<float>& array, size_t size) {
    return array.empty() || array.size() == size;
  };
  EFFIGY_CHECK(fits(gradient.rest, shape.rest.size()));
  EFFIGY_CHECK(fits(gradient.expression_basis, shape.expression_basis.size()));
  EFFIGY_CHECK(fits(gradient.pose_basis, shape.pose_basis.size()));
  EFFIGY_CHECK(fits(gradient.weights, shape.weights.size()));
  EFFIGY_CHECK(fits(gradient.expression, pose.expression.size()));
  EFFIGY_CHECK(fits(gradient.joint_rotation, pose.joint_rotation.size()));
}

// Gradients of one basis: of its rows (when wanted) and of its coefficients (when wanted).
void basis_backward(const std::vector<float>& basis, size_t stride, const float* coefficients,
                    size_t rows, size_t begin3, size_t count, const float* d_shaped,
                    std::vector<float>& d_basis, std::vector<double>& d_coefficients) {
  for (size_t k = 0; k < rows; ++k) {
    const size_t at = k * stride + begin3;
    if (!d_coefficients.empty())
      d_coefficients[k] += static_cast<double>(dot(basis.data() + at, d_shaped, count));
    if (!d_basis.empty() && coefficients[k] != 0)
      add_scaled(d_shaped, coefficients[k], d_basis.data() + at, count);
  }
}

}  // namespace

void pose_vertices_backward(const RigShape& shape, const RigPose& pose,
                            std::span<const float> d_vertices, RigGradient& gradient) {
  rig_detail::check_pose(shape, pose);
  check_gradient(shape, pose, gradient);
  const size_t v3 = shape.rest.size(), vertices = v3 / 3, joints = shape.parents.size();
  EFFIGY_CHECK_EQ(d_vertices.size(), v3);
  const Chain chain = rig_detail::joint_chain(shape, pose);
  const std::vector<float> features = rig_detail::pose_features(shape, chain);

  const bool want_rotation = !gradient.joint_rotation.empty();
  std::vector<double> d_expression(gradient.expression.size());
  std::vector<double> d_features(want_rotation ? features.size() : 0);
  std::vector<double> d_matrices(12 * joints);
  Vec3d d_translation = Vec3d::Zero();
  Block block;
  float shaped[3 * kBlock], d_shaped[3 * kBlock];
  for (size_t begin = 0; begin < vertices; begin += kBlock) {
    const size_t count = std::min(kBlock, vertices - begin), begin3 = 3 * begin;
    const float* g = d_vertices.data() + begin3;
    for (size_t i = 0; i < count; ++i)
      d_translation += Eigen::Map<const Vec3f>(g + 3 * i).cast<double>();
    rig_detail::shape_block(shape, pose, features, begin, begin + count, shaped);
    load_block(shaped, g, count, block);
    for (size_t j = 0; j < joints; ++j) {
      const float* m = chain.matrices.data() + 12 * j;
      if (!gradient.weights.empty())
        add_weight_gradient(block, m, j, joints, count, gradient.weights.data() + begin * joints);
      if (!load_weights(shape.weights.data() + begin * joints, j, joints, count, block)) continue;
      add_shaped_gradient(block, m, count);
      if (want_rotation) add_matrix_gradient(block, count, d_matrices.data() + 12 * j);
    }
    store_block(block, count, d_shaped);
    if (!gradient.rest.empty())
      add_scaled(d_shaped, 1.0f, gradient.rest.data() + begin3, 3 * count);
    basis_backward(shape.expression_basis, v3, pose.expression.data(), pose.expression.size(),
                   begin3, 3 * count, d_shaped, gradient.expression_basis, d_expression);
    basis_backward(shape.pose_basis, v3, features.data(), features.size(), begin3, 3 * count,
                   d_shaped, gradient.pose_basis, d_features);
  }
  for (size_t axis = 0; axis < 3; ++axis)
    gradient.translation[axis] += static_cast<float>(d_translation[static_cast<int>(axis)]);
  for (size_t k = 0; k < d_expression.size(); ++k)
    gradient.expression[k] += static_cast<float>(d_expression[k]);
  if (want_rotation)
    chain_backward(shape, pose, chain, d_matrices, d_features, gradient.joint_rotation);
}

}  // namespace effigy
