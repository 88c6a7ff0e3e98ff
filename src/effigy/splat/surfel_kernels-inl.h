// The surfel rasterizer's inner loops, written once with Highway and compiled per instruction set.
// A vector holds neighbouring pixels of one row of a tile. Forward walks the tile's surfels front
// to back; backward replays the same walk (same thresholds, same bits) and carries the sum of w
// dL/dw that is still to come, so it needs nothing stored per pixel and surfel.
//
// Included by surfel_kernels.cpp once per target and by surfel_kernels_scalar.cpp.

// Per-target include guard.
#if defined(EFFIGY_SPLAT_SURFEL_KERNELS_INL_) == defined(HWY_TARGET_TOGGLE)
#ifdef EFFIGY_SPLAT_SURFEL_KERNELS_INL_
#undef EFFIGY_SPLAT_SURFEL_KERNELS_INL_
#else
#define EFFIGY_SPLAT_SURFEL_KERNELS_INL_
#endif

#include <algorithm>
#include <cmath>
#include <cstring>

#include "effigy/splat/surfel_kernels.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

// A vector never holds more than one row of a tile.
using Df = hn::CappedTag<float, kTileSize>;
using Di = hn::RebindToSigned<Df>;
using Vf = hn::Vec<Df>;
using Vi = hn::Vec<Di>;
using Mf = hn::Mask<Df>;
constexpr Df df;
constexpr Di di;
constexpr size_t kLanes = hn::MaxLanes(Df());
constexpr size_t kTile = kTileSize;
// One texel: 8 floats in one vector, or in as many as the target needs.
using Dt = hn::CappedTag<float, 8>;
constexpr Dt dt;
constexpr size_t kTexelLanes = hn::MaxLanes(Dt());

constexpr float kMaxAlpha = 0.99f;
constexpr float kMinTransmittance = 1e-4f;
constexpr size_t kMostListed = 2400;  // (1 - 1/255)^2400 < kMinTransmittance

HWY_INLINE Vf set(float x) {
  return hn::Set(df, x);
}
HWY_INLINE Vf load(const float* p) {
  return hn::Load(df, p);
}
HWY_INLINE void store(Vf v, float* p) {
  hn::Store(v, df, p);
}
// *p += a * b and *p += a, for vectors in memory.
HWY_INLINE void add_product(float* p, Vf a, Vf b) {
  store(hn::MulAdd(a, b, load(p)), p);
}
HWY_INLINE void add_to(float* p, Vf a) {
  store(hn::Add(a, load(p)), p);
}

// Bit i is set where lane i of the mask is.
HWY_INLINE uint32_t bits_of(Mf mask) {
  uint8_t bytes[HWY_MAX(size_t{8}, (kLanes + 7) / 8)] = {};
  hn::StoreMaskBits(df, mask, bytes);
  uint32_t bits;
  std::memcpy(&bits, bytes, sizeof(bits));
  return bits;
}

// 2^x for x in [-126, 1], relative error below 2e-7: Chebyshev polynomial of degree 5 on [-1/2,
// 1/2].
HWY_INLINE Vf exp2_fast(Vf x) {
  const Vf whole = hn::Round(x);
  const Vf f = hn::Sub(x, whole);
  Vf p = set(0.0013390863f);
  p = hn::MulAdd(p, f, set(0.0096760319f));
  p = hn::MulAdd(p, f, set(0.0555035711f));
  p = hn::MulAdd(p, f, set(0.2402210749f));
  p = hn::MulAdd(p, f, set(0.6931471880f));
  p = hn::MulAdd(p, f, set(1.0000000755f));
  const Vi exponent = hn::ShiftLeft<23>(hn::Add(hn::ConvertTo(di, whole), hn::Set(di, 127)));
  return hn::Mul(p, hn::BitCast(df, exponent));
}

// Columns first[row]..last[row] of the tile that the surfel can reach; first > last: none.
struct RowSpans {
  HWY_ALIGN int32_t first[kTile];
  HWY_ALIGN int32_t last[kTile];
};

