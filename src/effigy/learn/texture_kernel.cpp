#include "effigy/learn/texture_kernel.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "effigy/learn/texel_vector.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/learn/texture_kernel.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef EFFIGY_LEARN_TEXTURE_KERNEL_ONCE
#define EFFIGY_LEARN_TEXTURE_KERNEL_ONCE
namespace effigy::texture_kernel {

// Gradient with respect to raw normal xy where tanh was shortened to the limit: t = L p / |p| with
// p = tanh(raw), so dt/dp = (L / |p|)(I - p p' / |p|^2).
inline void shortened_normal(const float* raw, float limit, const float* d_normal, float* d_raw) {
  const double x = std::tanh(static_cast<double>(raw[0]));
  const double y = std::tanh(static_cast<double>(raw[1]));
  const double length = std::sqrt(x * x + y * y);
  double gx = d_normal[0], gy = d_normal[1];
  if (length > limit) {
    const double along = (gx * x + gy * y) / (length * length);
    gx = limit / length * (gx - along * x);
    gy = limit / length * (gy - along * y);
  }
  d_raw[0] = static_cast<float>(gx * (1 - x * x));
  d_raw[1] = static_cast<float>(gy * (1 - y * y));
}

}  // namespace effigy::texture_kernel
#endif  // EFFIGY_LEARN_TEXTURE_KERNEL_ONCE

HWY_BEFORE_NAMESPACE();
namespace effigy::texture_kernel::HWY_NAMESPACE {
#if HWY_TARGET == HWY_SCALAR
namespace hn = effigy::texel_vector;
#else
namespace hn = hwy::HWY_NAMESPACE;
#endif
// At most one texel a vector; narrower machines take a texel in parts.
using D = hn::CappedTag<float, 8>;
using V = hn::Vec<D>;

HWY_INLINE V sign(D d, V value) {
  return hn::IfThenElseZero(hn::Ne(value, hn::Zero(d)), hn::CopySign(hn::Set(d, 1.0f), value));
}

// exp(x) to 2 ulp for |x| < 87, clamped beyond (so that neither it nor 1 + it overflows).
HWY_INLINE V bounded_exp(D d, V x) {
#if HWY_TARGET == HWY_SCALAR
  return hn::Exp(d, hn::Max(hn::Min(x, hn::Set(d, 87.0f)), hn::Set(d, -87.0f)));
#else
  const hn::RebindToSigned<D> di;
  x = hn::Max(hn::Min(x, hn::Set(d, 87.0f)), hn::Set(d, -87.0f));
  // n = round(x / ln 2): adding 1.5 * 2^23 leaves n in the low mantissa bits.
  const V magic = hn::Set(d, 12582912.0f);
  const V shifted = hn::MulAdd(x, hn::Set(d, 1.44269504f), magic);
  const V n = hn::Sub(shifted, magic);
  V r = hn::NegMulAdd(n, hn::Set(d, 0.693145752f), x);  // ln 2 in two parts
  r = hn::NegMulAdd(n, hn::Set(d, 1.42860677e-6f), r);
  V p = hn::MulAdd(hn::Set(d, 1.0f / 720.0f), r, hn::Set(d, 1.0f / 120.0f));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0f / 24.0f));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0f / 6.0f));
  p = hn::MulAdd(p, r, hn::Set(d, 0.5f));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0f));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0f));
  const auto exponent = hn::ShiftLeft<23>(hn::BitCast(di, shifted));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), exponent));
#endif
}

// 1 / sqrt(value) to about 3e-7: one Newton step from the machine's estimate.
HWY_INLINE V inverse_sqrt(D d, V value) {
  const V estimate = hn::ApproximateReciprocalSqrt(value);
  const V half = hn::Mul(hn::Set(d, 0.5f), hn::Mul(value, estimate));
  return hn::Mul(estimate, hn::NegMulAdd(half, estimate, hn::Set(d, 1.5f)));
}

// x^2 + y^2 of the normal in lanes 5 and 6, 0 elsewhere. Reversing a block of four swaps them.
HWY_INLINE V normal_length_squared(V texel, V is_normal) {
  const V squares = hn::Mul(hn::Mul(texel, texel), is_normal);
  return hn::Add(squares, hn::Shuffle0123(squares));
}

