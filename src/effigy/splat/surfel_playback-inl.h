// Playback over one tile: one texture lookup for a run of surfels that agree about the texture
// coordinate, instead of one for each.
//
// Along a ray, surfels in front-to-back order are gathered into a run while their uv stays within
// `spread` texels of the run's weighted mean. A run keeps its weight, its mean uv and its blended
// tangent frame; when the next surfel does not fit, or at the end, the texture is read once at the
// mean. A smooth texture is linear over a texel or so, and a lookup of the mean of a linear
// function is the mean of the lookups: the error is of second order in the spread. Where less than
// kNegligible of the light still passes, surfels join the run whatever their uv (without moving its
// mean), so no more than that share of a pixel takes a neighbour's material.

#if defined(EFFIGY_SPLAT_SURFEL_PLAYBACK_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_SURFEL_PLAYBACK_INL_H_
#undef EFFIGY_SPLAT_SURFEL_PLAYBACK_INL_H_
#else
#define EFFIGY_SPLAT_SURFEL_PLAYBACK_INL_H_
#endif

#include "effigy/splat/surfel_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

// The current run of every pixel, in the workspace's gradient planes (which playback does not
// need).
enum RunPlane : int {
  kRunWeight = 0,
  kRunStart = 1,  // 2: uv of its first surfel
  kRunUv = 3,     // 2: sum of w (uv - start)
  kRunFrame = 5,  // 9: sum of w times the flipped frame
  kRunPlanes = 14,
};

struct Playback {
  SurfelWorkspace& ws;
  TextureGrid grid;
  Taps taps = {};
  TexelLanes texel = {};

  Playback(const SurfelScene& scene, SurfelWorkspace& w) : ws(w), grid(scene) {}
  HWY_INLINE float* run(int plane, size_t at) { return ws.grad[plane] + at; }
  HWY_INLINE float* out(int plane, size_t at) { return ws.out[plane] + at; }
};

// Mean uv of the runs with weight > 0.
HWY_INLINE void mean_uv(Playback& p, size_t at, Vf& u, Vf& v) {
  const Vf weight = load(p.run(kRunWeight, at));
  const Vf inverse = hn::Div(set(1.0f), hn::Max(weight, set(1e-6f)));
  u = hn::MulAdd(load(p.run(kRunUv, at)), inverse, load(p.run(kRunStart, at)));
  v = hn::MulAdd(load(p.run(kRunUv + 1, at)), inverse, load(p.run(kRunStart + 1, at)));
}

// Reads the texture once for each run of the lanes in `ending`, adds it to the outputs and empties
// the runs.
template <bool kOwnNormals>
HWY_INLINE void end_runs(Playback& p, size_t at, Mf ending, Vf u, Vf v) {
  Mf inside_x, inside_y;
  place_taps(p.grid, hn::IfThenElseZero(ending, u), hn::IfThenElseZero(ending, v), p.taps, inside_x,
             inside_y);
  sample(p.grid, p.taps, bits_of(ending), p.texel);
  const Material m = unpack(p.texel);
  const Vf weight = hn::IfThenElseZero(ending, load(p.run(kRunWeight, at)));
  add_to(p.out(kAlpha, at), weight);
  for (int k = 0; k < 5; ++k) add_product(p.out(kAlbedo + k, at), weight, m.channel[k]);
  add_product(p.out(kUv, at), weight, u);
  add_product(p.out(kUv + 1, at), weight, v);
  for (int k = 0; k < 3; ++k) {
    const Vf tangent = load(p.run(kRunFrame + k, at));
    const Vf bitangent = load(p.run(kRunFrame + 3 + k, at));
    const Vf normal = load(p.run(kRunFrame + 6 + k, at));
    const Vf mapped = hn::MulAdd(m.nx, tangent, hn::MulAdd(m.ny, bitangent, hn::Mul(m.nz, normal)));
    add_to(p.out(kMappedNormal + k, at), hn::IfThenElseZero(ending, mapped));
    if constexpr (!kOwnNormals) add_to(p.out(kNormal + k, at), hn::IfThenElseZero(ending, normal));
  }
  for (int k = 0; k < kRunPlanes; ++k)
    store(hn::IfThenZeroElse(ending, load(p.run(k, at))), p.run(k, at));
}

