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

// The block of a vector of pixels: its current run, the transmittance, and the depth.
enum PlaybackPlane : int {
  kRunWeight = 0,
  kRunStart = 1,  // 2: uv of its first surfel
  kRunUv = 3,     // 2: sum of w (uv - start)
  kRunFrame = 5,  // 9: sum of w times the flipped frame
  kRunPlanes = 14,
  kPlaybackT = 14,
  kPlaybackDepth = 15,
  kPlaybackPlanes = 16,
};
// The other outputs, in a second block: touched only where a run ends.
constexpr size_t kSumsBlock = kTilePixels * kPlaybackPlanes;
constexpr size_t kSumPlanes = kUvDistortion;
static_assert(kPlaybackPlanes + kSumPlanes <= kMostPlanes);

HWY_INLINE float* plane_of(float* block, int k) {
  return block + static_cast<size_t>(k) * kLanes;
}

// Vectors of pixels that met a surfel, and vectors of pixels with runs that have ended.
struct PlaybackBatch {
  TextureGrid grid;
  HWY_ALIGN float w[kSlots];
  HWY_ALIGN float z[kSlots];
  HWY_ALIGN float u[kSlots];
  HWY_ALIGN float v[kSlots];
  HWY_ALIGN float before[kSlots];
  const SurfelRecord* record[kBatch];
  size_t at[kBatch];
  size_t count = 0;

  TextureBatch texture = {};
  HWY_ALIGN float run[kBatch][12 * kLanes];  // weight, uv, frame
  size_t run_at[kBatch];
  size_t runs = 0;
  int64_t pairs = 0;

  explicit PlaybackBatch(const SurfelScene& scene) : grid(scene) {}
};

// Reads the texture once for each ended run and adds it to the sums.
template <bool kOwnNormals>
HWY_INLINE void sum_runs(PlaybackBatch& batch, SurfelWorkspace& ws) {
  sample(batch.grid, batch.texture);
  for (size_t k = 0; k < batch.runs; ++k) {
    float* const sums = ws.block + kSumsBlock + batch.run_at[k] * kSumPlanes;
    const auto run = [&](size_t p) HWY_ATTR { return load(batch.run[k] + p * kLanes); };
    const Material m = unpack(batch.texture.texel + 8 * k * kLanes);
    const Vf weight = run(0);
    add_to(plane_of(sums, kAlpha), weight);
    for (int c = 0; c < 5; ++c) add_product(plane_of(sums, kAlbedo + c), weight, m.channel[c]);
    add_product(plane_of(sums, kUv), weight, run(1));
    add_product(plane_of(sums, kUv + 1), weight, run(2));
    for (size_t c = 0; c < 3; ++c) {
      const Vf normal = run(9 + c);
      const int mapped = kMappedNormal + static_cast<int>(c);
      add_to(plane_of(sums, mapped),
             hn::MulAdd(m.nx, run(3 + c), hn::MulAdd(m.ny, run(6 + c), hn::Mul(m.nz, normal))));
      if constexpr (!kOwnNormals) add_to(plane_of(sums, kNormal + static_cast<int>(c)), normal);
    }
  }
  batch.texture.slots = 0;
  batch.runs = 0;
}

// Puts the runs of the lanes in `ending` aside for sum_runs and empties them.
template <bool kOwnNormals>
HWY_INLINE void end_runs(PlaybackBatch& batch, SurfelWorkspace& ws, size_t at, Mf ending) {
  float* const block = ws.block + at * kPlaybackPlanes;
  const auto run = [block](int k) HWY_ATTR { return load(plane_of(block, k)); };
  const Vf weight = hn::IfThenElseZero(ending, run(kRunWeight));
  const Vf inverse = hn::Div(set(1.0f), hn::Max(weight, set(1e-6f)));
  const Vf u = hn::MulAdd(run(kRunUv), inverse, run(kRunStart));
  const Vf v = hn::MulAdd(run(kRunUv + 1), inverse, run(kRunStart + 1));
  const size_t k = batch.runs++;
  float* const to = batch.run[k];
  batch.run_at[k] = at;
  store(weight, to);
  store(hn::IfThenElseZero(ending, u), to + kLanes);
  store(hn::IfThenElseZero(ending, v), to + 2 * kLanes);
  put_taps(find_taps(batch.grid, load(to + kLanes), load(to + 2 * kLanes)), ending, k,
           batch.texture);
  for (int c = 0; c < 9; ++c) {
    const Vf frame = run(kRunFrame + c);
    store(hn::IfThenElseZero(ending, frame), plane_of(to, 3 + c));
    store(hn::IfThenZeroElse(ending, frame), plane_of(block, kRunFrame + c));
  }
  for (int c = kRunWeight; c < kRunFrame; ++c)
    store(hn::IfThenZeroElse(ending, run(c)), plane_of(block, c));
  if (batch.runs == kBatch) sum_runs<kOwnNormals>(batch, ws);
}

