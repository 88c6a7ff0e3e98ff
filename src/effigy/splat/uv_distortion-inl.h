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

HWY_INLINE void begin_lists(const SurfelTile& tile, bool for_backward, SurfelWorkspace& ws) {
  const size_t floats = std::min(tile.count, kMostListed) * kTilePixels;
  ws.list_w.reserve(floats);
  ws.list_u.reserve(floats);
  ws.list_v.reserve(floats);
  if (for_backward) {
    ws.list_h.reserve(floats);
    ws.list_qu.reserve(floats);
    ws.list_qv.reserve(floats);
  }
  std::memset(ws.listed, 0, sizeof(ws.listed));
  std::memset(ws.cursor, 0, sizeof(ws.cursor));
  std::memset(ws.closed, 0, sizeof(ws.closed));
}

// Appends (w, u, v) of the lanes in `bits` to their pixels' lists, unless past the threshold.
HWY_INLINE void append(Vf weight, Vf u, Vf v, uint32_t bits, size_t at, float threshold,
                       SurfelWorkspace& ws) {
  HWY_ALIGN float w[kLanes], x[kLanes], y[kLanes];
  store(weight, w);
  store(u, x);
  store(v, y);
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const size_t pixel = at + lane;
    if (ws.closed[pixel]) continue;
    const auto n = static_cast<size_t>(ws.listed[pixel]);
    if (n > 0 && threshold > 0.0f) {
      const float du = x[lane] - ws.list_u[pixel], dv = y[lane] - ws.list_v[pixel];
      if (du * du + dv * dv > threshold * threshold) {
        ws.closed[pixel] = 1;
        continue;
      }
    }
    const size_t slot = n * kTilePixels + pixel;
    ws.list_w[slot] = w[lane];
    ws.list_u[slot] = x[lane];
    ws.list_v[slot] = y[lane];
    ws.listed[pixel] = static_cast<int32_t>(n + 1);
  }
}

// Fills shorter lists of a vector of pixels with weight 0 up to the longest; returns its length.
HWY_INLINE size_t even_out(size_t at, SurfelWorkspace& ws) {
  int32_t longest = 0;
  for (size_t lane = 0; lane < kLanes; ++lane) longest = std::max(longest, ws.listed[at + lane]);
  for (size_t lane = 0; lane < kLanes; ++lane) {
    for (auto n = static_cast<size_t>(ws.listed[at + lane]); n < static_cast<size_t>(longest);
         ++n) {
      const size_t slot = n * kTilePixels + at + lane;
      ws.list_w[slot] = ws.list_u[slot] = ws.list_v[slot] = 0.0f;
    }
  }
  return static_cast<size_t>(longest);
}

// Zeroth, first and second moments of uv about the pixel's first uv (for the squared distance).
struct Moments {
  Vf u0, v0, a, mu, mv, m2;
};

HWY_INLINE Moments moments_of(size_t at, size_t n, const SurfelWorkspace& ws) {
  const Vf zero = hn::Zero(df);
  Moments m{load(&ws.list_u[at]), load(&ws.list_v[at]), zero, zero, zero, zero};
  for (size_t i = 0; i < n; ++i) {
    const size_t slot = i * kTilePixels + at;
    const Vf w = load(&ws.list_w[slot]);
    const Vf u = hn::Sub(load(&ws.list_u[slot]), m.u0), v = hn::Sub(load(&ws.list_v[slot]), m.v0);
    m.a = hn::Add(m.a, w);
    m.mu = hn::MulAdd(w, u, m.mu);
    m.mv = hn::MulAdd(w, v, m.mv);
    m.m2 = hn::MulAdd(w, hn::MulAdd(u, u, hn::Mul(v, v)), m.m2);
  }
  return m;
}

// sum over ordered pairs of w_i w_j |uv_i - uv_j|, or of the squared distance, of a vector of
// pixels.
HWY_INLINE Vf distortion(size_t at, bool squared, SurfelWorkspace& ws) {
  const size_t n = even_out(at, ws);
  Vf total = hn::Zero(df);
  if (n == 0) return total;
  if (squared) {
    const Moments m = moments_of(at, n, ws);
    const Vf first = hn::MulAdd(m.mu, m.mu, hn::Mul(m.mv, m.mv));
    const Vf half = hn::Max(hn::MulSub(m.a, m.m2, first), total);
    return hn::Add(half, half);
  }
  for (size_t i = 1; i < n; ++i) {
    const size_t slot = i * kTilePixels + at;
    const Vf u = load(&ws.list_u[slot]), v = load(&ws.list_v[slot]);
    Vf sum = hn::Zero(df);
    for (size_t j = 0; j < i; ++j) {
      const size_t other = j * kTilePixels + at;
      const Vf du = hn::Sub(u, load(&ws.list_u[other])), dv = hn::Sub(v, load(&ws.list_v[other]));
      const Vf distance = hn::Sqrt(hn::MulAdd(du, du, hn::Mul(dv, dv)));
      sum = hn::MulAdd(load(&ws.list_w[other]), distance, sum);
    }
    total = hn::MulAdd(load(&ws.list_w[slot]), sum, total);
  }
  return hn::Add(total, total);
}

// Per listed surfel: list_h = dL/dw_i and (list_qu, list_qv) = dL/duv_i / w_i of the distortion L.
HWY_INLINE void distortion_backward(size_t at, bool squared, SurfelWorkspace& ws) {
  const size_t n = even_out(at, ws);
  if (n == 0) return;
  const Vf two = set(2.0f);
  if (squared) {
    const Moments m = moments_of(at, n, ws);
    for (size_t i = 0; i < n; ++i) {
      const size_t slot = i * kTilePixels + at;
      const Vf u = hn::Sub(load(&ws.list_u[slot]), m.u0);
      const Vf v = hn::Sub(load(&ws.list_v[slot]), m.v0);
      const Vf cross = hn::MulAdd(u, m.mu, hn::Mul(v, m.mv));
      const Vf own = hn::MulAdd(m.a, hn::MulAdd(u, u, hn::Mul(v, v)), m.m2);
      store(hn::Mul(two, hn::NegMulAdd(two, cross, own)), &ws.list_h[slot]);
      store(hn::Mul(set(4.0f), hn::MulSub(m.a, u, m.mu)), &ws.list_qu[slot]);
      store(hn::Mul(set(4.0f), hn::MulSub(m.a, v, m.mv)), &ws.list_qv[slot]);
    }
    return;
  }
  for (size_t i = 0; i < n; ++i) {
    const size_t slot = i * kTilePixels + at;
    const Vf u = load(&ws.list_u[slot]), v = load(&ws.list_v[slot]);
    Vf h = hn::Zero(df), qu = h, qv = h;
    for (size_t j = 0; j < n; ++j) {
      const size_t other = j * kTilePixels + at;
      const Vf du = hn::Sub(u, load(&ws.list_u[other])), dv = hn::Sub(v, load(&ws.list_v[other]));
      const Vf squares = hn::MulAdd(du, du, hn::Mul(dv, dv));
      // Equal uvs have distance 0 and pass no gradient.
      const Vf weight = hn::Div(load(&ws.list_w[other]), hn::Sqrt(hn::Add(squares, set(1e-30f))));
      h = hn::MulAdd(weight, squares, h);
      qu = hn::MulAdd(weight, du, qu);
      qv = hn::MulAdd(weight, dv, qv);
    }
    store(hn::Add(h, h), &ws.list_h[slot]);
    store(hn::Add(qu, qu), &ws.list_qu[slot]);
    store(hn::Add(qv, qv), &ws.list_qv[slot]);
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
