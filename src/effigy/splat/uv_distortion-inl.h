// The UV distortion of a pixel (GTAvatar section 4.3): its surfels' weights and texture coordinates
// in lists, the sum over pairs, and its derivatives.

#if defined(EFFIGY_SPLAT_UV_DISTORTION_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_UV_DISTORTION_INL_H_
#undef EFFIGY_SPLAT_UV_DISTORTION_INL_H_
#else
#define EFFIGY_SPLAT_UV_DISTORTION_INL_H_
#endif

#include "effigy/splat/surfel_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

// The list of a vector of pixels: an entry for every surfel that blended in one of its lanes,
// nearest first: weight (0 in lanes that it is not in, or past the threshold), u, v, a vector each.
// Backward adds dL/dw and dL/duv / w in a second array.
constexpr size_t kEntry = 3 * kLanes;
// A pixel takes at most log(1e-4) / log(1 - 1/255) = 2344 surfels.
constexpr size_t kMostListed = 2400 * kLanes;

// Room for one list, in floats.
HWY_INLINE size_t list_stride(const SplatTile& tile) {
  return std::min(tile.count, kMostListed) * kEntry;
}

HWY_INLINE void begin_lists(const SplatTile& tile, bool for_backward, SurfelWorkspace& ws) {
  ws.list_stride = list_stride(tile);
  ws.list.reserve(kVectors * ws.list_stride);
  if (for_backward) ws.d_list.reserve(kVectors * ws.list_stride);
  std::memset(ws.listed, 0, sizeof(ws.listed));
  std::memset(ws.cursor, 0, sizeof(ws.cursor));
  std::memset(ws.list_state, 0, sizeof(ws.list_state));
  std::memset(ws.list_ended, 0, sizeof(ws.list_ended));
}

// The planes of ws.list_state of a vector of pixels: 1 once a surfel is listed, its uv, and 1 once
// the list is closed because a uv was further from the first than the threshold.
enum ListState : size_t { kStarted = 0, kFirstU = 1, kFirstV = 2, kClosed = 3, kListStates = 4 };

// Appends the lanes in `blended` to their pixels' lists, unless past the threshold. A list ends
// when all its pixels' have closed, so that its n-th entry is the n-th surfel that blended in the
// vector.
HWY_INLINE void append(Vf weight, Vf u, Vf v, Mf blended, size_t at, float threshold,
                       SurfelWorkspace& ws) {
  const size_t vector = at / kLanes;
  if (threshold > 0.0f) {
    if (ws.list_ended[vector]) return;
    float* const state = ws.list_state + at * kListStates;
    const Vf one = set(1.0f);
    const Mf started = hn::Gt(load(state + kStarted * kLanes), hn::Zero(df));
    const Vf first_u = hn::IfThenElse(started, load(state + kFirstU * kLanes), u);
    const Vf first_v = hn::IfThenElse(started, load(state + kFirstV * kLanes), v);
    const Vf du = hn::Sub(u, first_u), dv = hn::Sub(v, first_v);
    const Mf beyond = hn::Gt(hn::MulAdd(du, du, hn::Mul(dv, dv)), set(threshold * threshold));
    const Vf closed = hn::IfThenElse(hn::And(blended, beyond), one, load(state + kClosed * kLanes));
    store(closed, state + kClosed * kLanes);
    store(hn::IfThenElse(blended, first_u, load(state + kFirstU * kLanes)),
          state + kFirstU * kLanes);
    store(hn::IfThenElse(blended, first_v, load(state + kFirstV * kLanes)),
          state + kFirstV * kLanes);
    store(hn::IfThenElse(blended, one, load(state + kStarted * kLanes)), state + kStarted * kLanes);
    weight = hn::IfThenElseZero(hn::Eq(closed, hn::Zero(df)), weight);
    ws.list_ended[vector] = hn::AllTrue(df, hn::Gt(closed, hn::Zero(df)));
    if (ws.list_ended[vector] && hn::AllFalse(df, hn::Gt(weight, hn::Zero(df)))) return;
  }
  float* const entry = ws.list.data() + vector * ws.list_stride + ws.listed[vector]++ * kEntry;
  store(weight, entry);
  store(u, entry + kLanes);
  store(v, entry + 2 * kLanes);
}

// Zeroth, first and second moments of uv about the first entry's (for the squared distance).
struct Moments {
  Vf u0, v0, a, mu, mv, m2;
};

HWY_INLINE Moments moments_of(const float* list, size_t n) {
  const Vf zero = hn::Zero(df);
  Moments m{load(list + kLanes), load(list + 2 * kLanes), zero, zero, zero, zero};
  for (const float* e = list; e != list + n * kEntry; e += kEntry) {
    const Vf w = load(e), u = hn::Sub(load(e + kLanes), m.u0);
    const Vf v = hn::Sub(load(e + 2 * kLanes), m.v0);
    m.a = hn::Add(m.a, w);
    m.mu = hn::MulAdd(w, u, m.mu);
    m.mv = hn::MulAdd(w, v, m.mv);
    m.m2 = hn::MulAdd(w, hn::MulAdd(u, u, hn::Mul(v, v)), m.m2);
  }
  return m;
}