// Adds the batch to the pixels' runs and empties it. kOwnNormals: the frames' normals are not the
// surfels' own, which then need their own sums.
template <bool kOwnNormals>
HWY_INLINE void join_runs(const SurfelScene& scene, PlaybackBatch& batch, SurfelWorkspace& ws) {
  const Vf width = set(batch.grid.width), height = set(batch.grid.height);
  const Vf reach = set(scene.spread * scene.spread);
  for (size_t k = 0; k < batch.count; ++k) {
    const SurfelRecord& r = *batch.record[k];
    const size_t at = batch.at[k], first = k * kLanes;
    float* const block = ws.block + at * kPlaybackPlanes;
    const auto run = [block](int p) HWY_ATTR { return load(plane_of(block, p)); };
    const Vf w = load(batch.w + first), u = load(batch.u + first), v = load(batch.v + first);
    const Mf blended = hn::Gt(w, hn::Zero(df));
    // uv - start; against the mean, times the run's weight: nothing to divide, and 0 for a new run.
    Vf du = hn::Sub(u, run(kRunStart)), dv = hn::Sub(v, run(kRunStart + 1));
    const Vf weight = run(kRunWeight), sum_u = run(kRunUv), sum_v = run(kRunUv + 1);
    const Vf away_u = hn::Mul(hn::MulSub(weight, du, sum_u), width);
    const Vf away_v = hn::Mul(hn::MulSub(weight, dv, sum_v), height);
    const Vf away2 = hn::MulAdd(away_u, away_u, hn::Mul(away_v, away_v));
    const Vf allowed = hn::Mul(hn::Mul(reach, hn::Mul(weight, weight)), hn::Add(weight, w));
    const Mf far = hn::And(blended, hn::Gt(hn::Mul(w, away2), allowed));
    Mf fresh = hn::And(blended, hn::Eq(weight, hn::Zero(df)));
    if (!hn::AllFalse(df, far)) {
      const Mf joins = hn::And(far, hn::Lt(load(batch.before + first), set(scene.negligible)));
      const Vf inverse = hn::Div(set(1.0f), hn::Max(weight, set(1e-6f)));
      du = hn::IfThenElse(joins, hn::Mul(sum_u, inverse), du);
      dv = hn::IfThenElse(joins, hn::Mul(sum_v, inverse), dv);
      const Mf ending = hn::AndNot(joins, far);
      if (!hn::AllFalse(df, ending)) {
        end_runs<kOwnNormals>(batch, ws, at, ending);
        fresh = hn::Or(fresh, ending);
      }
    }
    if (!hn::AllFalse(df, fresh)) {
      store(hn::IfThenElse(fresh, u, run(kRunStart)), plane_of(block, kRunStart));
      store(hn::IfThenElse(fresh, v, run(kRunStart + 1)), plane_of(block, kRunStart + 1));
      du = hn::IfThenZeroElse(fresh, du);
      dv = hn::IfThenZeroElse(fresh, dv);
    }
    add_to(plane_of(block, kRunWeight), w);
    add_product(plane_of(block, kRunUv), w, du);
    add_product(plane_of(block, kRunUv + 1), w, dv);
    for (int c = 0; c < 9; ++c) add_product(plane_of(block, kRunFrame + c), w, set(r.frame[c]));
    add_product(plane_of(block, kPlaybackDepth), w, load(batch.z + first));
    if constexpr (kOwnNormals) {
      float* const sums = ws.block + kSumsBlock + at * kSumPlanes;
      for (int c = 0; c < 3; ++c) add_product(plane_of(sums, kNormal + c), w, set(r.normal[c]));
    }
  }
  batch.count = 0;
}

template <bool kOwnNormals>
void playback_tile(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws) {
  std::memset(ws.block, 0, sizeof(float) * kTilePixels * (kPlaybackPlanes + kSumPlanes));
  Alive alive;
  begin_tile(tile, kPlaybackPlanes, kPlaybackT, ws, alive);
  PlaybackBatch batch(scene);
  const Vf opaque = set(scene.opaque);
  const auto visit = [&](auto low_pass, uint32_t, const SurfelRecord& r, const SurfelRows& rows,
                         const SurfelColumn& column, size_t y, size_t at) HWY_ATTR {
    float* const transmittance = plane_of(ws.block + at * kPlaybackPlanes, kPlaybackT);
    Hit hit =
        intersect<decltype(low_pass)::value>(r, rows, column, y, load(transmittance), scene.near);
    const Mf done = hn::And(hit.blended, hn::Lt(hit.after, opaque));
    hit.finished = hn::Or(hit.finished, done);
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
    store(hit.z, batch.z + first);
    store(hit.before, batch.before + first);
    store(u, batch.u + first);
    store(v, batch.v + first);
    if (batch.count == kBatch) join_runs<kOwnNormals>(scene, batch, ws);
  };
  const auto begin = [](uint32_t) HWY_ATTR {};
  walk(scene, tile, ws, alive, visit, begin);
  join_runs<kOwnNormals>(scene, batch, ws);
  for (size_t at = 0; at < kTilePixels; at += kLanes) {
    float* const block = ws.block + at * kPlaybackPlanes;
    const Mf open = hn::Gt(load(plane_of(block, kRunWeight)), hn::Zero(df));
    if (!hn::AllFalse(df, open)) end_runs<kOwnNormals>(batch, ws, at, open);
    store(load(plane_of(block, kPlaybackDepth)),
          plane_of(ws.block + kSumsBlock + at * kSumPlanes, kDepth));
  }
  sum_runs<kOwnNormals>(batch, ws);
  ws.pairs = batch.pairs;
  store_tile(scene, tile, ws.block + kSumsBlock, kSumPlanes, kSumPlanes);
}

void playback(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws) {
  if (scene.own_normals)
    playback_tile<true>(scene, tile, ws);
  else
    playback_tile<false>(scene, tile, ws);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
