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

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