HWY_INLINE void find_spans(const SurfelRecord& r, const SurfelOutline& o, const SurfelTile& tile,
                           RowSpans& spans) {
  if (o.everywhere) {
    for (size_t row = 0; row < kTile; ++row) {
      spans.first[row] = 0;
      spans.last[row] = tile.width - 1;
    }
    return;
  }
  const float top = static_cast<float>(tile.y) + 0.5f - r.anchor_y;
  const float to_column = r.anchor_x - static_cast<float>(tile.x) - 0.5f;
  const Vf zero = hn::Zero(df);
  for (size_t row = 0; row < kTile; row += kLanes) {
    const Vf y = hn::Add(hn::Iota(df, static_cast<float>(row)), set(top));
    const Vf dy = hn::Sub(y, set(o.y));
    const Vf q = hn::NegMulAdd(hn::Mul(dy, dy), set(o.inverse_yy), set(1.0f));
    const Vf half = hn::Sqrt(hn::Mul(hn::Max(q, zero), set(o.k)));
    const Vf middle = hn::MulAdd(set(o.slope), dy, set(o.x));
    const Mf inside = hn::Ge(q, zero);
    Vf left = hn::IfThenElse(inside, hn::Sub(middle, half), set(1e6f));
    Vf right = hn::IfThenElse(inside, hn::Add(middle, half), set(-1e6f));
    if (o.disc_squared > 0.0f) {
      const Vf ey = hn::Sub(y, set(o.disc_y));
      const Vf rest = hn::NegMulAdd(ey, ey, set(o.disc_squared));
      const Mf in_disc = hn::Ge(rest, zero);
      const Vf reach = hn::Sqrt(hn::Max(rest, zero));
      left = hn::IfThenElse(in_disc, hn::Min(left, hn::Sub(set(o.disc_x), reach)), left);
      right = hn::IfThenElse(in_disc, hn::Max(right, hn::Add(set(o.disc_x), reach)), right);
    }
    const Vf first = hn::Ceil(hn::Add(left, set(to_column)));
    const Vf last = hn::Floor(hn::Add(right, set(to_column)));
    const float end = static_cast<float>(tile.width);
    hn::Store(hn::ConvertTo(di, hn::Min(hn::Max(first, zero), set(end))), di, spans.first + row);
    hn::Store(hn::ConvertTo(di, hn::Max(hn::Min(last, set(end - 1.0f)), set(-1.0f))), di,
              spans.last + row);
  }
}

// The affine functions of one row: value at dx = 0.
struct RowStart {
  float a, b, c, dy;
};

HWY_INLINE RowStart start_row(const SurfelRecord& r, float dy) {
  return {r.a[0] + r.a[2] * dy, r.b[0] + r.b[2] * dy, r.c[0] + r.c[2] * dy, dy};
}

// One surfel met by a vector of pixels. All values are 0 in lanes where nothing is blended.
struct Hit {
  Vf u, v, z;  // standard deviations, camera depth; u = v = 0 where the low-pass won
  Vf inverse;  // 1 / C; 0 where the low-pass won
  Vf ex, ey;   // pixel - projected centre (low-pass)
  Vf alpha, weight, before, after;  // transmittance before and after
  Mf blended, low_pass, finished;
};

template <bool kLowPass>
HWY_INLINE Hit intersect(const SurfelRecord& r, const RowStart& row, Vf dx, Vf transmittance,
                         float near) {
  Hit hit;
  const Vf c = hn::MulAdd(set(r.c[1]), dx, set(row.c));
  Vf inverse = hn::Div(set(1.0f), c);
  Vf u = hn::Mul(hn::MulAdd(set(r.a[1]), dx, set(row.a)), inverse);
  Vf v = hn::Mul(hn::MulAdd(set(r.b[1]), dx, set(row.b)), inverse);
  Vf z = hn::Mul(set(r.depth), inverse);
  Vf rho = hn::MulAdd(u, u, hn::Mul(v, v));
  Mf front = hn::Gt(z, set(near));
  if constexpr (kLowPass) {
    hit.ex = hn::Sub(dx, set(r.low_pass_x));
    hit.ey = set(row.dy - r.low_pass_y);
    const Vf squared = hn::MulAdd(hit.ex, hit.ex, hn::Mul(hit.ey, hit.ey));
    const Vf filtered = hn::Add(squared, squared);
    // Where the plane is not met in front of the camera only the filter counts.
    rho = hn::IfThenElse(front, rho, set(1e30f));
    hit.low_pass = hn::Lt(filtered, rho);
    rho = hn::IfThenElse(hit.low_pass, filtered, rho);
    z = hn::IfThenElse(hit.low_pass, set(r.center_z), z);
    front = hn::Gt(z, set(near));
  }
  const Mf reached = hn::And(hn::Le(rho, set(r.rho_max)), front);
  constexpr float kHalfLog2E = 0.72134752044f;
  const Vf exponent = hn::NegMulAdd(rho, set(kHalfLog2E), set(r.log2_opacity));
  hit.alpha = hn::Min(exp2_fast(hn::Max(exponent, set(-100.0f))), set(kMaxAlpha));
  const Vf after = hn::NegMulAdd(hit.alpha, transmittance, transmittance);
  const Mf enough = hn::Ge(after, set(kMinTransmittance));
  hit.blended = hn::And(reached, enough);
  hit.finished = hn::AndNot(enough, reached);
  hit.before = transmittance;
  hit.after = hn::IfThenElse(hit.blended, after, hn::IfThenZeroElse(hit.finished, transmittance));
  hit.weight = hn::IfThenElseZero(hit.blended, hn::Mul(hit.alpha, transmittance));
  Mf by_plane = hit.blended;
  if constexpr (kLowPass) by_plane = hn::AndNot(hit.low_pass, hit.blended);
  hit.u = hn::IfThenElseZero(by_plane, u);
  hit.v = hn::IfThenElseZero(by_plane, v);
  hit.inverse = hn::IfThenElseZero(by_plane, inverse);
  hit.z = hn::IfThenElseZero(hit.blended, z);
  return hit;
}

