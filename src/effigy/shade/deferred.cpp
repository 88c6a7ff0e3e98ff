#include "effigy/shade/deferred.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/shade/deferred.cpp"
#include "hwy/foreach_target.h"
// Highway wants these after foreach_target.h.
#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_raster.h"
#include "hwy/contrib/math/math-inl.h"
#include "hwy/highway.h"

// Pixels are worked on in chunks of one row. Vector stages (one pixel a lane) compute directions,
// materials, display transform and their derivatives; between them a scalar stage looks up the
// environment and the BRDF table for each covered pixel with 4-wide (RGBA) arithmetic.

#ifndef EFFIGY_SHADE_DEFERRED_ONCE
#define EFFIGY_SHADE_DEFERRED_ONCE
namespace effigy {
namespace {

constexpr size_t kChunk = 32;  // pixels
constexpr float kLeastAlpha = 1e-4f;
constexpr float kLeastNormal = 1e-6f;
constexpr size_t kMostLevels = 32;

// RGBA arithmetic: four floats of the compiler's own, which exist for every Highway target.
using F4 = float __attribute__((vector_size(16)));
using F4Memory = float __attribute__((vector_size(16), aligned(4), may_alias));

// Everything a kernel needs about one call.
struct ShadeCall {
  int width = 0;
  std::array<const float*, 9> in;          // alpha, albedo 3, roughness, F0, normal 3
  std::array<float*, 9> d_in;              // likewise; backward only
  std::array<float*, 3> colour, radiance;  // forward only; radiance may be null
  std::array<const float*, 3> d_colour;    // backward only
  // Ray of pixel (x, y): ray + x ray_x + y ray_y (world, not unit).
  std::array<float, 3> ray, ray_x, ray_y;
  std::array<float, 3> background;
  bool divide_by_alpha = true, reinhard = false;
  const float* texels = nullptr;  // packed environment
  PackedCubemap diffuse;
  const PackedCubemap* specular = nullptr;
  size_t levels = 0;
  std::array<float, kMostLevels> roughness, inverse_step;
  const float* table = nullptr;
  int table_size = 0;
};

// One chunk: inputs, then what the stages leave for each other.
struct Chunk {
  alignas(64) float in[9][kChunk];  // as ShadeCall::in
  alignas(64) float view[3][kChunk], normal[3][kChunk], inverse_length[kChunk], n_dot_v[kChunk];
  alignas(64) float material[5][kChunk], inverse_alpha[kChunk];  // albedo 3, roughness, F0
  // Lookup positions: diffuse and specular.
  alignas(64) float s[2][kChunk], t[2][kChunk], inverse_major[2][kChunk];
  alignas(64) int32_t face[2][kChunk];
  alignas(64) int32_t level[kChunk];
  alignas(64) float level_fraction[kChunk], level_slope[kChunk];
  // Lookup results, 4 floats a pixel.
  alignas(64) float e_diffuse[kChunk * 4], e_specular[kChunk * 4];
  alignas(64) float brdf[kChunk * 4];  // scale, bias
  // Their derivatives (backward): by s, t of each lookup, by level fraction; the table's by n.v and
  // roughness: scale, bias each.
  alignas(64) float by_s[2][kChunk * 4], by_t[2][kChunk * 4], by_level[kChunk * 4];
  alignas(64) float d_brdf[kChunk * 4];
  // Gradients with respect to the looked-up radiance (backward).
  alignas(64) float g_diffuse[kChunk * 4], g_specular[kChunk * 4];
};

}  // namespace
}  // namespace effigy
#endif  // EFFIGY_SHADE_DEFERRED_ONCE

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<float, kChunk>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;
using M = hn::Mask<D>;

struct V3 {
  V x, y, z;
};
HWY_INLINE V dot(const V3& a, const V3& b) {
  return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}
HWY_INLINE V3 load3(const float (*rows)[kChunk], size_t i) {
  const D d;
  return {hn::Load(d, rows[0] + i), hn::Load(d, rows[1] + i), hn::Load(d, rows[2] + i)};
}
HWY_INLINE void store3(const V3& v, float (*rows)[kChunk], size_t i) {
  const D d;
  hn::Store(v.x, d, rows[0] + i);
  hn::Store(v.y, d, rows[1] + i);
  hn::Store(v.z, d, rows[2] + i);
}

// ---- Directions to cube positions, and back --------------------------------------------------

