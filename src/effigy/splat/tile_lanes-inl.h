// What the kernels of the surfel and the Gaussian rasterizer share, written with Highway: the
// pixels of a tile as vectors, which of them a splat reaches, transposes, loads and stores.

#if defined(EFFIGY_SPLAT_TILE_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_TILE_LANES_INL_H_
#undef EFFIGY_SPLAT_TILE_LANES_INL_H_
#else
#define EFFIGY_SPLAT_TILE_LANES_INL_H_
#endif

#include <algorithm>
#include <cstring>

#include "effigy/splat/tile_bins.h"
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

// Position of each lane in its vector's pixels.
HWY_INLINE Vf lane_x() {
  return hn::ConvertTo(df, hn::And(hn::Iota(di, 0), hn::Set(di, static_cast<int32_t>(kWide - 1))));
}
HWY_INLINE Vf lane_y() {
  constexpr int kBits = kWide == 4 ? 2 : 0;
  return hn::ConvertTo(df, hn::ShiftRight<kBits>(hn::Iota(di, 0)));
}

// Which rows of which columns of vectors a splat can reach: bit y of reach[j] is set when the
// vector of column j whose top row is y has a pixel inside the outline.
struct Reach {
  uint32_t rows[kColumns];
};

// x-range of the ellipse in the rows at `y` (pixel centres - anchor); empty (left > right) outside.
HWY_INLINE void ellipse_rows(const EllipseOutline& o, Vf y, Vf& left, Vf& right) {
  const Vf dy = hn::Sub(y, set(o.y));
  const Vf q = hn::NegMulAdd(hn::Mul(dy, dy), set(o.inverse_yy), set(1.0f));
  const Vf half = hn::Sqrt(hn::Mul(hn::Max(q, hn::Zero(df)), set(o.k)));
  const Vf middle = hn::MulAdd(set(o.slope), dy, set(o.x));
  const Mf inside = hn::Ge(q, hn::Zero(df));
  left = hn::IfThenElse(inside, hn::Sub(middle, half), set(1e6f));
  right = hn::IfThenElse(inside, hn::Add(middle, half), set(-1e6f));
}

// Notes rows row .. row + kLanes - 1, reached from `left` to `right` (x - anchor); `to_column`:
// from there to the tile's columns of pixels.
HWY_INLINE void reach_rows(const SplatTile& tile, size_t row, Vf left, Vf right, Vf to_column,
                           Reach& reach) {
  // First and last column of pixels; a vector is reached when it has one of them or lies between.
  const Vf first = hn::Ceil(hn::Add(left, to_column));
  const Vf last =
      hn::Min(hn::Floor(hn::Add(right, to_column)), set(static_cast<float>(tile.width - 1)));
  const Mf some = hn::Le(first, last);
  for (size_t j = 0; j < kColumns; ++j) {
    const auto begin = static_cast<float>(j * kWide);
    const Mf here = hn::And(hn::Le(first, set(begin + static_cast<float>(kWide - 1))),
                            hn::Ge(last, set(begin)));
    reach.rows[j] |= bits_of(hn::And(some, here)) << row;
  }
}

// Before reach_rows; all of the tile when the outline is unknown.
HWY_INLINE void begin_reach(const SplatTile& tile, bool everywhere, Reach& reach) {
  for (size_t j = 0; j < kColumns; ++j)
    reach.rows[j] = everywhere && static_cast<int>(j * kWide) < tile.width ? 0xffffu : 0;
}

// After reach_rows: from rows to vectors.
HWY_INLINE void end_reach(const SplatTile& tile, Reach& reach) {
  const uint32_t tall = (uint32_t{1} << tile.height) - 1;
  // A vector is reached when one of its rows is.
  for (size_t j = 0; j < kColumns; ++j) {
    const uint32_t bits = reach.rows[j] & tall;
    if constexpr (kTall == 1) reach.rows[j] = bits;
    if constexpr (kTall == 2) reach.rows[j] = (bits | bits >> 1) & 0x5555u;
    if constexpr (kTall == 4) reach.rows[j] = (bits | bits >> 1 | bits >> 2 | bits >> 3) & 0x1111u;
  }
}

// Which vectors of the tile still have a pixel to fill, column by column.
struct Alive {
  uint32_t rows[kColumns] = {};  // bit y: the vector whose top row is y
  size_t count = 0;

  HWY_INLINE void add(size_t vector) {
    rows[vector % kColumns] |= uint32_t{1} << (vector / kColumns * kTall);
    ++count;
  }
  HWY_INLINE void remove(size_t vector) {
    rows[vector % kColumns] &= ~(uint32_t{1} << (vector / kColumns * kTall));
    --count;
  }
};

// A set of vectors of a tile: bit n % 32 of word n / 32 is vector n.
constexpr size_t kVectors = kTilePixels / kLanes;
constexpr size_t kWords = HWY_MAX(size_t{1}, kVectors / 32);
struct VectorSet {
  uint32_t words[kWords] = {};
  size_t count = 0;

  HWY_INLINE void add(size_t vector) {
    words[vector / 32] |= uint32_t{1} << vector % 32;
    ++count;
  }
  HWY_INLINE void remove(size_t vector) {
    words[vector / 32] &= ~(uint32_t{1} << vector % 32);
    --count;
  }
};

