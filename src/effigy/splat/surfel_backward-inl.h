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

// The same with derivatives with respect to the texture coordinates in texels.
HWY_INLINE void sample_with_slopes(const TextureGrid& grid, const Taps& taps, uint32_t bits,
                                   TexelLanes& value, TexelLanes& along_x, TexelLanes& along_y) {
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const float* p = grid.texels + 8 * static_cast<size_t>(taps.index[lane]);
    const float* q = p + grid.step_y;
    const auto fx = hn::Set(dt, taps.fx[lane]), fy = hn::Set(dt, taps.fy[lane]);
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto p0 = hn::LoadU(dt, p + c), q0 = hn::LoadU(dt, q + c);
      const auto dp = hn::Sub(hn::LoadU(dt, p + grid.step_x + c), p0);
      const auto dq = hn::Sub(hn::LoadU(dt, q + grid.step_x + c), q0);
      const auto top = hn::MulAdd(fx, dp, p0);
      const auto bottom = hn::MulAdd(fx, dq, q0);
      const auto dy = hn::Sub(bottom, top);
      const size_t at = 4 * lane;
      store_texel(hn::MulAdd(fy, dy, top), c, value.low + at, value.high + at);
      store_texel(hn::MulAdd(fy, hn::Sub(dq, dp), dp), c, along_x.low + at, along_x.high + at);
      store_texel(dy, c, along_y.low + at, along_y.high + at);
    }
  }
}

// Adds the lanes' texel gradients to the four texels that each lane read.
HWY_INLINE void scatter(const TextureGrid& grid, const Taps& taps, uint32_t bits,
                        const TexelLanes& gradient, const SurfelGradientBuffers& buffers) {
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const auto index = static_cast<size_t>(taps.index[lane]);
    buffers.touched[index / kTexelBlock] = 1;
    float* p = buffers.texels + 8 * index;
    float* q = p + grid.step_y;
    const float fx = taps.fx[lane], fy = taps.fy[lane];
    const float w11 = fx * fy, w01 = fx - w11, w10 = fy - w11, w00 = 1.0f - fx - w10;
    for (size_t c = 0; c < 8; c += kTexelLanes) {
      const auto g = load_texel(c, gradient.low + 4 * lane, gradient.high + 4 * lane);
      const auto add = [&](float* to, float weight) HWY_ATTR {
        hn::StoreU(hn::MulAdd(hn::Set(dt, weight), g, hn::LoadU(dt, to)), dt, to);
      };
      add(p + c, w00);
      add(p + grid.step_x + c, w01);
      add(q + c, w10);
      add(q + grid.step_x + c, w11);
    }
  }
}

// One surfel's gradient sums, a vector each.
struct Sums {
  HWY_ALIGN float lanes[SurfelSums::kCount * kLanes];
  HWY_INLINE float* at(int k) { return lanes + static_cast<size_t>(k) * kLanes; }
};

// Derivative of the distortion of the lanes' next list entries: dL/dw, dL/du, dL/dv.
HWY_INLINE void take_listed(uint32_t bits, size_t at, SurfelWorkspace& ws, Vf& h, Vf& qu, Vf& qv) {
  HWY_ALIGN float ah[kLanes] = {}, au[kLanes] = {}, av[kLanes] = {};
  for (; bits != 0; bits &= bits - 1) {
    const size_t lane = hwy::Num0BitsBelowLS1Bit_Nonzero32(bits);
    const size_t pixel = at + lane;
    const int32_t n = ws.cursor[pixel]++;
    if (n >= ws.listed[pixel]) continue;
    const size_t slot = static_cast<size_t>(n) * kTilePixels + pixel;
    ah[lane] = ws.list_h[slot];
    au[lane] = ws.list_qu[slot];
    av[lane] = ws.list_qv[slot];
  }
  h = load(ah);
  qu = load(au);
  qv = load(av);
}