HWY_INLINE V activate_lanes(D d, const Lanes& lanes, float normal_limit, V raw, size_t k) {
  const V one = hn::Set(d, 1.0f);
  const V e = bounded_exp(d, hn::Neg(hn::Mul(hn::Load(d, lanes.slope + k), raw)));
  V t = hn::Add(hn::Load(d, lanes.low + k), hn::Div(hn::Load(d, lanes.range + k), hn::Add(one, e)));
  const V length = normal_length_squared(t, hn::Load(d, lanes.is_normal + k));
  const auto longer = hn::Gt(length, hn::Set(d, normal_limit * normal_limit));
  if (HWY_UNLIKELY(!hn::AllFalse(d, longer)))
    t = hn::IfThenElse(longer, hn::Mul(t, hn::Div(hn::Set(d, normal_limit), hn::Sqrt(length))), t);
  return t;
}

// Sums over a row, kept in registers where the whole texel is one vector.
struct Accumulators {
  V tv, normal, prior, albedo_prior, boundary;
};

// Total variation: gradient of the pairs of one texel, and the values of its pairs to the right and
// above (so that each pair is counted once).
template <bool kSquared>
HWY_INLINE V tv_gradient(D d, const Row& row, size_t at, V t, uint8_t flags, V& value) {
  V gradient = hn::Zero(d);
  const auto pair = [&](const float* other, bool counted) HWY_ATTR {
    const V difference = hn::Sub(t, hn::LoadU(d, other));
    if constexpr (kSquared) {
      gradient = hn::MulAdd(hn::Set(d, 2.0f), difference, gradient);
      if (counted) value = hn::MulAdd(difference, difference, value);
    } else {
      gradient = hn::Add(gradient, sign(d, difference));
      if (counted) value = hn::Add(value, hn::Abs(difference));
    }
  };
  if (HWY_LIKELY(flags == 31)) {
    pair(row.texels + at + 8, true);
    pair(row.texels + at - 8, false);
    pair(row.above + at, true);
    pair(row.below + at, false);
    return gradient;
  }
  if (flags & 2) pair(row.texels + at + 8, true);
  if (flags & 4) pair(row.texels + at - 8, false);
  if (flags & 8) pair(row.above + at, true);
  if (flags & 16) pair(row.below + at, false);
  return gradient;
}

// Gradient of all texture losses with respect to the activated texel (lanes k...).
template <bool kSquared>
HWY_INLINE V loss_gradient(D d, const Settings& settings, const Row& row, size_t at, size_t k, V t,
                           V length, uint8_t flags, Accumulators& sums) {
  const Lanes& lanes = settings.lanes;
  const V one = hn::Set(d, 1.0f);
  const V is_normal = hn::Load(d, lanes.is_normal + k);
  // |x| + |y| + |1 - z|; z does not exceed 1. Half of |1 - z| is counted in each of the two lanes.
  const V z_squared = hn::Sub(one, length);
  const V inverse_z = inverse_sqrt(d, z_squared);
  const V z = hn::Mul(z_squared, inverse_z);
  const V normal_gradient = hn::MulAdd(t, inverse_z, sign(d, t));
  const V normal_value =
      hn::Mul(is_normal, hn::MulAdd(hn::Set(d, 0.5f), hn::Sub(one, z), hn::Abs(t)));
  if (!(flags & 1)) {
    const V difference = hn::Sub(t, hn::Load(d, lanes.boundary_target + k));
    const auto counts = hn::Gt(hn::Abs(difference), hn::Set(d, settings.boundary_tolerance));
    const auto normal_lane = hn::Ne(is_normal, hn::Zero(d));
    const V value = hn::IfThenElse(normal_lane, normal_value, hn::Abs(difference));
    const V gradient = hn::IfThenElse(normal_lane, normal_gradient, sign(d, difference));
    sums.boundary = hn::Add(sums.boundary, hn::IfThenElseZero(counts, value));
    return hn::IfThenElseZero(counts, hn::Mul(gradient, hn::Load(d, lanes.boundary + k)));
  }
  sums.normal = hn::Add(sums.normal, normal_value);
  V gradient = hn::Mul(normal_gradient, hn::Load(d, lanes.normal + k));
  if (settings.tv) {
    const V tv = tv_gradient<kSquared>(d, row, at, t, flags, sums.tv);
    gradient = hn::MulAdd(tv, hn::Load(d, lanes.tv + k), gradient);
  }
  if (settings.prior) {
    const V difference = hn::Sub(t, hn::Load(d, lanes.prior_target + k));
    sums.prior = hn::MulAdd(difference, difference, sums.prior);
    gradient = hn::MulAdd(difference, hn::Load(d, lanes.prior + k), gradient);
  }
  if (row.albedo_target != nullptr) {
    const V difference = hn::Sub(t, hn::LoadU(d, row.albedo_target + at));
    sums.albedo_prior = hn::Add(sums.albedo_prior, hn::Abs(difference));
    gradient = hn::MulAdd(sign(d, difference), hn::Load(d, lanes.albedo_prior + k), gradient);
  }
  return gradient;
}