// Where each lane reads the texture.
struct Taps {
  HWY_ALIGN int32_t index[kLanes];  // upper-left texel
  HWY_ALIGN float fx[kLanes];
  HWY_ALIGN float fy[kLanes];
};

// Texels of each lane after interpolation, as two times four channels a lane.
struct TexelLanes {
  HWY_ALIGN float low[4 * kLanes];
  HWY_ALIGN float high[4 * kLanes];
};

struct TextureGrid {
  const float* texels;
  size_t step_x, step_y;  // floats
  float width, height;
  int32_t row;

  explicit TextureGrid(const SurfelScene& scene)
      : texels(scene.texels),
        step_x(scene.texture_width > 1 ? 8 : 0),
        step_y(scene.texture_height > 1 ? 8 * static_cast<size_t>(scene.texture_width) : 0),
        width(static_cast<float>(scene.texture_width)),
        height(static_cast<float>(scene.texture_height)),
        row(scene.texture_width) {}
};

// Bilinear at (u width - 1/2, v height - 1/2), clamped to the edge texels. `inside_x`, `inside_y`:
// lanes where the coordinate was not clamped (where it has a derivative).
HWY_INLINE void place_taps(const TextureGrid& grid, Vf u, Vf v, Taps& taps, Mf& inside_x,
                           Mf& inside_y) {
  const Vf zero = hn::Zero(df);
  const Vf x = hn::MulSub(u, set(grid.width), set(0.5f));
  const Vf y = hn::MulSub(v, set(grid.height), set(0.5f));
  const Vf cx = hn::Min(hn::Max(x, zero), set(grid.width - 1.0f));
  const Vf cy = hn::Min(hn::Max(y, zero), set(grid.height - 1.0f));
  inside_x = hn::Eq(cx, x);
  inside_y = hn::Eq(cy, y);
  const Vf x0 = hn::Min(hn::Floor(cx), set(std::max(grid.width - 2.0f, 0.0f)));
  const Vf y0 = hn::Min(hn::Floor(cy), set(std::max(grid.height - 2.0f, 0.0f)));
  store(hn::Sub(cx, x0), taps.fx);
  store(hn::Sub(cy, y0), taps.fy);
  const Vi index =
      hn::Add(hn::Mul(hn::ConvertTo(di, y0), hn::Set(di, grid.row)), hn::ConvertTo(di, x0));
  hn::Store(index, di, taps.index);
}

// Stores or loads floats c..c+kTexelLanes of a texel, held as two halves.
HWY_INLINE void store_texel(hn::Vec<Dt> v, size_t c, float* low, float* high) {
#if HWY_TARGET != HWY_SCALAR
  if constexpr (kTexelLanes == 8) {
    const hn::Half<Dt> half;
    hn::Store(hn::LowerHalf(half, v), half, low);
    hn::Store(hn::UpperHalf(half, v), half, high);
    return;
  }
#endif
  hn::Store(v, dt, c < 4 ? low + c : high + (c - 4));
}

HWY_INLINE hn::Vec<Dt> load_texel(size_t c, const float* low, const float* high) {
#if HWY_TARGET != HWY_SCALAR
  if constexpr (kTexelLanes == 8) {
    const hn::Half<Dt> half;
    return hn::Combine(dt, hn::Load(half, high), hn::Load(half, low));
  }
#endif
  return hn::Load(dt, c < 4 ? low + c : high + (c - 4));
}

// Looks up the texture for the lanes in `bits`; other lanes keep what they held (finite).
HWY_INLINE void sample(const TextureGrid& grid, const Taps& taps, uint32_t bits,
                       TexelLanes& value) {
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const float* p = grid.texels + 8 * static_cast<size_t>(taps.index[lane]);
    const float* q = p + grid.step_y;
    const auto fx = hn::Set(dt, taps.fx[lane]), fy = hn::Set(dt, taps.fy[lane]);
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto p0 = hn::LoadU(dt, p + c), p1 = hn::LoadU(dt, p + grid.step_x + c);
      const auto q0 = hn::LoadU(dt, q + c), q1 = hn::LoadU(dt, q + grid.step_x + c);
      const auto top = hn::MulAdd(fx, hn::Sub(p1, p0), p0);
      const auto bottom = hn::MulAdd(fx, hn::Sub(q1, q0), q0);
      store_texel(hn::MulAdd(fy, hn::Sub(bottom, top), top), c, value.low + 4 * lane,
                  value.high + 4 * lane);
    }
  }
}

