// Playback over one tile: one texture lookup for a run of surfels that agree about the texture
// coordinate, instead of one for each.
//
// Along a ray, surfels in front-to-back order are gathered into a run while their uv stays within
// `spread` texels of the run's weighted mean. A run keeps its weight, its mean uv and its blended
// tangent frame; when the next surfel does not fit, or at the end, the texture is read once at the
// mean. A smooth texture is linear over a texel or so, and a lookup of the mean of a linear
// function is the mean of the lookups: the error is of second order in the spread. A pixel
// through which less than `opaque` of the light still passes is done: the surfel at hand takes what
// is left, since what lies close behind mostly looks the same.

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

// What to draw: the planes that shading reads; all; all, where the frames' normals are not the
// surfels' own and need their own sums.
enum class Draw { kShading, kAll, kAllOwnNormals };

// The block of a vector of pixels: its current run and the transmittance.
enum PlaybackPlane : int {
  kRunWeight = 0,
  kRunUv = 1,     // 2: sum of w uv
  kRunFrame = 3,  // 9: sum of w times the flipped frame
  kRunPlanes = 12,
  kPlaybackT = 12,
  kPlaybackPlanes = 13,
};
// The outputs, in a second block; those that shading reads come first and are touched only where a
// run ends.
enum SumPlane : int {
  kSumAlpha = 0,
  kSumMaterial = 1,  // 5
  kSumMapped = 6,    // 3
  kShadingPlanes = 9,
  kSumNormal = 9,  // 3
  kSumUv = 12,     // 2
  kSumDepth = 14,
  kAllPlanes = 15,
};
constexpr size_t kSumToPlane[kAllPlanes] = {kAlpha,        kAlbedo,           kAlbedo + 1,
                                            kAlbedo + 2,   kRoughness,        kSpecular,
                                            kMappedNormal, kMappedNormal + 1, kMappedNormal + 2,
                                            kNormal,       kNormal + 1,       kNormal + 2,
                                            kUv,           kUv + 1,           kDepth};
constexpr size_t kSumsBlock = kTilePixels * size_t{kPlaybackPlanes};
static_assert(kSumsBlock + kTilePixels * kAllPlanes <= kTilePixels * kMostPlanes);

template <Draw kDraw>
constexpr size_t kSumPlanes = kDraw == Draw::kShading ? kShadingPlanes : kAllPlanes;

HWY_INLINE float* plane_of(float* block, int k) {
  return block + static_cast<size_t>(k) * kLanes;
}
template <Draw kDraw>
HWY_INLINE float* sums_of(SurfelWorkspace& ws, size_t at) {
  return ws.block + kSumsBlock + at * kSumPlanes<kDraw>;
}

// Vectors of pixels that met a surfel, and vectors of pixels with runs that have ended.
struct PlaybackBatch {
  TextureGrid grid;
  const hwy::float16_t* texels;
  HWY_ALIGN float w[kSlots];
  HWY_ALIGN float z[kSlots];
  HWY_ALIGN float u[kSlots];
  HWY_ALIGN float v[kSlots];
  const SurfelRecord* record[kBatch];
  size_t at[kBatch];
  size_t count = 0;

  TextureBatch texture = {};
  HWY_ALIGN float run[kBatch][kRunPlanes * kLanes];  // weight, mean uv, frame
  size_t run_at[kBatch];
  size_t runs = 0;
  int64_t pairs = 0;

  explicit PlaybackBatch(const SurfelScene& scene)
      : grid(scene), texels(reinterpret_cast<const hwy::float16_t*>(scene.half_texels)) {}
};

// As sample(), from half floats.
HWY_INLINE void sample_halves(PlaybackBatch& batch) {
  constexpr hn::Rebind<hwy::float16_t, Dt> dh;
  TextureBatch& texture = batch.texture;
  const size_t step_x = batch.grid.step_x, step_y = batch.grid.step_y;
  for (size_t k = 0; k < texture.slots; ++k) {
    const auto slot = static_cast<size_t>(texture.slot[k]);
    const hwy::float16_t* p = batch.texels + 8 * static_cast<size_t>(texture.index[slot]);
    const hwy::float16_t* q = p + step_y;
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto weight = [&](size_t w) HWY_ATTR { return hn::Set(dt, texture.weight[w][slot]); };
      const auto texel = [&](const hwy::float16_t* from)
                             HWY_ATTR { return hn::PromoteTo(dt, hn::LoadU(dh, from + c)); };
      const auto top = hn::MulAdd(weight(1), texel(p + step_x), hn::Mul(weight(0), texel(p)));
      const auto bottom = hn::MulAdd(weight(3), texel(q + step_x), hn::Mul(weight(2), texel(q)));
      hn::Store(hn::Add(top, bottom), dt, texture.texel + 8 * slot + c);
    }
  }
}