// Derivative with respect to raw of one part of a texel.
template <bool kSquared>
HWY_INLINE V raw_gradient(D d, const Settings& settings, const Row& row, size_t x, size_t k,
                          Accumulators& sums, uint32_t& not_finite) {
  const Lanes& lanes = settings.lanes;
  const size_t at = 8 * x + k;
  const V t = hn::LoadU(d, row.texels + at);
  V g = hn::LoadU(d, row.d_texels + at);
  const auto finite = hn::IsFinite(g);
  if (HWY_UNLIKELY(!hn::AllTrue(d, finite))) {
    not_finite += static_cast<uint32_t>(hn::Lanes(d) - hn::CountTrue(d, finite));
    g = hn::IfThenElseZero(finite, g);
  }
  const V length = normal_length_squared(t, hn::Load(d, lanes.is_normal + k));
  g = hn::Add(g, loss_gradient<kSquared>(d, settings, row, at, k, t, length, row.flags[x], sums));
  const V from_low = hn::Sub(t, hn::Load(d, lanes.low + k));
  const V slope = hn::Mul(hn::Load(d, lanes.slope + k), hn::Load(d, lanes.inverse_range + k));
  V d_raw = hn::Mul(hn::Mul(g, slope),
                    hn::Mul(from_low, hn::Sub(hn::Load(d, lanes.range + k), from_low)));
  const float limit = settings.normal_limit;
  if (HWY_UNLIKELY(!hn::AllFalse(d, hn::Gt(length, hn::Set(d, limit * limit * 0.99999f))))) {
    HWY_ALIGN float from[8], to[8];
    hn::Store(g, d, from);
    hn::Store(d_raw, d, to);
    shortened_normal(row.raw + 8 * x + 5, limit, from + (5 - k), to + (5 - k));
    d_raw = hn::Load(d, to);
  }
  return d_raw;
}

HWY_INLINE void clear(D d, Accumulators& sums) {
  sums.tv = sums.normal = sums.prior = sums.albedo_prior = sums.boundary = hn::Zero(d);
}

HWY_INLINE void store(D d, const Accumulators& sums, size_t k, Sums& out) {
  hn::StoreU(sums.tv, d, out.tv + k);
  hn::StoreU(sums.normal, d, out.normal + k);
  hn::StoreU(sums.prior, d, out.prior + k);
  hn::StoreU(sums.albedo_prior, d, out.albedo_prior + k);
  hn::StoreU(sums.boundary, d, out.boundary + k);
}

// The derivative with respect to raw for a run whose texels are all inside with all neighbours
// inside, without branches. Returns false, with nothing added to `sums`, when a texel needs more
// care (a gradient that is not finite, a normal at its limit).
template <bool kSquared>
HWY_INLINE bool interior_run(D d, const Settings& settings, const Row& row, size_t x, size_t k,
                             Accumulators& sums, float* HWY_RESTRICT g) {
  const Lanes& lanes = settings.lanes;
  const V one = hn::Set(d, 1.0f), zero = hn::Zero(d);
  const V is_normal = hn::Load(d, lanes.is_normal + k);
  const V normal_weight = hn::Load(d, lanes.normal + k), tv_weight = hn::Load(d, lanes.tv + k);
  const V low = hn::Load(d, lanes.low + k), range = hn::Load(d, lanes.range + k);
  const V slope = hn::Mul(hn::Load(d, lanes.slope + k), hn::Load(d, lanes.inverse_range + k));
  V poison = zero, longest = zero, normal_sum = zero, tv_sum = zero;
  for (size_t i = 0; i < kRun; ++i) {
    const size_t at = 8 * (x + i) + k;
    const V t = hn::LoadU(d, row.texels + at);
    const V from_image = hn::LoadU(d, row.d_texels + at);
    poison = hn::MulAdd(from_image, zero, poison);  // NaN once an entry is not finite
    const V length = normal_length_squared(t, is_normal);
    longest = hn::Max(longest, length);
    const V z_squared = hn::Sub(one, length);
    const V inverse_z = inverse_sqrt(d, z_squared);
    const V half_cap = hn::NegMulAdd(z_squared, inverse_z, one);
    normal_sum = hn::Add(normal_sum, hn::MulAdd(hn::Set(d, 0.5f), half_cap, hn::Abs(t)));
    V loss = hn::Mul(normal_weight, hn::MulAdd(t, inverse_z, sign(d, t)));
    const V right = hn::Sub(t, hn::LoadU(d, row.texels + at + 8));
    const V left = hn::Sub(t, hn::LoadU(d, row.texels + at - 8));
    const V above = hn::Sub(t, hn::LoadU(d, row.above + at));
    const V below = hn::Sub(t, hn::LoadU(d, row.below + at));
    V tv;
    if constexpr (kSquared) {
      tv = hn::Add(hn::Add(right, left), hn::Add(above, below));
      tv = hn::Add(tv, tv);
      tv_sum = hn::MulAdd(right, right, hn::MulAdd(above, above, tv_sum));
    } else {
      tv = hn::Add(hn::Add(sign(d, right), sign(d, left)), hn::Add(sign(d, above), sign(d, below)));
      tv_sum = hn::Add(tv_sum, hn::Add(hn::Abs(right), hn::Abs(above)));
    }
    loss = hn::MulAdd(tv, tv_weight, loss);
    const V from_low = hn::Sub(t, low);
    const V derivative = hn::Mul(slope, hn::Mul(from_low, hn::Sub(range, from_low)));
    hn::Store(hn::Mul(hn::Add(from_image, loss), derivative), d, g + 8 * i);
  }
  const float limit = settings.normal_limit;
  const auto careful =
      hn::Or(hn::Ne(poison, zero), hn::Gt(longest, hn::Set(d, limit * limit * 0.99999f)));
  if (HWY_UNLIKELY(!hn::AllFalse(d, careful))) return false;
  sums.normal = hn::MulAdd(is_normal, normal_sum, sums.normal);
  if (settings.tv) sums.tv = hn::Add(sums.tv, tv_sum);
  return true;
}

