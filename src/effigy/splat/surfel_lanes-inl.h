// What the surfel rasterizer's passes share: walking a tile's surfels, meeting one of them, looking
// up the texture.

#if defined(EFFIGY_SPLAT_SURFEL_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_SURFEL_LANES_INL_H_
#undef EFFIGY_SPLAT_SURFEL_LANES_INL_H_
#else
#define EFFIGY_SPLAT_SURFEL_LANES_INL_H_
#endif

#include <algorithm>
#include <cstring>
#include <type_traits>

#include "effigy/splat/surfel_kernels.h"
#include "effigy/splat/tile_lanes-inl.h"
#include "hwy/cache_control.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

// The rows of a tile as one surfel sees them: its affine functions at dx = 0, and which vectors of
// pixels it can reach.
struct SurfelRows {
  HWY_ALIGN float a[kTile];
  HWY_ALIGN float b[kTile];
  HWY_ALIGN float c[kTile];
  HWY_ALIGN float y[kTile];  // pixel centre - anchor
  Reach reach;
};

HWY_INLINE void find_rows(const SurfelRecord& r, const SurfelOutline& o, const SplatTile& tile,
                          SurfelRows& rows) {
  const float top = static_cast<float>(tile.y) + 0.5f - r.anchor_y;
  const Vf to_column = set(r.anchor_x - static_cast<float>(tile.x) - 0.5f);
  begin_reach(tile, o.everywhere, rows.reach);
  for (size_t row = 0; row < kTile; row += kLanes) {
    const Vf y = hn::Iota(df, top + static_cast<float>(row));
    store(hn::MulAdd(set(r.a[2]), y, set(r.a[0])), rows.a + row);
    store(hn::MulAdd(set(r.b[2]), y, set(r.b[0])), rows.b + row);
    store(hn::MulAdd(set(r.c[2]), y, set(r.c[0])), rows.c + row);
    store(y, rows.y + row);
    if (o.everywhere) continue;
    Vf left, right;
    ellipse_rows(o, y, left, right);
    if (o.disc_squared > 0.0f) {
      const Vf ey = hn::Sub(y, set(o.disc_y));
      const Vf rest = hn::NegMulAdd(ey, ey, set(o.disc_squared));
      const Mf in_disc = hn::Ge(rest, hn::Zero(df));
      const Vf reach = hn::Sqrt(hn::Max(rest, hn::Zero(df)));
      left = hn::IfThenElse(in_disc, hn::Min(left, hn::Sub(set(o.disc_x), reach)), left);
      right = hn::IfThenElse(in_disc, hn::Max(right, hn::Add(set(o.disc_x), reach)), right);
    }
    reach_rows(tile, row, left, right, to_column, rows.reach);
  }
  end_reach(tile, rows.reach);
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

HWY_INLINE void begin_surfel_tile(const SplatTile& tile, size_t planes, size_t plane,
                                  SurfelWorkspace& ws, Alive& alive) {
  ws.pairs = 0;
  ws.used = 0;
  begin_tile(tile, planes, plane, 0.0f, ws.block, alive);
}

// Stores the new transmittances; notes when the vector's last pixel has finished.
HWY_INLINE void update(const Hit& hit, float* transmittance, size_t at, Alive& alive) {
  store(hit.after, transmittance);
  if (!hn::AllFalse(df, hit.finished) && hn::AllFalse(df, hn::Gt(hit.after, hn::Zero(df))))
    alive.remove(at / kLanes);
}

// Calls visit(low-pass?, surfel, record, rows, column, top row, at) for every vector of
// pixels that the tile's surfels reach, front to back, and begin(surfel) before each surfel.
template <class Visit, class Begin>
HWY_INLINE void walk(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws,
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
      uint32_t bits = rows.reach.rows[j] & alive.rows[j];
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