// Reads the texture once for each ended run and adds it to the sums.
template <Draw kDraw>
HWY_INLINE void sum_runs(PlaybackBatch& batch, SurfelWorkspace& ws) {
  sample_halves(batch);
  for (size_t k = 0; k < batch.runs; ++k) {
    float* const sums = sums_of<kDraw>(ws, batch.run_at[k]);
    const auto run = [&](int p) HWY_ATTR { return load(plane_of(batch.run[k], p)); };
    const Material m = unpack(batch.texture.texel + 8 * k * kLanes);
    const Vf weight = run(kRunWeight);
    add_to(plane_of(sums, kSumAlpha), weight);
    for (int c = 0; c < 5; ++c) add_product(plane_of(sums, kSumMaterial + c), weight, m.channel[c]);
    for (int c = 0; c < 3; ++c) {
      const Vf normal = run(kRunFrame + 6 + c);
      add_to(plane_of(sums, kSumMapped + c),
             hn::MulAdd(m.nx, run(kRunFrame + c),
                        hn::MulAdd(m.ny, run(kRunFrame + 3 + c), hn::Mul(m.nz, normal))));
      if constexpr (kDraw == Draw::kAll) add_to(plane_of(sums, kSumNormal + c), normal);
    }
    if constexpr (kDraw != Draw::kShading) {
      add_product(plane_of(sums, kSumUv), weight, run(kRunUv));
      add_product(plane_of(sums, kSumUv + 1), weight, run(kRunUv + 1));
    }
  }
  batch.texture.slots = 0;
  batch.runs = 0;
}

// Fetches the texels of the slots from `first` on.
HWY_INLINE void prefetch_slots(const PlaybackBatch& batch, size_t first) {
  for (size_t k = first; k < batch.texture.slots; ++k) {
    const int32_t index = batch.texture.index[batch.texture.slot[k]];
    const hwy::float16_t* p = batch.texels + 8 * static_cast<size_t>(index);
    hwy::Prefetch(p);
    hwy::Prefetch(p + batch.grid.step_y);
  }
}

// Puts the runs of the lanes in `ending` aside for sum_runs and empties them.
template <Draw kDraw>
HWY_INLINE void end_runs(PlaybackBatch& batch, SurfelWorkspace& ws, size_t at, Mf ending) {
  float* const block = ws.block + at * kPlaybackPlanes;
  const auto run = [block](int k) HWY_ATTR { return load(plane_of(block, k)); };
  const Vf weight = hn::IfThenElseZero(ending, run(kRunWeight));
  const Vf inverse = hn::Div(set(1.0f), hn::Max(weight, set(1e-6f)));
  const size_t k = batch.runs++;
  float* const to = batch.run[k];
  batch.run_at[k] = at;
  store(weight, plane_of(to, kRunWeight));
  const Vf u = hn::IfThenElseZero(ending, hn::Mul(run(kRunUv), inverse));
  const Vf v = hn::IfThenElseZero(ending, hn::Mul(run(kRunUv + 1), inverse));
  store(u, plane_of(to, kRunUv));
  store(v, plane_of(to, kRunUv + 1));
  const size_t first = batch.texture.slots;
  put_taps(find_taps(batch.grid, u, v), ending, k, batch.texture);
  prefetch_slots(batch, first);
  for (int c = 0; c < kRunFrame; ++c) store(hn::IfThenZeroElse(ending, run(c)), plane_of(block, c));
  for (int c = kRunFrame; c < kRunPlanes; ++c) {
    const Vf frame = run(c);
    store(hn::IfThenElseZero(ending, frame), plane_of(to, c));
    store(hn::IfThenZeroElse(ending, frame), plane_of(block, c));
  }
  if (batch.runs == kBatch) sum_runs<kDraw>(batch, ws);
}

// Adds the batch to the pixels' runs and empties it.
template <Draw kDraw>
HWY_INLINE void join_runs(const SurfelScene& scene, PlaybackBatch& batch, SurfelWorkspace& ws) {
  const Vf width = set(batch.grid.width), height = set(batch.grid.height);
  const Vf reach = set(scene.spread * scene.spread);
  for (size_t k = 0; k < batch.count; ++k) {
    const SurfelRecord& r = *batch.record[k];
    const size_t at = batch.at[k], first = k * kLanes;
    float* const block = ws.block + at * kPlaybackPlanes;
    const auto run = [block](int p) HWY_ATTR { return load(plane_of(block, p)); };
    const Vf w = load(batch.w + first);
    const Vf u = load(batch.u + first), v = load(batch.v + first);
    // uv against the mean, times the run's weight: nothing to divide, and 0 for a new run.
    const Vf weight = run(kRunWeight), sum_u = run(kRunUv), sum_v = run(kRunUv + 1);
    const Vf away_u = hn::Mul(hn::MulSub(weight, u, sum_u), width);
    const Vf away_v = hn::Mul(hn::MulSub(weight, v, sum_v), height);
    const Vf away2 = hn::MulAdd(away_u, away_u, hn::Mul(away_v, away_v));
    const Vf allowed = hn::Mul(hn::Mul(reach, hn::Mul(weight, weight)), hn::Add(weight, w));
    const Mf far = hn::Gt(hn::Mul(w, away2), allowed);
    if (!hn::AllFalse(df, far)) end_runs<kDraw>(batch, ws, at, far);
    add_to(plane_of(block, kRunWeight), w);
    add_product(plane_of(block, kRunUv), w, u);
    add_product(plane_of(block, kRunUv + 1), w, v);
    for (int c = 0; c < 9; ++c) add_product(plane_of(block, kRunFrame + c), w, set(r.frame[c]));
    if constexpr (kDraw == Draw::kShading) continue;
    float* const sums = sums_of<kDraw>(ws, at);
    add_product(plane_of(sums, kSumDepth), w, load(batch.z + first));
    if constexpr (kDraw == Draw::kAllOwnNormals)
      for (int c = 0; c < 3; ++c) add_product(plane_of(sums, kSumNormal + c), w, set(r.normal[c]));
  }
  batch.count = 0;
}

