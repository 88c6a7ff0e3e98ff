// The backward pass over one tile: replays the forward walk (same thresholds, same bits) and
// carries the sum of w dL/dw that is still to come, so nothing is stored per pixel and surfel.

#if defined(EFFIGY_SPLAT_SURFEL_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_SURFEL_BACKWARD_INL_H_
#undef EFFIGY_SPLAT_SURFEL_BACKWARD_INL_H_
#else
#define EFFIGY_SPLAT_SURFEL_BACKWARD_INL_H_
#endif

#include "effigy/splat/surfel_forward-inl.h"
#include "effigy/splat/surfel_lanes-inl.h"
#include "effigy/splat/uv_distortion-inl.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

// The block of a vector of pixels: derivatives of the loss with respect to the G-buffer's planes,
// the transmittance, and the sum of w dL/dw over the surfels not yet replayed.
constexpr size_t kBackwardT = kGBufferPlanes;
constexpr size_t kRemaining = kGBufferPlanes + 1;
constexpr size_t kBackwardPlanes = kGBufferPlanes + 2;
static_assert(kBackwardPlanes <= kMostPlanes);

// Loads the tile's derivatives (0 outside the image) and, with the values, the sum of w dL/dw over
// all surfels: outputs are sums of w times something, so it is value times derivative (twice that
// for the distortion, which is of degree two in w).
HWY_INLINE void load_derivatives(const SurfelScene& scene, const SplatTile& tile,
                                 SurfelWorkspace& ws) {
  const size_t used = scene.uv_distortion == UvDistortion::kOff ? kUvDistortion : kGBufferPlanes;
  std::memset(ws.block, 0, sizeof(float) * kTilePixels * kBackwardPlanes);
  for (size_t y = 0; y < static_cast<size_t>(tile.height); ++y) {
    const size_t row =
        (static_cast<size_t>(tile.y) + y) * scene.row_size + static_cast<size_t>(tile.x);
    for (size_t x = 0; x < static_cast<size_t>(tile.width); x += kWide) {
      const size_t at = (y / kTall * kColumns + x / kWide) * kLanes;
      float* const block = ws.block + at * kBackwardPlanes + y % kTall * kWide;
      auto remaining = hn::Zero(dw);
      for (size_t c = 0; c < used; ++c) {
        const size_t from = c * scene.plane_size + row + x;
        const auto d = load_row(scene.d_gbuffer + from, static_cast<size_t>(tile.width) - x);
        const auto value = load_row(scene.gbuffer + from, static_cast<size_t>(tile.width) - x);
        hn::Store(d, dw, block + c * kLanes);
        remaining = hn::MulAdd(c == kUvDistortion ? hn::Add(d, d) : d, value, remaining);
      }
      hn::Store(remaining, dw, block + kRemaining * kLanes);
    }
  }
}

// One surfel's gradient sums, a vector each.
struct Sums {
  HWY_ALIGN float lanes[SurfelSums::kCount * kLanes];
  HWY_INLINE float* at(int k) { return lanes + static_cast<size_t>(k) * kLanes; }
};

// Vectors of pixels that met a surfel: what the later steps need of the meeting.
struct BackwardBatch {
  TextureGrid grid;
  const SurfelGradientBuffers& buffers;
  TextureBatch texture = {};  // texel: the interpolated value
  HWY_ALIGN float fx[kSlots];
  HWY_ALIGN float fy[kSlots];
  HWY_ALIGN float scale_x[kSlots];  // texels per u where it is not clamped, else 0
  HWY_ALIGN float scale_y[kSlots];
  HWY_ALIGN float along_x[8 * kSlots];  // derivative of the value by texels, slot by slot
  HWY_ALIGN float along_y[8 * kSlots];
  HWY_ALIGN float d_texel[8 * kSlots];  // derivative of the loss, slot by slot
  HWY_ALIGN float w[kSlots];
  HWY_ALIGN float z[kSlots];
  HWY_ALIGN float u[kSlots];  // standard deviations
  HWY_ALIGN float v[kSlots];
  HWY_ALIGN float tu[kSlots];  // texture
  HWY_ALIGN float tv[kSlots];
  HWY_ALIGN float inverse[kSlots];
  HWY_ALIGN float alpha[kSlots];  // 0 where nothing is blended
  HWY_ALIGN float before[kSlots];
  HWY_ALIGN float dx[kSlots];
  HWY_ALIGN float dy[kSlots];
  HWY_ALIGN float d_w[kSlots];   // dL/dw
  HWY_ALIGN float d_tu[kSlots];  // dL/d texture uv
  HWY_ALIGN float d_tv[kSlots];
  size_t at[kBatch];
  uint32_t surfel[kBatch];
  size_t count = 0;
  Sums sums = {};  // of surfel `open`
  uint32_t open = ~uint32_t{0};