// The same with derivatives with respect to the texture coordinates in texels.
HWY_INLINE void sample_with_slopes(const TextureGrid& grid, const Taps& taps, uint32_t bits,
                                   TexelLanes& value, TexelLanes& along_x, TexelLanes& along_y) {
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const float* p = grid.texels + 8 * static_cast<size_t>(taps.index[lane]);
    const float* q = p + grid.step_y;
    const auto fx = hn::Set(dt, taps.fx[lane]), fy = hn::Set(dt, taps.fy[lane]);
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto p0 = hn::LoadU(dt, p + c), q0 = hn::LoadU(dt, q + c);
      const auto dp = hn::Sub(hn::LoadU(dt, p + grid.step_x + c), p0);
      const auto dq = hn::Sub(hn::LoadU(dt, q + grid.step_x + c), q0);
      const auto top = hn::MulAdd(fx, dp, p0);
      const auto bottom = hn::MulAdd(fx, dq, q0);
      const auto dy = hn::Sub(bottom, top);
      const size_t at = 4 * lane;
      store_texel(hn::MulAdd(fy, dy, top), c, value.low + at, value.high + at);
      store_texel(hn::MulAdd(fy, hn::Sub(dq, dp), dp), c, along_x.low + at, along_x.high + at);
      store_texel(dy, c, along_y.low + at, along_y.high + at);
    }
  }
}

// Adds the lanes' texel gradients to the four texels that each lane read.
HWY_INLINE void scatter(const TextureGrid& grid, const Taps& taps, uint32_t bits,
                        const TexelLanes& gradient, const SurfelGradientBuffers& buffers) {
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const auto index = static_cast<size_t>(taps.index[lane]);
    buffers.touched[index / kTexelBlock] = 1;
    float* p = buffers.texels + 8 * index;
    float* q = p + grid.step_y;
    const float fx = taps.fx[lane], fy = taps.fy[lane];
    const float w11 = fx * fy, w01 = fx - w11, w10 = fy - w11, w00 = 1.0f - fx - w10;
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto g = load_texel(c, gradient.low + 4 * lane, gradient.high + 4 * lane);
      const auto add = [&](float* to, float weight) HWY_ATTR {
        hn::StoreU(hn::MulAdd(hn::Set(dt, weight), g, hn::LoadU(dt, to)), dt, to);
      };
      add(p + c, w00);
      add(p + grid.step_x + c, w01);
      add(q + c, w10);
      add(q + grid.step_x + c, w11);
    }
  }
}

// Which vectors of the tile still have a pixel to fill.
struct Alive {
  uint8_t chunk[kTilePixels / kLanes];
  size_t count;
};

HWY_INLINE void begin_tile(const SurfelTile& tile, SurfelWorkspace& ws, Alive& alive) {
  ws.pairs = 0;
  ws.used = 0;
  for (int y = 0; y < kTileSize; ++y) {
    for (int x = 0; x < kTileSize; ++x)
      ws.transmittance[y * kTileSize + x] = x < tile.width && y < tile.height ? 1.0f : 0.0f;
  }
  alive.count = 0;
  for (size_t k = 0; k < kTilePixels / kLanes; ++k) {
    const bool any = !hn::AllFalse(df, hn::Gt(load(ws.transmittance + k * kLanes), hn::Zero(df)));
    alive.chunk[k] = any;
    alive.count += any;
  }
}

// Stores the new transmittances; notes when the vector's last pixel has finished.
HWY_INLINE void update(const Hit& hit, size_t at, SurfelWorkspace& ws, Alive& alive) {
  store(hit.after, ws.transmittance + at);
  if (!hn::AllFalse(df, hit.finished) && hn::AllFalse(df, hn::Gt(hit.after, hn::Zero(df)))) {
    alive.chunk[at / kLanes] = 0;
    --alive.count;
  }
}

