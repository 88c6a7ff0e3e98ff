#include "effigy/learn/image_losses.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/learn/image_losses.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef EFFIGY_LEARN_IMAGE_LOSSES_ONCE
#define EFFIGY_LEARN_IMAGE_LOSSES_ONCE
namespace effigy {

constexpr int kRadius = 5;
constexpr int kTaps = 2 * kRadius + 1;
constexpr int kMoments = 4;      // x, y, x^2 + y^2, x y
constexpr int kDerivatives = 3;  // of SSIM with respect to E[x], E[x^2], E[x y]

// One channel of the region (an image of its own with zero padding), and one band of its rows.
struct SsimBand {
  const float* x;  // rendered
  const float* y;  // target
  float* d_x;      // or null
  size_t stride;
  int width, height;
  int row_begin, row_end;
  float weight_l1, weight_ssim;  // factors of the gradients of sums of |x - y| and of SSIM
  const float* window;           // kTaps
  double* row_l1;                // height: sums over the row
  double* row_ssim;
};

struct MaskBand {
  const float* alpha;
  const float* mask;
  float* d_alpha;  // or null
  size_t stride;
  int width, row_begin, row_end;
  float weight;
  double* row_sum;
};

}  // namespace effigy
#endif  // EFFIGY_LEARN_IMAGE_LOSSES_ONCE

HWY_BEFORE_NAMESPACE();
namespace effigy::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<float>;
using V = hn::Vec<D>;

HWY_INLINE V sign(D d, V difference) {
  const V zero = hn::Zero(d);
  return hn::IfThenElseZero(hn::Ne(difference, zero), hn::CopySign(hn::Set(d, 1.0f), difference));
}

// out[i] = sum_k window[k] in[i + k], for i < width rounded up to whole vectors.
HWY_INLINE void filter_row(const float* HWY_RESTRICT in, float* HWY_RESTRICT out, size_t width,
                           const float* HWY_RESTRICT window) {
  const D d;
  const size_t lanes = hn::Lanes(d);
  const V w0 = hn::Set(d, window[0]), w1 = hn::Set(d, window[1]), w2 = hn::Set(d, window[2]);
  const V w3 = hn::Set(d, window[3]), w4 = hn::Set(d, window[4]), w5 = hn::Set(d, window[5]);
  for (size_t i = 0; i < width; i += lanes) {
    const float* p = in + i;
    V a = hn::Mul(w0, hn::Add(hn::LoadU(d, p), hn::LoadU(d, p + 10)));
    V b = hn::Mul(w1, hn::Add(hn::LoadU(d, p + 1), hn::LoadU(d, p + 9)));
    a = hn::MulAdd(w2, hn::Add(hn::LoadU(d, p + 2), hn::LoadU(d, p + 8)), a);
    b = hn::MulAdd(w3, hn::Add(hn::LoadU(d, p + 3), hn::LoadU(d, p + 7)), b);
    a = hn::MulAdd(w4, hn::Add(hn::LoadU(d, p + 4), hn::LoadU(d, p + 6)), a);
    b = hn::MulAdd(w5, hn::LoadU(d, p + 5), b);
    hn::StoreU(hn::Add(a, b), d, out + i);
  }
}

HWY_INLINE V filter_column(D d, const float* const* rows, size_t offset, V w0, V w1, V w2, V w3,
                           V w4, V w5) {
  const auto at = [&](int k) HWY_ATTR { return hn::LoadU(d, rows[k] + offset); };
  V a = hn::Mul(w0, hn::Add(at(0), at(10)));
  V b = hn::Mul(w1, hn::Add(at(1), at(9)));
  a = hn::MulAdd(w2, hn::Add(at(2), at(8)), a);
  b = hn::MulAdd(w3, hn::Add(at(3), at(7)), b);
  a = hn::MulAdd(w4, hn::Add(at(4), at(6)), a);
  b = hn::MulAdd(w5, at(5), b);
  return hn::Add(a, b);
}