  BackwardBatch(const SurfelScene& scene, const SurfelGradientBuffers& b)
      : grid(scene), buffers(b) {}
};

// Looks up the texture and its derivatives with respect to the texture coordinates in texels.
HWY_INLINE void sample_with_slopes(BackwardBatch& batch) {
  TextureBatch& texture = batch.texture;
  const float* const texels = batch.grid.texels;
  const size_t step_x = batch.grid.step_x, step_y = batch.grid.step_y;
  for (size_t k = 0; k < texture.slots; ++k) {
    const auto slot = static_cast<size_t>(texture.slot[k]);
    const float* p = texels + 8 * static_cast<size_t>(texture.index[slot]);
    const float* q = p + step_y;
    const auto fx = hn::Set(dt, batch.fx[slot]), fy = hn::Set(dt, batch.fy[slot]);
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto p0 = hn::LoadU(dt, p + c), q0 = hn::LoadU(dt, q + c);
      const auto dp = hn::Sub(hn::LoadU(dt, p + step_x + c), p0);
      const auto dq = hn::Sub(hn::LoadU(dt, q + step_x + c), q0);
      const auto top = hn::MulAdd(fx, dp, p0);
      const auto bottom = hn::MulAdd(fx, dq, q0);
      const auto dy = hn::Sub(bottom, top);
      const size_t at = 8 * slot + c;
      hn::Store(hn::MulAdd(fy, dy, top), dt, texture.texel + at);
      hn::Store(hn::MulAdd(fy, hn::Sub(dq, dp), dp), dt, batch.along_x + at);
      hn::Store(dy, dt, batch.along_y + at);
    }
  }
}

// Adds the slots' texel gradients to the four texels that each read.
HWY_INLINE void scatter(const BackwardBatch& batch) {
  const TextureBatch& texture = batch.texture;
  float* const texels = batch.buffers.texels;
  uint8_t* const touched = batch.buffers.touched;
  const size_t step_x = batch.grid.step_x, step_y = batch.grid.step_y;
  for (size_t k = 0; k < texture.slots; ++k) {
    const auto slot = static_cast<size_t>(texture.slot[k]);
    const auto index = static_cast<size_t>(texture.index[slot]);
    touched[index / kTexelBlock] = 1;
    float* p = texels + 8 * index;
    float* q = p + step_y;
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto g = hn::Load(dt, batch.d_texel + 8 * slot + c);
      const auto add = [&](float* to, size_t w) HWY_ATTR {
        const auto weight = hn::Set(dt, texture.weight[w][slot]);
        hn::StoreU(hn::MulAdd(weight, g, hn::LoadU(dt, to)), dt, to);
      };
      add(p + c, 0);
      add(p + step_x + c, 1);
      add(q + c, 2);
      add(q + step_x + c, 3);
    }
  }
}