// Calls visit(surfel, record, row start, dx, offset in the tile) for every vector of pixels that
// the tile's surfels reach, front to back, and before/after each surfel begin(surfel) and
// end(surfel).
template <class Visit, class Begin, class End>
HWY_INLINE void walk(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws,
                     Alive& alive, const Visit& visit, const Begin& begin, const End& end) {
  RowSpans spans;
  for (size_t e = 0; e < tile.count && alive.count != 0; ++e) {
    const uint32_t surfel = tile.entries[e];
    const SurfelRecord& r = scene.records[surfel];
    find_spans(r, scene.outlines[surfel], tile, spans);
    begin(surfel);
    const float dy0 = static_cast<float>(tile.y) + 0.5f - r.anchor_y;
    const float dx0 = static_cast<float>(tile.x) + 0.5f - r.anchor_x;
    for (size_t y = 0; y < static_cast<size_t>(tile.height); ++y) {
      if (spans.first[y] > spans.last[y]) continue;
      const RowStart row = start_row(r, dy0 + static_cast<float>(y));
      const auto last = static_cast<size_t>(spans.last[y]);
      for (size_t x = static_cast<size_t>(spans.first[y]) / kLanes * kLanes; x <= last;
           x += kLanes) {
        const size_t at = y * kTile + x;
        if (!alive.chunk[at / kLanes]) continue;
        const Vf dx = hn::Iota(df, dx0 + static_cast<float>(x));
        visit(surfel, r, row, dx, at);
      }
    }
    end(surfel);
    ws.used = e + 1;
  }
}

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

HWY_INLINE void texture_uv(const SurfelRecord& r, const Hit& hit, Vf& u, Vf& v) {
  const auto at = [&](int k) HWY_ATTR { return set(r.uv_per_st[k]); };
  u = hn::MulAdd(at(0), hit.u, hn::MulAdd(at(1), hit.v, set(r.uv[0])));
  v = hn::MulAdd(at(2), hit.u, hn::MulAdd(at(3), hit.v, set(r.uv[1])));
}

// Material and tangent-space normal of a vector of pixels, channel by channel.
struct Material {
  Vf channel[5];
  Vf nx, ny, nz;
};

HWY_INLINE Material unpack(const TexelLanes& lanes) {
  Material m;
  Vf spare;
  hn::LoadInterleaved4(df, lanes.low, m.channel[0], m.channel[1], m.channel[2], m.channel[3]);
  hn::LoadInterleaved4(df, lanes.high, m.channel[4], m.nx, m.ny, spare);
  const Vf rest = hn::NegMulAdd(m.nx, m.nx, hn::NegMulAdd(m.ny, m.ny, set(1.0f)));
  m.nz = hn::Sqrt(hn::Max(rest, hn::Zero(df)));
  return m;
}

template <bool kLowPass, bool kShade, bool kLists>
HWY_INLINE void forward_walk(const SurfelScene& scene, const SurfelTile& tile,
                             SurfelWorkspace& ws) {
  Alive alive;
  begin_tile(tile, ws, alive);
  const TextureGrid grid(scene);
  Taps taps;
  TexelLanes texel = {};
  int64_t pairs = 0;
  const auto visit = [&](uint32_t, const SurfelRecord& r, const RowStart& row, Vf dx,
                         size_t at) HWY_ATTR {
    const Hit hit = intersect<kLowPass>(r, row, dx, load(ws.transmittance + at), scene.near);
    update(hit, at, ws, alive);
    const uint32_t bits = bits_of(hit.blended);
    if (bits == 0) return;
    Vf u, v;
    texture_uv(r, hit, u, v);
    if constexpr (kLists) append(hit.weight, u, v, bits, at, scene.uv_threshold, ws);
    if constexpr (kShade) {
      pairs += static_cast<int64_t>(hwy::PopCount(bits));
      Mf inside_x, inside_y;
      place_taps(grid, u, v, taps, inside_x, inside_y);
      sample(grid, taps, bits, texel);
      const Material m = unpack(texel);
      const Vf w = hit.weight;
      add_to(ws.out[kAlpha] + at, w);
      add_product(ws.out[kDepth] + at, w, hit.z);
      for (int k = 0; k < 5; ++k) add_product(ws.out[kAlbedo + k] + at, w, m.channel[k]);
      const Vf wx = hn::Mul(w, m.nx), wy = hn::Mul(w, m.ny), wz = hn::Mul(w, m.nz);
      for (int k = 0; k < 3; ++k) {
        add_product(ws.out[kNormal + k] + at, w, set(r.normal[k]));
        const Vf tangent = hn::MulAdd(wx, set(r.frame[k]), load(ws.out[kMappedNormal + k] + at));
        store(hn::MulAdd(wz, set(r.frame[6 + k]), hn::MulAdd(wy, set(r.frame[3 + k]), tangent)),
              ws.out[kMappedNormal + k] + at);
      }
      add_product(ws.out[kUv] + at, w, u);
      add_product(ws.out[kUv + 1] + at, w, v);
    }
  };
  const auto nothing = [](uint32_t) HWY_ATTR {};
  walk(scene, tile, ws, alive, visit, nothing, nothing);
  ws.pairs = pairs;
}