// kOwnNormals: the frames' normals are not the surfels' own, which then need their own sums.
template <bool kLowPass, bool kOwnNormals>
void playback_tile(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws) {
  std::memset(ws.out, 0, sizeof(ws.out));
  std::memset(ws.grad, 0, sizeof(ws.grad));
  Alive alive;
  begin_tile(tile, ws, alive);
  Playback p(scene, ws);
  int64_t pairs = 0;
  const Vf zero = hn::Zero(df), width = set(p.grid.width), height = set(p.grid.height);
  const Vf reach = set(scene.spread * scene.spread);
  const auto visit = [&](uint32_t, const SurfelRecord& r, const RowStart& row, Vf dx,
                         size_t at) HWY_ATTR {
    const Hit hit = intersect<kLowPass>(r, row, dx, load(ws.transmittance + at), scene.near);
    update(hit, at, ws, alive);
    const uint32_t bits = bits_of(hit.blended);
    if (bits == 0) return;
    pairs += static_cast<int64_t>(hwy::PopCount(bits));
    Vf u, v, mean_u, mean_v;
    texture_uv(r, hit, u, v);
    mean_uv(p, at, mean_u, mean_v);
    Mf open = hn::Gt(load(p.run(kRunWeight, at)), zero);
    const Vf du = hn::Mul(hn::Sub(u, mean_u), width), dv = hn::Mul(hn::Sub(v, mean_v), height);
    const Mf far =
        hn::And(hn::And(hit.blended, open), hn::Gt(hn::MulAdd(du, du, hn::Mul(dv, dv)), reach));
    if (!hn::AllFalse(df, far)) {
      const Mf joins = hn::And(far, hn::Lt(hit.before, set(scene.negligible)));
      u = hn::IfThenElse(joins, mean_u, u);
      v = hn::IfThenElse(joins, mean_v, v);
      const Mf ending = hn::AndNot(joins, far);
      if (!hn::AllFalse(df, ending)) {
        end_runs<kOwnNormals>(p, at, ending, mean_u, mean_v);
        open = hn::AndNot(ending, open);
      }
    }
    const Vf w = hit.weight;
    const Vf start_u = hn::IfThenElse(open, load(p.run(kRunStart, at)), u);
    const Vf start_v = hn::IfThenElse(open, load(p.run(kRunStart + 1, at)), v);
    store(start_u, p.run(kRunStart, at));
    store(start_v, p.run(kRunStart + 1, at));
    add_to(p.run(kRunWeight, at), w);
    add_product(p.run(kRunUv, at), w, hn::Sub(u, start_u));
    add_product(p.run(kRunUv + 1, at), w, hn::Sub(v, start_v));
    for (int k = 0; k < 9; ++k) add_product(p.run(kRunFrame + k, at), w, set(r.frame[k]));
    add_product(p.out(kDepth, at), w, hit.z);
    if constexpr (kOwnNormals) {
      for (int k = 0; k < 3; ++k) add_product(p.out(kNormal + k, at), w, set(r.normal[k]));
    }
  };
  const auto nothing = [](uint32_t) HWY_ATTR {};
  walk(scene, tile, ws, alive, visit, nothing, nothing);
  for (size_t at = 0; at < kTilePixels; at += kLanes) {
    const Mf open = hn::Gt(load(p.run(kRunWeight, at)), zero);
    if (hn::AllFalse(df, open)) continue;
    Vf u, v;
    mean_uv(p, at, u, v);
    end_runs<kOwnNormals>(p, at, open, u, v);
  }
  ws.pairs = pairs;
}

void playback(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws) {
  if (scene.low_pass)
    scene.own_normals ? playback_tile<true, true>(scene, tile, ws)
                      : playback_tile<true, false>(scene, tile, ws);
  else
    scene.own_normals ? playback_tile<false, true>(scene, tile, ws)
                      : playback_tile<false, false>(scene, tile, ws);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