// The derivative with respect to raw of `count` texels from x on, into g (8 floats apart).
template <bool kSquared>
HWY_INLINE void gradient_run(D d, const Settings& settings, const Row& row, size_t x, size_t k,
                             size_t count, Accumulators& sums, uint32_t& not_finite,
                             float* HWY_RESTRICT g) {
  if (row.kinds[x / kRun] == kInterior && !settings.prior &&
      interior_run<kSquared>(d, settings, row, x, k, sums, g))
    return;
  for (size_t i = 0; i < count; ++i)
    hn::Store(raw_gradient<kSquared>(d, settings, row, x + i, k, sums, not_finite), d, g + 8 * i);
}

HWY_INLINE bool all_zero(D d, const float* values, size_t count) {
  V any = hn::Zero(d);
  for (size_t i = 0; i < count; i += hn::Lanes(d)) any = hn::Or(any, hn::LoadU(d, values + i));
  return hn::AllFalse(d, hn::Ne(any, hn::Zero(d)));
}

// Adam on `count` texels' lanes k...; `g` holds their gradients. Returns whether all gradients and
// moments are zero now.
HWY_INLINE bool adam(const Settings& settings, const Row& row, size_t x, size_t k, size_t count,
                     const float* HWY_RESTRICT g) {
  const D d;
  const V rate = hn::Load(d, settings.lanes.rate + k);
  const V beta1 = hn::Set(d, settings.beta1), beta2 = hn::Set(d, settings.beta2);
  const V rest1 = hn::Set(d, 1.0f - settings.beta1), rest2 = hn::Set(d, 1.0f - settings.beta2);
  const V tiny = hn::Set(d, std::numeric_limits<float>::min());
  const V inverse_root = hn::Set(d, settings.inverse_root);
  const V epsilon = hn::Set(d, settings.epsilon);
  float* HWY_RESTRICT raws = row.new_raw + 8 * x + k;
  float* HWY_RESTRICT ms = row.m + 8 * x + k;
  float* HWY_RESTRICT vs = row.v + 8 * x + k;
  V any = hn::Zero(d);
  for (size_t i = 0; i < 8 * count; i += 8) {
    const V gradient = hn::Load(d, g + i);
    V m = hn::MulAdd(beta1, hn::LoadU(d, ms + i), hn::Mul(rest1, gradient));
    V v = hn::MulAdd(beta2, hn::LoadU(d, vs + i), hn::Mul(rest2, hn::Mul(gradient, gradient)));
    m = hn::IfThenElseZero(hn::Ge(hn::Abs(m), tiny), m);
    v = hn::IfThenElseZero(hn::Ge(v, tiny), v);
    const V move = hn::Div(hn::Mul(rate, m), hn::MulAdd(hn::Sqrt(v), inverse_root, epsilon));
    hn::StoreU(m, d, ms + i);
    hn::StoreU(v, d, vs + i);
    hn::StoreU(hn::Sub(hn::LoadU(d, raws + i), move), d, raws + i);
    any = hn::Or(hn::Or(any, gradient), hn::Or(m, v));
  }
  return hn::AllFalse(d, hn::Ne(any, hn::Zero(d)));
}

