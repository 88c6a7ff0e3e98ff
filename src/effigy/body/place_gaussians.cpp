#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/body/uv_gaussians.h"
#include "effigy/light/zonal.h"

namespace effigy {
namespace {

using Channels = GaussianChannels;
// Vec4f: quaternions w x y z.
constexpr size_t kGrain = 1024;
constexpr size_t kLine = 16;  // floats
constexpr size_t kZonal = Channels::kNormal - Channels::kColoured;

// log(1 + e^x), without overflow, exact for small values.
float softplus(float x) {
  // log(1 + e), whose rounding of 1 + e is taken back out (Kahan's form, faster than log1p).
  const float e = std::exp(-std::abs(x)), u = 1.0f + e;
  return std::max(x, 0.0f) + (u == 1.0f ? e : std::log(u) * (e / (u - 1.0f)));
}
float sigmoid(float x) {
  return x >= 0 ? 1.0f / (1.0f + std::exp(-x)) : std::exp(x) / (1.0f + std::exp(x));
}

Mat3f matrix_of(const Vec4f& q) {
  return Eigen::Quaternionf(q[0], q[1], q[2], q[3]).toRotationMatrix();
}

// The gradient by a unit quaternion from that by its matrix R(q) (entries as polynomials of q).
Vec4f matrix_backward(const Vec4f& q, const Mat3f& d) {
  const float w = q[0], x = q[1], y = q[2], z = q[3];
  return 2.0f * Vec4f(x * (d(2, 1) - d(1, 2)) + y * (d(0, 2) - d(2, 0)) + z * (d(1, 0) - d(0, 1)),
                      w * (d(2, 1) - d(1, 2)) + y * (d(0, 1) + d(1, 0)) + z * (d(0, 2) + d(2, 0)) -
                          2.0f * x * (d(1, 1) + d(2, 2)),
                      w * (d(0, 2) - d(2, 0)) + x * (d(0, 1) + d(1, 0)) + z * (d(1, 2) + d(2, 1)) -
                          2.0f * y * (d(0, 0) + d(2, 2)),
                      w * (d(1, 0) - d(0, 1)) + x * (d(0, 2) + d(2, 0)) + y * (d(1, 2) + d(2, 1)) -
                          2.0f * z * (d(0, 0) + d(1, 1)));
}

// Left multiplication by a quaternion as a matrix; its transpose is the way back.
Eigen::Matrix4f product_matrix(const Vec4f& a) {
  Eigen::Matrix4f m;
  m << a[0], -a[1], -a[2], -a[3],  //
      a[1], a[0], -a[3], a[2],     //
      a[2], a[3], a[0], -a[1],     //
      a[3], -a[2], a[1], a[0];
  return m;
}

// What both directions need of one texel.
struct Texel {
  Mat3f tbn, delta;  // TBN, delta R
  Vec4f tbn_q;       // TBN as a quaternion
  Vec4f q;           // delta R as a unit quaternion
  float q_length;    // before it was made unit; 0: the identity was taken
  Vec3f n;           // (0, 0, 1) + delta n
  float n_length;