// Cube position of a unit direction (cubemap_layout.h).
HWY_INLINE void cube_position(const V3& p, Chunk& chunk, size_t which, size_t i) {
  const D d;
  const DI di;
  const V ax = hn::Abs(p.x), ay = hn::Abs(p.y), az = hn::Abs(p.z);
  const M is_x = hn::And(hn::Ge(ax, ay), hn::Ge(ax, az));
  const M is_y = hn::AndNot(is_x, hn::Ge(ay, az));
  const M x_low = hn::Lt(p.x, hn::Zero(d)), y_low = hn::Lt(p.y, hn::Zero(d)),
          z_low = hn::Lt(p.z, hn::Zero(d));
  const V major = hn::IfThenElse(is_x, ax, hn::IfThenElse(is_y, ay, az));
  const V inverse = hn::Div(hn::Set(d, 1.0f), major);
  const V s = hn::IfThenElse(is_x, hn::IfThenElse(x_low, p.z, hn::Neg(p.z)),
                             hn::IfThenElse(is_y, p.x, hn::IfThenElse(z_low, hn::Neg(p.x), p.x)));
  const V t = hn::IfThenElse(is_y, hn::IfThenElse(y_low, hn::Neg(p.z), p.z), hn::Neg(p.y));
  const V one = hn::Set(d, 1.0f), zero = hn::Zero(d);
  const V face =
      hn::IfThenElse(is_x, hn::IfThenElse(x_low, one, zero),
                     hn::IfThenElse(is_y, hn::IfThenElse(y_low, hn::Set(d, 3.0f), hn::Set(d, 2.0f)),
                                    hn::IfThenElse(z_low, hn::Set(d, 5.0f), hn::Set(d, 4.0f))));
  const V low = hn::Set(d, -1.0f);
  hn::Store(hn::Min(hn::Max(hn::Mul(s, inverse), low), one), d, chunk.s[which] + i);
  hn::Store(hn::Min(hn::Max(hn::Mul(t, inverse), low), one), d, chunk.t[which] + i);
  hn::Store(inverse, d, chunk.inverse_major[which] + i);
  hn::Store(hn::ConvertTo(di, face), di, chunk.face[which] + i);
}

// Gradient with respect to the direction from those with respect to s and t.
HWY_INLINE V3 cube_position_backward(const V3& p, V g_s, V g_t, const Chunk& chunk, size_t which,
                                     size_t i) {
  const D d;
  const V inverse = hn::Load(d, chunk.inverse_major[which] + i);
  const V s = hn::Load(d, chunk.s[which] + i), t = hn::Load(d, chunk.t[which] + i);
  const V ds = hn::Mul(g_s, inverse), dt = hn::Mul(g_t, inverse);
  const V d_major = hn::Neg(hn::MulAdd(ds, s, hn::Mul(dt, t)));
  const V ax = hn::Abs(p.x), ay = hn::Abs(p.y), az = hn::Abs(p.z);
  const M is_x = hn::And(hn::Ge(ax, ay), hn::Ge(ax, az));
  const M is_y = hn::AndNot(is_x, hn::Ge(ay, az));
  const M x_low = hn::Lt(p.x, hn::Zero(d)), y_low = hn::Lt(p.y, hn::Zero(d)),
          z_low = hn::Lt(p.z, hn::Zero(d));
  const auto signed_by = [](M negative, V v) { return hn::IfThenElse(negative, hn::Neg(v), v); };
  return {hn::IfThenElse(is_x, signed_by(x_low, d_major),
                         hn::IfThenElse(is_y, ds, signed_by(z_low, ds))),
          hn::IfThenElse(is_y, signed_by(y_low, d_major), hn::Neg(dt)),
          hn::IfThenElse(is_x, hn::Neg(signed_by(x_low, ds)),
                         hn::IfThenElse(is_y, signed_by(y_low, dt), signed_by(z_low, d_major)))};
}

// ---- Display transform -----------------------------------------------------------------------

// sRGB of min(|x|, 1) or of Reinhard's |x| / (1 + |x|), with x's sign; optionally the derivative.
template <bool kDerivative>
HWY_INLINE V display(V x, bool reinhard, V* derivative) {
  const D d;
  const V one = hn::Set(d, 1.0f), size = hn::Abs(x);
  V y = hn::Min(size, one), slope = one;
  if (reinhard) {
    const V inverse = hn::Div(one, hn::Add(one, size));
    y = hn::Mul(size, inverse);
    if (kDerivative) slope = hn::Mul(inverse, inverse);
  } else if (kDerivative) {
    slope = hn::IfThenElseZero(hn::Le(size, one), one);
  }
  const M toe = hn::Le(y, hn::Set(d, 0.0031308f));
  const V safe = hn::Max(y, hn::Set(d, 0.0031308f));
  const V power =
      hn::Mul(hn::Set(d, 1.055f), hn::Exp(d, hn::Mul(hn::Log(d, safe), hn::Set(d, 1.0f / 2.4f))));
  const V encoded =
      hn::IfThenElse(toe, hn::Mul(y, hn::Set(d, 12.92f)), hn::Sub(power, hn::Set(d, 0.055f)));
  if (kDerivative)
    *derivative = hn::Mul(slope, hn::IfThenElse(toe, hn::Set(d, 12.92f),
                                                hn::Div(power, hn::Mul(safe, hn::Set(d, 2.4f)))));
  return hn::CopySign(encoded, x);
}

// ---- Stages ----------------------------------------------------------------------------------