template <bool kLowPass>
void forward_tile(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws) {
  std::memset(ws.out, 0, sizeof(ws.out));
  if (scene.uv_distortion == UvDistortion::kOff) {
    forward_walk<kLowPass, true, false>(scene, tile, ws);
    return;
  }
  begin_lists(tile, false, ws);
  forward_walk<kLowPass, true, true>(scene, tile, ws);
  if (tile.count == 0) return;
  for (size_t at = 0; at < kTilePixels; at += kLanes)
    store(distortion(at, scene.uv_distortion == UvDistortion::kSquared, ws),
          ws.out[kUvDistortion] + at);
}

void forward(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws) {
  if (scene.low_pass)
    forward_tile<true>(scene, tile, ws);
  else
    forward_tile<false>(scene, tile, ws);
}

// One surfel's gradient sums, a vector each.
struct Sums {
  HWY_ALIGN float lanes[SurfelSums::kCount * kLanes];
  HWY_INLINE float* at(int k) { return lanes + static_cast<size_t>(k) * kLanes; }
};

// Derivative of the distortion of the lanes' next list entries: dL/dw, dL/du, dL/dv.
HWY_INLINE void take_listed(uint32_t bits, size_t at, SurfelWorkspace& ws, Vf& h, Vf& qu, Vf& qv) {
  HWY_ALIGN float ah[kLanes] = {}, au[kLanes] = {}, av[kLanes] = {};
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const size_t pixel = at + lane;
    const int32_t n = ws.cursor[pixel]++;
    if (n >= ws.listed[pixel]) continue;
    const size_t slot = static_cast<size_t>(n) * kTilePixels + pixel;
    ah[lane] = ws.list_h[slot];
    au[lane] = ws.list_qu[slot];
    av[lane] = ws.list_qv[slot];
  }
  h = load(ah);
  qu = load(au);
  qv = load(av);
}

// Everything backward needs at hand while it replays a tile.
struct Replay {
  const SurfelScene& scene;
  SurfelWorkspace& ws;
  const SurfelGradientBuffers& buffers;
  TextureGrid grid;
  Taps taps = {};
  TexelLanes value = {}, along_x = {}, along_y = {}, d_texel = {};
  Sums sums = {};
  bool any = false;

  Replay(const SurfelScene& s, SurfelWorkspace& w, const SurfelGradientBuffers& b)
      : scene(s), ws(w), buffers(b), grid(s) {}
};

// Texel gradients of one vector: scatters them, adds to the frame's sums, and returns the
// derivatives with respect to texture u and v.
HWY_INLINE void texture_backward(Replay& replay, const SurfelRecord& r, const Material& m, Vf w,
                                 uint32_t bits, size_t at, Mf inside_x, Mf inside_y, Vf& du,
                                 Vf& dv) {
  SurfelWorkspace& ws = replay.ws;
  Sums& sums = replay.sums;
  const Vf zero = hn::Zero(df);
  const Vf wx = hn::Mul(w, m.nx), wy = hn::Mul(w, m.ny), wz = hn::Mul(w, m.nz);
  Vf along_t = zero, along_b = zero, along_n = zero;
  for (int k = 0; k < 3; ++k) {
    const Vf g = load(ws.grad[kMappedNormal + k] + at);
    add_product(sums.at(SurfelSums::kFrame + k), wx, g);
    add_product(sums.at(SurfelSums::kFrame + 3 + k), wy, g);
    add_product(sums.at(SurfelSums::kFrame + 6 + k), wz, g);
    along_t = hn::MulAdd(set(r.frame[k]), g, along_t);
    along_b = hn::MulAdd(set(r.frame[3 + k]), g, along_b);
    along_n = hn::MulAdd(set(r.frame[6 + k]), g, along_n);
  }
  // n_z = sqrt(1 - x^2 - y^2), constant 0 beyond the unit circle.
  const Vf upright = hn::IfThenElseZero(hn::Gt(m.nz, zero), hn::Div(along_n, m.nz));
  const Vf d_nx = hn::Mul(w, hn::NegMulAdd(m.nx, upright, along_t));
  const Vf d_ny = hn::Mul(w, hn::NegMulAdd(m.ny, upright, along_b));
  Vf d[5];
  for (int k = 0; k < 5; ++k) d[k] = hn::Mul(w, load(ws.grad[kAlbedo + k] + at));
  hn::StoreInterleaved4(d[0], d[1], d[2], d[3], df, replay.d_texel.low);
  hn::StoreInterleaved4(d[4], d_nx, d_ny, zero, df, replay.d_texel.high);
  scatter(replay.grid, replay.taps, bits, replay.d_texel, replay.buffers);

  const auto slope = [&](const TexelLanes& lanes) HWY_ATTR {
    Vf c0, c1, c2, c3, c4, c5, c6, c7;
    hn::LoadInterleaved4(df, lanes.low, c0, c1, c2, c3);
    hn::LoadInterleaved4(df, lanes.high, c4, c5, c6, c7);
    Vf sum = hn::MulAdd(d[0], c0, hn::MulAdd(d[1], c1, hn::Mul(d[2], c2)));
    sum = hn::MulAdd(d[3], c3, hn::MulAdd(d[4], c4, sum));
    return hn::MulAdd(d_nx, c5, hn::MulAdd(d_ny, c6, sum));
  };
  du = hn::IfThenElseZero(inside_x, hn::Mul(slope(replay.along_x), set(replay.grid.width)));
  dv = hn::IfThenElseZero(inside_y, hn::Mul(slope(replay.along_y), set(replay.grid.height)));
}

