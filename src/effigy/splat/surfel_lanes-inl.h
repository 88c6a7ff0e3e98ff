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
#include <type_traits>
#include "effigy/splat/surfel_kernels.h"
#include "hwy/cache_control.h"
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
// A vector covers kWide x kTall pixels: a compact shape wastes fewer lanes along a surfel's
// outline. Vector (j, y / kTall) of the tile has the number y / kTall * kColumns + j; its pixels'
// data start at that number times kLanes ("at").
constexpr size_t kWide = kLanes < 4 ? kLanes : 4;
constexpr size_t kTall = kLanes / kWide;
constexpr size_t kColumns = kTile / kWide;
using Dw = hn::CappedTag<float, kWide>;  // one row of a vector's pixels
constexpr Dw dw;
// One texel: 8 floats in one vector, or in as many as the target needs.
using Dt = hn::CappedTag<float, 8>;
constexpr Dt dt;
constexpr size_t kTexelLanes = hn::MaxLanes(Dt());

constexpr float kMaxAlpha = 0.99f;
constexpr float kMinTransmittance = 1e-4f;
constexpr float kRoundingShift = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer

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

// 2^x for x in [-126, 1], relative error below 2e-7: Chebyshev polynomial of degree 5 on
// [-1/2, 1/2]. Garbage (but no trap) beyond.
HWY_INLINE Vf exp2_fast(Vf x) {
  const Vf shifted = hn::Add(x, set(kRoundingShift));
  const Vf f = hn::Sub(x, hn::Sub(shifted, set(kRoundingShift)));
  Vf p = set(0.0013390863f);
  p = hn::MulAdd(p, f, set(0.0096760319f));
  p = hn::MulAdd(p, f, set(0.0555035711f));
  p = hn::MulAdd(p, f, set(0.2402210749f));
  p = hn::MulAdd(p, f, set(0.6931471880f));
  p = hn::MulAdd(p, f, set(1.0000000755f));
  // The low bits of `shifted` are the integer part.
  const Vi exponent = hn::ShiftLeft<23>(hn::BitCast(di, shifted));
  return hn::BitCast(df, hn::Add(hn::BitCast(di, p), exponent));
}

// The rows of a tile as one surfel sees them: its affine functions at dx = 0, and which vectors of
// pixels it can reach.
struct SurfelRows {
  HWY_ALIGN float a[kTile];
  HWY_ALIGN float b[kTile];
  HWY_ALIGN float c[kTile];
  HWY_ALIGN float y[kTile];  // pixel centre - anchor
  uint32_t reach[kColumns];  // bit y: the vector of this column whose top row is y
};

HWY_INLINE void find_rows(const SurfelRecord& r, const SurfelOutline& o, const SurfelTile& tile,
                          SurfelRows& rows) {
  const float top = static_cast<float>(tile.y) + 0.5f - r.anchor_y;
  const Vf to_column = set(r.anchor_x - static_cast<float>(tile.x) - 0.5f);
  const Vf zero = hn::Zero(df), one = set(1.0f);
  const uint32_t tall = (uint32_t{1} << tile.height) - 1;
  for (size_t j = 0; j < kColumns; ++j)
    rows.reach[j] = o.everywhere && static_cast<int>(j * kWide) < tile.width ? tall : 0;
  for (size_t row = 0; row < kTile; row += kLanes) {
    const Vf y = hn::Iota(df, top + static_cast<float>(row));
    store(hn::MulAdd(set(r.a[2]), y, set(r.a[0])), rows.a + row);
    store(hn::MulAdd(set(r.b[2]), y, set(r.b[0])), rows.b + row);
    store(hn::MulAdd(set(r.c[2]), y, set(r.c[0])), rows.c + row);
    store(y, rows.y + row);
    if (o.everywhere) continue;
    const Vf dy = hn::Sub(y, set(o.y));
    const Vf q = hn::NegMulAdd(hn::Mul(dy, dy), set(o.inverse_yy), one);
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
    // First and last column of pixels; a vector is reached when it has one of them or lies between.
    const Vf first = hn::Ceil(hn::Add(left, to_column));
    const Vf last =
        hn::Min(hn::Floor(hn::Add(right, to_column)), set(static_cast<float>(tile.width - 1)));
    const Mf some = hn::Le(first, last);
    for (size_t j = 0; j < kColumns; ++j) {
      const auto begin = static_cast<float>(j * kWide);
      const Mf here = hn::And(hn::Le(first, set(begin + static_cast<float>(kWide - 1))),
                              hn::Ge(last, set(begin)));
      rows.reach[j] |= (bits_of(hn::And(some, here)) << row) & tall;
    }
  }
  // A vector is reached when one of its rows is.
  for (size_t j = 0; j < kColumns; ++j) {
    const uint32_t bits = rows.reach[j];
    if constexpr (kTall == 2) rows.reach[j] = (bits | bits >> 1) & 0x5555u;
    if constexpr (kTall == 4) rows.reach[j] = (bits | bits >> 1 | bits >> 2 | bits >> 3) & 0x1111u;
  }
}