// Two entries' uv difference, distance and its inverse. Equal uvs have distance 0 (about 1e-12,
// from the number that keeps the inverse finite).
struct Apart {
  Vf du, dv, distance, inverse;
};

// kFine: relative error below 2e-7 on x86 (a Newton step), else below 4e-4 (the processor's
// estimate, where it is that good).
template <bool kFine>
HWY_INLINE Apart apart(Vf u, Vf v, const float* other) {
  Apart a;
  a.du = hn::Sub(u, load(other + kLanes));
  a.dv = hn::Sub(v, load(other + 2 * kLanes));
  const Vf squares = hn::MulAdd(a.du, a.du, hn::MulAdd(a.dv, a.dv, set(1e-24f)));
  a.inverse = hn::ApproximateReciprocalSqrt(squares);
  a.distance = hn::Mul(squares, a.inverse);
  constexpr bool kGoodEstimate = HWY_ARCH_X86 && HWY_TARGET != HWY_SCALAR;
  if constexpr (kFine || !kGoodEstimate) {
    const Vf step = hn::NegMulAdd(hn::Mul(a.distance, set(0.5f)), a.inverse, set(1.5f));
    a.distance = hn::Mul(a.distance, step);
    a.inverse = hn::Mul(a.inverse, step);
  }
  return a;
}

// sum over ordered pairs of w_i w_j |uv_i - uv_j|, or of the squared distance, of a vector of
// pixels.
HWY_INLINE Vf distortion(size_t at, bool squared, const SurfelWorkspace& ws) {
  const size_t n = ws.listed[at / kLanes];
  const float* const list = ws.list.data() + at / kLanes * ws.list_stride;
  Vf total = hn::Zero(df);
  if (n == 0) return total;
  if (squared) {
    const Moments m = moments_of(list, n);
    const Vf first = hn::MulAdd(m.mu, m.mu, hn::Mul(m.mv, m.mv));
    const Vf half = hn::Max(hn::MulSub(m.a, m.m2, first), total);
    return hn::Add(half, half);
  }
  for (const float* i = list + kEntry; i < list + n * kEntry; i += kEntry) {
    const Vf u = load(i + kLanes), v = load(i + 2 * kLanes);
    Vf sum = hn::Zero(df);
    for (const float* j = list; j != i; j += kEntry)
      sum = hn::MulAdd(load(j), apart<true>(u, v, j).distance, sum);
    total = hn::MulAdd(load(i), sum, total);
  }
  return hn::Add(total, total);
}

// Fills ws.d_list of a vector of pixels: dL/dw_i and dL/duv_i / w_i of the distortion L.
HWY_INLINE void distortion_backward(size_t at, bool squared, SurfelWorkspace& ws) {
  const size_t n = ws.listed[at / kLanes];
  if (n == 0) return;
  const float* const list = ws.list.data() + at / kLanes * ws.list_stride;
  float* const d_list = ws.d_list.data() + at / kLanes * ws.list_stride;
  const Vf two = set(2.0f);
  if (squared) {
    const Moments m = moments_of(list, n);
    for (size_t e = 0; e < n * kEntry; e += kEntry) {
      const Vf u = hn::Sub(load(list + e + kLanes), m.u0);
      const Vf v = hn::Sub(load(list + e + 2 * kLanes), m.v0);
      const Vf cross = hn::MulAdd(u, m.mu, hn::Mul(v, m.mv));
      const Vf own = hn::MulAdd(m.a, hn::MulAdd(u, u, hn::Mul(v, v)), m.m2);
      store(hn::Mul(two, hn::NegMulAdd(two, cross, own)), d_list + e);
      store(hn::Mul(set(4.0f), hn::MulSub(m.a, u, m.mu)), d_list + e + kLanes);
      store(hn::Mul(set(4.0f), hn::MulSub(m.a, v, m.mv)), d_list + e + 2 * kLanes);
    }
    return;
  }
  // Each pair once: entry i gathers from those before it and adds its part to them.
  std::memset(d_list, 0, n * kEntry * sizeof(float));
  for (size_t i = 0; i < n * kEntry; i += kEntry) {
    const Vf w = hn::Mul(two, load(list + i));
    const Vf u = load(list + i + kLanes), v = load(list + i + 2 * kLanes);
    Vf h = hn::Zero(df), qu = h, qv = h;
    for (size_t j = 0; j < i; j += kEntry) {
      const Apart a = apart<false>(u, v, list + j);
      const Vf other = load(list + j);
      const Vf mine = hn::Mul(w, a.inverse), theirs = hn::Mul(other, a.inverse);
      h = hn::MulAdd(other, a.distance, h);
      qu = hn::MulAdd(theirs, a.du, qu);
      qv = hn::MulAdd(theirs, a.dv, qv);
      add_product(d_list + j, w, a.distance);
      store(hn::NegMulAdd(mine, a.du, load(d_list + j + kLanes)), d_list + j + kLanes);
      store(hn::NegMulAdd(mine, a.dv, load(d_list + j + 2 * kLanes)), d_list + j + 2 * kLanes);
    }
    add_product(d_list + i, two, h);
    add_product(d_list + i + kLanes, two, qu);
    add_product(d_list + i + 2 * kLanes, two, qv);
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
