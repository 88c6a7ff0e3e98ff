// The element-wise passes of small networks on plain NHWC arrays. libtorch has all of them, but its
// PReLU is scalar and each pass costs a read and a write of the activation: here they are fused and
// vectorised.
#pragma once

#include <cstddef>
#include <vector>

namespace effigy {

enum class Activation { kNone, kRelu, kRelu6, kPrelu, kHardSwish, kLogistic };

// Slopes of a PReLU, repeated so that the inner loop is long whatever the channel count.
struct PreluSlopes {
  std::vector<float> repeated;
  PreluSlopes() = default;
  // slope: one value per channel.
  explicit PreluSlopes(const std::vector<float>& slope);
};

// y[i] = activation(y[i]). For kPrelu, i modulo the channel count selects the slope and n is a
// multiple of it.
void activate(float* y, size_t n, Activation activation, const PreluSlopes& slopes);
// y[i] = activation(a[i] + b[i]); y may be a or b.
void add_activate(float* y, const float* a, const float* b, size_t n, Activation activation,
                  const PreluSlopes& slopes);
// y[p][c] = x[p][c] * gain[c]; y may be x.
void scale_channels(float* y, const float* x, const float* gain, size_t pixels, size_t channels);
// mean over pixels per channel.
void mean_channels(float* mean, const float* x, size_t pixels, size_t channels);
// One output row of a max pool: out[x][c] = max over the window rows and columns, which must lie in
// the picture. rows: window_h pointers to input rows; x0: first input column of output column 0.
void max_pool_row(float* out, const float* const* rows, int window_h, int window_w, int stride_w,
                  int out_w, size_t channels);

}  // namespace effigy