// Vector k of the batch: from the derivatives of the outputs to those of w, of the texels (put down
// for scatter), of the texture coordinates, and of the surfel's normal and frame.
template <bool kLists>
HWY_INLINE void outputs_backward(BackwardBatch& batch, const SurfelRecord& r, size_t k,
                                 SurfelWorkspace& ws) {
  const size_t first = k * kLanes;
  const float* const block = ws.block + batch.at[k] * kBackwardPlanes;
  const auto grad = [block](int p)
                        HWY_ATTR { return load(block + static_cast<size_t>(p) * kLanes); };
  Sums& sums = batch.sums;
  const Vf zero = hn::Zero(df);
  const Vf w = load(batch.w + first);
  const Material m = unpack(batch.texture.texel + 8 * first);

  // Mapped normal: g.(x T + y B + z N) needs the derivatives along the frame's three axes.
  const Vf wx = hn::Mul(w, m.nx), wy = hn::Mul(w, m.ny), wz = hn::Mul(w, m.nz);
  Vf along_t = zero, along_b = zero, along_n = zero, d_normal = zero;
  for (int c = 0; c < 3; ++c) {
    const Vf g = grad(kMappedNormal + c);
    add_product(sums.at(SurfelSums::kFrame + c), wx, g);
    add_product(sums.at(SurfelSums::kFrame + 3 + c), wy, g);
    add_product(sums.at(SurfelSums::kFrame + 6 + c), wz, g);
    along_t = hn::MulAdd(set(r.frame[c]), g, along_t);
    along_b = hn::MulAdd(set(r.frame[3 + c]), g, along_b);
    along_n = hn::MulAdd(set(r.frame[6 + c]), g, along_n);
    const Vf g_n = grad(kNormal + c);
    add_product(sums.at(SurfelSums::kNormal + c), w, g_n);
    d_normal = hn::MulAdd(g_n, set(r.normal[c]), d_normal);
  }
  const Vf d_mapped = hn::MulAdd(m.nx, along_t, hn::MulAdd(m.ny, along_b, hn::Mul(m.nz, along_n)));
  // n_z = sqrt(1 - x^2 - y^2), constant 0 beyond the unit circle.
  const Vf upright = hn::IfThenElseZero(hn::Gt(m.nz, zero), hn::Div(along_n, m.nz));
  const Vf d_nx = hn::Mul(w, hn::NegMulAdd(m.nx, upright, along_t));
  const Vf d_ny = hn::Mul(w, hn::NegMulAdd(m.ny, upright, along_b));
  const Vf g0 = grad(kAlbedo), g1 = grad(kAlbedo + 1), g2 = grad(kAlbedo + 2);
  const Vf g3 = grad(kRoughness), g4 = grad(kSpecular);
  const Vf d0 = hn::Mul(w, g0), d1 = hn::Mul(w, g1), d2 = hn::Mul(w, g2);
  const Vf d3 = hn::Mul(w, g3), d4 = hn::Mul(w, g4);
  untranspose({d0, d1, d2, d3, d4, d_nx, d_ny, zero}, batch.d_texel + 8 * first);

  const auto slope = [&](const float* texels) HWY_ATTR {
    const Channels t = transpose(texels + 8 * first);
    const Vf a = hn::MulAdd(d0, t.c0, hn::MulAdd(d1, t.c1, hn::Mul(d2, t.c2)));
    const Vf b = hn::MulAdd(d3, t.c3, hn::Mul(d4, t.c4));
    return hn::Add(hn::Add(a, b), hn::MulAdd(d_nx, t.c5, hn::Mul(d_ny, t.c6)));
  };
  const Vf g_u = grad(kUv), g_v = grad(kUv + 1);
  Vf d_tu = hn::MulAdd(w, g_u, hn::Mul(slope(batch.along_x), load(batch.scale_x + first)));
  Vf d_tv = hn::MulAdd(w, g_v, hn::Mul(slope(batch.along_y), load(batch.scale_y + first)));

  const Vf a = hn::MulAdd(grad(kDepth), load(batch.z + first), grad(kAlpha));
  const Vf b = hn::MulAdd(g_u, load(batch.tu + first), hn::Mul(g_v, load(batch.tv + first)));
  const Vf c =
      hn::MulAdd(g0, m.channel[0], hn::MulAdd(g1, m.channel[1], hn::Mul(g2, m.channel[2])));
  const Vf d = hn::MulAdd(g3, m.channel[3], hn::Mul(g4, m.channel[4]));
  Vf d_w = hn::Add(hn::Add(hn::Add(a, b), hn::Add(c, d)), hn::Add(d_normal, d_mapped));
  if constexpr (kLists) {
    // The vector's next entry; 0 where this surfel is not in a pixel's list.
    const size_t vector = batch.at[k] / kLanes, entry = ws.cursor[vector]++;
    if (entry < ws.listed[vector]) {
      const size_t e = vector * ws.list_stride + entry * kEntry;
      const Mf listed = hn::Gt(load(ws.list.data() + e), zero);
      const Vf g = hn::IfThenElseZero(listed, grad(kUvDistortion)), weighted = hn::Mul(w, g);
      d_w = hn::MulAdd(g, load(ws.d_list.data() + e), d_w);
      d_tu = hn::MulAdd(weighted, load(ws.d_list.data() + e + kLanes), d_tu);
      d_tv = hn::MulAdd(weighted, load(ws.d_list.data() + e + 2 * kLanes), d_tv);
    }
  }
  store(d_w, batch.d_w + first);
  store(d_tu, batch.d_tu + first);
  store(d_tv, batch.d_tv + first);
}

