#include "effigy/learn/bias_activation.h"

#include <algorithm>
#include <vector>

#include "effigy/base/simd.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

// Overloads, not templates: GCC cannot clone templates per instruction set.
EFFIGY_CLONES void leaky_row(const float* x, const float* bias, float* y, size_t n, float slope) {
  for (size_t i = 0; i < n; ++i) {
    const float sum = x[i] + bias[i];
    y[i] = std::max(sum, 0.0f) + slope * std::min(sum, 0.0f);
  }
}
void leaky_row(const double* x, const double* bias, double* y, size_t n, double slope) {
  for (size_t i = 0; i < n; ++i) {
    const double sum = x[i] + bias[i];
    y[i] = std::max(sum, 0.0) + slope * std::min(sum, 0.0);
  }
}

EFFIGY_CLONES void leaky_row_backward(const float* y, const float* d_y, float* d_x, float* d_bias,
                                      size_t n, float slope) {
  for (size_t i = 0; i < n; ++i) d_x[i] = d_bias[i] = y[i] > 0.0f ? d_y[i] : slope * d_y[i];
}
void leaky_row_backward(const double* y, const double* d_y, double* d_x, double* d_bias, size_t n,
                        double slope) {
  for (size_t i = 0; i < n; ++i) d_x[i] = d_bias[i] = y[i] > 0.0 ? d_y[i] : slope * d_y[i];
}

constexpr size_t kBlock = 512;  // pixels

}  // namespace

template <typename T>
void add_bias(size_t pixels, size_t channels, bool tied, double slope, const T* x, const T* bias,
              T* y) {
  parallel_for(pixels, kBlock, [&](size_t begin, size_t end, int) {
    if (!tied) {
      const size_t at = begin * channels;
      leaky_row(x + at, bias + at, y + at, (end - begin) * channels, static_cast<T>(slope));
      return;
    }
    for (size_t p = begin; p < end; ++p)
      leaky_row(x + p * channels, bias, y + p * channels, channels, static_cast<T>(slope));
  });
}

template <typename T>
void add_bias_backward(size_t pixels, size_t channels, bool tied, double slope, const T* y,
                       const T* d_y, T* d_x, T* d_bias) {
  // One partial sum per block of pixels, added up in order: the thread count does not change it.
  const size_t blocks = (pixels + kBlock - 1) / kBlock;
  std::vector<T> partial(tied ? blocks * channels : 0);
  parallel_for(blocks, 1, [&](size_t begin, size_t end, int) {
    std::vector<T> pixel_bias(tied ? channels : 0);
    for (size_t p = begin * kBlock; p < std::min(end * kBlock, pixels); ++p) {
      const size_t at = p * channels;
      leaky_row_backward(y + at, d_y + at, d_x + at, tied ? pixel_bias.data() : d_bias + at,
                         channels, static_cast<T>(slope));
      if (tied)
        for (size_t i = 0; i < channels; ++i) partial[p / kBlock * channels + i] += pixel_bias[i];
    }
  });
  if (!tied) return;
  std::fill_n(d_bias, channels, T(0));
  for (size_t i = 0; i < partial.size(); ++i) d_bias[i % channels] += partial[i];
}

#define EFFIGY_INSTANTIATE(T)                                                   \
  template void add_bias(size_t, size_t, bool, double, const T*, const T*, T*); \
  template void add_bias_backward(size_t, size_t, bool, double, const T*, const T*, T*, T*);
EFFIGY_INSTANTIATE(float)
EFFIGY_INSTANTIATE(double)
#undef EFFIGY_INSTANTIATE

}  // namespace effigy