// Everything backward needs at hand while it replays a tile.
struct Replay {
  const SurfelScene& scene;
  SurfelWorkspace& ws;
  const SurfelGradientBuffers& buffers;
  TextureGrid grid;
  Taps taps = {};
  TexelLanes value = {}, along_x = {}, along_y = {}, d_texel = {};
  Sums sums = {};
  bool any = false;

  Replay(const SurfelScene& s, SurfelWorkspace& w, const SurfelGradientBuffers& b)
      : scene(s), ws(w), buffers(b), grid(s) {}
};

// Texel gradients of one vector: scatters them, adds to the frame's sums, and returns the
// derivatives with respect to texture u and v.
HWY_INLINE void texture_backward(Replay& replay, const SurfelRecord& r, const Material& m, Vf w,
                                 uint32_t bits, size_t at, Mf inside_x, Mf inside_y, Vf& du,
                                 Vf& dv) {
  SurfelWorkspace& ws = replay.ws;
  Sums& sums = replay.sums;
  const Vf zero = hn::Zero(df);
  const Vf wx = hn::Mul(w, m.nx), wy = hn::Mul(w, m.ny), wz = hn::Mul(w, m.nz);
  Vf along_t = zero, along_b = zero, along_n = zero;
  for (int k = 0; k < 3; ++k) {
    const Vf g = load(ws.grad[kMappedNormal + k] + at);
    add_product(sums.at(SurfelSums::kFrame + k), wx, g);
    add_product(sums.at(SurfelSums::kFrame + 3 + k), wy, g);
    add_product(sums.at(SurfelSums::kFrame + 6 + k), wz, g);
    along_t = hn::MulAdd(set(r.frame[k]), g, along_t);
    along_b = hn::MulAdd(set(r.frame[3 + k]), g, along_b);
    along_n = hn::MulAdd(set(r.frame[6 + k]), g, along_n);
  }
  // n_z = sqrt(1 - x^2 - y^2), constant 0 beyond the unit circle.
  const Vf upright = hn::IfThenElseZero(hn::Gt(m.nz, zero), hn::Div(along_n, m.nz));
  const Vf d_nx = hn::Mul(w, hn::NegMulAdd(m.nx, upright, along_t));
  const Vf d_ny = hn::Mul(w, hn::NegMulAdd(m.ny, upright, along_b));
  Vf d[5];
  for (int k = 0; k < 5; ++k) d[k] = hn::Mul(w, load(ws.grad[kAlbedo + k] + at));
  hn::StoreInterleaved4(d[0], d[1], d[2], d[3], df, replay.d_texel.low);
  hn::StoreInterleaved4(d[4], d_nx, d_ny, zero, df, replay.d_texel.high);
  scatter(replay.grid, replay.taps, bits, replay.d_texel, replay.buffers);

  const auto slope = [&](const TexelLanes& lanes) HWY_ATTR {
    Vf c0, c1, c2, c3, c4, c5, c6, c7;
    hn::LoadInterleaved4(df, lanes.low, c0, c1, c2, c3);
    hn::LoadInterleaved4(df, lanes.high, c4, c5, c6, c7);
    Vf sum = hn::MulAdd(d[0], c0, hn::MulAdd(d[1], c1, hn::Mul(d[2], c2)));
    sum = hn::MulAdd(d[3], c3, hn::MulAdd(d[4], c4, sum));
    return hn::MulAdd(d_nx, c5, hn::MulAdd(d_ny, c6, sum));
  };
  du = hn::IfThenElseZero(inside_x, hn::Mul(slope(replay.along_x), set(replay.grid.width)));
  dv = hn::IfThenElseZero(inside_y, hn::Mul(slope(replay.along_y), set(replay.grid.height)));
}