// A tile without surfels: shading reads no other plane there.
void clear_alpha(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws) {
  ws.pairs = 0;
  ws.used = 0;
  const auto at = [&](int y) {
    return kAlpha * scene.plane_size + static_cast<size_t>(y) * scene.row_size +
           static_cast<size_t>(tile.x);
  };
  for (int y = tile.y; y < tile.y + tile.height; ++y)
    std::fill_n(scene.gbuffer + at(y), tile.width, 0.0f);
}

template <Draw kDraw>
void playback_tile(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws) {
  if (kDraw == Draw::kShading && tile.count == 0) return clear_alpha(scene, tile, ws);
  std::memset(ws.block, 0, sizeof(float) * (kSumsBlock + kTilePixels * kSumPlanes<kDraw>));
  Alive alive;
  begin_surfel_tile(tile, kPlaybackPlanes, kPlaybackT, ws, alive);
  PlaybackBatch batch(scene);
  const Vf opaque = set(scene.opaque);
  const auto visit = [&](auto low_pass, uint32_t, const SurfelRecord& r, const SurfelRows& rows,
                         const SurfelColumn& column, size_t y, size_t at) HWY_ATTR {
    float* const transmittance = plane_of(ws.block + at * kPlaybackPlanes, kPlaybackT);
    Hit hit =
        intersect<decltype(low_pass)::value>(r, rows, column, y, load(transmittance), scene.near);
    const Mf done = hn::And(hit.blended, hn::Lt(hit.after, opaque));
    hit.finished = hn::Or(hit.finished, done);
    // What still passes a pixel that is done falls on the surfel at hand.
    hit.weight = hn::IfThenElse(done, hit.before, hit.weight);
    hit.after = hn::IfThenZeroElse(done, hit.after);
    update(hit, transmittance, at, alive);
    const uint32_t bits = bits_of(hit.blended);
    if (bits == 0) return;
    Vf u, v;
    texture_uv(r, hit, u, v);
    const size_t k = batch.count++, first = k * kLanes;
    batch.record[k] = &r;
    batch.at[k] = at;
    batch.pairs += static_cast<int64_t>(hwy::PopCount(bits));
    store(hit.weight, batch.w + first);
    if constexpr (kDraw != Draw::kShading) store(hit.z, batch.z + first);
    store(u, batch.u + first);
    store(v, batch.v + first);
    if (batch.count == kBatch) join_runs<kDraw>(scene, batch, ws);
  };
  const auto begin = [](uint32_t) HWY_ATTR {};
  walk(scene, tile, ws, alive, visit, begin);
  join_runs<kDraw>(scene, batch, ws);
  for (size_t at = 0; at < kTilePixels; at += kLanes) {
    const Vf weight = load(plane_of(ws.block + at * kPlaybackPlanes, kRunWeight));
    const Mf open = hn::Gt(weight, hn::Zero(df));
    if (!hn::AllFalse(df, open)) end_runs<kDraw>(batch, ws, at, open);
  }
  sum_runs<kDraw>(batch, ws);
  ws.pairs = batch.pairs;
  for (size_t c = 0; c < kSumPlanes<kDraw>; ++c)
    store_plane(tile, ws.block + kSumsBlock, kSumPlanes<kDraw>, c,
                scene.gbuffer + static_cast<size_t>(kSumToPlane[c]) * scene.plane_size,
                scene.row_size);
}

void playback(const SurfelScene& scene, const SplatTile& tile, SurfelWorkspace& ws) {
  if (scene.only_shading)
    playback_tile<Draw::kShading>(scene, tile, ws);
  else if (scene.own_normals)
    playback_tile<Draw::kAllOwnNormals>(scene, tile, ws);
  else
    playback_tile<Draw::kAll>(scene, tile, ws);
}

void halve(const float* from, size_t count, uint16_t* to) {
  constexpr hn::Rebind<hwy::float16_t, Dt> dh;
  for (size_t i = 0; i < count; i += kTexelLanes)
    hn::StoreU(hn::DemoteTo(dh, hn::LoadU(dt, from + i)), dh,
               reinterpret_cast<hwy::float16_t*>(to + i));
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