// Copies the inputs of pixels [x, x + count) of row y; lanes past the end are uncovered.
HWY_INLINE bool load_chunk(const ShadeCall& call, size_t pixel, size_t count, Chunk& chunk) {
  const float* alpha = call.in[0] + pixel;
  bool any = false;
  for (size_t i = 0; i < count; ++i) any |= alpha[i] > 0.0f;
  if (!any) return false;
  for (size_t k = 0; k < 9; ++k) {
    std::memcpy(chunk.in[k], call.in[k] + pixel, count * sizeof(float));
    if (count < kChunk) std::memset(chunk.in[k] + count, 0, (kChunk - count) * sizeof(float));
  }
  return true;
}

// Directions, materials and lookup positions.
HWY_INLINE void prepare(const ShadeCall& call, int x, int y, Chunk& chunk) {
  const D d;
  const DI di;
  const V one = hn::Set(d, 1.0f), zero = hn::Zero(d);
  for (size_t i = 0; i < kChunk; i += hn::Lanes(d)) {
    const V px = hn::Iota(d, static_cast<float>(x) + static_cast<float>(i));
    const auto ray = [&](size_t c) {
      return hn::MulAdd(px, hn::Set(d, call.ray_x[c]),
                        hn::Set(d, call.ray[c] + static_cast<float>(y) * call.ray_y[c]));
    };
    V3 v{ray(0), ray(1), ray(2)};
    const V inverse_ray = hn::Div(hn::Set(d, -1.0f), hn::Sqrt(dot(v, v)));
    v = {hn::Mul(v.x, inverse_ray), hn::Mul(v.y, inverse_ray), hn::Mul(v.z, inverse_ray)};
    V3 n = load3(chunk.in + 6, i);
    const V length2 = dot(n, n);
    const M sound = hn::And(hn::Ge(length2, hn::Set(d, kLeastNormal * kLeastNormal)),
                            hn::Le(length2, hn::Set(d, 1e30f)));
    const V inverse_length =
        hn::IfThenElseZero(sound, hn::Div(one, hn::Sqrt(hn::IfThenElse(sound, length2, one))));
    n = {hn::IfThenElse(sound, hn::Mul(n.x, inverse_length), v.x),
         hn::IfThenElse(sound, hn::Mul(n.y, inverse_length), v.y),
         hn::IfThenElse(sound, hn::Mul(n.z, inverse_length), v.z)};
    const V n_dot_v = dot(n, v), twice = hn::Add(n_dot_v, n_dot_v);
    const V3 reflected{hn::MulSub(twice, n.x, v.x), hn::MulSub(twice, n.y, v.y),
                       hn::MulSub(twice, n.z, v.z)};
    store3(v, chunk.view, i);
    store3(n, chunk.normal, i);
    hn::Store(inverse_length, d, chunk.inverse_length + i);
    hn::Store(n_dot_v, d, chunk.n_dot_v + i);
    cube_position(n, chunk, 0, i);
    cube_position(reflected, chunk, 1, i);

    const V alpha = hn::Load(d, chunk.in[0] + i);
    const V inverse_alpha =
        call.divide_by_alpha ? hn::Div(one, hn::Max(alpha, hn::Set(d, kLeastAlpha))) : one;
    hn::Store(inverse_alpha, d, chunk.inverse_alpha + i);
    for (size_t k = 0; k < 5; ++k)
      hn::Store(hn::Mul(hn::Load(d, chunk.in[1 + k] + i), inverse_alpha), d, chunk.material[k] + i);
    // Roughness level; comparisons are false for NaN, which becomes 0.
    const V r = hn::Load(d, chunk.material[3] + i);
    const V clamped = hn::IfThenElseZero(hn::Gt(r, zero), hn::IfThenElse(hn::Gt(r, one), one, r));
    V level = zero, low = hn::Set(d, call.roughness[0]), step = hn::Set(d, call.inverse_step[0]);
    for (size_t k = 1; k + 1 < call.levels; ++k) {
      const V at = hn::Set(d, call.roughness[k]);
      const M above = hn::Ge(clamped, at);
      level = hn::IfThenElse(above, hn::Set(d, static_cast<float>(k)), level);
      low = hn::IfThenElse(above, at, low);
      step = hn::IfThenElse(above, hn::Set(d, call.inverse_step[k]), step);
    }
    const V fraction = hn::Mul(hn::Sub(clamped, low), step);
    hn::Store(hn::ConvertTo(di, level), di, chunk.level + i);
    hn::Store(hn::Min(hn::Max(fraction, zero), one), d, chunk.level_fraction + i);
    const M inside =
        hn::And(hn::Eq(clamped, r), hn::And(hn::Ge(fraction, zero), hn::Le(fraction, one)));
    hn::Store(hn::IfThenElseZero(inside, step), d, chunk.level_slope + i);
  }
}