// From the derivatives with respect to alpha, depth and texture uv to the surfel's sums.
template <bool kLowPass>
HWY_INLINE void geometry_backward(Sums& sums, const SurfelRecord& r, const Hit& hit, Vf dx,
                                  float dy, Vf d_alpha, Vf d_z, Vf d_tu, Vf d_tv) {
  const Vf scaled = hn::Mul(d_alpha, hit.alpha);
  add_to(sums.at(SurfelSums::kOpacity), scaled);
  add_to(sums.at(SurfelSums::kUv), d_tu);
  add_to(sums.at(SurfelSums::kUv + 1), d_tv);
  add_product(sums.at(SurfelSums::kUvPerSt), d_tu, hit.u);
  add_product(sums.at(SurfelSums::kUvPerSt + 1), d_tu, hit.v);
  add_product(sums.at(SurfelSums::kUvPerSt + 2), d_tv, hit.u);
  add_product(sums.at(SurfelSums::kUvPerSt + 3), d_tv, hit.v);
  // d alpha / d rho = -alpha / 2; rho = u^2 + v^2.
  const Vf d_u = hn::NegMulAdd(
      scaled, hit.u, hn::MulAdd(set(r.uv_per_st[0]), d_tu, hn::Mul(set(r.uv_per_st[2]), d_tv)));
  const Vf d_v = hn::NegMulAdd(
      scaled, hit.v, hn::MulAdd(set(r.uv_per_st[1]), d_tu, hn::Mul(set(r.uv_per_st[3]), d_tv)));
  const Vf d_a = hn::Mul(d_u, hit.inverse), d_b = hn::Mul(d_v, hit.inverse);
  const Vf d_depth = hn::Mul(d_z, hit.inverse);
  const Vf d_c = hn::Neg(hn::MulAdd(d_a, hit.u, hn::MulAdd(d_b, hit.v, hn::Mul(d_depth, hit.z))));
  const Vf y = set(dy);
  const auto affine = [&](int k, Vf g) HWY_ATTR {
    add_to(sums.at(k), g);
    add_product(sums.at(k + 1), g, dx);
    add_product(sums.at(k + 2), g, y);
  };
  affine(SurfelSums::kA, d_a);
  affine(SurfelSums::kB, d_b);
  affine(SurfelSums::kC, d_c);
  add_to(sums.at(SurfelSums::kDepth), d_depth);
  if constexpr (kLowPass) {
    const Mf filtered = hn::And(hit.low_pass, hit.blended);
    if (hn::AllFalse(df, filtered)) return;
    // rho = 2 (ex^2 + ey^2), ex = x - centre: d alpha / d centre_x = 2 alpha ex.
    const Vf twice = hn::IfThenElseZero(filtered, hn::Add(scaled, scaled));
    add_product(sums.at(SurfelSums::kScreen), twice, hit.ex);
    add_product(sums.at(SurfelSums::kScreen + 1), twice, hit.ey);
    add_to(sums.at(SurfelSums::kCenterZ), hn::IfThenElseZero(filtered, d_z));
  }
}