// Position of each lane in its vector's pixels.
HWY_INLINE Vf lane_x() {
  return hn::ConvertTo(df, hn::And(hn::Iota(di, 0), hn::Set(di, static_cast<int32_t>(kWide - 1))));
}
HWY_INLINE Vf lane_y() {
  constexpr int kBits = kWide == 4 ? 2 : 0;
  return hn::ConvertTo(df, hn::ShiftRight<kBits>(hn::Iota(di, 0)));
}

// One column of vectors as a surfel sees it: dx = pixel centre - anchor, dy beyond the top row, and
// the affine functions' share of both.
struct SurfelColumn {
  Vf dx, dy, a, b, c;

  HWY_INLINE SurfelColumn(const SurfelRecord& r, float first)
      : dx(hn::Add(lane_x(), set(first))),
        dy(lane_y()),
        a(hn::MulAdd(set(r.a[1]), dx, hn::Mul(set(r.a[2]), dy))),
        b(hn::MulAdd(set(r.b[1]), dx, hn::Mul(set(r.b[2]), dy))),
        c(hn::MulAdd(set(r.c[1]), dx, hn::Mul(set(r.c[2]), dy))) {}
};

// One surfel met by a vector of pixels. u, v, z, inverse and weight are 0 in lanes where nothing is
// blended.
struct Hit {
  Vf u, v, z;  // standard deviations, camera depth; u = v = 0 where the low-pass won
  Vf inverse;  // 1 / C; 0 where the low-pass won
  Vf ex, ey;   // pixel - projected centre (low-pass)
  Vf alpha, weight, before, after;  // transmittance before and after
  Mf blended, low_pass, finished;
};

