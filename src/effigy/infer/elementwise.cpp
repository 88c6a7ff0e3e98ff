#include "effigy/infer/elementwise.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/simd.h"

namespace effigy {
namespace {

constexpr size_t kBlock = 256;

// Both signs are computed and added: a product inside the condition would not vectorise.
EFFIGY_CLONES void prelu_block(float* y, const float* slope, size_t n) {
  for (size_t i = 0; i < n; ++i) {
    const float value = y[i];
    const float above = value > 0.0f ? value : 0.0f, below = value > 0.0f ? 0.0f : value;
    y[i] = above + slope[i] * below;
  }
}

EFFIGY_CLONES void add_prelu_block(float* y, const float* a, const float* b, const float* slope,
                                   size_t n) {
  for (size_t i = 0; i < n; ++i) {
    const float sum = a[i] + b[i];
    const float above = sum > 0.0f ? sum : 0.0f, below = sum > 0.0f ? 0.0f : sum;
    y[i] = above + slope[i] * below;
  }
}

EFFIGY_CLONES void clamp_block(float* y, size_t n, float high) {
  for (size_t i = 0; i < n; ++i) y[i] = std::min(std::max(y[i], 0.0f), high);
}

EFFIGY_CLONES void add_clamp_block(float* y, const float* a, const float* b, size_t n, float low,
                                   float high) {
  for (size_t i = 0; i < n; ++i) y[i] = std::min(std::max(a[i] + b[i], low), high);
}

EFFIGY_CLONES void hard_swish_block(float* y, size_t n) {
  for (size_t i = 0; i < n; ++i)
    y[i] = y[i] * std::min(std::max(y[i] + 3.0f, 0.0f), 6.0f) * (1.0f / 6.0f);
}

constexpr float kHuge = 3.0e38f;

}  // namespace

PreluSlopes::PreluSlopes(const std::vector<float>& slope) {
  if (slope.empty()) return;
  const size_t copies = (kBlock + slope.size() - 1) / slope.size();
  repeated.reserve(copies * slope.size());
  for (size_t i = 0; i < copies; ++i) repeated.insert(repeated.end(), slope.begin(), slope.end());
}

void activate(float* y, size_t n, Activation activation, const PreluSlopes& slopes) {
  switch (activation) {
    case Activation::kNone:
      break;
    case Activation::kRelu:
      clamp_block(y, n, kHuge);
      break;
    case Activation::kRelu6:
      clamp_block(y, n, 6.0f);
      break;
    case Activation::kHardSwish:
      hard_swish_block(y, n);
      break;
    case Activation::kLogistic:
      for (size_t i = 0; i < n; ++i) y[i] = 1.0f / (1.0f + std::exp(-y[i]));
      break;
    case Activation::kPrelu: {
      const size_t step = slopes.repeated.size();
      for (size_t i = 0; i < n; i += step)
        prelu_block(y + i, slopes.repeated.data(), std::min(step, n - i));
      break;
    }
  }
}

void add_activate(float* y, const float* a, const float* b, size_t n, Activation activation,
                  const PreluSlopes& slopes) {
  switch (activation) {
    case Activation::kNone:
      add_clamp_block(y, a, b, n, -kHuge, kHuge);
      break;
    case Activation::kRelu:
      add_clamp_block(y, a, b, n, 0.0f, kHuge);
      break;
    case Activation::kRelu6:
      add_clamp_block(y, a, b, n, 0.0f, 6.0f);
      break;
    case Activation::kPrelu: {
      const size_t step = slopes.repeated.size();
      for (size_t i = 0; i < n; i += step)
        add_prelu_block(y + i, a + i, b + i, slopes.repeated.data(), std::min(step, n - i));
      break;
    }
    case Activation::kHardSwish:
    case Activation::kLogistic:
      add_clamp_block(y, a, b, n, -kHuge, kHuge);
      activate(y, n, activation, slopes);
      break;
  }
}

EFFIGY_CLONES void scale_channels(float* y, const float* x, const float* gain, size_t pixels,
                                  size_t channels) {
  for (size_t p = 0; p < pixels; ++p) {
    const float* in = x + p * channels;
    float* out = y + p * channels;
    for (size_t c = 0; c < channels; ++c) out[c] = in[c] * gain[c];
  }
}

EFFIGY_CLONES void mean_channels(float* mean, const float* x, size_t pixels, size_t channels) {
  std::fill(mean, mean + channels, 0.0f);
  for (size_t p = 0; p < pixels; ++p)
    for (size_t c = 0; c < channels; ++c) mean[c] += x[p * channels + c];
  const float scale = 1.0f / static_cast<float>(pixels);
  for (size_t c = 0; c < channels; ++c) mean[c] *= scale;
}

EFFIGY_CLONES void max_pool_row(float* out, const float* const* rows, int window_h, int window_w,
                                int stride_w, int out_w, size_t channels) {
  for (int x = 0; x < out_w; ++x) {
    float* target = out + static_cast<size_t>(x) * channels;
    const size_t first = static_cast<size_t>(x) * stride_w * channels;
    for (size_t c = 0; c < channels; ++c) target[c] = rows[0][first + c];
    for (int v = 0; v < window_h; ++v)
      for (int u = 0; u < window_w; ++u) {
        const float* source = rows[v] + first + static_cast<size_t>(u) * channels;
        for (size_t c = 0; c < channels; ++c) target[c] = std::max(target[c], source[c]);
      }
  }
}

}  // namespace effigy