// Where a bilinear lookup reads: its first texel and its position in the cell.
struct Tap {
  size_t first, stride;  // floats
  float a, b;
};
HWY_INLINE Tap tap(const PackedCubemap& map, int32_t face, float s, float t) {
  const float half = 0.5f * static_cast<float>(map.size);
  const float u = (s + 1.0f) * half + 0.5f, v = (t + 1.0f) * half + 0.5f;
  const int x = static_cast<int>(u), y = static_cast<int>(v);
  const size_t n = static_cast<size_t>(map.size) + 2;
  return {4 * (map.offset + (static_cast<size_t>(face) * n + static_cast<size_t>(y)) * n +
               static_cast<size_t>(x)),
          4 * n, u - static_cast<float>(x), v - static_cast<float>(y)};
}

HWY_INLINE F4 load4(const float* p) {
  return *reinterpret_cast<const F4Memory*>(p);
}
HWY_INLINE void store4(F4 v, float* p) {
  *reinterpret_cast<F4Memory*>(p) = v;
}
HWY_INLINE F4 lerp(F4 a, F4 b, float f) {
  return a + f * (b - a);
}

// Value and derivatives by s and t.
struct Lookup {
  F4 value, by_s, by_t;
};
template <bool kDerivative>
HWY_INLINE Lookup look_up(const ShadeCall& call, const PackedCubemap& map, const Tap& at) {
  const float* p = call.texels + at.first;
  const F4 t00 = load4(p), t10 = load4(p + 4);
  const F4 t01 = load4(p + at.stride), t11 = load4(p + at.stride + 4);
  const F4 top = lerp(t00, t10, at.a), bottom = lerp(t01, t11, at.a);
  Lookup out{lerp(top, bottom, at.b), F4{}, F4{}};
  if (kDerivative) {
    const float half = 0.5f * static_cast<float>(map.size);
    out.by_s = half * lerp(t10 - t00, t11 - t01, at.b);
    out.by_t = half * (bottom - top);
  }
  return out;
}

// BRDF table at (n.v, r): as sample_brdf.
template <bool kDerivative>
HWY_INLINE void look_up_brdf(const ShadeCall& call, size_t i, Chunk& chunk) {
  const int n = call.table_size;
  const float size = static_cast<float>(n), last = size - 1.0f;
  const auto place = [&](float x, int& first, float& slope) {
    const float u = x * size - 0.5f;
    slope = u > 0.0f && u < last ? size : 0.0f;
    const float inside = u > 0.0f ? (u < last ? u : last) : 0.0f;
    first = std::min(static_cast<int>(inside), n - 2);
    return inside - static_cast<float>(first);
  };
  int column, row;
  float column_slope, row_slope;
  const float a = place(chunk.n_dot_v[i], column, column_slope);
  const float b = place(chunk.material[3][i], row, row_slope);
  const float* p = call.table + 2 * (static_cast<size_t>(row) * static_cast<size_t>(n) +
                                     static_cast<size_t>(column));
  const F4 low = load4(p), high = load4(p + 2 * static_cast<size_t>(n));
  const F4 mixed = lerp(low, high, b);
  chunk.brdf[4 * i] = mixed[0] + a * (mixed[2] - mixed[0]);
  chunk.brdf[4 * i + 1] = mixed[1] + a * (mixed[3] - mixed[1]);
  if (kDerivative) {
    const F4 rise = high - low;
    chunk.d_brdf[4 * i] = column_slope * (mixed[2] - mixed[0]);
    chunk.d_brdf[4 * i + 1] = column_slope * (mixed[3] - mixed[1]);
    chunk.d_brdf[4 * i + 2] = row_slope * (rise[0] + a * (rise[2] - rise[0]));
    chunk.d_brdf[4 * i + 3] = row_slope * (rise[1] + a * (rise[3] - rise[1]));
  }
}

template <bool kDerivative>
HWY_INLINE void look_up_chunk(const ShadeCall& call, Chunk& chunk) {
  for (size_t i = 0; i < kChunk; ++i) {
    if (!(chunk.in[0][i] > 0.0f)) continue;
    const Lookup diffuse = look_up<kDerivative>(
        call, call.diffuse, tap(call.diffuse, chunk.face[0][i], chunk.s[0][i], chunk.t[0][i]));
    const size_t level = static_cast<size_t>(chunk.level[i]);
    const PackedCubemap& fine = call.specular[level];
    const PackedCubemap& coarse = call.specular[std::min(level + 1, call.levels - 1)];
    const int32_t face = chunk.face[1][i];
    const float s = chunk.s[1][i], t = chunk.t[1][i];
    const Lookup low = look_up<kDerivative>(call, fine, tap(fine, face, s, t));
    const Lookup high = look_up<kDerivative>(call, coarse, tap(coarse, face, s, t));
    const float f = chunk.level_fraction[i];
    store4(diffuse.value, chunk.e_diffuse + 4 * i);
    store4(lerp(low.value, high.value, f), chunk.e_specular + 4 * i);
    if (kDerivative) {
      store4(diffuse.by_s, chunk.by_s[0] + 4 * i);
      store4(diffuse.by_t, chunk.by_t[0] + 4 * i);
      store4(lerp(low.by_s, high.by_s, f), chunk.by_s[1] + 4 * i);
      store4(lerp(low.by_t, high.by_t, f), chunk.by_t[1] + 4 * i);
      store4(high.value - low.value, chunk.by_level + 4 * i);
    }
    look_up_brdf<kDerivative>(call, i, chunk);
  }
}

