#include "effigy/track/guided_filter.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"

namespace effigy {
namespace {

// Interleaved channels make the running sums vectors: one pass over memory for all of them.
constexpr int kMoments = 16;  // 13 are used
constexpr int kCoefficients = 4;

template <int channels>
[[gnu::always_inline]] inline void rows_of(const float* in, float* out, int width, int height,
                                           int radius, const float* scale) {
  for (int y = 0; y < height; ++y) {
    const float* row = in + static_cast<size_t>(y) * width * channels;
    float* result = out + static_cast<size_t>(y) * width * channels;
    float sum[channels] = {};
    for (int x = 0; x < std::min(radius, width); ++x)
      for (int c = 0; c < channels; ++c) sum[c] += row[x * channels + c];
    for (int x = 0; x < width; ++x) {
      if (x + radius < width)
        for (int c = 0; c < channels; ++c) sum[c] += row[(x + radius) * channels + c];
      if (x - radius - 1 >= 0)
        for (int c = 0; c < channels; ++c) sum[c] -= row[(x - radius - 1) * channels + c];
      for (int c = 0; c < channels; ++c) result[x * channels + c] = sum[c] * scale[x];
    }
  }
}

EFFIGY_CLONES void rows_1(const float* in, float* out, int width, int height, int radius,
                          const float* scale) {
  rows_of<1>(in, out, width, height, radius, scale);
}
EFFIGY_CLONES void rows_4(const float* in, float* out, int width, int height, int radius,
                          const float* scale) {
  rows_of<kCoefficients>(in, out, width, height, radius, scale);
}
EFFIGY_CLONES void rows_16(const float* in, float* out, int width, int height, int radius,
                           const float* scale) {
  rows_of<kMoments>(in, out, width, height, radius, scale);
}

// `line`: values in a row.
EFFIGY_CLONES void columns_of(const float* in, float* out, size_t line, int height, int radius,
                              float* sum) {
  std::fill_n(sum, line, 0.0f);
  for (int y = 0; y < std::min(radius, height); ++y)
    for (size_t i = 0; i < line; ++i) sum[i] += in[static_cast<size_t>(y) * line + i];
  for (int y = 0; y < height; ++y) {
    if (y + radius < height) {
      const float* row = in + static_cast<size_t>(y + radius) * line;
      for (size_t i = 0; i < line; ++i) sum[i] += row[i];
    }
    if (y - radius - 1 >= 0) {
      const float* row = in + static_cast<size_t>(y - radius - 1) * line;
      for (size_t i = 0; i < line; ++i) sum[i] -= row[i];
    }
    const int count = std::min(y + radius, height - 1) - std::max(y - radius, 0) + 1;
    const float scale = 1.0f / static_cast<float>(count);
    float* result = out + static_cast<size_t>(y) * line;
    for (size_t i = 0; i < line; ++i) result[i] = sum[i] * scale;
  }
}

using RowPass = void (*)(const float*, float*, int, int, int, const float*);

void box(const float* in, int width, int height, int channels, int radius, RowPass rows,
         float* out) {
  std::vector<float> scale(static_cast<size_t>(width));
  for (int x = 0; x < width; ++x)
    scale[x] =
        1.0f / static_cast<float>(std::min(x + radius, width - 1) - std::max(x - radius, 0) + 1);
  const size_t line = static_cast<size_t>(width) * channels;
  const auto between = std::make_unique_for_overwrite<float[]>(line * height);
  std::vector<float> sum(line);
  rows(in, between.get(), width, height, radius, scale.data());
  columns_of(between.get(), out, line, height, radius, sum.data());
}

// Moments of one pixel: colours 0-2, their products 3-8 (rr rg rb gg gb bb), colours times matte
// 9-11, matte 12.
EFFIGY_CLONES void fill_moments(const uint8_t* guide, const float* matte, size_t n,
                                float* moments) {
  for (size_t i = 0; i < n; ++i) {
    float* m = moments + i * kMoments;
    const float r = static_cast<float>(guide[3 * i]) * (1.0f / 255.0f);
    const float g = static_cast<float>(guide[3 * i + 1]) * (1.0f / 255.0f);
    const float b = static_cast<float>(guide[3 * i + 2]) * (1.0f / 255.0f);
    const float p = matte[i];
    const float all[kMoments] = {r,     g,     b,     r * r, r * g, r * b, g * g, g * b,
                                 b * b, r * p, g * p, b * p, p,     0,     0,     0};
    for (int k = 0; k < kMoments; ++k) m[k] = all[k];
  }
}

// (Sigma + eps)^-1 cov by Cramer's rule, for blocks of pixels with the moments transposed.
EFFIGY_CLONES void solve_blocks(const float* moments, size_t n, float eps, float* coefficients) {
  constexpr size_t kBlock = 16;
  float m[13][kBlock], out[4][kBlock];
  for (size_t begin = 0; begin < n; begin += kBlock) {
    const size_t count = std::min(kBlock, n - begin);
    for (size_t i = 0; i < kBlock; ++i)
      for (int k = 0; k < 13; ++k)
        m[k][i] = moments[(begin + std::min(i, count - 1)) * kMoments + static_cast<size_t>(k)];
    for (size_t i = 0; i < kBlock; ++i) {
      const float r = m[0][i], g = m[1][i], bl = m[2][i], p = m[12][i];
      const float rr = m[3][i] - r * r + eps, rg = m[4][i] - r * g, rb = m[5][i] - r * bl;
      const float gg = m[6][i] - g * g + eps, gb = m[7][i] - g * bl;
      const float bb = m[8][i] - bl * bl + eps;
      const float cr = m[9][i] - r * p, cg = m[10][i] - g * p, cb = m[11][i] - bl * p;
      const float i00 = gg * bb - gb * gb, i01 = gb * rb - rg * bb, i02 = rg * gb - gg * rb;
      const float i11 = rr * bb - rb * rb, i12 = rb * rg - rr * gb, i22 = rr * gg - rg * rg;
      const float inverse = 1.0f / (rr * i00 + rg * i01 + rb * i02);
      const float ar = (i00 * cr + i01 * cg + i02 * cb) * inverse;
      const float ag = (i01 * cr + i11 * cg + i12 * cb) * inverse;
      const float ab = (i02 * cr + i12 * cg + i22 * cb) * inverse;
      out[0][i] = ar;
      out[1][i] = ag;
      out[2][i] = ab;
      out[3][i] = p - ar * r - ag * g - ab * bl;
    }
    for (size_t i = 0; i < count; ++i)
      for (size_t k = 0; k < 4; ++k) coefficients[4 * (begin + i) + k] = out[k][i];
  }
}

// Bilinear position of each target pixel in a source of another size.
struct Taps {
  std::vector<int> low, high;
  std::vector<float> fraction;
  Taps(int target, int source) {
    for (int i = 0; i < target; ++i) {
      const double x = std::clamp((i + 0.5) * source / target - 0.5, 0.0, source - 1.0);
      const int floor = static_cast<int>(x);
      low.push_back(floor);
      high.push_back(std::min(floor + 1, source - 1));
      fraction.push_back(static_cast<float>(x - floor));
    }
  }
};

// One output row from a row of coefficients that is already blended vertically.
EFFIGY_CLONES void apply_row(const float* row, const int* low, const int* high,
                             const float* fraction, const uint8_t* pixels, int width, float floor,
                             float gain, float* out) {
  for (int x = 0; x < width; ++x) {
    const float *p = row + 4 * low[x], *q = row + 4 * high[x];
    const float f = fraction[x];
    float c[4];
    for (int k = 0; k < 4; ++k) c[k] = p[k] + f * (q[k] - p[k]);
    const float value =
        (c[0] * static_cast<float>(pixels[3 * x]) + c[1] * static_cast<float>(pixels[3 * x + 1]) +
         c[2] * static_cast<float>(pixels[3 * x + 2])) *
            (1.0f / 255.0f) +
        c[3];
    out[x] = std::min(std::max((value - floor) * gain, 0.0f), 1.0f);
  }
}

EFFIGY_CLONES void blend(const float* p, const float* q, float fraction, float* out, size_t n) {
  for (size_t i = 0; i < n; ++i) out[i] = p[i] + fraction * (q[i] - p[i]);
}

}  // namespace

void box_mean(std::span<const float> in, int width, int height, int radius, std::span<float> out) {
  EFFIGY_CHECK_EQ(in.size(), static_cast<size_t>(width) * height);
  EFFIGY_CHECK_EQ(out.size(), in.size());
  box(in.data(), width, height, 1, radius, rows_1, out.data());
}

std::vector<float> guided_coefficients(const Image8& guide, const Image& matte, int radius,
                                       float epsilon) {
  EFFIGY_CHECK(guide.channels == 3 && matte.channels == 1);
  EFFIGY_CHECK(guide.width == matte.width && guide.height == matte.height);
  const size_t n = matte.data.size();
  // Megabytes that are written whole: not filled with zeros first.
  const auto moments = std::make_unique_for_overwrite<float[]>(n * kMoments);
  const auto means = std::make_unique_for_overwrite<float[]>(n * kMoments);
  fill_moments(guide.data.data(), matte.data.data(), n, moments.get());
  box(moments.get(), matte.width, matte.height, kMoments, radius, rows_16, means.get());
  const auto coefficients = std::make_unique_for_overwrite<float[]>(n * kCoefficients);
  std::vector<float> smooth(n * kCoefficients);
  solve_blocks(means.get(), n, epsilon, coefficients.get());
  box(coefficients.get(), matte.width, matte.height, kCoefficients, radius, rows_4, smooth.data());
  return smooth;
}

Image apply_guided(const Image8& picture, std::span<const float> coefficients, int width,
                   int height, float low, float high) {
  EFFIGY_CHECK_EQ(coefficients.size(), static_cast<size_t>(width) * height * kCoefficients);
  Image out(picture.width, picture.height, 1);
  const Taps columns(picture.width, width), rows(picture.height, height);
  const size_t line = static_cast<size_t>(width) * kCoefficients;
  std::vector<float> blended(line);
  for (int y = 0; y < picture.height; ++y) {
    blend(coefficients.data() + static_cast<size_t>(rows.low[y]) * line,
          coefficients.data() + static_cast<size_t>(rows.high[y]) * line, rows.fraction[y],
          blended.data(), line);
    apply_row(blended.data(), columns.low.data(), columns.high.data(), columns.fraction.data(),
              picture.at(0, y), picture.width, low, 1.0f / (high - low), out.at(0, y));
  }
  return out;
}

}  // namespace effigy