template <bool kLowPass>
HWY_INLINE Hit intersect(const SurfelRecord& r, const SurfelRows& rows, const SurfelColumn& column,
                         size_t y, Vf transmittance, float near) {
  Hit hit;
  const Vf inverse = hn::Div(set(1.0f), hn::Add(column.c, set(rows.c[y])));
  const Vf u = hn::Mul(hn::Add(column.a, set(rows.a[y])), inverse);
  const Vf v = hn::Mul(hn::Add(column.b, set(rows.b[y])), inverse);
  Vf z = hn::Mul(set(r.depth), inverse);
  Vf rho = hn::MulAdd(u, u, hn::Mul(v, v));
  Mf front = hn::Gt(z, set(near));
  if constexpr (kLowPass) {
    hit.ex = hn::Sub(column.dx, set(r.low_pass_x));
    hit.ey = hn::Add(column.dy, set(rows.y[y] - r.low_pass_y));
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
  hit.alpha = hn::Min(exp2_fast(exponent), set(kMaxAlpha));
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

// Meeting surfels, reading the texture and summing up are done for a batch of vectors at a time,
// one after the other: each is a long chain of dependent steps, and only several vectors' chains
// side by side keep the processor busy. A slot is one lane of one vector of the batch.
constexpr size_t kSlots = 64;
constexpr size_t kBatch = kSlots / kLanes;  // vectors

// For every byte, the indices of its set bits, one a byte, lowest first.
struct SetBits {
  uint64_t lanes[256];
  constexpr SetBits() : lanes() {
    for (unsigned bits = 0; bits < 256; ++bits) {
      int count = 0;
      for (unsigned lane = 0; lane < 8; ++lane)
        if (bits >> lane & 1u) lanes[bits] |= uint64_t{lane} << (8 * count++);
    }
  }
};
constexpr SetBits kSetBits;

// Where each slot reads the texture, and what it finds there.
struct TextureBatch {
  HWY_ALIGN int32_t index[kSlots];    // upper-left texel
  HWY_ALIGN float weight[4][kSlots];  // (x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)
  HWY_ALIGN float texel[8 * kSlots];  // interpolated, slot by slot
  uint8_t slot[kSlots + 8];           // the slots that blend
  size_t slots = 0;
};

// One channel of all lanes in each vector.
struct Channels {
  Vf c0, c1, c2, c3, c4, c5, c6, c7;
};

#if HWY_TARGET != HWY_SCALAR
// 4 x 4 transpose within each 128-bit block.
template <class D, class V>
HWY_INLINE void transpose4(D d, V& r0, V& r1, V& r2, V& r3) {
  const hn::Repartition<double, D> wide;
  const auto lower = [&](V a, V b) HWY_ATTR {
    return hn::BitCast(d, hn::InterleaveLower(wide, hn::BitCast(wide, a), hn::BitCast(wide, b)));
  };
  const auto upper = [&](V a, V b) HWY_ATTR {
    return hn::BitCast(d, hn::InterleaveUpper(wide, hn::BitCast(wide, a), hn::BitCast(wide, b)));
  };
  const V a = hn::InterleaveLower(d, r0, r1), b = hn::InterleaveLower(d, r2, r3);
  const V c = hn::InterleaveUpper(d, r0, r1), e = hn::InterleaveUpper(d, r2, r3);
  r0 = lower(a, b);
  r1 = upper(a, b);
  r2 = lower(c, e);
  r3 = upper(c, e);
}
#endif

#if HWY_TARGET != HWY_SCALAR && HWY_MAX_BYTES >= 32
struct EightTexels {
  hn::Vec<Dt> r0, r1, r2, r3, r4, r5, r6, r7;
};

HWY_INLINE EightTexels transpose_rows(EightTexels e) {
  transpose4(dt, e.r0, e.r1, e.r2, e.r3);
  transpose4(dt, e.r4, e.r5, e.r6, e.r7);
  return {hn::ConcatLowerLower(dt, e.r4, e.r0), hn::ConcatLowerLower(dt, e.r5, e.r1),
          hn::ConcatLowerLower(dt, e.r6, e.r2), hn::ConcatLowerLower(dt, e.r7, e.r3),
          hn::ConcatUpperUpper(dt, e.r4, e.r0), hn::ConcatUpperUpper(dt, e.r5, e.r1),
          hn::ConcatUpperUpper(dt, e.r6, e.r2), hn::ConcatUpperUpper(dt, e.r7, e.r3)};
}

HWY_INLINE EightTexels transpose8(const float* from) {
  const auto row = [&](size_t k) HWY_ATTR { return hn::Load(dt, from + 8 * k); };
  return transpose_rows({row(0), row(1), row(2), row(3), row(4), row(5), row(6), row(7)});
}

HWY_INLINE void store_rows(const EightTexels& e, float* to) {
  hn::Store(e.r0, dt, to);
  hn::Store(e.r1, dt, to + 8);
  hn::Store(e.r2, dt, to + 16);
  hn::Store(e.r3, dt, to + 24);
  hn::Store(e.r4, dt, to + 32);
  hn::Store(e.r5, dt, to + 40);
  hn::Store(e.r6, dt, to + 48);
  hn::Store(e.r7, dt, to + 56);
}
#endif

// From kLanes times eight floats, lane by lane, to channel by channel.
HWY_INLINE Channels transpose(const float* p) {
#if HWY_TARGET == HWY_SCALAR
  return {load(p),     load(p + 1), load(p + 2), load(p + 3),
          load(p + 4), load(p + 5), load(p + 6), load(p + 7)};
#elif HWY_MAX_BYTES < 32  // four lanes
  Channels t{load(p),     load(p + 8),  load(p + 16), load(p + 24),
             load(p + 4), load(p + 12), load(p + 20), load(p + 28)};
  transpose4(df, t.c0, t.c1, t.c2, t.c3);
  transpose4(df, t.c4, t.c5, t.c6, t.c7);
  return t;
#elif HWY_MAX_BYTES < 64  // eight
  const EightTexels x = transpose8(p);
  return {x.r0, x.r1, x.r2, x.r3, x.r4, x.r5, x.r6, x.r7};
#else                     // sixteen
  const EightTexels x = transpose8(p), y = transpose8(p + 64);
  const auto both = [](auto lower, auto upper) HWY_ATTR { return hn::Combine(df, upper, lower); };
  return {both(x.r0, y.r0), both(x.r1, y.r1), both(x.r2, y.r2), both(x.r3, y.r3),
          both(x.r4, y.r4), both(x.r5, y.r5), both(x.r6, y.r6), both(x.r7, y.r7)};
#endif
}

// The other way round.
HWY_INLINE void untranspose(Channels t, float* p) {
#if HWY_TARGET == HWY_SCALAR
  store(t.c0, p);
  store(t.c1, p + 1);
  store(t.c2, p + 2);
  store(t.c3, p + 3);
  store(t.c4, p + 4);
  store(t.c5, p + 5);
  store(t.c6, p + 6);
  store(t.c7, p + 7);
#elif HWY_MAX_BYTES < 32  // four lanes
  transpose4(df, t.c0, t.c1, t.c2, t.c3);
  transpose4(df, t.c4, t.c5, t.c6, t.c7);
  store(t.c0, p);
  store(t.c4, p + 4);
  store(t.c1, p + 8);
  store(t.c5, p + 12);
  store(t.c2, p + 16);
  store(t.c6, p + 20);
  store(t.c3, p + 24);
  store(t.c7, p + 28);
#elif HWY_MAX_BYTES < 64  // eight
  store_rows(transpose_rows({t.c0, t.c1, t.c2, t.c3, t.c4, t.c5, t.c6, t.c7}), p);
#else                     // sixteen
  const auto lower = [](Vf v) HWY_ATTR { return hn::LowerHalf(dt, v); };
  const auto upper = [](Vf v) HWY_ATTR { return hn::UpperHalf(dt, v); };
  store_rows(transpose_rows({lower(t.c0), lower(t.c1), lower(t.c2), lower(t.c3), lower(t.c4),
                             lower(t.c5), lower(t.c6), lower(t.c7)}),
             p);
  store_rows(transpose_rows({upper(t.c0), upper(t.c1), upper(t.c2), upper(t.c3), upper(t.c4),
                             upper(t.c5), upper(t.c6), upper(t.c7)}),
             p + 64);
#endif
}

struct TextureGrid {
  const float* texels;
  size_t step_x, step_y;  // floats
  float width, height;
  float last_x, last_y;      // last texel
  float before_x, before_y;  // last texel that has a right (lower) neighbour
  int32_t row;

  explicit TextureGrid(const SurfelScene& scene)
      : texels(scene.texels),
        step_x(scene.texture_width > 1 ? 8 : 0),
        step_y(scene.texture_height > 1 ? 8 * static_cast<size_t>(scene.texture_width) : 0),
        width(static_cast<float>(scene.texture_width)),
        height(static_cast<float>(scene.texture_height)),
        last_x(width - 1.0f),
        last_y(height - 1.0f),
        before_x(std::max(width - 2.0f, 0.0f)),
        before_y(std::max(height - 2.0f, 0.0f)),
        row(scene.texture_width) {}
};

// Where to read the texture, bilinear at (u width - 1/2, v height - 1/2), clamped to the edge
// texels.
struct Taps {
  Vi index;               // upper-left texel
  Vf fx, fy;              // weight of the right and lower neighbours
  Mf inside_x, inside_y;  // lanes where the coordinate was not clamped (where it has a derivative)
};

HWY_INLINE Taps find_taps(const TextureGrid& grid, Vf u, Vf v) {
  Taps taps;
  const Vf zero = hn::Zero(df);
  const Vf x = hn::MulSub(u, set(grid.width), set(0.5f));
  const Vf y = hn::MulSub(v, set(grid.height), set(0.5f));
  const Vf cx = hn::Min(hn::Max(x, zero), set(grid.last_x));
  const Vf cy = hn::Min(hn::Max(y, zero), set(grid.last_y));
  taps.inside_x = hn::Eq(cx, x);
  taps.inside_y = hn::Eq(cy, y);
  const Vf x0 = hn::Min(hn::Floor(cx), set(grid.before_x));
  const Vf y0 = hn::Min(hn::Floor(cy), set(grid.before_y));
  taps.fx = hn::Sub(cx, x0);
  taps.fy = hn::Sub(cy, y0);
  // Whole numbers below 2^23 sit in the low bits after adding 2^23.
  const auto whole = [](Vf f) HWY_ATTR {
    return hn::And(hn::BitCast(di, hn::Add(f, set(8388608.0f))), hn::Set(di, 0x7fffff));
  };
  taps.index = hn::Add(hn::Mul(whole(y0), hn::Set(di, grid.row)), whole(x0));
  return taps;
}

// Notes the taps of vector k of the batch, for the lanes in `mask`.
HWY_INLINE void put_taps(const Taps& taps, Mf mask, size_t k, TextureBatch& batch) {
  const size_t first = k * kLanes;
  const Vf both = hn::Mul(taps.fx, taps.fy);
  const Vf right = hn::Sub(taps.fx, both), below = hn::Sub(taps.fy, both);
  hn::Store(taps.index, di, batch.index + first);
  store(hn::Sub(hn::Sub(set(1.0f), taps.fx), below), batch.weight[0] + first);
  store(right, batch.weight[1] + first);
  store(below, batch.weight[2] + first);
  store(both, batch.weight[3] + first);
  const uint32_t bits = bits_of(mask);
  for (size_t byte = 0; byte < kLanes; byte += 8) {
    const uint64_t lanes = kSetBits.lanes[(bits >> byte) & 255u];
    const uint64_t slots = lanes + (first + byte) * 0x0101010101010101u;
    std::memcpy(batch.slot + batch.slots, &slots, sizeof(slots));
    batch.slots += hwy::PopCount((bits >> byte) & 255u);
  }
}

// Looks up the texture for the batch's slots; the others keep what they held (finite).
HWY_INLINE void sample(const TextureGrid& grid, TextureBatch& batch) {
  const float* const texels = grid.texels;
  const size_t step_x = grid.step_x, step_y = grid.step_y;
  for (size_t k = 0; k < batch.slots; ++k) {
    const auto slot = static_cast<size_t>(batch.slot[k]);
    const float* p = texels + 8 * static_cast<size_t>(batch.index[slot]);
    const float* q = p + step_y;
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto weight = [&](size_t w) HWY_ATTR { return hn::Set(dt, batch.weight[w][slot]); };
      const auto top = hn::MulAdd(weight(1), hn::LoadU(dt, p + step_x + c),
                                  hn::Mul(weight(0), hn::LoadU(dt, p + c)));
      const auto bottom = hn::MulAdd(weight(3), hn::LoadU(dt, q + step_x + c),
                                     hn::Mul(weight(2), hn::LoadU(dt, q + c)));
      hn::Store(hn::Add(top, bottom), dt, batch.texel + 8 * slot + c);
    }
  }
}

// Which vectors of the tile still have a pixel to fill.
struct Alive {
  uint32_t rows[kColumns];  // bit y: the vector whose top row is y
  size_t count;
};

// The transmittance of the vector of pixels `at` is at ws.block[at * planes + plane * kLanes].
HWY_INLINE void begin_tile(const SurfelTile& tile, size_t planes, size_t plane, SurfelWorkspace& ws,
                           Alive& alive) {
  ws.pairs = 0;
  ws.used = 0;
  alive.count = 0;
  for (size_t j = 0; j < kColumns; ++j) alive.rows[j] = 0;
  for (size_t y = 0; y < kTile; y += kTall) {
    for (size_t j = 0; j < kColumns; ++j) {
      const size_t at = (y / kTall * kColumns + j) * kLanes;
      const auto left = static_cast<float>(tile.width - static_cast<int>(j * kWide));
      const auto below = static_cast<float>(tile.height - static_cast<int>(y));
      const Mf inside = hn::And(hn::Lt(lane_x(), set(left)), hn::Lt(lane_y(), set(below)));
      store(hn::IfThenElseZero(inside, set(1.0f)), ws.block + at * planes + plane * kLanes);
      if (hn::AllFalse(df, inside)) continue;
      alive.rows[j] |= uint32_t{1} << y;
      ++alive.count;
    }
  }
}

// Stores the new transmittances; notes when the vector's last pixel has finished.
HWY_INLINE void update(const Hit& hit, float* transmittance, size_t at, Alive& alive) {
  store(hit.after, transmittance);
  if (!hn::AllFalse(df, hit.finished) && hn::AllFalse(df, hn::Gt(hit.after, hn::Zero(df)))) {
    const size_t vector = at / kLanes;
    alive.rows[vector % kColumns] &= ~(uint32_t{1} << (vector / kColumns * kTall));
    --alive.count;
  }
}

// Calls visit(low-pass?, surfel, record, rows, column, top row, at) for every vector of
// pixels that the tile's surfels reach, front to back, and begin(surfel) before each surfel.
template <class Visit, class Begin>
HWY_INLINE void walk(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws,
                     Alive& alive, const Visit& visit, const Begin& begin) {
  SurfelRows rows;
  for (size_t e = 0; e < tile.count && alive.count != 0; ++e) {
    const uint32_t surfel = tile.entries[e];
    const SurfelRecord& r = scene.records[surfel];
    if (e + 1 < tile.count) {
      const SurfelRecord* next = scene.records + tile.entries[e + 1];
      hwy::Prefetch(next);
      hwy::Prefetch(reinterpret_cast<const char*>(next) + 64);
      hwy::Prefetch(reinterpret_cast<const char*>(next) + 128);
      hwy::Prefetch(scene.outlines + tile.entries[e + 1]);
    }
    find_rows(r, scene.outlines[surfel], tile, rows);
    begin(surfel);
    const float dx0 = static_cast<float>(tile.x) + 0.5f - r.anchor_x;
    for (size_t j = 0; j < kColumns; ++j) {
      uint32_t bits = rows.reach[j] & alive.rows[j];
      if (bits == 0) continue;
      const SurfelColumn column(r, dx0 + static_cast<float>(j * kWide));
      const auto each_row = [&](auto low_pass) HWY_ATTR {
        for (; bits != 0; bits &= bits - 1) {
          const size_t y = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
          visit(low_pass, surfel, r, rows, column, y, (y / kTall * kColumns + j) * kLanes);
        }
      };
      if (scene.low_pass && r.filtered)
        each_row(std::true_type());
      else
        each_row(std::false_type());
    }
    ws.used = e + 1;
  }
}

// Copies plane `c` of the tile's block of `planes` planes to plane `to_plane` of the image; that of
// vector `at` is at block[at * planes + c * kLanes].
HWY_INLINE void store_plane(const SurfelScene& scene, const SurfelTile& tile, const float* block,
                            size_t planes, size_t c, size_t to_plane) {
  for (size_t y = 0; y < static_cast<size_t>(tile.height); ++y) {
    float* to = scene.gbuffer + to_plane * scene.plane_size +
                (static_cast<size_t>(tile.y) + y) * scene.row_size + static_cast<size_t>(tile.x);
    const float* from = block + y / kTall * kTile * kTall * planes + c * kLanes + y % kTall * kWide;
    for (size_t x = 0; x < static_cast<size_t>(tile.width); x += kWide) {
      if (x + kWide <= static_cast<size_t>(tile.width))
        hn::StoreU(hn::Load(dw, from), dw, to + x);
      else
        std::copy_n(from, static_cast<size_t>(tile.width) - x, to + x);
      from += planes * kLanes;
    }
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

HWY_INLINE Material unpack(const float* texels) {
  const Channels t = transpose(texels);
  const Vf rest = hn::NegMulAdd(t.c5, t.c5, hn::NegMulAdd(t.c6, t.c6, set(1.0f)));
  return {{t.c0, t.c1, t.c2, t.c3, t.c4}, t.c5, t.c6, hn::Sqrt(hn::Max(rest, hn::Zero(df)))};
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
