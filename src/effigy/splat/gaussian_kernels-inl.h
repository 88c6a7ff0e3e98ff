// The Gaussian rasterizer's inner loops for one instruction set: included by gaussian_kernels.cpp
// once per target and by gaussian_kernels_scalar.cpp.

#if defined(EFFIGY_SPLAT_GAUSSIAN_KERNELS_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_GAUSSIAN_KERNELS_INL_H_
#undef EFFIGY_SPLAT_GAUSSIAN_KERNELS_INL_H_
#else
#define EFFIGY_SPLAT_GAUSSIAN_KERNELS_INL_H_
#endif

#include <algorithm>
#include <cstring>

#include "effigy/splat/gaussian_kernels.h"
#include "effigy/splat/tile_lanes-inl.h"
#include "hwy/cache_control.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

constexpr float kLog2MinAlpha = -7.9943534f;  // log2(1 / 255)

// The block of a vector of pixels. The transmittance of a finished pixel is kept negative, that of
// one outside the image is -1.
constexpr size_t kT = 0;
// Forward: the features' sums.
constexpr size_t kForwardFeatures = 1;
// Backward: the sum of w dL/dw over the Gaussians not yet replayed, and the derivatives of the loss
// with respect to alpha and the features.
constexpr size_t kRemaining = 1;
constexpr size_t kDerivatives = 2;

// One Gaussian as a tile sees it.
struct GaussianRow {
  Vf a, b, c, log2_opacity;
  Vf dy0;  // centre of the vector's pixels, moved to the first row - mean
  HWY_ALIGN float au[kColumns * kLanes];  // a dx of every column of vectors
  uint32_t reach[kWords];
};

HWY_INLINE void find_gaussian(const GaussianRecord& r, const SplatTile& tile, GaussianRow& row) {
  const EllipseOutline& o = r.outline;
  // Exact, both being whole numbers and a half.
  const float x = static_cast<float>(tile.x) + 0.5f - r.anchor_x;
  const float y = static_cast<float>(tile.y) + 0.5f - r.anchor_y;
  row.a = set(r.a);
  row.b = set(r.b);
  row.c = set(r.c);
  row.log2_opacity = set(r.log2_opacity);
  row.dy0 = hn::Add(lane_y(), set(y - o.y));
  const Vf dx = hn::Add(lane_x(), set(x - o.x));
  for (size_t j = 0; j < kColumns; ++j)
    store(hn::Mul(row.a, hn::Add(dx, set(static_cast<float>(j * kWide)))), row.au + j * kLanes);
  if (o.everywhere)
    std::fill_n(row.reach, kWords, ~uint32_t{0});
  else
    vectors_in_ellipse(o, x, y, row.reach);
}

// One Gaussian met by a vector of pixels.
struct Meeting {
  Vf u, v, alpha;
  Vf before, after;  // transmittance
  Mf blended;        // lanes where it is blended
};

// `transmittance` is replaced.
HWY_INLINE Meeting meet(const GaussianRow& row, size_t vector, float* transmittance,
                        VectorSet& alive) {
  Meeting m;
  const Vf y = hn::Add(row.dy0, set(static_cast<float>(vector / kColumns * kTall)));
  m.u = hn::MulAdd(row.b, y, load(row.au + vector % kColumns * kLanes));
  m.v = hn::Mul(row.c, y);
  const Vf exponent = hn::NegMulAdd(m.u, m.u, hn::NegMulAdd(m.v, m.v, row.log2_opacity));
  const Mf reached = hn::Ge(exponent, set(kLog2MinAlpha));
  m.alpha = hn::Min(exp2_fast(exponent), set(kMaxAlpha));
  m.before = load(transmittance);
  m.after = hn::NegMulAdd(m.alpha, m.before, m.before);
  const Mf enough = hn::Ge(m.after, set(kMinTransmittance));
  m.blended = hn::And(reached, enough);
  const Mf finished = hn::AndNot(enough, reached);
  const Vf sign = hn::IfThenElseZero(finished, hn::SignBit(df));
  const Vf next = hn::IfThenElse(m.blended, m.after, hn::Or(m.before, sign));
  store(next, transmittance);
  // Once for every vector, so that the processor foresees it.
  if (hn::AllTrue(df, hn::Lt(next, hn::Zero(df)))) alive.remove(vector);
  return m;
}

