#include "effigy/learn/adam.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr size_t kGrain = 1 << 14;
// Sums are taken over blocks of this length, so that they do not depend on the thread count.
constexpr size_t kBlock = 1 << 14;
constexpr uint32_t kExponentBits = 0x7f800000u;

struct AdamRates {
  float rate, inverse_root, epsilon, beta1, beta2;
};

EFFIGY_CLONES size_t adam_range(float* __restrict p, const float* __restrict g, float* __restrict m,
                                float* __restrict v, size_t count, const AdamRates& r) {
  const float rate = r.rate, inverse_root = r.inverse_root, epsilon = r.epsilon;
  const float beta1 = r.beta1, beta2 = r.beta2, rest1 = 1.0f - beta1, rest2 = 1.0f - beta2;
  const float tiny = std::numeric_limits<float>::min();
  uint32_t bad = 0;
  for (size_t i = 0; i < count; ++i) {
    // Branch-free, so that the loop vectorises: all ones where the gradient is finite.
    const uint32_t bits = std::bit_cast<uint32_t>(g[i]);
    const uint32_t finite = (bits & kExponentBits) == kExponentBits ? 0u : ~0u;
    bad += 1u + finite;
    const float gradient = std::bit_cast<float>(bits & finite);
    float first = beta1 * m[i] + rest1 * gradient;
    float second = beta2 * v[i] + rest2 * (gradient * gradient);
    first = std::fabs(first) < tiny ? 0.0f : first;
    second = second < tiny ? 0.0f : second;
    m[i] = first;
    v[i] = second;
    p[i] -= rate * first / (std::sqrt(second) * inverse_root + epsilon);
  }
  return bad;
}

EFFIGY_CLONES GradientCheck check_block(const float* g, size_t count) {
  double lanes[8] = {};
  uint32_t bad[8] = {};
  size_t i = 0;
  for (; i + 8 <= count; i += 8)
    for (size_t k = 0; k < 8; ++k) {
      const uint32_t bits = std::bit_cast<uint32_t>(g[i + k]);
      const uint32_t finite = (bits & kExponentBits) == kExponentBits ? 0u : ~0u;
      bad[k] += 1u + finite;
      const double value = static_cast<double>(std::bit_cast<float>(bits & finite));
      lanes[k] += value * value;
    }
  for (; i < count; ++i) {
    if (std::isfinite(g[i]))
      lanes[i % 8] += static_cast<double>(g[i]) * static_cast<double>(g[i]);
    else
      ++bad[0];
  }
  GradientCheck check;
  for (int k = 0; k < 8; ++k) {
    check.norm += lanes[k];
    check.not_finite += bad[k];
  }
  return check;  // norm holds the sum of squares
}

}  // namespace

void AdamState::rearrange(std::span<const int32_t> source, size_t width) {
  EFFIGY_CHECK(width > 0 && m.size() % width == 0 && m.size() == v.size());
  const size_t rows = m.size() / width;
  std::vector<float> new_m(source.size() * width), new_v(source.size() * width);
  for (size_t i = 0; i < source.size(); ++i) {
    if (source[i] < 0) continue;
    const size_t from = static_cast<size_t>(source[i]);
    EFFIGY_CHECK(from < rows);
    std::copy_n(m.data() + from * width, width, new_m.data() + i * width);
    std::copy_n(v.data() + from * width, width, new_v.data() + i * width);
  }
  m = std::move(new_m);
  v = std::move(new_v);
}

AdamScale adam_scale(const AdamSettings& settings, int64_t step) {
  EFFIGY_CHECK(step >= 1);
  const double t = static_cast<double>(step);
  return {1.0 / (1.0 - std::pow(static_cast<double>(settings.beta1), t)),
          1.0 / std::sqrt(1.0 - std::pow(static_cast<double>(settings.beta2), t))};
}

size_t adam_step(std::span<float> parameters, std::span<const float> gradient, AdamState& state,
                 float lr, const AdamSettings& settings) {
  EFFIGY_CHECK_EQ(parameters.size(), gradient.size());
  EFFIGY_CHECK_EQ(parameters.size(), state.m.size());
  EFFIGY_CHECK_EQ(parameters.size(), state.v.size());
  const AdamScale scale = adam_scale(settings, ++state.step);
  const AdamRates rates{static_cast<float>(lr * scale.inverse_correction1),
                        static_cast<float>(scale.inverse_root), settings.epsilon, settings.beta1,
                        settings.beta2};
  std::vector<size_t> bad(static_cast<size_t>(thread_count()));
  parallel_for(parameters.size(), kGrain, [&](size_t begin, size_t end, int slot) {
    // Blocks keep the 32-bit counter of a call from overflowing.
    for (size_t at = begin; at < end; at += kBlock)
      bad[static_cast<size_t>(slot)] +=
          adam_range(parameters.data() + at, gradient.data() + at, state.m.data() + at,
                     state.v.data() + at, std::min(kBlock, end - at), rates);
  });
  size_t total = 0;
  for (const size_t count : bad) total += count;
  return total;
}

GradientCheck check_gradient(std::span<const float> gradient) {
  const size_t blocks = (gradient.size() + kBlock - 1) / kBlock;
  std::vector<GradientCheck> parts(blocks);
  parallel_for(blocks, 1, [&](size_t begin, size_t end, int) {
    for (size_t b = begin; b < end; ++b)
      parts[b] =
          check_block(gradient.data() + b * kBlock, std::min(kBlock, gradient.size() - b * kBlock));
  });
  GradientCheck check;
  for (const GradientCheck& part : parts) {
    check.norm += part.norm;
    check.not_finite += part.not_finite;
  }
  check.norm = std::sqrt(check.norm);
  return check;
}

GradientCheck clip_gradient(std::span<float> gradient, double limit) {
  const GradientCheck check = check_gradient(gradient);
  if (check.not_finite == 0 && check.norm <= limit) return check;
  const float scale = check.norm > limit ? static_cast<float>(limit / check.norm) : 1.0f;
  parallel_for(gradient.size(), kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i)
      gradient[i] = std::isfinite(gradient[i]) ? gradient[i] * scale : 0.0f;
  });
  return check;
}

void save_adam(const AdamState& state, const std::string& name, TensorFile& file) {
  const int64_t count = static_cast<int64_t>(state.m.size());
  file.tensors[name + ".m"] = Tensor::from(std::span<const float>(state.m), {count});
  file.tensors[name + ".v"] = Tensor::from(std::span<const float>(state.v), {count});
  const int64_t step[1] = {state.step};
  file.tensors[name + ".step"] = Tensor::from(std::span<const int64_t>(step), {1});
}

AdamState load_adam(const TensorFile& file, const std::string& name, size_t count) {
  AdamState state;
  const int64_t length = static_cast<int64_t>(count);
  state.m = file.floats(name + ".m", {length});
  state.v = file.floats(name + ".v", {length});
  state.step = file.longs(name + ".step", {1}).front();
  if (state.step < 0)
    throw Error(file.path.string() + ": '" + name + ".step' is negative; start the training anew.");
  for (const float value : state.v)
    if (value < 0.0f)
      throw Error(file.path.string() + ": '" + name +
                  ".v' has a negative entry; start the training anew.");
  return state;
}

}  // namespace effigy
