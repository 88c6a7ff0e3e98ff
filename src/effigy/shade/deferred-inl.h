// The stages of deferred shading (deferred.cpp), for one Highway target.
//
// Pixels are worked on in chunks of one row. Vector stages (one pixel a lane) compute directions,
// materials, cells of the lookups, display transform and their derivatives; between them a stage
// goes over the covered pixels one by one and looks up environment and BRDF table with 4-wide
// (RGBA) arithmetic.

#ifndef EFFIGY_SHADE_DEFERRED_CALL
#define EFFIGY_SHADE_DEFERRED_CALL

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

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
  // Packed environment: per specular level, then the diffuse map, the size of a widened face, the
  // first texel, and half the size without the border. A last level stands there twice.
  const float* texels = nullptr;
  size_t levels = 0;
  std::array<int32_t, kMostLevels + 2> width_of, first_of;
  std::array<float, kMostLevels + 2> half_of;
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
  alignas(64) int32_t level[kChunk];
  alignas(64) float level_fraction[kChunk], level_slope[kChunk];
  // Bilinear cells: of the diffuse map, the finer and the coarser specular level, the BRDF table.
  alignas(64) int32_t cell[4][kChunk];
  alignas(64) float cell_a[4][kChunk], cell_b[4][kChunk];
  alignas(64) float brdf_slope[2][kChunk];  // table cells per unit of n.v and roughness, or 0
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
#endif  // EFFIGY_SHADE_DEFERRED_CALL

// Once per target (the toggle is Highway's idiom).
#if defined(EFFIGY_SHADE_DEFERRED_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef EFFIGY_SHADE_DEFERRED_INL
#undef EFFIGY_SHADE_DEFERRED_INL
#else
#define EFFIGY_SHADE_DEFERRED_INL
#endif

#include "hwy/contrib/math/math-inl.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<float, kChunk>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;
using VI = hn::Vec<DI>;
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

// Cube position of a unit direction (cubemap_layout.h). Returns the face.
HWY_INLINE VI cube_position(const V3& p, Chunk& chunk, size_t which, size_t i) {
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
  return hn::ConvertTo(di, face);
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
  const D d;
  for (size_t k = 0; k < 9; ++k) {
    std::memcpy(chunk.in[k], call.in[k] + pixel, count * sizeof(float));
    if (count < kChunk) std::memset(chunk.in[k] + count, 0, (kChunk - count) * sizeof(float));
    if (k > 0) continue;
    V most = hn::Zero(d);
    for (size_t i = 0; i < kChunk; i += hn::Lanes(d))
      most = hn::Max(most, hn::Load(d, chunk.in[0] + i));
    if (hn::AllFalse(d, hn::Gt(most, hn::Zero(d)))) return false;
  }
  return true;
}

// Cell of a bilinear lookup in a packed cubemap whose widened faces are `width` wide.
HWY_INLINE void cube_cell(VI face, VI width, VI first, V half, Chunk& chunk, size_t position,
                          size_t which, size_t i) {
  const D d;
  const DI di;
  const V one = hn::Set(d, 1.0f), middle = hn::Set(d, 0.5f);
  const V u = hn::MulAdd(hn::Add(hn::Load(d, chunk.s[position] + i), one), half, middle);
  const V v = hn::MulAdd(hn::Add(hn::Load(d, chunk.t[position] + i), one), half, middle);
  const VI x = hn::ConvertTo(di, u), y = hn::ConvertTo(di, v);
  const VI row = hn::Add(hn::Mul(face, width), y);
  hn::Store(hn::Add(first, hn::Add(hn::Mul(row, width), x)), di, chunk.cell[which] + i);
  hn::Store(hn::Sub(u, hn::ConvertTo(d, x)), d, chunk.cell_a[which] + i);
  hn::Store(hn::Sub(v, hn::ConvertTo(d, y)), d, chunk.cell_b[which] + i);
}