// Calls visit(row, vector) for every vector of pixels that the tile's Gaussians reach, front to
// back, and begin(id), end(entry, id) around each Gaussian. Returns the number of entries walked.
template <class Begin, class Visit, class End>
HWY_INLINE size_t walk_gaussians(const GaussianTarget& scene, const SplatTile& tile,
                                 VectorSet& alive, const Begin& begin, const Visit& visit,
                                 const End& end) {
  // The next Gaussian is looked at before the present one is drawn: which vectors it reaches takes
  // long to find out, and the processor cannot go on without knowing.
  GaussianRow rows[2];
  if (tile.count > 0) find_gaussian(scene.records[tile.entries[0]], tile, rows[0]);
  size_t e = 0;
  for (; e < tile.count && alive.count != 0; ++e) {
    const uint32_t id = tile.entries[e];
    if (e + 8 < tile.count) {
      hwy::Prefetch(scene.records + tile.entries[e + 8]);
      hwy::Prefetch(scene.features + tile.entries[e + 8] * scene.channels);
    }
    const GaussianRow& row = rows[e % 2];
    if (e + 1 < tile.count)
      find_gaussian(scene.records[tile.entries[e + 1]], tile, rows[(e + 1) % 2]);
    begin(id);
    for (size_t w = 0; w < kWords; ++w) {
      for (uint32_t bits = row.reach[w] & alive.words[w]; bits != 0; bits &= bits - 1)
        visit(row, 32 * w + hwy::Num0BitsBelowLS1Bit_Nonzero32(bits));
    }
    end(e, id);
  }
  return e;
}

// Fills the tile with what an empty one shows.
HWY_INLINE void clear_tile(const GaussianTarget& scene, const SplatTile& tile) {
  for (size_t p = 0; p <= scene.channels; ++p) {
    const float value = p == 0 ? 0.0f : scene.background[p - 1];
    for (size_t y = 0; y < static_cast<size_t>(tile.height); ++y)
      std::fill_n(scene.image + p * scene.plane_size +
                      (static_cast<size_t>(tile.y) + y) * scene.row_size +
                      static_cast<size_t>(tile.x),
                  tile.width, value);
  }
}

// kChannels: the number of channels, 0 when it is only known at run time.
template <size_t kChannels>
void forward_tile(const GaussianTarget& scene, const SplatTile& tile, GaussianWorkspace& ws) {
  const size_t channels = kChannels ? kChannels : scene.channels;
  const size_t planes = kForwardFeatures + channels;
  ws.block.reserve(planes * kTilePixels);
  float* const block = ws.block.data();
  std::memset(block, 0, sizeof(float) * kTilePixels * planes);
  VectorSet alive;
  begin_tile(tile, planes, kT, -1.0f, block, alive);
  const float* feature = nullptr;
  Vi pairs = hn::Zero(di);
  const auto begin = [&](uint32_t id) HWY_ATTR { feature = scene.features + id * channels; };
  const auto visit = [&](const GaussianRow& row, size_t vector) HWY_ATTR {
    float* const pixels = block + vector * kLanes * planes;
    const Meeting m = meet(row, vector, pixels, alive);
    pairs = hn::Sub(pairs, hn::BitCast(di, hn::VecFromMask(df, m.blended)));
    const Vf w = hn::IfThenElseZero(m.blended, hn::Mul(m.alpha, m.before));
    float* const sums = pixels + kForwardFeatures * kLanes;
    for (size_t c = 0; c < channels; ++c) add_product(sums + c * kLanes, w, set(feature[c]));
  };
  const auto end = [](size_t, uint32_t) HWY_ATTR {};
  ws.used = walk_gaussians(scene, tile, alive, begin, visit, end);
  ws.pairs = hn::GetLane(hn::SumOfLanes(di, pairs));
  for (size_t at = 0; at < kTilePixels; at += kLanes) {
    float* const pixels = block + at * planes;
    const Vf rest = hn::Abs(load(pixels));
    store(hn::Sub(set(1.0f), rest), pixels);
    for (size_t c = 0; c < channels; ++c)
      add_product(pixels + (kForwardFeatures + c) * kLanes, rest, set(scene.background[c]));
  }
  for (size_t p = 0; p < planes; ++p)
    store_plane(tile, block, planes, p, scene.image + p * scene.plane_size, scene.row_size);
}

