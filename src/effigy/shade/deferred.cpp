#include "effigy/shade/deferred.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/shade/deferred.cpp"
#include "hwy/foreach_target.h"
// Highway wants these after foreach_target.h.
#include <algorithm>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/shade/deferred-inl.h"
#include "effigy/splat/surfel_raster.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

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

HWY_INLINE void scatter(const ShadeCall& call, const Chunk& chunk, size_t map, size_t which,
                        size_t i, F4 g, float* d_texels) {
  float* p = d_texels + 4 * static_cast<size_t>(chunk.cell[which][i]);
  float* q = p + 4 * static_cast<size_t>(call.width_of[map]);
  const F4 bottom = chunk.cell_b[which][i] * g, top = g - bottom;
  const F4 top_right = chunk.cell_a[which][i] * top, bottom_right = chunk.cell_a[which][i] * bottom;
  store4(load4(p) + (top - top_right), p);
  store4(load4(p + 4) + top_right, p + 4);
  store4(load4(q) + (bottom - bottom_right), q);
  store4(load4(q + 4) + bottom_right, q + 4);
}

HWY_INLINE void scatter_chunk(const ShadeCall& call, const Chunk& chunk, float* d_texels) {
  for (size_t i = 0; i < kChunk; ++i) {
    if (!(chunk.in[0][i] > 0.0f)) continue;
    const size_t level = static_cast<size_t>(chunk.level[i]);
    const F4 g = load4(chunk.g_specular + 4 * i), g_high = chunk.level_fraction[i] * g;
    scatter(call, chunk, call.levels + 1, 0, i, load4(chunk.g_diffuse + 4 * i), d_texels);
    scatter(call, chunk, level, 1, i, g - g_high, d_texels);
    scatter(call, chunk, level + 1, 2, i, g_high, d_texels);
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
  call.levels = light.specular.size();
  for (size_t k = 0; k < call.levels + 2; ++k) {
    const PackedCubemap& map =
        k > call.levels ? light.diffuse : light.specular[std::min(k, call.levels - 1)];
    EFFIGY_CHECK(4 * (map.offset + map.texels()) <= light.texels.size());
    call.width_of[k] = map.size + 2;
    call.first_of[k] = static_cast<int32_t>(map.offset);
    call.half_of[k] = 0.5f * static_cast<float>(map.size);
  }
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
