#include "effigy/learn/phase_shuffle.h"

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

// A channel's tied bias collects the gradients of all pixels: one partial sum per row of pixels,
// added up in order, so that the thread count does not change it.
template <typename T>
void sum_rows(const std::vector<T>& partial, size_t channels, T* total) {
  std::fill_n(total, channels, T(0));
  for (size_t i = 0; i < partial.size(); ++i) total[i % channels] += partial[i];
}

constexpr size_t kRowGrain = 8;

}  // namespace

template <typename T>
void phase_shuffle(const PhaseShuffle& s, const T* phases, const T* bias, T* output) {
  const size_t c = s.channels, width = 2 * s.width, phase_row = (s.width + 1) * 4 * c;
  parallel_for(2 * s.height, kRowGrain, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y) {
      const T* row = phases + (y + 1) / 2 * phase_row + (y + 1) % 2 * 2 * c;
      for (size_t x = 0; x < width; ++x) {
        const size_t pixel = (y * width + x) * c;
        leaky_row(row + (x + 1) / 2 * 4 * c + (x + 1) % 2 * c, bias + (s.tied ? 0 : pixel),
                  output + pixel, c, static_cast<T>(s.slope));
      }
    }
  });
}

template <typename T>
void phase_shuffle_backward(const PhaseShuffle& s, const T* output, const T* d_output, T* d_phases,
                            T* d_bias) {
  const size_t c = s.channels, height = 2 * s.height, width = 2 * s.width;
  std::vector<T> partial(s.tied ? (height + 2) * c : 0);
  // Rows of the phase picture's shuffled form, the dropped border included.
  parallel_for(height + 2, kRowGrain, [&](size_t begin, size_t end, int) {
    std::vector<T> pixel_bias(s.tied ? c : 0);
    for (size_t r = begin; r < end; ++r) {
      T* row = d_phases + r / 2 * (s.width + 1) * 4 * c + r % 2 * 2 * c;
      for (size_t q = 0; q < width + 2; ++q) {
        T* d_x = row + q / 2 * 4 * c + q % 2 * c;
        if (r == 0 || r == height + 1 || q == 0 || q == width + 1) {
          std::fill_n(d_x, c, T(0));
          continue;
        }
        const size_t pixel = ((r - 1) * width + q - 1) * c;
        leaky_row_backward(output + pixel, d_output + pixel, d_x,
                           s.tied ? pixel_bias.data() : d_bias + pixel, c, static_cast<T>(s.slope));
        if (s.tied)
          for (size_t i = 0; i < c; ++i) partial[r * c + i] += pixel_bias[i];
      }
    }
  });
  if (s.tied) sum_rows(partial, c, d_bias);
}

template <typename T>
void add_bias(size_t pixels, size_t channels, bool tied, double slope, const T* x, const T* bias,
              T* y) {
  parallel_for(pixels, 512, [&](size_t begin, size_t end, int) {
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
  constexpr size_t kBlock = 512;
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
  if (tied) sum_rows(partial, channels, d_bias);
}

#define EFFIGY_INSTANTIATE(T)                                                            \
  template void phase_shuffle(const PhaseShuffle&, const T*, const T*, T*);              \
  template void phase_shuffle_backward(const PhaseShuffle&, const T*, const T*, T*, T*); \
  template void add_bias(size_t, size_t, bool, double, const T*, const T*, T*);          \
  template void add_bias_backward(size_t, size_t, bool, double, const T*, const T*, T*, T*);
EFFIGY_INSTANTIATE(float)
EFFIGY_INSTANTIATE(double)
#undef EFFIGY_INSTANTIATE

}  // namespace effigy