HWY_INLINE V3 load_rgb(const float* rgba, size_t i) {
  const D d;
  V3 v;
  V unused;
  hn::LoadInterleaved4(d, rgba + 4 * i, v.x, v.y, v.z, unused);
  return v;
}

HWY_INLINE V radiance_of(V albedo, V e_diffuse, V reflectance, V e_specular) {
  return hn::MulAdd(albedo, e_diffuse, hn::Mul(reflectance, e_specular));
}

// ---- Forward ---------------------------------------------------------------------------------

HWY_INLINE void finish_forward(const ShadeCall& call, size_t pixel, size_t count, Chunk& chunk) {
  const D d;
  alignas(64) float colour[3][kChunk], radiance[3][kChunk];
  for (size_t i = 0; i < kChunk; i += hn::Lanes(d)) {
    const V alpha = hn::Load(d, chunk.in[0] + i);
    const M covered = hn::Gt(alpha, hn::Zero(d));
    V scale, bias, unused0, unused1;
    hn::LoadInterleaved4(d, chunk.brdf + 4 * i, scale, bias, unused0, unused1);
    const V reflectance = hn::MulAdd(hn::Load(d, chunk.material[4] + i), scale, bias);
    const V3 e_d = load_rgb(chunk.e_diffuse, i), e_s = load_rgb(chunk.e_specular, i);
    const V light_d[3] = {e_d.x, e_d.y, e_d.z}, light_s[3] = {e_s.x, e_s.y, e_s.z};
    for (size_t c = 0; c < 3; ++c) {
      const V value = hn::IfThenElseZero(covered, radiance_of(hn::Load(d, chunk.material[c] + i),
                                                              light_d[c], reflectance, light_s[c]));
      const V shown = display<false>(value, call.reinhard, nullptr);
      const V background = hn::Set(d, call.background[c]);
      hn::Store(hn::IfThenElse(covered, hn::MulAdd(alpha, hn::Sub(shown, background), background),
                               background),
                d, colour[c] + i);
      hn::Store(value, d, radiance[c] + i);
    }
  }
  for (size_t c = 0; c < 3; ++c) {
    std::memcpy(call.colour[c] + pixel, colour[c], count * sizeof(float));
    if (call.radiance[c]) std::memcpy(call.radiance[c] + pixel, radiance[c], count * sizeof(float));
  }
}

void forward_rows(const ShadeCall& call, int row_begin, int row_end) {
  Chunk chunk;
  std::memset(&chunk, 0, sizeof(chunk));
  for (int y = row_begin; y < row_end; ++y) {
    for (int x = 0; x < call.width; x += static_cast<int>(kChunk)) {
      const size_t count = std::min(kChunk, static_cast<size_t>(call.width - x));
      const size_t pixel =
          static_cast<size_t>(y) * static_cast<size_t>(call.width) + static_cast<size_t>(x);
      if (load_chunk(call, pixel, count, chunk)) {
        prepare(call, x, y, chunk);
        look_up_chunk<false>(call, chunk);
        finish_forward(call, pixel, count, chunk);
        continue;
      }
      for (size_t c = 0; c < 3; ++c) {
        std::fill_n(call.colour[c] + pixel, count, call.background[c]);
        if (call.radiance[c]) std::fill_n(call.radiance[c] + pixel, count, 0.0f);
      }
    }
  }
}

// ---- Backward --------------------------------------------------------------------------------

// Gradients of the normal from those of the lookups and of n.v.
HWY_INLINE V3 normal_gradient(const Chunk& chunk, const V3& g_diffuse, const V3& g_specular,
                              V g_n_dot_v, size_t i) {
  const D d;
  const V3 n = load3(chunk.normal, i), v = load3(chunk.view, i);
  const V n_dot_v = hn::Load(d, chunk.n_dot_v + i), twice = hn::Add(n_dot_v, n_dot_v);
  const V3 reflected{hn::MulSub(twice, n.x, v.x), hn::MulSub(twice, n.y, v.y),
                     hn::MulSub(twice, n.z, v.z)};
  const V3 by_n = cube_position_backward(n, dot(g_diffuse, load_rgb(chunk.by_s[0], i)),
                                         dot(g_diffuse, load_rgb(chunk.by_t[0], i)), chunk, 0, i);
  const V3 by_r = cube_position_backward(reflected, dot(g_specular, load_rgb(chunk.by_s[1], i)),
                                         dot(g_specular, load_rgb(chunk.by_t[1], i)), chunk, 1, i);
  // reflected = 2 (n.v) n - v.
  const V along = dot(by_r, n), view = hn::Add(g_n_dot_v, hn::Add(along, along));
  const V3 g{hn::Add(by_n.x, hn::MulAdd(twice, by_r.x, hn::Mul(view, v.x))),
             hn::Add(by_n.y, hn::MulAdd(twice, by_r.y, hn::Mul(view, v.y))),
             hn::Add(by_n.z, hn::MulAdd(twice, by_r.z, hn::Mul(view, v.z)))};
  // Through the normalisation.
  const V inverse = hn::Load(d, chunk.inverse_length + i), radial = dot(g, n);
  return {hn::Mul(inverse, hn::NegMulAdd(radial, n.x, g.x)),
          hn::Mul(inverse, hn::NegMulAdd(radial, n.y, g.y)),
          hn::Mul(inverse, hn::NegMulAdd(radial, n.z, g.z))};
}