void forward(const GaussianTarget& scene, const SplatTile& tile, GaussianWorkspace& ws) {
  ws.pairs = 0;
  ws.used = 0;
  if (tile.count == 0) return clear_tile(scene, tile);
  if (scene.channels == 3) return forward_tile<3>(scene, tile, ws);
  if (scene.channels == 10) return forward_tile<10>(scene, tile, ws);
  forward_tile<0>(scene, tile, ws);
}

// Loads the tile's derivatives (0 outside the image). With D = dL/dalpha - sum of background_c
// dL/dfeature_c, the loss changes by sum of w (D + sum of f_c dL/dfeature_c); all of it is the
// first "remaining".
HWY_INLINE void load_derivatives(const GaussianTarget& scene, const SplatTile& tile, size_t planes,
                                 float* block) {
  for (size_t y = 0; y < static_cast<size_t>(tile.height); ++y) {
    const size_t row =
        (static_cast<size_t>(tile.y) + y) * scene.row_size + static_cast<size_t>(tile.x);
    for (size_t x = 0; x < static_cast<size_t>(tile.width); x += kWide) {
      const size_t at = (y / kTall * kColumns + x / kWide) * kLanes;
      float* const pixels = block + at * planes + y % kTall * kWide;
      const size_t left = static_cast<size_t>(tile.width) - x;
      const auto alpha = load_row(scene.image + row + x, left);
      const auto rest = hn::Sub(hn::Set(dw, 1.0f), alpha);
      auto d_alpha = load_row(scene.d_image + row + x, left);
      auto remaining = hn::Zero(dw);
      for (size_t c = 0; c < scene.channels; ++c) {
        const size_t from = (c + 1) * scene.plane_size + row + x;
        const auto d = load_row(scene.d_image + from, left);
        const auto background = hn::Set(dw, scene.background[c]);
        const auto value = hn::NegMulAdd(rest, background, load_row(scene.image + from, left));
        hn::Store(d, dw, pixels + (kDerivatives + 1 + c) * kLanes);
        remaining = hn::MulAdd(d, value, remaining);
        d_alpha = hn::NegMulAdd(d, background, d_alpha);
      }
      hn::Store(d_alpha, dw, pixels + kDerivatives * kLanes);
      hn::Store(hn::MulAdd(d_alpha, alpha, remaining), dw, pixels + kRemaining * kLanes);
    }
  }
}

// Vectors of pixels that met one Gaussian, and what the later steps need of the meeting. u, v,
// weight and alpha are finite or masked: alpha is 0 in lanes where nothing is blended.
struct MetVectors {
  HWY_ALIGN float u[kTilePixels];
  HWY_ALIGN float v[kTilePixels];
  HWY_ALIGN float w[kTilePixels];
  HWY_ALIGN float alpha[kTilePixels];
  HWY_ALIGN float before[kTilePixels];
  HWY_ALIGN float d_w[kTilePixels];
  float* pixels[kVectors];
  size_t count = 0;
};