// Products of one row into padded rows (kRadius zeros before, zeros after), then filtered into
// `out` (kMoments rows of `pitch`). Returns the row's sum of |x - y|.
HWY_INLINE double moment_row(const SsimBand& band, int row, float* HWY_RESTRICT padded,
                             size_t padded_pitch, float* HWY_RESTRICT out, size_t pitch) {
  const D d;
  const size_t lanes = hn::Lanes(d), width = static_cast<size_t>(band.width);
  const float* HWY_RESTRICT x = band.x + static_cast<size_t>(row) * band.stride;
  const float* HWY_RESTRICT y = band.y + static_cast<size_t>(row) * band.stride;
  float* const p = padded + kRadius;
  V sum = hn::Zero(d);
  const auto put = [&](size_t i, V vx, V vy) HWY_ATTR {
    hn::StoreU(vx, d, p + i);
    hn::StoreU(vy, d, p + padded_pitch + i);
    hn::StoreU(hn::MulAdd(vx, vx, hn::Mul(vy, vy)), d, p + 2 * padded_pitch + i);
    hn::StoreU(hn::Mul(vx, vy), d, p + 3 * padded_pitch + i);
    sum = hn::Add(sum, hn::AbsDiff(vx, vy));
  };
  size_t i = 0;
  for (; i + lanes <= width; i += lanes) put(i, hn::LoadU(d, x + i), hn::LoadU(d, y + i));
  if (i < width) {
    HWY_ALIGN float tail_x[HWY_MAX_BYTES / sizeof(float)] = {};
    HWY_ALIGN float tail_y[HWY_MAX_BYTES / sizeof(float)] = {};
    for (size_t k = i; k < width; ++k) {
      tail_x[k - i] = x[k];
      tail_y[k - i] = y[k];
    }
    put(i, hn::Load(d, tail_x), hn::Load(d, tail_y));
  }
  for (int c = 0; c < kMoments; ++c)
    filter_row(padded + c * padded_pitch, out + c * pitch, width, band.window);
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

// SSIM of one row from the 11 rows of moments around it; its derivatives (when `padded` is not
// null) into padded rows. Returns the row's sum of SSIM.
template <bool kBackward>
HWY_INLINE double ssim_row(const SsimBand& band, const float* const* rows, size_t pitch,
                           float* HWY_RESTRICT padded, size_t padded_pitch) {
  const D d;
  const size_t lanes = hn::Lanes(d), width = static_cast<size_t>(band.width);
  const float* w = band.window;
  const V w0 = hn::Set(d, w[0]), w1 = hn::Set(d, w[1]), w2 = hn::Set(d, w[2]);
  const V w3 = hn::Set(d, w[3]), w4 = hn::Set(d, w[4]), w5 = hn::Set(d, w[5]);
  const V c1 = hn::Set(d, 1e-4f), c2 = hn::Set(d, 9e-4f), two = hn::Set(d, 2.0f);
  const V one = hn::Set(d, 1.0f);
  V sum = hn::Zero(d);
  for (size_t i = 0; i < width; i += lanes) {
    const V mx = filter_column(d, rows, i, w0, w1, w2, w3, w4, w5);
    const V my = filter_column(d, rows, i + pitch, w0, w1, w2, w3, w4, w5);
    const V squares = filter_column(d, rows, i + 2 * pitch, w0, w1, w2, w3, w4, w5);
    const V product = filter_column(d, rows, i + 3 * pitch, w0, w1, w2, w3, w4, w5);
    const V mxy = hn::Mul(mx, my);
    const V means = hn::MulAdd(mx, mx, hn::Mul(my, my));
    const V a1 = hn::MulAdd(two, mxy, c1);
    const V a2 = hn::MulAdd(two, hn::Sub(product, mxy), c2);
    const V b1 = hn::Add(means, c1);
    const V b2 = hn::Add(hn::Sub(squares, means), c2);
    const V bottom = hn::Mul(b1, b2);
    // Where both images are black a1 a2 and b1 b2 are the same number: exactly 1.
    V s = hn::Div(hn::Mul(a1, a2), bottom);
    const auto inside = hn::FirstN(d, width - i);
    if constexpr (kBackward) {
      const V inverse = hn::IfThenElseZero(inside, hn::Div(one, bottom));
      const V s_inverse = hn::Mul(s, inverse);
      const V d_square = hn::Neg(hn::Mul(s_inverse, b1));
      const V d_product = hn::Mul(hn::Mul(two, a1), inverse);
      const V from_y = hn::MulSub(hn::Mul(two, a2), inverse, d_product);
      const V from_x = hn::Mul(two, hn::MulAdd(s_inverse, b2, d_square));
      const V d_mean = hn::MulSub(my, from_y, hn::Mul(mx, from_x));
      float* p = padded + kRadius + i;
      hn::StoreU(d_mean, d, p);
      hn::StoreU(d_square, d, p + padded_pitch);
      hn::StoreU(d_product, d, p + 2 * padded_pitch);
    }
    sum = hn::Add(sum, hn::IfThenElseZero(inside, s));
  }
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

// Adds the gradient of one row from the 11 rows of filtered derivatives around it:
// d_x = G*d_mean + 2 x G*d_square + y G*d_product.
HWY_INLINE void gradient_row(const SsimBand& band, int row, const float* const* rows,
                             size_t pitch) {
  const D d;
  const size_t lanes = hn::Lanes(d), width = static_cast<size_t>(band.width);
  const float* w = band.window;
  const V w0 = hn::Set(d, w[0]), w1 = hn::Set(d, w[1]), w2 = hn::Set(d, w[2]);
  const V w3 = hn::Set(d, w[3]), w4 = hn::Set(d, w[4]), w5 = hn::Set(d, w[5]);
  const V two = hn::Set(d, 2.0f);
  const V scale_l1 = hn::Set(d, band.weight_l1), scale_ssim = hn::Set(d, band.weight_ssim);
  const size_t start = static_cast<size_t>(row) * band.stride;
  const auto gradient = [&](size_t i, V x, V y) HWY_ATTR {
    const V mean = filter_column(d, rows, i, w0, w1, w2, w3, w4, w5);
    const V square = filter_column(d, rows, i + pitch, w0, w1, w2, w3, w4, w5);
    const V product = filter_column(d, rows, i + 2 * pitch, w0, w1, w2, w3, w4, w5);
    const V s = hn::MulAdd(hn::Mul(two, x), square, hn::MulAdd(y, product, mean));
    return hn::MulAdd(scale_ssim, s, hn::Mul(scale_l1, sign(d, hn::Sub(x, y))));
  };
  size_t i = 0;
  for (; i + lanes <= width; i += lanes) {
    float* out = band.d_x + start + i;
    const V g = gradient(i, hn::LoadU(d, band.x + start + i), hn::LoadU(d, band.y + start + i));
    hn::StoreU(hn::Add(g, hn::LoadU(d, out)), d, out);
  }
  if (i == width) return;
  HWY_ALIGN float tail_x[HWY_MAX_BYTES / sizeof(float)] = {};
  HWY_ALIGN float tail_y[HWY_MAX_BYTES / sizeof(float)] = {};
  for (size_t k = i; k < width; ++k) {
    tail_x[k - i] = band.x[start + k];
    tail_y[k - i] = band.y[start + k];
  }
  hn::Store(gradient(i, hn::Load(d, tail_x), hn::Load(d, tail_y)), d, tail_x);
  for (size_t k = i; k < width; ++k) band.d_x[start + k] += tail_x[k - i];
}

// Rows stream through two rings of 11: rows of filtered moments, and rows of filtered derivatives.
// Gradient rows [begin, end) need derivatives 5 rows beyond, which need moments 5 rows further.
template <bool kBackward>
HWY_INLINE void ssim_band(const SsimBand& band) {
  constexpr size_t kAlign = HWY_MAX_BYTES / sizeof(float);
  // An odd number of cache lines a row, else all rings' rows fall into the same few cache sets.
  const size_t lines = (static_cast<size_t>(band.width) + kAlign - 1) / kAlign;
  const size_t pitch = (lines | 1) * kAlign;
  const size_t padded_pitch = pitch + 2 * kRadius + kAlign;
  const size_t moment_size = kMoments * pitch, derivative_size = kDerivatives * pitch;
  std::vector<float> memory(kTaps * (moment_size + derivative_size) + moment_size +
                            (kMoments + kDerivatives) * padded_pitch);
  float* const moments = memory.data();
  float* const derivatives = moments + kTaps * moment_size;
  float* const zero = derivatives + kTaps * derivative_size;
  float* const padded_moments = zero + moment_size;
  float* const padded_derivatives = padded_moments + kMoments * padded_pitch;

  const int reach = kBackward ? 2 * kRadius : kRadius;
  const int first = std::max(0, band.row_begin - reach);
  const float* rows[kTaps];
  const auto gather = [&](float* ring, size_t size, int centre) {
    for (int k = 0; k < kTaps; ++k) {
      const int row = centre + k - kRadius;
      rows[k] = row < 0 || row >= band.height ? zero : ring + (row % kTaps) * size;
    }
  };
  for (int row = first; row < band.row_end + reach; ++row) {
    if (row < band.height) {
      const double l1 = moment_row(band, row, padded_moments, padded_pitch,
                                   moments + (row % kTaps) * moment_size, pitch);
      if (row >= band.row_begin && row < band.row_end) band.row_l1[row] = l1;
    }
    const int map = row - kRadius;
    if (map >= std::max(0, band.row_begin - (reach - kRadius)) && map < band.height) {
      gather(moments, moment_size, map);
      const double s = ssim_row<kBackward>(band, rows, pitch, padded_derivatives, padded_pitch);
      if (map >= band.row_begin && map < band.row_end) band.row_ssim[map] = s;
      if constexpr (kBackward)
        for (int c = 0; c < kDerivatives; ++c)
          filter_row(padded_derivatives + c * padded_pitch,
                     derivatives + (map % kTaps) * derivative_size + c * pitch,
                     static_cast<size_t>(band.width), band.window);
    }
    const int output = row - 2 * kRadius;
    if (kBackward && output >= band.row_begin && output < band.row_end) {
      gather(derivatives, derivative_size, output);
      gradient_row(band, output, rows, pitch);
    }
  }
}

void photometric_band(const SsimBand& band) {
  if (band.d_x != nullptr)
    ssim_band<true>(band);
  else
    ssim_band<false>(band);
}

void mask_band(const MaskBand& band) {
  const D d;
  const size_t lanes = hn::Lanes(d), width = static_cast<size_t>(band.width);
  const V weight = hn::Set(d, band.weight);
  for (int row = band.row_begin; row < band.row_end; ++row) {
    const size_t start = static_cast<size_t>(row) * band.stride;
    const float* alpha = band.alpha + start;
    const float* mask = band.mask + start;
    float* out = band.d_alpha == nullptr ? nullptr : band.d_alpha + start;
    V sum = hn::Zero(d);
    size_t i = 0;
    for (; i + lanes <= width; i += lanes) {
      const V difference = hn::Sub(hn::LoadU(d, alpha + i), hn::LoadU(d, mask + i));
      sum = hn::Add(sum, hn::Abs(difference));
      if (out != nullptr)
        hn::StoreU(hn::MulAdd(weight, sign(d, difference), hn::LoadU(d, out + i)), d, out + i);
    }
    double total = hn::GetLane(hn::SumOfLanes(d, sum));
    for (; i < width; ++i) {
      const float difference = alpha[i] - mask[i];
      total += std::abs(difference);
      if (out != nullptr && difference != 0.0f) out[i] += std::copysign(band.weight, difference);
    }
    band.row_sum[row] = total;
  }
}

}  // namespace effigy::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy {
namespace {

HWY_EXPORT(photometric_band);
HWY_EXPORT(mask_band);

std::array<float, kTaps> gaussian_window() {
  std::array<double, kTaps> weights;
  double sum = 0;
  for (int i = 0; i < kTaps; ++i) {
    const double t = i - kRadius;
    weights[static_cast<size_t>(i)] = std::exp(-t * t / (2 * 1.5 * 1.5));
    sum += weights[static_cast<size_t>(i)];
  }
  std::array<float, kTaps> window;
  for (size_t i = 0; i < kTaps; ++i) window[i] = static_cast<float>(weights[i] / sum);
  return window;
}

double sum_of(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum;
}

}  // namespace

PixelBox nonzero_box(const Planes& colour, const Planes& target, std::span<const float> alpha,
                     std::span<const float> mask) {
  const int width = colour.width, height = colour.height;
  std::vector<const float*> planes;
  for (int c = 0; c < 3; ++c) {
    planes.push_back(colour.plane(c));
    planes.push_back(target.plane(c));
  }
  if (!alpha.empty()) planes.push_back(alpha.data());
  if (!mask.empty()) planes.push_back(mask.data());
  std::vector<int> first(static_cast<size_t>(height), width), last(static_cast<size_t>(height), -1);
  parallel_for(static_cast<size_t>(height), 16, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y)
      for (const float* plane : planes) {
        const float* row = plane + y * static_cast<size_t>(width);
        int left = 0, right = width - 1;
        // Only columns that would enlarge the box are looked at.
        while (left < first[y] && row[left] == 0.0f) ++left;
        first[y] = std::min(first[y], left);
        while (right > last[y] && row[right] == 0.0f) --right;
        last[y] = std::max(last[y], right);
      }
  });
  PixelBox box{width, height, 0, 0};
  for (int y = 0; y < height; ++y) {
    const size_t i = static_cast<size_t>(y);
    if (last[i] < 0) continue;
    box.x0 = std::min(box.x0, first[i]);
    box.x1 = std::max(box.x1, last[i] + 1);
    box.y0 = std::min(box.y0, y);
    box.y1 = y + 1;
  }
  return box.empty() ? PixelBox{} : box;
}