  Texel(const float* rotation, const float* x, size_t channels) {
    tbn = Eigen::Map<const Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(rotation);
    const Eigen::Quaternionf turn(tbn);
    tbn_q = Vec4f(turn.w(), turn.x(), turn.y(), turn.z()).normalized();
    q = Vec4f(x + Channels::kRotation) + Vec4f(1, 0, 0, 0);
    q_length = q.norm();
    q = q_length > 0 ? Vec4f(q / q_length) : Vec4f(1, 0, 0, 0);
    delta = matrix_of(q);
    n = Vec3f(x + Channels::normal_of(channels)) + Vec3f(0, 0, 1);
    n_length = n.norm();
  }
};

// What the decoder's zonal harmonics are added to: Lambert about the normal.
const std::array<float, kZonal>& start_zonal() {
  static const std::array<float, kZonal> start = [] {
    std::array<float, kZonal> values{};
    constexpr size_t kColourBands = 4, kMonoBands = kZonalBands - kColourBands;
    for (size_t l = 0; l < kZonalBands; ++l) {
      const auto z = static_cast<float>(lambert_zonal()[l]);
      if (l < kColourBands)
        std::fill_n(&values[(2 * kColourBands + l) * 3], 3, z);
      else
        values[Channels::kMono - Channels::kColoured + 2 * kMonoBands + l - kColourBands] = z;
    }
    return values;
  }();
  return start;
}

}  // namespace

void place_gaussians(const UvTexels& texels, const TexelFrames& frames,
                     std::span<const float> decoded, UvGaussians& gaussians) {
  const size_t count = texels.count();
  const size_t channels = decoded.size() / count, transfer = Channels::transfer_of(channels);
  EFFIGY_CHECK(channels > 14);
  EFFIGY_CHECK_EQ(decoded.size(), channels * count);
  EFFIGY_CHECK_EQ(frames.rotation.size(), 9 * count);
  UvGaussians& g = gaussians;
  g.center.resize(3 * count);
  g.rotation.resize(4 * count);
  g.scale.resize(3 * count);
  g.opacity.resize(count);
  g.axes.resize(9 * count);
  g.zonal.resize(transfer * count);
  g.normal.resize(3 * count);
  const auto& start = start_zonal();
  const auto start_opacity = static_cast<float>(std::log(kStartOpacity / (1 - kStartOpacity)));
  parallel_for(count, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const float* x = &decoded[channels * i];
      const Texel texel(&frames.rotation[9 * i], x, channels);
      Eigen::Map<Vec3f>(&g.center[3 * i]) =
          Vec3f(&frames.position[3 * i]) +
          static_cast<float>(kOffsetUnit) * (texel.tbn * Vec3f(x + Channels::kOffset));
      Eigen::Map<Vec4f>(&g.rotation[4 * i]) = product_matrix(texel.tbn_q) * texel.q;
      for (size_t c = 0; c < 3; ++c)
        g.scale[3 * i + c] = softplus(x[Channels::kScale + c] + texels.scale_start[i]);
      g.opacity[i] = sigmoid(x[Channels::kOpacity] + start_opacity);
      const Mat3f r = texel.tbn * texel.delta;
      const Vec3f normal =
          r * (texel.n_length > 0 ? Vec3f(texel.n / texel.n_length) : Vec3f(0, 0, 1));
      for (size_t axis = 0; axis < 3; ++axis)
        for (size_t c = 0; c < 3; ++c)
          g.axes[(3 * axis + c) * count + i] =
              r(static_cast<Eigen::Index>(c), static_cast<Eigen::Index>(axis));
      for (size_t c = 0; c < 3; ++c) g.normal[c * count + i] = normal[static_cast<int>(c)];
    }
    // Texel by texel to plane by plane, a cache line of each plane at a time.
    for (size_t first = begin; first < end; first += kLine) {
      const size_t last = std::min(end, first + kLine);
      for (size_t c = 0; c < transfer; ++c) {
        const float from = transfer == kZonal ? start[c] : 0.0f;
        for (size_t i = first; i < last; ++i)
          g.zonal[c * count + i] = decoded[channels * i + Channels::kColoured + c] + from;
      }
    }
  });
}

void place_gaussians_backward(const UvTexels& texels, const TexelFrames& frames,
                              std::span<const float> decoded, const UvGaussianGradients& gradients,
                              std::span<float> d_decoded) {
  const size_t count = texels.count();
  const UvGaussianGradients& d = gradients;
  const size_t channels = decoded.size() / count, transfer = Channels::transfer_of(channels);
  EFFIGY_CHECK_EQ(decoded.size(), channels * count);
  EFFIGY_CHECK_EQ(d_decoded.size(), decoded.size());
  const auto start_opacity = static_cast<float>(std::log(kStartOpacity / (1 - kStartOpacity)));
  parallel_for(count, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const float* x = &decoded[channels * i];
      float* d_x = &d_decoded[channels * i];
      std::fill_n(d_x, channels, 0.0f);
      const Texel texel(&frames.rotation[9 * i], x, channels);
      if (!d.center.empty())
        Eigen::Map<Vec3f>(d_x + Channels::kOffset) =
            static_cast<float>(kOffsetUnit) * (texel.tbn.transpose() * Vec3f(&d.center[3 * i]));
      for (size_t c = 0; !d.scale.empty() && c < 3; ++c)
        d_x[Channels::kScale + c] =
            d.scale[3 * i + c] * sigmoid(x[Channels::kScale + c] + texels.scale_start[i]);
      if (!d.opacity.empty()) {
        const float o = sigmoid(x[Channels::kOpacity] + start_opacity);
        d_x[Channels::kOpacity] = d.opacity[i] * o * (1 - o);
      }
      Mat3f d_r = Mat3f::Zero();
      for (int axis = 0; !d.axes.empty() && axis < 3; ++axis)
        for (int c = 0; c < 3; ++c)
          d_r(c, axis) = d.axes[static_cast<size_t>(3 * axis + c) * count + i];
      if (!d.normal.empty() && texel.n_length > 0) {
        const Vec3f up(d.normal[i], d.normal[count + i], d.normal[2 * count + i]);
        const Vec3f n = texel.n / texel.n_length;
        d_r += up * n.transpose();
        const Vec3f d_n = (texel.tbn * texel.delta).transpose() * up;
        Eigen::Map<Vec3f>(d_x + Channels::normal_of(channels)) =
            (d_n - n.dot(d_n) * n) / texel.n_length;
      }
      if (texel.q_length > 0) {
        Vec4f d_q = matrix_backward(texel.q, texel.tbn.transpose() * d_r);
        if (!d.rotation.empty())
          d_q += product_matrix(texel.tbn_q).transpose() * Vec4f(&d.rotation[4 * i]);
        Eigen::Map<Vec4f>(d_x + Channels::kRotation) =
            (d_q - texel.q.dot(d_q) * texel.q) / texel.q_length;
      }
      for (size_t c = 0; !d.zonal.empty() && c < transfer; ++c)
        d_x[Channels::kColoured + c] = d.zonal[c * count + i];
    }
  });
}

}  // namespace effigy
