#include "effigy/image/filter.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

// out[i] = sum_k kernel[k] * in[i + k * step] for i in [0, count).
EFFIGY_CLONES void filter_row(const float* in, const float* kernel, int taps, int step, int count,
                              float* out) {
  for (int i = 0; i < count; ++i) out[i] = 0.0f;
  int k = 0;
  for (; k + 4 <= taps; k += 4) {
    const float k0 = kernel[k], k1 = kernel[k + 1], k2 = kernel[k + 2], k3 = kernel[k + 3];
    const float* a = in + k * step;
    const float* b = a + step;
    const float* c = b + step;
    const float* d = c + step;
    for (int i = 0; i < count; ++i) out[i] += k0 * a[i] + k1 * b[i] + k2 * c[i] + k3 * d[i];
  }
  for (; k < taps; ++k) {
    const float weight = kernel[k];
    const float* a = in + k * step;
    for (int i = 0; i < count; ++i) out[i] += weight * a[i];
  }
}

EFFIGY_CLONES void add_scaled(const float* in, float weight, int count, float* out) {
  for (int i = 0; i < count; ++i) out[i] += weight * in[i];
}

}  // namespace

void filter_separable(const float* in, int width, int height, int channels,
                      std::span<const float> kernel_x, std::span<const float> kernel_y,
                      float* out) {
  EFFIGY_CHECK(kernel_x.size() % 2 == 1 && kernel_y.size() % 2 == 1);
  const int radius_x = static_cast<int>(kernel_x.size() / 2);
  const int radius_y = static_cast<int>(kernel_y.size() / 2);
  const int row = width * channels;
  const auto line = static_cast<size_t>(row);
  std::vector<float> across(line * static_cast<size_t>(height));
  parallel_for(static_cast<size_t>(height), 16, [&](size_t begin, size_t end, int) {
    std::vector<float> padded(static_cast<size_t>(width + 2 * radius_x) *
                              static_cast<size_t>(channels));
    const auto pixel = static_cast<size_t>(channels);
    for (size_t y = begin; y < end; ++y) {
      const float* source = in + y * line;
      float* middle = padded.data() + static_cast<size_t>(radius_x) * pixel;
      std::memcpy(middle, source, line * sizeof(float));
      for (size_t i = 0; i < static_cast<size_t>(radius_x); ++i) {
        std::memcpy(padded.data() + i * pixel, source, pixel * sizeof(float));
        std::memcpy(middle + line + i * pixel, source + line - pixel, pixel * sizeof(float));
      }
      filter_row(padded.data(), kernel_x.data(), static_cast<int>(kernel_x.size()), channels, row,
                 across.data() + y * line);
    }
  });
  parallel_for(static_cast<size_t>(height), 16, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y) {
      float* target = out + y * line;
      std::memset(target, 0, line * sizeof(float));
      for (int k = -radius_y; k <= radius_y; ++k) {
        const int from = std::clamp(static_cast<int>(y) + k, 0, height - 1);
        add_scaled(across.data() + static_cast<size_t>(from) * line,
                   kernel_y[static_cast<size_t>(k + radius_y)], row, target);
      }
    }
  });
}

std::vector<float> gaussian_kernel(double sigma, int radius) {
  std::vector<double> values;
  double sum = 0.0;
  for (int x = -radius; x <= radius; ++x) {
    values.push_back(std::exp(-0.5 * x * x / (sigma * sigma)));
    sum += values.back();
  }
  std::vector<float> kernel;
  for (double value : values) kernel.push_back(static_cast<float>(value / sum));
  return kernel;
}

}  // namespace effigy
