// The forward pass over one tile.

#if defined(EFFIGY_SPLAT_SURFEL_FORWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_SURFEL_FORWARD_INL_H_
#undef EFFIGY_SPLAT_SURFEL_FORWARD_INL_H_
#else
#define EFFIGY_SPLAT_SURFEL_FORWARD_INL_H_
#endif

#include "effigy/splat/surfel_lanes-inl.h"
#include "effigy/splat/uv_distortion-inl.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

// The block of a vector of pixels: the G-buffer's planes; the transmittance stands in for the UV
// distortion, which is only known at the end.
constexpr size_t kForwardPlanes = kGBufferPlanes;
constexpr size_t kForwardT = kUvDistortion;

// Vectors of pixels that met a surfel.
struct ForwardBatch {
  TextureBatch texture = {};
  HWY_ALIGN float w[kSlots];
  HWY_ALIGN float z[kSlots];
  HWY_ALIGN float u[kSlots];
  HWY_ALIGN float v[kSlots];
  const SurfelRecord* record[kBatch];
  size_t at[kBatch];
  size_t count = 0;
};

// Adds the batch to the outputs and empties it.
HWY_INLINE void sum_batch(const TextureGrid& grid, ForwardBatch& batch, SurfelWorkspace& ws) {
  sample(grid, batch.texture);
  for (size_t k = 0; k < batch.count; ++k) {
    const SurfelRecord& r = *batch.record[k];
    float* const block = ws.block + batch.at[k] * kForwardPlanes;
    const auto plane = [block](int p) { return block + static_cast<size_t>(p) * kLanes; };
    const size_t first = k * kLanes;
    const Vf w = load(batch.w + first);
    add_to(plane(kAlpha), w);
    add_product(plane(kDepth), w, load(batch.z + first));
    for (int c = 0; c < 3; ++c) add_product(plane(kNormal + c), w, set(r.normal[c]));
    add_product(plane(kUv), w, load(batch.u + first));
    add_product(plane(kUv + 1), w, load(batch.v + first));
    const Material m = unpack(batch.texture.texel + 8 * first);
    for (int c = 0; c < 5; ++c) add_product(plane(kAlbedo + c), w, m.channel[c]);
    const Vf wx = hn::Mul(w, m.nx), wy = hn::Mul(w, m.ny), wz = hn::Mul(w, m.nz);
    for (int c = 0; c < 3; ++c) {
      const Vf tangent = hn::MulAdd(wx, set(r.frame[c]), load(plane(kMappedNormal + c)));
      store(hn::MulAdd(wz, set(r.frame[6 + c]), hn::MulAdd(wy, set(r.frame[3 + c]), tangent)),
            plane(kMappedNormal + c));
    }
  }
  ws.pairs += static_cast<int64_t>(batch.texture.slots);
  batch.texture.slots = 0;
  batch.count = 0;
}

// Walks the tile front to back. kShade: sums the outputs (otherwise only the transmittance and the
// lists); kLists: lists weights and uvs for the UV distortion.
template <bool kShade, bool kLists>
HWY_INLINE void forward_walk(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws) {
  Alive alive;
  begin_surfel_tile(tile, kForwardPlanes, kForwardT, ws, alive);
  const TextureGrid grid(scene);
  ForwardBatch batch;
  const auto visit = [&](auto low_pass, uint32_t, const SurfelRecord& r, const SurfelRows& rows,
                         const SurfelColumn& column, size_t y, size_t at) HWY_ATTR {
    float* const transmittance = ws.block + at * kForwardPlanes + kForwardT * kLanes;
    const Hit hit =
        intersect<decltype(low_pass)::value>(r, rows, column, y, load(transmittance), scene.near);
    update(hit, transmittance, at, alive);
    if (hn::AllFalse(df, hit.blended)) return;
    Vf u, v;
    texture_uv(r, hit, u, v);
    if constexpr (kLists) append(hit.weight, u, v, hit.blended, at, scene.uv_threshold, ws);
    if constexpr (kShade) {
      const size_t k = batch.count++, first = k * kLanes;
      batch.record[k] = &r;
      batch.at[k] = at;
      store(hit.weight, batch.w + first);
      store(hit.z, batch.z + first);
      store(u, batch.u + first);
      store(v, batch.v + first);
      put_taps(find_taps(grid, u, v), hit.blended, k, batch.texture);
      if (batch.count == kBatch) sum_batch(grid, batch, ws);
    }
  };
  const auto begin = [](uint32_t) HWY_ATTR {};
  walk(scene, tile, ws, alive, visit, begin);
  if constexpr (kShade) sum_batch(grid, batch, ws);
}

void forward(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws) {
  std::memset(ws.block, 0, sizeof(float) * kTilePixels * kForwardPlanes);
  const bool lists = scene.uv_distortion != UvDistortion::kOff;
  if (lists) {
    begin_lists(tile, false, ws);
    forward_walk<true, true>(scene, tile, ws);
  } else {
    forward_walk<true, false>(scene, tile, ws);
  }
  for (size_t at = 0; at < kTilePixels; at += kLanes) {
    const bool squared = scene.uv_distortion == UvDistortion::kSquared;
    store(lists && tile.count > 0 ? distortion(at, squared, ws) : hn::Zero(df),
          ws.block + at * kForwardPlanes + kUvDistortion * kLanes);
  }
  for (size_t c = 0; c < kGBufferPlanes; ++c)
    store_plane(tile, ws.block, kForwardPlanes, c, scene.gbuffer + c * scene.plane_size,
                scene.row_size);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