// From the derivatives with respect to alpha, depth and texture uv to the surfel's sums.
template <bool kLowPass>
HWY_INLINE void geometry_backward(Sums& sums, const SurfelRecord& r, const Hit& hit, Vf dx,
                                  float dy, Vf d_alpha, Vf d_z, Vf d_tu, Vf d_tv) {
  const Vf scaled = hn::Mul(d_alpha, hit.alpha);
  add_to(sums.at(SurfelSums::kOpacity), scaled);
  add_to(sums.at(SurfelSums::kUv), d_tu);
  add_to(sums.at(SurfelSums::kUv + 1), d_tv);
  add_product(sums.at(SurfelSums::kUvPerSt), d_tu, hit.u);
  add_product(sums.at(SurfelSums::kUvPerSt + 1), d_tu, hit.v);
  add_product(sums.at(SurfelSums::kUvPerSt + 2), d_tv, hit.u);
  add_product(sums.at(SurfelSums::kUvPerSt + 3), d_tv, hit.v);
  // d alpha / d rho = -alpha / 2; rho = u^2 + v^2.
  const Vf d_u = hn::NegMulAdd(
      scaled, hit.u, hn::MulAdd(set(r.uv_per_st[0]), d_tu, hn::Mul(set(r.uv_per_st[2]), d_tv)));
  const Vf d_v = hn::NegMulAdd(
      scaled, hit.v, hn::MulAdd(set(r.uv_per_st[1]), d_tu, hn::Mul(set(r.uv_per_st[3]), d_tv)));
  const Vf d_a = hn::Mul(d_u, hit.inverse), d_b = hn::Mul(d_v, hit.inverse);
  const Vf d_depth = hn::Mul(d_z, hit.inverse);
  const Vf d_c = hn::Neg(hn::MulAdd(d_a, hit.u, hn::MulAdd(d_b, hit.v, hn::Mul(d_depth, hit.z))));
  const Vf y = set(dy);
  const auto affine = [&](int k, Vf g) HWY_ATTR {
    add_to(sums.at(k), g);
    add_product(sums.at(k + 1), g, dx);
    add_product(sums.at(k + 2), g, y);
  };
  affine(SurfelSums::kA, d_a);
  affine(SurfelSums::kB, d_b);
  affine(SurfelSums::kC, d_c);
  add_to(sums.at(SurfelSums::kDepth), d_depth);
  if constexpr (kLowPass) {
    const Mf filtered = hn::And(hit.low_pass, hit.blended);
    if (hn::AllFalse(df, filtered)) return;
    // rho = 2 (ex^2 + ey^2), ex = x - centre: d alpha / d centre_x = 2 alpha ex.
    const Vf twice = hn::IfThenElseZero(filtered, hn::Add(scaled, scaled));
    add_product(sums.at(SurfelSums::kScreen), twice, hit.ex);
    add_product(sums.at(SurfelSums::kScreen + 1), twice, hit.ey);
    add_to(sums.at(SurfelSums::kCenterZ), hn::IfThenElseZero(filtered, d_z));
  }
}