// Vector k of the batch: from the derivatives of w, depth and texture coordinates to the surfel's
// sums.
HWY_INLINE void geometry_backward(BackwardBatch& batch, const SurfelRecord& r, size_t k,
                                  SurfelWorkspace& ws) {
  const size_t first = k * kLanes;
  float* const block = ws.block + batch.at[k] * kBackwardPlanes;
  Sums& sums = batch.sums;
  const Vf w = load(batch.w + first), alpha = load(batch.alpha + first);
  const Vf d_w = load(batch.d_w + first);

  // w = alpha T, and every later weight carries (1 - alpha).
  const Vf later = hn::NegMulAdd(w, d_w, load(block + kRemaining * kLanes));
  store(later, block + kRemaining * kLanes);
  const Vf through = hn::Div(later, hn::Sub(set(1.0f), alpha));
  const Vf d_alpha = hn::IfThenElseZero(hn::Lt(alpha, set(kMaxAlpha)),
                                        hn::MulSub(load(batch.before + first), d_w, through));
  const Vf scaled = hn::Mul(d_alpha, alpha);  // alpha is 0 where nothing is blended
  const Vf d_z = hn::Mul(w, load(block + kDepth * kLanes));
  const Vf d_tu = load(batch.d_tu + first), d_tv = load(batch.d_tv + first);
  const Vf u = load(batch.u + first), v = load(batch.v + first);

  add_to(sums.at(SurfelSums::kOpacity), scaled);
  add_to(sums.at(SurfelSums::kUv), d_tu);
  add_to(sums.at(SurfelSums::kUv + 1), d_tv);
  add_product(sums.at(SurfelSums::kUvPerSt), d_tu, u);
  add_product(sums.at(SurfelSums::kUvPerSt + 1), d_tu, v);
  add_product(sums.at(SurfelSums::kUvPerSt + 2), d_tv, u);
  add_product(sums.at(SurfelSums::kUvPerSt + 3), d_tv, v);
  // d alpha / d rho = -alpha / 2; rho = u^2 + v^2.
  const auto j = [&r](int e) HWY_ATTR { return set(r.uv_per_st[e]); };
  const Vf d_u = hn::NegMulAdd(scaled, u, hn::MulAdd(j(0), d_tu, hn::Mul(j(2), d_tv)));
  const Vf d_v = hn::NegMulAdd(scaled, v, hn::MulAdd(j(1), d_tu, hn::Mul(j(3), d_tv)));
  const Vf inverse = load(batch.inverse + first);  // 0 where the low-pass won
  const Vf d_a = hn::Mul(d_u, inverse), d_b = hn::Mul(d_v, inverse);
  const Vf d_depth = hn::Mul(d_z, inverse);
  const Vf z = load(batch.z + first);
  const Vf d_c = hn::Neg(hn::MulAdd(d_a, u, hn::MulAdd(d_b, v, hn::Mul(d_depth, z))));
  const Vf dx = load(batch.dx + first), dy = load(batch.dy + first);
  const auto affine = [&](int e, Vf g) HWY_ATTR {
    add_to(sums.at(e), g);
    add_product(sums.at(e + 1), g, dx);
    add_product(sums.at(e + 2), g, dy);
  };
  affine(SurfelSums::kA, d_a);
  affine(SurfelSums::kB, d_b);
  affine(SurfelSums::kC, d_c);
  add_to(sums.at(SurfelSums::kDepth), d_depth);
  if (!r.filtered) return;
  const Mf filtered = hn::Eq(inverse, hn::Zero(df));
  if (hn::AllFalse(df, filtered)) return;
  // rho = 2 (ex^2 + ey^2), ex = x - centre: d alpha / d centre_x = 2 alpha ex.
  const Vf twice = hn::IfThenElseZero(filtered, hn::Add(scaled, scaled));
  add_product(sums.at(SurfelSums::kScreen), twice, hn::Sub(dx, set(r.low_pass_x)));
  add_product(sums.at(SurfelSums::kScreen + 1), twice, hn::Sub(dy, set(r.low_pass_y)));
  add_to(sums.at(SurfelSums::kCenterZ), hn::IfThenElseZero(filtered, d_z));
}