// The vectors that have a pixel inside the ellipse; (x, y): centre of the tile's first pixel -
// anchor. What lies outside the image is not left out.
HWY_INLINE void vectors_in_ellipse(const EllipseOutline& o, float x, float y, uint32_t* words) {
  // A lane is a row of vectors; the rows of a word.
  constexpr size_t kRows = kTile / kTall / kWords;
  const hn::RebindToUnsigned<Df> du;
  const Vf to_column = set(-x), last_column = set(static_cast<float>(kTile - 1));
  const Vf zero = hn::Zero(df);
  const auto all = hn::Set(du, ~uint32_t{0});
  const auto lane = hn::Iota(du, 0);
  // Where the bits of each lane's row go.
  const auto place = hn::ShiftLeft < kColumns == 4 ? 2 : 4 > (lane);
  for (size_t w = 0; w < kWords; ++w) {
    uint32_t word = 0;
    for (size_t k = 0; k < kRows; k += kLanes) {
      Vf left = set(1e6f), right = set(-1e6f);
      for (size_t t = 0; t < kTall; ++t) {
        const float top = y + static_cast<float>((w * kRows + k) * kTall + t);
        const Vf rows = hn::MulAdd(hn::Iota(df, 0.0f), set(static_cast<float>(kTall)), set(top));
        Vf l, r;
        ellipse_rows(o, rows, l, r);
        left = hn::Min(left, l);
        right = hn::Max(right, r);
      }
      // First and last column of pixels, then of vectors.
      const Vf first = hn::Max(hn::Ceil(hn::Add(left, to_column)), zero);
      const Vf last = hn::Min(hn::Floor(hn::Add(right, to_column)), last_column);
      const auto column = [&](Vf f) HWY_ATTR {
        return hn::ShiftRight < kWide == 4 ? 2 : 0 > (hn::BitCast(du, hn::ConvertTo(di, f)));
      };
      const auto from = column(hn::Min(first, last_column));
      const auto to = hn::Sub(hn::Set(du, 31), column(hn::Max(last, zero)));
      auto some = hn::RebindMask(du, hn::Le(first, last));
      if constexpr (kRows < kLanes)
        some = hn::And(
            some, hn::RebindMask(du, hn::Lt(hn::Iota(df, 0.0f), set(static_cast<float>(kRows)))));
      const auto row = hn::And(hn::operator<<(all, from), hn::operator>>(all, to));
      // The rows' bits do not overlap.
      const auto bits = hn::operator<<(hn::IfThenElseZero(some, row), place);
      word |= hn::GetLane(hn::SumOfLanes(du, bits)) << (k * kColumns);
    }
    words[w] = word;
  }
}

// Sets the transmittance, which of the vector of pixels `at` is at block[at * planes + plane *
// kLanes], to 1 inside the image and to `outside` elsewhere.
template <class Vectors>
HWY_INLINE void begin_tile(const SplatTile& tile, size_t planes, size_t plane, float outside,
                           float* block, Vectors& alive) {
  alive = Vectors();
  for (size_t y = 0; y < kTile; y += kTall) {
    for (size_t j = 0; j < kColumns; ++j) {
      const size_t vector = y / kTall * kColumns + j;
      const auto left = static_cast<float>(tile.width - static_cast<int>(j * kWide));
      const auto below = static_cast<float>(tile.height - static_cast<int>(y));
      const Mf inside = hn::And(hn::Lt(lane_x(), set(left)), hn::Lt(lane_y(), set(below)));
      store(hn::IfThenElse(inside, set(1.0f), set(outside)),
            block + (vector * planes + plane) * kLanes);
      if (!hn::AllFalse(df, inside)) alive.add(vector);
    }
  }
}

// Copies plane `c` of the tile's block of `planes` planes to `image`, a plane of rows of `row_size`
// floats; that of vector `at` is at block[at * planes + c * kLanes].
HWY_INLINE void store_plane(const SplatTile& tile, const float* block, size_t planes, size_t c,
                            float* image, size_t row_size) {
  for (size_t y = 0; y < static_cast<size_t>(tile.height); ++y) {
    float* to = image + (static_cast<size_t>(tile.y) + y) * row_size + static_cast<size_t>(tile.x);
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

// One row of a vector's pixels, of which `left` remain in the image; zeros beyond.
HWY_INLINE hn::Vec<Dw> load_row(const float* p, size_t left) {
  if (left >= kWide) return hn::LoadU(dw, p);
  HWY_ALIGN float some[kWide] = {};
  std::copy_n(p, left, some);
  return hn::Load(dw, some);
}

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

// to[k] += the sum of the lanes of vector k of `lanes`, for `count` vectors (a multiple of 8).
HWY_INLINE void add_lane_sums(const float* lanes, size_t count, float* to) {
#if HWY_TARGET != HWY_SCALAR && HWY_MAX_BYTES == 32
  for (size_t k = 0; k < count; k += 8) {
    const Channels t = transpose(lanes + k * kLanes);
    const Vf a = hn::Add(hn::Add(t.c0, t.c1), hn::Add(t.c2, t.c3));
    const Vf b = hn::Add(hn::Add(t.c4, t.c5), hn::Add(t.c6, t.c7));
    hn::StoreU(hn::Add(hn::LoadU(df, to + k), hn::Add(a, b)), df, to + k);
  }
#else
  for (size_t k = 0; k < count; ++k)
    to[k] += hn::GetLane(hn::SumOfLanes(df, load(lanes + k * kLanes)));
#endif
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
