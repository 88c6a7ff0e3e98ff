// What the rasterizer's passes share, written with Highway: a vector holds neighbouring pixels of
// one row of a tile; walking a tile's surfels, meeting one of them, looking up the texture.

#if defined(EFFIGY_SPLAT_SURFEL_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_SURFEL_LANES_INL_H_
#undef EFFIGY_SPLAT_SURFEL_LANES_INL_H_
#else
#define EFFIGY_SPLAT_SURFEL_LANES_INL_H_
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

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