// For kGroup channels from `first` on: the share of the features in dL/dw, and dL/dfeature.
template <size_t kGroup>
HWY_INLINE void channels_backward(MetVectors& met, const float* feature, size_t first,
                                  float* sums) {
  const auto at = [&](size_t c)
                      HWY_ATTR { return c < kGroup ? set(feature[first + c]) : hn::Zero(df); };
  const Vf f0 = at(0), f1 = at(1), f2 = at(2), f3 = at(3), f4 = at(4);
  Vf s0 = hn::Zero(df), s1 = s0, s2 = s0, s3 = s0, s4 = s0;
  for (size_t k = 0; k < met.count; ++k) {
    const float* d = met.pixels[k] + (kDerivatives + 1 + first) * kLanes;
    const Vf w = load(met.w + k * kLanes);
    Vf d_w = load(met.d_w + k * kLanes);
    const auto step = [&](size_t c, Vf f, Vf& s) HWY_ATTR {
      if (c >= kGroup) return;
      const Vf g = load(d + c * kLanes);
      d_w = hn::MulAdd(g, f, d_w);
      s = hn::MulAdd(g, w, s);
    };
    step(0, f0, s0);
    step(1, f1, s1);
    step(2, f2, s2);
    step(3, f3, s3);
    step(4, f4, s4);
    store(d_w, met.d_w + k * kLanes);
  }
  const auto put = [&](size_t c, Vf s) HWY_ATTR {
    if (c < kGroup) store(s, sums + (GaussianSums::kCount + first + c) * kLanes);
  };
  put(0, s0);
  put(1, s1);
  put(2, s2);
  put(3, s3);
  put(4, s4);
}

// From dL/dw to the sums of the Gaussian's exponent; takes its share from what remains.
HWY_INLINE void exponent_backward(MetVectors& met, float* sums) {
  const Vf zero = hn::Zero(df), one = set(1.0f);
  Vf s = zero, su = zero, sv = zero, suu = zero, suv = zero, svv = zero;
  for (size_t k = 0; k < met.count; ++k) {
    const size_t at = k * kLanes;
    float* const remaining = met.pixels[k] + kRemaining * kLanes;
    const Vf alpha = load(met.alpha + at), d_w = load(met.d_w + at);
    // w = alpha T, and every later weight carries (1 - alpha).
    const Vf later = hn::NegMulAdd(load(met.w + at), d_w, load(remaining));
    store(later, remaining);
    const Vf through = hn::Div(later, hn::Sub(one, alpha));
    const Vf d_alpha = hn::MulSub(load(met.before + at), d_w, through);
    // The clamp passes nothing on; alpha is 0 where nothing is blended.
    const Vf g = hn::IfThenElseZero(hn::Lt(alpha, set(kMaxAlpha)), hn::Mul(d_alpha, alpha));
    const Vf u = load(met.u + at), v = load(met.v + at);
    const Vf gu = hn::Mul(g, u), gv = hn::Mul(g, v);
    s = hn::Add(s, g);
    su = hn::Add(su, gu);
    sv = hn::Add(sv, gv);
    suu = hn::MulAdd(gu, u, suu);
    suv = hn::MulAdd(gu, v, suv);
    svv = hn::MulAdd(gv, v, svv);
  }
  const auto put = [sums](int k, Vf x)
                       HWY_ATTR { store(x, sums + static_cast<size_t>(k) * kLanes); };
  put(GaussianSums::kOne, s);
  put(GaussianSums::kU, su);
  put(GaussianSums::kV, sv);
  put(GaussianSums::kUU, suu);
  put(GaussianSums::kUV, suv);
  put(GaussianSums::kVV, svv);
}

template <size_t kChannels>
HWY_INLINE void all_channels_backward(MetVectors& met, const float* feature, size_t channels,
                                      float* sums) {
  if constexpr (kChannels == 3) {
    channels_backward<3>(met, feature, 0, sums);
  } else if constexpr (kChannels == 10) {
    channels_backward<5>(met, feature, 0, sums);
    channels_backward<5>(met, feature, 5, sums);
  } else {
    size_t c = 0;
    for (; c + 4 <= channels; c += 4) channels_backward<4>(met, feature, c, sums);
    for (; c < channels; ++c) channels_backward<1>(met, feature, c, sums);
  }
}