// Fills d_in (gradients of the nine inputs) and chunk.g_diffuse, g_specular.
HWY_INLINE void finish_backward(const ShadeCall& call, const float (*d_colour)[kChunk],
                                Chunk& chunk, float (*d_in)[kChunk]) {
  const D d;
  const V zero = hn::Zero(d);
  for (size_t i = 0; i < kChunk; i += hn::Lanes(d)) {
    const V alpha = hn::Load(d, chunk.in[0] + i);
    const M covered = hn::Gt(alpha, zero);
    V scale, bias, unused0, unused1;
    hn::LoadInterleaved4(d, chunk.brdf + 4 * i, scale, bias, unused0, unused1);
    const V specular = hn::Load(d, chunk.material[4] + i);
    const V reflectance = hn::MulAdd(specular, scale, bias);
    const V3 e_d = load_rgb(chunk.e_diffuse, i), e_s = load_rgb(chunk.e_specular, i);
    const V light_d[3] = {e_d.x, e_d.y, e_d.z}, light_s[3] = {e_s.x, e_s.y, e_s.z};
    V g_material[5], g_d[3], g_s[3];
    V g_alpha = zero, g_reflectance = zero;
    for (size_t c = 0; c < 3; ++c) {
      const V albedo = hn::Load(d, chunk.material[c] + i);
      const V g = hn::Load(d, d_colour[c] + i);
      V slope;
      const V shown = display<true>(radiance_of(albedo, light_d[c], reflectance, light_s[c]),
                                    call.reinhard, &slope);
      g_alpha = hn::MulAdd(g, hn::Sub(shown, hn::Set(d, call.background[c])), g_alpha);
      const V g_value = hn::IfThenElseZero(covered, hn::Mul(hn::Mul(g, alpha), slope));
      g_material[c] = hn::Mul(g_value, light_d[c]);
      g_d[c] = hn::Mul(g_value, albedo);
      g_s[c] = hn::Mul(g_value, reflectance);
      g_reflectance = hn::MulAdd(g_value, light_s[c], g_reflectance);
    }
    const V3 g_diffuse{g_d[0], g_d[1], g_d[2]}, g_specular{g_s[0], g_s[1], g_s[2]};
    hn::StoreInterleaved4(g_diffuse.x, g_diffuse.y, g_diffuse.z, zero, d, chunk.g_diffuse + 4 * i);
    hn::StoreInterleaved4(g_specular.x, g_specular.y, g_specular.z, zero, d,
                          chunk.g_specular + 4 * i);
    V scale_nv, bias_nv, scale_r, bias_r;
    hn::LoadInterleaved4(d, chunk.d_brdf + 4 * i, scale_nv, bias_nv, scale_r, bias_r);
    const V by_scale = hn::Mul(g_reflectance, specular);
    g_material[4] = hn::Mul(g_reflectance, scale);
    g_material[3] =
        hn::MulAdd(hn::Load(d, chunk.level_slope + i), dot(g_specular, load_rgb(chunk.by_level, i)),
                   hn::MulAdd(by_scale, scale_r, hn::Mul(g_reflectance, bias_r)));
    const V g_n_dot_v = hn::MulAdd(by_scale, scale_nv, hn::Mul(g_reflectance, bias_nv));
    const V3 g_normal = normal_gradient(chunk, g_diffuse, g_specular, g_n_dot_v, i);
    // Materials are G / alpha.
    const V inverse = hn::Load(d, chunk.inverse_alpha + i);
    V sum = zero;
    for (size_t k = 0; k < 5; ++k) {
      sum = hn::MulAdd(g_material[k], hn::Load(d, chunk.material[k] + i), sum);
      hn::Store(hn::IfThenElseZero(covered, hn::Mul(g_material[k], inverse)), d, d_in[1 + k] + i);
    }
    if (call.divide_by_alpha)
      g_alpha = hn::Sub(g_alpha, hn::IfThenElseZero(hn::Gt(alpha, hn::Set(d, kLeastAlpha)),
                                                    hn::Mul(sum, inverse)));
    hn::Store(hn::IfThenElseZero(covered, g_alpha), d, d_in[0] + i);
    hn::Store(hn::IfThenElseZero(covered, g_normal.x), d, d_in[6] + i);
    hn::Store(hn::IfThenElseZero(covered, g_normal.y), d, d_in[7] + i);
    hn::Store(hn::IfThenElseZero(covered, g_normal.z), d, d_in[8] + i);
  }
}

