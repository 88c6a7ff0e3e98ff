#include "effigy/learn/albedo_prior.h"

#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_raster.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/learn/albedo_prior.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
// After highway.h.
#include <hwy/contrib/math/math-inl.h>

#ifndef EFFIGY_LEARN_ALBEDO_PRIOR_ONCE
#define EFFIGY_LEARN_ALBEDO_PRIOR_ONCE
namespace effigy {

// One run of pixels.
struct AlbedoRow {
  size_t count;
  const float *alpha, *mask;
  const float* albedo[3];
  const float* prior[3];
  float* d_alpha;  // null: values only
  float* d_albedo[3];
  float min_alpha, scale;  // weight / pixels
};
struct AlbedoSums {
  double loss = 0;
};

}  // namespace effigy
#endif  // EFFIGY_LEARN_ALBEDO_PRIOR_ONCE

HWY_BEFORE_NAMESPACE();
namespace effigy::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// sRGB transfer function (IEC 61966-2-1) and its derivative; x^(1/2.4) as exp(log(x) / 2.4).
template <typename D, typename V>
HWY_INLINE V srgb(D d, V linear, V& derivative) {
  const V threshold = hn::Set(d, 0.0031308f), slope = hn::Set(d, 12.92f);
  const V x = hn::Max(linear, threshold);
  const V power = hn::Exp(d, hn::Mul(hn::Log(d, x), hn::Set(d, 1.0f / 2.4f)));
  const auto straight = hn::Le(linear, threshold);
  derivative =
      hn::IfThenElse(straight, slope, hn::Div(hn::Mul(hn::Set(d, 1.055f / 2.4f), power), x));
  return hn::IfThenElse(straight, hn::Mul(slope, linear),
                        hn::MulSub(hn::Set(d, 1.055f), power, hn::Set(d, 0.055f)));
}

template <typename D>
HWY_INLINE void albedo_pixels(D d, const AlbedoRow& row, size_t i, AlbedoSums& sums) {
  using V = hn::Vec<D>;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0f);
  const V alpha = hn::LoadU(d, row.alpha + i), mask = hn::LoadU(d, row.mask + i);
  const auto counts = hn::And(hn::Ge(alpha, hn::Set(d, row.min_alpha)), hn::Gt(mask, zero));
  if (hn::AllFalse(d, counts)) return;
  const V m = hn::IfThenElseZero(counts, mask);
  const V inverse = hn::Div(one, hn::IfThenElse(counts, alpha, one));
  V loss = zero, d_alpha = zero;
  for (int c = 0; c < 3; ++c) {
    const V albedo = hn::Mul(hn::LoadU(d, row.albedo[c] + i), inverse);
    V slope;
    const V difference = hn::Sub(srgb(d, albedo, slope), hn::LoadU(d, row.prior[c] + i));
    loss = hn::MulAdd(m, hn::Abs(difference), loss);
    if (row.d_alpha == nullptr) continue;
    const V sign = hn::IfThenElseZero(hn::Ne(difference, zero), hn::CopySign(one, difference));
    const V g = hn::Mul(hn::Mul(hn::Mul(hn::Set(d, row.scale), m), hn::Mul(sign, slope)), inverse);
    float* out = row.d_albedo[c] + i;
    hn::StoreU(hn::Add(hn::LoadU(d, out), g), d, out);
    d_alpha = hn::NegMulAdd(g, albedo, d_alpha);
  }
  if (row.d_alpha != nullptr)
    hn::StoreU(hn::Add(hn::LoadU(d, row.d_alpha + i), d_alpha), d, row.d_alpha + i);
  sums.loss += static_cast<double>(hn::GetLane(hn::SumOfLanes(d, loss)));
}

AlbedoSums albedo_row(const AlbedoRow& row) {
  const hn::ScalableTag<float> full;
  const hn::CappedTag<float, 1> single;
  AlbedoSums sums;
  size_t i = 0;
  for (; i + hn::Lanes(full) <= row.count; i += hn::Lanes(full)) albedo_pixels(full, row, i, sums);
  for (; i < row.count; ++i) albedo_pixels(single, row, i, sums);
  return sums;
}

}  // namespace effigy::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy {
namespace {

HWY_EXPORT(albedo_row);

// Sum of the mask over pixels that count.
double counted_mask(std::span<const float> alpha, std::span<const float> mask, float min_alpha) {
  double sum = 0;
  for (size_t i = 0; i < mask.size(); ++i)
    if (alpha[i] >= min_alpha && mask[i] > 0.0f) sum += static_cast<double>(mask[i]);
  return sum;
}

}  // namespace

double albedo_prior_loss(const Planes& gbuffer, const Planes& prior, std::span<const float> mask,
                         const AlbedoPriorOptions& options, float weight, Planes* d_gbuffer) {
  EFFIGY_CHECK(gbuffer.count >= kAlbedo + 3 && prior.count >= 3);
  EFFIGY_CHECK(gbuffer.width == prior.width && gbuffer.height == prior.height);
  EFFIGY_CHECK_EQ(mask.size(), gbuffer.pixels());
  EFFIGY_CHECK(options.min_alpha > 0.0f);
  if (d_gbuffer != nullptr)
    EFFIGY_CHECK(d_gbuffer->width == gbuffer.width && d_gbuffer->height == gbuffer.height &&
                 d_gbuffer->count >= kAlbedo + 3);
  if (gbuffer.pixels() == 0) return 0.0;
  const size_t width = static_cast<size_t>(gbuffer.width);
  const size_t height = static_cast<size_t>(gbuffer.height);
  double samples = 3.0 * static_cast<double>(gbuffer.pixels());
  if (options.mean_over_mask)
    samples =
        3.0 * counted_mask({gbuffer.plane(kAlpha), gbuffer.pixels()}, mask, options.min_alpha);
  if (samples == 0.0) return 0.0;
  std::vector<AlbedoSums> sums(height);
  parallel_for(height, 16, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y) {
      const size_t at = y * width;
      AlbedoRow row;
      row.count = width;
      row.alpha = gbuffer.plane(kAlpha) + at;
      row.mask = mask.data() + at;
      row.d_alpha = d_gbuffer == nullptr ? nullptr : d_gbuffer->plane(kAlpha) + at;
      for (int c = 0; c < 3; ++c) {
        row.albedo[c] = gbuffer.plane(kAlbedo + c) + at;
        row.prior[c] = prior.plane(c) + at;
        row.d_albedo[c] = d_gbuffer == nullptr ? nullptr : d_gbuffer->plane(kAlbedo + c) + at;
      }
      row.min_alpha = options.min_alpha;
      row.scale = static_cast<float>(weight / samples);
      sums[y] = HWY_DYNAMIC_DISPATCH(albedo_row)(row);
    }
  });
  double loss = 0;
  for (const AlbedoSums& row : sums) loss += row.loss;
  return loss / samples;
}

}  // namespace effigy
#endif  // HWY_ONCE