// Gradient, Adam and activation take turns over runs of texels: one long chain a texel would leave
// the machine waiting for each exponential and division. Runs outside the islands that rest are
// only looked at: a zero gradient leaves them as they are.
template <bool kSquared>
HWY_INLINE void step(const Settings& settings, const Row& row) {
  const D d;
  const size_t runs = (row.width + kRun - 1) / kRun;
  const auto length = [&](size_t run) { return std::min(kRun, row.width - run * kRun); };
  for (size_t run = 0; run < runs; ++run) {
    const size_t at = 8 * run * kRun, count = 8 * length(run);
    if (row.resting[run] != 0 && !all_zero(d, row.d_texels + at, count)) row.resting[run] = 0;
    if (row.resting[run] == 0) std::copy_n(row.out + at, count, row.old + at);
  }
  HWY_ALIGN float g[8 * kRun];
  uint32_t not_finite = 0;
  for (size_t k = 0; k < 8; k += hn::Lanes(d)) {
    const bool last_part = k + hn::Lanes(d) == 8;
    Accumulators sums;
    clear(d, sums);
    for (size_t run = 0; run < runs; ++run) {
      const size_t x = run * kRun, count = length(run);
      if (row.resting[run] == 1) continue;
      gradient_run<kSquared>(d, settings, row, x, k, count, sums, not_finite, g);
      for (size_t at = 8 * x + k; at < 8 * (x + count); at += 8)
        hn::StoreU(hn::Zero(d), d, row.new_d_texels + at);
      bool rests = adam(settings, row, x, k, count, g);
      for (size_t at = 8 * x + k; at < 8 * (x + count); at += 8)
        hn::StoreU(activate_lanes(d, settings.lanes, settings.normal_limit,
                                  hn::LoadU(d, row.new_raw + at), k),
                   d, row.out + at);
      // 2: the parts of the texels so far rest; 0 once one does not.
      if (row.kinds[run] != kOutside) continue;
      const bool first_part = k == 0;
      rests = rests && (first_part || row.resting[run] == 2);
      row.resting[run] = rests ? (last_part ? 1 : 2) : 0;
    }
    store(d, sums, k, *row.sums);
  }
  row.sums->not_finite = not_finite;
}

template <bool kSquared>
HWY_INLINE void gradient(const Settings& settings, const Row& row) {
  const D d;
  HWY_ALIGN float g[8 * kRun];
  uint32_t not_finite = 0;
  for (size_t k = 0; k < 8; k += hn::Lanes(d)) {
    Accumulators sums;
    clear(d, sums);
    for (size_t x = 0; x < row.width; x += kRun) {
      const size_t count = std::min(kRun, row.width - x);
      gradient_run<kSquared>(d, settings, row, x, k, count, sums, not_finite, g);
      for (size_t i = 0; i < 8 * count; i += 8)
        hn::StoreU(hn::Load(d, g + i), d, row.out + 8 * x + k + i);
    }
    store(d, sums, k, *row.sums);
  }
  row.sums->not_finite = not_finite;
}

void step_row_target(const Settings& settings, const Row& row) {
  if (settings.tv_squared)
    step<true>(settings, row);
  else
    step<false>(settings, row);
}

void gradient_row_target(const Settings& settings, const Row& row) {
  if (settings.tv_squared)
    gradient<true>(settings, row);
  else
    gradient<false>(settings, row);
}

void activate_target(const Settings& settings, const float* raw, float* texels, size_t count) {
  const D d;
  for (size_t i = 0; i < count; ++i)
    for (size_t k = 0; k < 8; k += hn::Lanes(d))
      hn::StoreU(activate_lanes(d, settings.lanes, settings.normal_limit,
                                hn::LoadU(d, raw + 8 * i + k), k),
                 d, texels + 8 * i + k);
}

}  // namespace effigy::texture_kernel::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy::texture_kernel {

HWY_EXPORT(step_row_target);
HWY_EXPORT(gradient_row_target);
HWY_EXPORT(activate_target);

void step_row(const Settings& settings, const Row& row) {
  HWY_DYNAMIC_DISPATCH(step_row_target)(settings, row);
}
void gradient_row(const Settings& settings, const Row& row) {
  HWY_DYNAMIC_DISPATCH(gradient_row_target)(settings, row);
}
void activate(const Settings& settings, const float* raw, float* texels, size_t count) {
  HWY_DYNAMIC_DISPATCH(activate_target)(settings, raw, texels, count);
}

}  // namespace effigy::texture_kernel
#endif  // HWY_ONCE