// Replays the forward walk (same thresholds, same bits).
template <size_t kChannels>
void backward_tile(const GaussianTarget& scene, const SplatTile& tile, GaussianWorkspace& ws,
                   const uint32_t* places, float* entry_sums, float* d_background) {
  const size_t channels = kChannels ? kChannels : scene.channels;
  const size_t planes = kDerivatives + 1 + channels;
  const size_t stride = GaussianSums::kCount + channels;
  const size_t rounded = (stride + 7) / 8 * 8;
  ws.block.reserve(planes * kTilePixels);
  ws.sums.reserve(rounded * (kLanes + 1));
  float* const block = ws.block.data();
  float* const sums = ws.sums.data();
  std::memset(sums, 0, sizeof(float) * rounded * (kLanes + 1));
  std::memset(block, 0, sizeof(float) * kTilePixels * planes);
  load_derivatives(scene, tile, planes, block);
  VectorSet alive;
  begin_tile(tile, planes, kT, -1.0f, block, alive);
  MetVectors met;
  const auto begin = [&](uint32_t) HWY_ATTR { met.count = 0; };
  const auto visit = [&](const GaussianRow& row, size_t vector) HWY_ATTR {
    float* const pixels = block + vector * kLanes * planes;
    const Meeting m = meet(row, vector, pixels, alive);
    if (hn::AllFalse(df, m.blended)) return;
    const size_t k = met.count++ * kLanes;
    met.pixels[k / kLanes] = pixels;
    store(m.u, met.u + k);
    store(m.v, met.v + k);
    const Vf alpha = hn::IfThenElseZero(m.blended, m.alpha);
    store(alpha, met.alpha + k);
    store(m.before, met.before + k);
    store(hn::Mul(alpha, m.before), met.w + k);
    store(load(pixels + kDerivatives * kLanes), met.d_w + k);
  };
  const auto end = [&](size_t e, uint32_t id) HWY_ATTR {
    float* const to = entry_sums + places[e] * stride;
    if (met.count == 0) {
      std::fill_n(to, stride, 0.0f);
      return;
    }
    all_channels_backward<kChannels>(met, scene.features + id * channels, channels, sums);
    exponent_backward(met, sums);
    float* const total = sums + rounded * kLanes;
    std::memset(total, 0, rounded * sizeof(float));
    add_lane_sums(sums, rounded, total);
    for (size_t k = 0; k < stride; ++k) to[k] = total[k];
  };
  const size_t used = walk_gaussians(scene, tile, alive, begin, visit, end);
  for (size_t e = used; e < tile.count; ++e)
    std::fill_n(entry_sums + places[e] * stride, stride, 0.0f);
  if (!d_background) return;
  for (size_t c = 0; c < channels; ++c) {
    Vf sum = hn::Zero(df);
    for (size_t at = 0; at < kTilePixels; at += kLanes) {
      const float* pixels = block + at * planes;
      sum = hn::MulAdd(hn::Abs(load(pixels)), load(pixels + (kDerivatives + 1 + c) * kLanes), sum);
    }
    d_background[c] = hn::GetLane(hn::SumOfLanes(df, sum));
  }
}

void backward(const GaussianTarget& scene, const SplatTile& tile, GaussianWorkspace& ws,
              const uint32_t* places, float* entry_sums, float* d_background) {
  if (scene.channels == 3)
    return backward_tile<3>(scene, tile, ws, places, entry_sums, d_background);
  if (scene.channels == 10)
    return backward_tile<10>(scene, tile, ws, places, entry_sums, d_background);
  backward_tile<0>(scene, tile, ws, places, entry_sums, d_background);
}

GaussianKernels kernels() {
  return {&forward, &backward, hwy::TargetName(HWY_TARGET)};
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
