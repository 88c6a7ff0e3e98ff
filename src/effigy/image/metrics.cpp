#include "effigy/image/metrics.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/image/filter.h"

namespace effigy {
namespace {

constexpr int kRadius = 5;
constexpr int kTaps = 2 * kRadius + 1;

void check_same_size(const Image& a, const Image& b) {
  EFFIGY_CHECK_EQ(a.width, b.width);
  EFFIGY_CHECK_EQ(a.height, b.height);
  EFFIGY_CHECK_EQ(a.channels, b.channels);
  EFFIGY_CHECK(!a.empty());
}

// Adds weight * (a, b, a a, b b, a b) of one row to five rows of sums.
EFFIGY_CLONES void add_moments(const float* a, const float* b, float weight, int count,
                               float* sum_a, float* sum_b, float* sum_aa, float* sum_bb,
                               float* sum_ab) {
  for (int i = 0; i < count; ++i) {
    const float wa = weight * a[i], wb = weight * b[i];
    sum_a[i] += wa;
    sum_b[i] += wb;
    sum_aa[i] += wa * a[i];
    sum_bb[i] += wb * b[i];
    sum_ab[i] += wa * b[i];
  }
}

EFFIGY_CLONES void filter_window(const float* in, const float* kernel, int count, float* out) {
  for (int i = 0; i < count; ++i) {
    float sum = 0.0f;
    for (int k = 0; k < kTaps; ++k) sum += kernel[k] * in[i + k];
    out[i] = sum;
  }
}

EFFIGY_CLONES void ssim_row(const float* __restrict mu_a, const float* __restrict mu_b,
                            const float* __restrict aa, const float* __restrict bb,
                            const float* __restrict ab, int count, float* __restrict out) {
  constexpr float c1 = 0.01f * 0.01f, c2 = 0.03f * 0.03f;
  for (int i = 0; i < count; ++i) {
    const float a2 = mu_a[i] * mu_a[i], b2 = mu_b[i] * mu_b[i], m = mu_a[i] * mu_b[i];
    out[i] = ((2.0f * m + c1) * (2.0f * (ab[i] - m) + c2)) /
             ((a2 + b2 + c1) * ((aa[i] - a2) + (bb[i] - b2) + c2));
  }
}

// Sum of SSIM over row y of one plane. `work` holds 5 padded rows and 6 rows.
double ssim_of_row(const float* a, const float* b, int width, int height, int y,
                   const std::vector<float>& kernel, std::vector<float>& work) {
  const auto row = static_cast<size_t>(width), padded = row + 2 * kRadius;
  std::fill(work.begin(), work.begin() + static_cast<std::ptrdiff_t>(5 * padded), 0.0f);
  std::array<float*, 5> sum{};
  for (size_t i = 0; i < 5; ++i) sum[i] = work.data() + i * padded + kRadius;
  for (int k = std::max(-kRadius, -y); k <= std::min(kRadius, height - 1 - y); ++k) {
    const size_t offset = static_cast<size_t>(y + k) * row;
    add_moments(a + offset, b + offset, kernel[static_cast<size_t>(k + kRadius)], width, sum[0],
                sum[1], sum[2], sum[3], sum[4]);
  }
  float* flat = work.data() + 5 * padded;
  for (size_t i = 0; i < 5; ++i)
    filter_window(work.data() + i * padded, kernel.data(), width, flat + i * row);
  float* value = flat + 5 * row;
  ssim_row(flat, flat + row, flat + 2 * row, flat + 3 * row, flat + 4 * row, width, value);
  double total = 0.0;
  for (size_t x = 0; x < row; ++x) total += static_cast<double>(value[x]);
  return total;
}

}  // namespace

double psnr(const Image& a, const Image& b, const Image* mask) {
  check_same_size(a, b);
  if (mask != nullptr) {
    EFFIGY_CHECK_EQ(mask->width, a.width);
    EFFIGY_CHECK_EQ(mask->height, a.height);
    EFFIGY_CHECK_EQ(mask->channels, 1);
  }
  const auto channels = static_cast<size_t>(a.channels);
  const size_t pixels = a.data.size() / channels;
  double squares = 0.0, weights = 0.0;
  for (size_t i = 0; i < pixels; ++i) {
    const double weight = mask != nullptr ? static_cast<double>(mask->data[i]) : 1.0;
    double pixel = 0.0;
    for (size_t c = i * channels; c < (i + 1) * channels; ++c) {
      const double difference = static_cast<double>(a.data[c]) - static_cast<double>(b.data[c]);
      pixel += difference * difference;
    }
    squares += weight * pixel;
    weights += weight;
  }
  if (weights <= 0.0)
    throw Error("PSNR was asked for under a mask that covers nothing; leave such frames out.");
  const double mse = squares / (weights * static_cast<double>(channels));
  return mse > 0.0 ? std::min(100.0, -10.0 * std::log10(mse)) : 100.0;
}

double ssim(const Image& a, const Image& b) {
  check_same_size(a, b);
  const Planes planes_a = to_planes(a), planes_b = to_planes(b);
  const auto kernel = gaussian_kernel(1.5, kRadius);
  const auto height = static_cast<size_t>(a.height), width = static_cast<size_t>(a.width);
  // One sum a row, added in order: the same value for every thread count.
  std::vector<double> rows(height * static_cast<size_t>(a.channels));
  parallel_for(rows.size(), 16, [&](size_t begin, size_t end, int) {
    std::vector<float> work(5 * (width + 2 * kRadius) + 6 * width);
    for (size_t i = begin; i < end; ++i) {
      const int c = static_cast<int>(i / height), y = static_cast<int>(i % height);
      rows[i] =
          ssim_of_row(planes_a.plane(c), planes_b.plane(c), a.width, a.height, y, kernel, work);
    }
  });
  double total = 0.0;
  for (double value : rows) total += value;
  return total / static_cast<double>(a.data.size());
}

}  // namespace effigy