template <bool kLowPass, bool kLists>
HWY_INLINE void replay_vector(Replay& replay, const SurfelRecord& r, const Hit& hit, uint32_t bits,
                              Vf dx, float dy, size_t at) {
  SurfelWorkspace& ws = replay.ws;
  const auto grad = [&](int plane) HWY_ATTR { return load(ws.grad[plane] + at); };
  Vf u, v;
  texture_uv(r, hit, u, v);
  Mf inside_x, inside_y;
  place_taps(replay.grid, u, v, replay.taps, inside_x, inside_y);
  sample_with_slopes(replay.grid, replay.taps, bits, replay.value, replay.along_x, replay.along_y);
  const Material m = unpack(replay.value);
  const Vf w = hit.weight;

  // dL/dw of this surfel.
  const Vf g_z = grad(kDepth), g_u = grad(kUv), g_v = grad(kUv + 1);
  Vf d_w = hn::MulAdd(g_z, hit.z, grad(kAlpha));
  for (int k = 0; k < 5; ++k) d_w = hn::MulAdd(grad(kAlbedo + k), m.channel[k], d_w);
  for (int k = 0; k < 3; ++k) {
    const Vf mapped =
        hn::MulAdd(m.nx, set(r.frame[k]),
                   hn::MulAdd(m.ny, set(r.frame[3 + k]), hn::Mul(m.nz, set(r.frame[6 + k]))));
    d_w = hn::MulAdd(grad(kMappedNormal + k), mapped, d_w);
    const Vf g_n = grad(kNormal + k);
    d_w = hn::MulAdd(g_n, set(r.normal[k]), d_w);
    add_product(replay.sums.at(SurfelSums::kNormal + k), w, g_n);
  }
  d_w = hn::MulAdd(g_u, u, hn::MulAdd(g_v, v, d_w));
  Vf d_tu, d_tv;
  texture_backward(replay, r, m, w, bits, at, inside_x, inside_y, d_tu, d_tv);
  d_tu = hn::MulAdd(w, g_u, d_tu);
  d_tv = hn::MulAdd(w, g_v, d_tv);
  if constexpr (kLists) {
    Vf h, qu, qv;
    take_listed(bits, at, ws, h, qu, qv);
    const Vf g = grad(kUvDistortion), weighted = hn::Mul(w, g);
    d_w = hn::MulAdd(g, h, d_w);
    d_tu = hn::MulAdd(weighted, qu, d_tu);
    d_tv = hn::MulAdd(weighted, qv, d_tv);
  }

  // w = alpha T, and every later weight carries (1 - alpha).
  const Vf later = hn::NegMulAdd(w, d_w, load(ws.remaining + at));
  store(later, ws.remaining + at);
  const Vf through = hn::Div(later, hn::Sub(set(1.0f), hit.alpha));
  const Mf free = hn::And(hit.blended, hn::Lt(hit.alpha, set(kMaxAlpha)));
  const Vf d_alpha = hn::IfThenElseZero(free, hn::MulSub(hit.before, d_w, through));
  geometry_backward<kLowPass>(replay.sums, r, hit, dx, dy, d_alpha, hn::Mul(w, g_z), d_tu, d_tv);
}

template <bool kLowPass, bool kLists>
void backward_tile(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws,
                   const SurfelGradientBuffers& buffers) {
  if constexpr (kLists) {
    begin_lists(tile, true, ws);
    forward_walk<kLowPass, false, true>(scene, tile, ws);
    for (size_t at = 0; at < kTilePixels; at += kLanes)
      distortion_backward(at, scene.uv_distortion == UvDistortion::kSquared, ws);
  }
  Alive alive;
  begin_tile(tile, ws, alive);
  Replay replay(scene, ws, buffers);
  const auto begin = [&](uint32_t) HWY_ATTR {
    std::memset(replay.sums.lanes, 0, sizeof(replay.sums.lanes));
    replay.any = false;
  };
  const auto visit = [&](uint32_t, const SurfelRecord& r, const RowStart& row, Vf dx,
                         size_t at) HWY_ATTR {
    const Hit hit = intersect<kLowPass>(r, row, dx, load(ws.transmittance + at), scene.near);
    update(hit, at, ws, alive);
    const uint32_t bits = bits_of(hit.blended);
    if (bits == 0) return;
    replay.any = true;
    replay_vector<kLowPass, kLists>(replay, r, hit, bits, dx, row.dy, at);
  };
  const auto end = [&](uint32_t surfel) HWY_ATTR {
    if (!replay.any) return;
    float* sums = buffers.sums + static_cast<size_t>(surfel) * SurfelSums::kCount;
    for (int k = 0; k < SurfelSums::kCount; ++k)
      sums[k] += hn::GetLane(hn::SumOfLanes(df, load(replay.sums.at(k))));
  };
  walk(scene, tile, ws, alive, visit, begin, end);
}

void backward(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws,
              const SurfelGradientBuffers& buffers) {
  const bool lists = scene.uv_distortion != UvDistortion::kOff;
  if (scene.low_pass)
    lists ? backward_tile<true, true>(scene, tile, ws, buffers)
          : backward_tile<true, false>(scene, tile, ws, buffers);
  else
    lists ? backward_tile<false, true>(scene, tile, ws, buffers)
          : backward_tile<false, false>(scene, tile, ws, buffers);
}

SurfelKernels kernels() {
  return {&forward, &backward, hwy::TargetName(HWY_TARGET)};
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // per-target include guard