template <bool kLowPass, bool kLists>
HWY_INLINE void replay_vector(Replay& replay, const SurfelRecord& r, const Hit& hit, uint32_t bits,
                              Vf dx, float dy, size_t at) {
  SurfelWorkspace& ws = replay.ws;
  const auto grad = [&](int plane) HWY_ATTR { return load(ws.grad[plane] + at); };
  Vf u, v;
  texture_uv(r, hit, u, v);
  Mf inside_x, inside_y;
  place_taps(replay.grid, u, v, replay.taps, inside_x, inside_y);
  sample_with_slopes(replay.grid, replay.taps, bits, replay.value, replay.along_x, replay.along_y);
  const Material m = unpack(replay.value);
  const Vf w = hit.weight;

  // dL/dw of this surfel.
  const Vf g_z = grad(kDepth), g_u = grad(kUv), g_v = grad(kUv + 1);
  Vf d_w = hn::MulAdd(g_z, hit.z, grad(kAlpha));
  for (int k = 0; k < 5; ++k) d_w = hn::MulAdd(grad(kAlbedo + k), m.channel[k], d_w);
  for (int k = 0; k < 3; ++k) {
    const Vf mapped =
        hn::MulAdd(m.nx, set(r.frame[k]),
                   hn::MulAdd(m.ny, set(r.frame[3 + k]), hn::Mul(m.nz, set(r.frame[6 + k]))));
    d_w = hn::MulAdd(grad(kMappedNormal + k), mapped, d_w);
    const Vf g_n = grad(kNormal + k);
    d_w = hn::MulAdd(g_n, set(r.normal[k]), d_w);
    add_product(replay.sums.at(SurfelSums::kNormal + k), w, g_n);
  }
  d_w = hn::MulAdd(g_u, u, hn::MulAdd(g_v, v, d_w));
  Vf d_tu, d_tv;
  texture_backward(replay, r, m, w, bits, at, inside_x, inside_y, d_tu, d_tv);
  d_tu = hn::MulAdd(w, g_u, d_tu);
  d_tv = hn::MulAdd(w, g_v, d_tv);
  if constexpr (kLists) {
    Vf h, qu, qv;
    take_listed(bits, at, ws, h, qu, qv);
    const Vf g = grad(kUvDistortion), weighted = hn::Mul(w, g);
    d_w = hn::MulAdd(g, h, d_w);
    d_tu = hn::MulAdd(weighted, qu, d_tu);
    d_tv = hn::MulAdd(weighted, qv, d_tv);
  }

  // w = alpha T, and every later weight carries (1 - alpha).
  const Vf later = hn::NegMulAdd(w, d_w, load(ws.remaining + at));
  store(later, ws.remaining + at);
  const Vf through = hn::Div(later, hn::Sub(set(1.0f), hit.alpha));
  const Mf free = hn::And(hit.blended, hn::Lt(hit.alpha, set(kMaxAlpha)));
  const Vf d_alpha = hn::IfThenElseZero(free, hn::MulSub(hit.before, d_w, through));
  geometry_backward<kLowPass>(replay.sums, r, hit, dx, dy, d_alpha, hn::Mul(w, g_z), d_tu, d_tv);
}

template <bool kLowPass, bool kLists>
void backward_tile(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws,
                   const SurfelGradientBuffers& buffers) {
  if constexpr (kLists) {
    begin_lists(tile, true, ws);
    forward_walk<kLowPass, false, true>(scene, tile, ws);
    for (size_t at = 0; at < kTilePixels; at += kLanes)
      distortion_backward(at, scene.uv_distortion == UvDistortion::kSquared, ws);
  }
  Alive alive;
  begin_tile(tile, ws, alive);
  Replay replay(scene, ws, buffers);
  const auto begin = [&](uint32_t) HWY_ATTR {
    std::memset(replay.sums.lanes, 0, sizeof(replay.sums.lanes));
    replay.any = false;
  };
  const auto visit = [&](uint32_t, const SurfelRecord& r, const RowStart& row, Vf dx,
                         size_t at) HWY_ATTR {
    const Hit hit = intersect<kLowPass>(r, row, dx, load(ws.transmittance + at), scene.near);
    update(hit, at, ws, alive);
    const uint32_t bits = bits_of(hit.blended);
    if (bits == 0) return;
    replay.any = true;
    replay_vector<kLowPass, kLists>(replay, r, hit, bits, dx, row.dy, at);
  };
  const auto end = [&](uint32_t surfel) HWY_ATTR {
    if (!replay.any) return;
    float* sums = buffers.sums + static_cast<size_t>(surfel) * SurfelSums::kCount;
    for (int k = 0; k < SurfelSums::kCount; ++k)
      sums[k] += hn::GetLane(hn::SumOfLanes(df, load(replay.sums.at(k))));
  };
  walk(scene, tile, ws, alive, visit, begin, end);
}

void backward(const SurfelScene& scene, const SurfelTile& tile, SurfelWorkspace& ws,
              const SurfelGradientBuffers& buffers) {
  const bool lists = scene.uv_distortion != UvDistortion::kOff;
  if (scene.low_pass)
    lists ? backward_tile<true, true>(scene, tile, ws, buffers)
          : backward_tile<true, false>(scene, tile, ws, buffers);
  else
    lists ? backward_tile<false, true>(scene, tile, ws, buffers)
          : backward_tile<false, false>(scene, tile, ws, buffers);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