PhotometricLoss photometric_loss(const Planes& colour, const Planes& target,
                                 std::span<const float> alpha, std::span<const float> mask,
                                 const PhotometricWeights& weights, Planes* d_colour,
                                 std::span<float> d_alpha, const PixelBox& box) {
  const int width = colour.width, height = colour.height;
  const size_t pixels = colour.pixels();
  EFFIGY_CHECK(pixels > 0 && colour.count >= 3 && target.count >= 3);
  EFFIGY_CHECK(target.width == width && target.height == height);
  EFFIGY_CHECK_EQ(alpha.size(), mask.size());
  EFFIGY_CHECK(alpha.empty() || alpha.size() == pixels);
  if (d_colour != nullptr) {
    EFFIGY_CHECK(d_colour->width == width && d_colour->height == height && d_colour->count >= 3);
    EFFIGY_CHECK_EQ(d_alpha.size(), alpha.size());
  }
  // Beyond 10 pixels from the box the windows of the windows are black: SSIM 1, gradient 0.
  PixelBox region{0, 0, width, height};
  if (!box.empty())
    region = {std::max(0, box.x0 - 2 * kRadius), std::max(0, box.y0 - 2 * kRadius),
              std::min(width, box.x1 + 2 * kRadius), std::min(height, box.y1 + 2 * kRadius)};
  const int rows = region.y1 - region.y0, columns = region.x1 - region.x0;
  EFFIGY_CHECK(rows > 0 && columns > 0);
  const size_t offset =
      static_cast<size_t>(region.y0) * static_cast<size_t>(width) + static_cast<size_t>(region.x0);
  const auto window = gaussian_window();
  const double samples = 3.0 * static_cast<double>(pixels);
  std::vector<double> l1(3 * static_cast<size_t>(rows)), similarity(l1.size());
  std::vector<double> mask_sums(static_cast<size_t>(rows));

  parallel_for(static_cast<size_t>(rows), 8, [&](size_t begin, size_t end, int) {
    for (int c = 0; c < 3; ++c) {
      SsimBand band;
      band.x = colour.plane(c) + offset;
      band.y = target.plane(c) + offset;
      band.d_x = d_colour == nullptr ? nullptr : d_colour->plane(c) + offset;
      band.stride = static_cast<size_t>(width);
      band.width = columns;
      band.height = rows;
      band.row_begin = static_cast<int>(begin);
      band.row_end = static_cast<int>(end);
      band.weight_l1 = static_cast<float>(weights.l1 / samples);
      band.weight_ssim = static_cast<float>(-weights.dssim / samples);
      band.window = window.data();
      band.row_l1 = l1.data() + static_cast<size_t>(c) * static_cast<size_t>(rows);
      band.row_ssim = similarity.data() + static_cast<size_t>(c) * static_cast<size_t>(rows);
      HWY_DYNAMIC_DISPATCH(photometric_band)(band);
    }
    if (alpha.empty()) return;
    MaskBand band;
    band.alpha = alpha.data() + offset;
    band.mask = mask.data() + offset;
    band.d_alpha = d_colour == nullptr ? nullptr : d_alpha.data() + offset;
    band.stride = static_cast<size_t>(width);
    band.width = columns;
    band.row_begin = static_cast<int>(begin);
    band.row_end = static_cast<int>(end);
    band.weight = static_cast<float>(weights.mask / static_cast<double>(pixels));
    band.row_sum = mask_sums.data();
    HWY_DYNAMIC_DISPATCH(mask_band)(band);
  });

  const double black = samples - 3.0 * rows * columns;
  PhotometricLoss loss;
  loss.l1 = sum_of(l1) / samples;
  loss.dssim = 1.0 - (sum_of(similarity) + black) / samples;
  loss.mask = sum_of(mask_sums) / static_cast<double>(pixels);
  return loss;
}

}  // namespace effigy
#endif  // HWY_ONCE