HWY_INLINE void scatter(const Tap& at, F4 g, float* d_texels) {
  float* p = d_texels + at.first;
  float* q = p + at.stride;
  const F4 bottom = at.b * g, top = g - bottom;
  const F4 top_right = at.a * top, bottom_right = at.a * bottom;
  store4(load4(p) + (top - top_right), p);
  store4(load4(p + 4) + top_right, p + 4);
  store4(load4(q) + (bottom - bottom_right), q);
  store4(load4(q + 4) + bottom_right, q + 4);
}

HWY_INLINE void scatter_chunk(const ShadeCall& call, const Chunk& chunk, float* d_texels) {
  for (size_t i = 0; i < kChunk; ++i) {
    if (!(chunk.in[0][i] > 0.0f)) continue;
    scatter(tap(call.diffuse, chunk.face[0][i], chunk.s[0][i], chunk.t[0][i]),
            load4(chunk.g_diffuse + 4 * i), d_texels);
    const size_t level = static_cast<size_t>(chunk.level[i]);
    const PackedCubemap& fine = call.specular[level];
    const PackedCubemap& coarse = call.specular[std::min(level + 1, call.levels - 1)];
    const int32_t face = chunk.face[1][i];
    const float s = chunk.s[1][i], t = chunk.t[1][i];
    const F4 g = load4(chunk.g_specular + 4 * i);
    const F4 g_high = chunk.level_fraction[i] * g;
    scatter(tap(fine, face, s, t), g - g_high, d_texels);
    scatter(tap(coarse, face, s, t), g_high, d_texels);
  }
}