// Cell, position in it and slope along one axis of the BRDF table, as sample_brdf; NaN goes to 0.
HWY_INLINE VI table_cell(V x, int size, V& fraction, V& slope) {
  const D d;
  const DI di;
  const V zero = hn::Zero(d), last = hn::Set(d, static_cast<float>(size - 1));
  const V u = hn::MulSub(x, hn::Set(d, static_cast<float>(size)), hn::Set(d, 0.5f));
  const M above = hn::Gt(u, zero), below = hn::Lt(u, last);
  slope = hn::IfThenElseZero(hn::And(above, below), hn::Set(d, static_cast<float>(size)));
  const V inside = hn::IfThenElseZero(above, hn::IfThenElse(below, u, last));
  const VI cell = hn::Min(hn::ConvertTo(di, inside), hn::Set(di, size - 2));
  fraction = hn::Sub(inside, hn::ConvertTo(d, cell));
  return cell;
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
    const size_t diffuse = call.levels + 1;
    cube_cell(cube_position(n, chunk, 0, i), hn::Set(di, call.width_of[diffuse]),
              hn::Set(di, call.first_of[diffuse]), hn::Set(d, call.half_of[diffuse]), chunk, 0, 0,
              i);
    const VI face = cube_position(reflected, chunk, 1, i);

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
    const VI index = hn::ConvertTo(di, level);
    hn::Store(index, di, chunk.level + i);
    for (size_t k = 0; k < 2; ++k)
      cube_cell(face, hn::GatherIndex(di, call.width_of.data() + k, index),
                hn::GatherIndex(di, call.first_of.data() + k, index),
                hn::GatherIndex(d, call.half_of.data() + k, index), chunk, 1, 1 + k, i);
    V a, b, slope_a, slope_b;
    const VI column = table_cell(n_dot_v, call.table_size, a, slope_a);
    const VI row = table_cell(r, call.table_size, b, slope_b);
    hn::Store(hn::Add(hn::Mul(row, hn::Set(di, call.table_size)), column), di, chunk.cell[3] + i);
    hn::Store(a, d, chunk.cell_a[3] + i);
    hn::Store(b, d, chunk.cell_b[3] + i);
    hn::Store(slope_a, d, chunk.brdf_slope[0] + i);
    hn::Store(slope_b, d, chunk.brdf_slope[1] + i);
    hn::Store(hn::Min(hn::Max(fraction, zero), one), d, chunk.level_fraction + i);
    const M inside =
        hn::And(hn::Eq(clamped, r), hn::And(hn::Ge(fraction, zero), hn::Le(fraction, one)));
    hn::Store(hn::IfThenElseZero(inside, step), d, chunk.level_slope + i);
  }
}

// ---- Lookups, pixel by pixel -----------------------------------------------------------------

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
// Lookup `which` of pixel i (0 diffuse, 1 finer, 2 coarser specular level) in map `map` of the
// call.
template <bool kDerivative>
HWY_INLINE Lookup look_up(const ShadeCall& call, const Chunk& chunk, size_t map, size_t which,
                          size_t i) {
  const float* p = call.texels + 4 * static_cast<size_t>(chunk.cell[which][i]);
  const float* q = p + 4 * static_cast<size_t>(call.width_of[map]);
  const float a = chunk.cell_a[which][i], b = chunk.cell_b[which][i];
  const F4 t00 = load4(p), t10 = load4(p + 4), t01 = load4(q), t11 = load4(q + 4);
  const F4 top = lerp(t00, t10, a), bottom = lerp(t01, t11, a);
  Lookup out{lerp(top, bottom, b), F4{}, F4{}};
  if (kDerivative) {
    out.by_s = call.half_of[map] * lerp(t10 - t00, t11 - t01, b);
    out.by_t = call.half_of[map] * (bottom - top);
  }
  return out;
}

// BRDF table at (n.v, r).
template <bool kDerivative>
HWY_INLINE void look_up_brdf(const ShadeCall& call, size_t i, Chunk& chunk) {
  const float* p = call.table + 2 * static_cast<size_t>(chunk.cell[3][i]);
  const float a = chunk.cell_a[3][i], b = chunk.cell_b[3][i];
  // Scale and bias at two columns.
  const F4 low = load4(p), high = load4(p + 2 * static_cast<size_t>(call.table_size));
  const F4 rise = high - low, mixed = low + b * rise;
  const F4 right = __builtin_shufflevector(mixed, mixed, 2, 3, 2, 3);
  store4(mixed + a * (right - mixed), chunk.brdf + 4 * i);
  if (kDerivative) {
    const F4 rise_right = __builtin_shufflevector(rise, rise, 2, 3, 2, 3);
    const F4 by_view = chunk.brdf_slope[0][i] * (right - mixed);
    const F4 by_roughness = chunk.brdf_slope[1][i] * (rise + a * (rise_right - rise));
    store4(__builtin_shufflevector(by_view, by_roughness, 0, 1, 4, 5), chunk.d_brdf + 4 * i);
  }
}

template <bool kDerivative>
HWY_INLINE void look_up_chunk(const ShadeCall& call, Chunk& chunk) {
  for (size_t i = 0; i < kChunk; ++i) {
    if (!(chunk.in[0][i] > 0.0f)) continue;
    const size_t level = static_cast<size_t>(chunk.level[i]);
    const Lookup diffuse = look_up<kDerivative>(call, chunk, call.levels + 1, 0, i);
    const Lookup low = look_up<kDerivative>(call, chunk, level, 1, i);
    const Lookup high = look_up<kDerivative>(call, chunk, level + 1, 2, i);
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

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();
#endif  // once per target