// Adds the open surfel's sums to the frame's and opens the next.
HWY_INLINE void open_surfel(BackwardBatch& batch, uint32_t surfel) {
  if (batch.open != ~uint32_t{0}) {
    float* to = batch.buffers.sums + static_cast<size_t>(batch.open) * SurfelSums::kCount;
    add_lane_sums(batch.sums.lanes, SurfelSums::kCount, to);
  }
  std::memset(batch.sums.lanes, 0, sizeof(batch.sums.lanes));
  batch.open = surfel;
}

// Goes back through the batch and empties it.
template <bool kLists>
HWY_INLINE void batch_backward(const SurfelScene& scene, BackwardBatch& batch,
                               SurfelWorkspace& ws) {
  sample_with_slopes(batch);
  for (size_t begin = 0; begin < batch.count;) {
    const uint32_t surfel = batch.surfel[begin];
    size_t end = begin + 1;
    while (end < batch.count && batch.surfel[end] == surfel) ++end;
    if (surfel != batch.open) open_surfel(batch, surfel);
    const SurfelRecord& r = scene.records[surfel];
    for (size_t k = begin; k < end; ++k) outputs_backward<kLists>(batch, r, k, ws);
    for (size_t k = begin; k < end; ++k) geometry_backward(batch, r, k, ws);
    begin = end;
  }
  scatter(batch);
  batch.texture.slots = 0;
  batch.count = 0;
}

template <bool kLists>
void backward_tile(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws,
                   const SurfelGradientBuffers& buffers) {
  if constexpr (kLists) {
    begin_lists(tile, true, ws);
    forward_walk<false, true>(scene, tile, ws);
    for (size_t at = 0; at < kTilePixels; at += kLanes)
      distortion_backward(at, scene.uv_distortion == UvDistortion::kSquared, ws);
  }
  load_derivatives(scene, tile, ws);
  Alive alive;
  begin_surfel_tile(tile, kBackwardPlanes, kBackwardT, ws, alive);
  BackwardBatch batch(scene, buffers);
  const auto visit = [&](auto low_pass, uint32_t surfel, const SurfelRecord& r,
                         const SurfelRows& rows, const SurfelColumn& column, size_t y,
                         size_t at) HWY_ATTR {
    float* const transmittance = ws.block + at * kBackwardPlanes + kBackwardT * kLanes;
    const Hit hit =
        intersect<decltype(low_pass)::value>(r, rows, column, y, load(transmittance), scene.near);
    update(hit, transmittance, at, alive);
    if (hn::AllFalse(df, hit.blended)) return;
    Vf u, v;
    texture_uv(r, hit, u, v);
    const size_t k = batch.count++, first = k * kLanes;
    batch.surfel[k] = surfel;
    batch.at[k] = at;
    store(column.dx, batch.dx + first);
    store(hn::Add(column.dy, set(rows.y[y])), batch.dy + first);
    store(hit.weight, batch.w + first);
    store(hit.z, batch.z + first);
    store(hit.u, batch.u + first);
    store(hit.v, batch.v + first);
    store(hit.inverse, batch.inverse + first);
    store(hn::IfThenElseZero(hit.blended, hit.alpha), batch.alpha + first);
    store(hit.before, batch.before + first);
    store(u, batch.tu + first);
    store(v, batch.tv + first);
    const Taps taps = find_taps(batch.grid, u, v);
    put_taps(taps, hit.blended, k, batch.texture);
    store(taps.fx, batch.fx + first);
    store(taps.fy, batch.fy + first);
    store(hn::IfThenElseZero(taps.inside_x, set(batch.grid.width)), batch.scale_x + first);
    store(hn::IfThenElseZero(taps.inside_y, set(batch.grid.height)), batch.scale_y + first);
    if (batch.count == kBatch) batch_backward<kLists>(scene, batch, ws);
  };
  const auto begin = [](uint32_t) HWY_ATTR {};
  // Slots that never blended hold no garbage that 0 times it could turn into NaN.
  std::memset(batch.along_x, 0, sizeof(batch.along_x));
  std::memset(batch.along_y, 0, sizeof(batch.along_y));
  walk(scene, tile, ws, alive, visit, begin);
  batch_backward<kLists>(scene, batch, ws);
  open_surfel(batch, ~uint32_t{0});
}

void backward(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws,
              const SurfelGradientBuffers& buffers) {
  if (scene.uv_distortion != UvDistortion::kOff)
    backward_tile<true>(scene, tile, ws, buffers);
  else
    backward_tile<false>(scene, tile, ws, buffers);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