void backward_rows(const ShadeCall& call, int row_begin, int row_end, float* d_texels) {
  Chunk chunk;
  std::memset(&chunk, 0, sizeof(chunk));
  alignas(64) float d_colour[3][kChunk], d_in[9][kChunk];
  for (int y = row_begin; y < row_end; ++y) {
    for (int x = 0; x < call.width; x += static_cast<int>(kChunk)) {
      const size_t count = std::min(kChunk, static_cast<size_t>(call.width - x));
      const size_t pixel =
          static_cast<size_t>(y) * static_cast<size_t>(call.width) + static_cast<size_t>(x);
      if (!load_chunk(call, pixel, count, chunk)) continue;
      prepare(call, x, y, chunk);
      look_up_chunk<true>(call, chunk);
      std::memset(d_colour, 0, sizeof(d_colour));
      for (size_t c = 0; c < 3; ++c)
        std::memcpy(d_colour[c], call.d_colour[c] + pixel, count * sizeof(float));
      finish_backward(call, d_colour, chunk, d_in);
      for (size_t k = 0; k < 9; ++k) {
        float* out = call.d_in[k] + pixel;
        for (size_t i = 0; i < count; ++i) out[i] += d_in[k][i];
      }
      if (d_texels) scatter_chunk(call, chunk, d_texels);
    }
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy {

HWY_EXPORT(forward_rows);
HWY_EXPORT(backward_rows);

namespace {

EFFIGY_CLONES size_t covered_pixels(const float* alpha, size_t count) {
  uint32_t sum = 0;
  for (size_t i = 0; i < count; ++i) sum += alpha[i] > 0.0f ? 1u : 0u;
  return sum;
}

// Cuts rows into `parts` ranges with about equally many covered pixels: parts + 1 borders.
std::vector<int> balanced_rows(const Planes& gbuffer, int parts) {
  const size_t width = static_cast<size_t>(gbuffer.width);
  std::vector<size_t> until(static_cast<size_t>(gbuffer.height) + 1, 0);
  for (size_t y = 0; y < static_cast<size_t>(gbuffer.height); ++y)
    // A row costs a little even when it is empty.
    until[y + 1] = until[y] + width / 32 + covered_pixels(gbuffer.plane(kAlpha) + y * width, width);
  std::vector<int> borders = {0};
  for (int part = 1; part < parts; ++part) {
    const size_t target = until.back() * static_cast<size_t>(part) / static_cast<size_t>(parts);
    borders.push_back(
        static_cast<int>(std::lower_bound(until.begin(), until.end(), target) - until.begin()));
  }
  borders.push_back(gbuffer.height);
  return borders;
}

ShadeCall make_call(const Planes& gbuffer, const Camera& camera, const PackedEnvironment& light,
                    const ShadeOptions& options) {
  EFFIGY_CHECK_EQ(gbuffer.count, int{kGBufferPlanes});
  EFFIGY_CHECK_EQ(gbuffer.width, camera.width);
  EFFIGY_CHECK_EQ(gbuffer.height, camera.height);
  EFFIGY_CHECK(!light.specular.empty() && light.specular.size() <= kMostLevels);
  ShadeCall call;
  call.width = gbuffer.width;
  const int normal = options.mapped_normal ? kMappedNormal : kNormal;
  const std::array<int, 9> planes = {kAlpha,    kAlbedo, kAlbedo + 1, kAlbedo + 2, kRoughness,
                                     kSpecular, normal,  normal + 1,  normal + 2};
  for (size_t k = 0; k < 9; ++k) {
    call.in[k] = gbuffer.plane(planes[k]);
    call.d_in[k] = nullptr;
  }
  call.colour.fill(nullptr);
  call.radiance.fill(nullptr);
  call.d_colour.fill(nullptr);
  const Mat3d world_from_camera = camera.camera_from_world_rotation.transpose();
  const Vec3d corner((0.5 - camera.cx) / camera.fx, (0.5 - camera.cy) / camera.fy, 1.0);
  const Vec3d ray = world_from_camera * corner, ray_x = world_from_camera.col(0) / camera.fx,
              ray_y = world_from_camera.col(1) / camera.fy;
  for (size_t c = 0; c < 3; ++c) {
    call.ray[c] = static_cast<float>(ray[static_cast<int>(c)]);
    call.ray_x[c] = static_cast<float>(ray_x[static_cast<int>(c)]);
    call.ray_y[c] = static_cast<float>(ray_y[static_cast<int>(c)]);
  }
  call.background = options.background;
  call.divide_by_alpha = options.divide_by_alpha;
  call.reinhard = options.display == DisplayTransform::kReinhardSrgb;
  call.texels = light.texels.data();
  call.diffuse = light.diffuse;
  call.specular = light.specular.data();
  call.levels = light.specular.size();
  call.roughness.fill(0.0f);
  call.inverse_step.fill(0.0f);
  for (size_t k = 0; k < call.levels; ++k) {
    call.roughness[k] = light.roughness[k];
    if (k + 1 < call.levels) {
      EFFIGY_CHECK(light.roughness[k + 1] > light.roughness[k]);
      call.inverse_step[k] = 1.0f / (light.roughness[k + 1] - light.roughness[k]);
    }
  }
  call.table = brdf_table().value.data();
  call.table_size = brdf_table().size;
  return call;
}

void shape(Planes& planes, int width, int height, int count) {
  if (planes.width != width || planes.height != height || planes.count != count)
    planes = Planes(width, height, count);
}

}  // namespace

void shade_deferred(const Planes& gbuffer, const Camera& camera, const PackedEnvironment& light,
                    const ShadeOptions& options, Planes& colour, Planes* radiance) {
  ShadeCall call = make_call(gbuffer, camera, light, options);
  shape(colour, gbuffer.width, gbuffer.height, 3);
  if (radiance) shape(*radiance, gbuffer.width, gbuffer.height, 3);
  for (int c = 0; c < 3; ++c) {
    call.colour[static_cast<size_t>(c)] = colour.plane(c);
    if (radiance) call.radiance[static_cast<size_t>(c)] = radiance->plane(c);
  }
  const int parts = thread_count();
  const std::vector<int> rows = balanced_rows(gbuffer, parts);
  run_slots(parts, [&](int part) {
    const size_t p = static_cast<size_t>(part);
    HWY_DYNAMIC_DISPATCH(forward_rows)(call, rows[p], rows[p + 1]);
  });
}

void shade_deferred(const Planes& gbuffer, const Camera& camera,
                    const PrefilteredEnvironment& light, const ShadeOptions& options,
                    Planes& colour, Planes* radiance) {
  shade_deferred(gbuffer, camera, pack_environment(light), options, colour, radiance);
}

void shade_deferred_backward(const Planes& gbuffer, const Camera& camera,
                             const PrefilteredEnvironment& light, const ShadeOptions& options,
                             const Planes& d_colour, Planes& d_gbuffer,
                             PrefilteredEnvironment* d_light) {
  const PackedEnvironment packed = pack_environment(light);
  ShadeCall call = make_call(gbuffer, camera, packed, options);
  EFFIGY_CHECK(d_colour.width == gbuffer.width && d_colour.height == gbuffer.height);
  EFFIGY_CHECK_EQ(d_colour.count, 3);
  EFFIGY_CHECK_EQ(d_gbuffer.data.size(), gbuffer.data.size());
  for (size_t k = 0; k < 9; ++k)
    call.d_in[k] = d_gbuffer.data.data() + (call.in[k] - gbuffer.data.data());
  for (int c = 0; c < 3; ++c) call.d_colour[static_cast<size_t>(c)] = d_colour.plane(c);
  const int parts = thread_count();
  const std::vector<int> rows = balanced_rows(gbuffer, parts);
  std::vector<std::vector<float>> d_texels(static_cast<size_t>(parts));
  run_slots(parts, [&](int part) {
    const size_t p = static_cast<size_t>(part);
    if (d_light) d_texels[p].assign(packed.texels.size(), 0.0f);
    HWY_DYNAMIC_DISPATCH(backward_rows)
    (call, rows[p], rows[p + 1], d_light ? d_texels[p].data() : nullptr);
  });
  if (!d_light) return;
  for (size_t p = 1; p < d_texels.size(); ++p)
    for (size_t i = 0; i < packed.texels.size(); ++i) d_texels[0][i] += d_texels[p][i];
  add_packed_gradient(packed, d_texels[0], *d_light);
}

}  // namespace effigy
#endif  // HWY_ONCE
