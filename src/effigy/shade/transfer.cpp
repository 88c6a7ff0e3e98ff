#include "effigy/shade/transfer.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

// Elements are worked on a block at a time, every quantity an array over the block, so that the
// loops become vector instructions.
constexpr size_t kBlock = 32;
using Lane = float[kBlock];
constexpr size_t kOrderCount = sh_count(kZonalOrder);
constexpr size_t kGrain = 1024;  // elements worth a slot

// Reads elements [first, first + count) of `planes` planes; the rest of the block is `fill`.
void load_planes(std::span<const float> from, size_t n, size_t first, size_t count, size_t planes,
                 Lane* to, float fill) {
  for (size_t p = 0; p < planes; ++p) {
    const float* plane = from.data() + p * n + first;
    for (size_t i = 0; i < count; ++i) to[p][i] = plane[i];
    for (size_t i = count; i < kBlock; ++i) to[p][i] = fill;
  }
}

void add_planes(const Lane* from, size_t n, size_t first, size_t count, size_t planes,
                std::span<float> to) {
  for (size_t p = 0; p < planes; ++p) {
    float* plane = to.data() + p * n + first;
    for (size_t i = 0; i < count; ++i) plane[i] += from[p][i];
  }
}

// Direction to a light and its strength for a block.
struct Towards {
  Lane w[3], strength, inverse_distance;
};

[[gnu::always_inline]] inline void find_towards(const PointLights& points, const PointLight& light,
                                                const Lane* position, Towards& t) {
  if (light.directional) {
    for (int c = 0; c < 3; ++c)
      for (size_t i = 0; i < kBlock; ++i) t.w[c][i] = light.position[c];
    for (size_t i = 0; i < kBlock; ++i) t.strength[i] = 1.0f;
    for (size_t i = 0; i < kBlock; ++i) t.inverse_distance[i] = 0.0f;
    return;
  }
  const float px = light.position.x(), py = light.position.y(), pz = light.position.z();
  const float reference = points.falloff ? (light.position - points.center).squaredNorm() : 0.0f;
  for (size_t i = 0; i < kBlock; ++i) {
    const float x = px - position[0][i], y = py - position[1][i], z = pz - position[2][i];
    // A light inside the surface gives a direction of no meaning, but a finite one.
    const float inverse = 1.0f / std::sqrt(x * x + y * y + z * z + 1e-20f);
    t.inverse_distance[i] = inverse;
    t.w[0][i] = x * inverse;
    t.w[1][i] = y * inverse;
    t.w[2][i] = z * inverse;
    t.strength[i] = points.falloff ? reference * inverse * inverse : 1.0f;
  }
}

// From derivatives by direction and strength to the position.
[[gnu::always_inline]] inline void towards_backward(const PointLights& points,
                                                    const PointLight& light, const Towards& t,
                                                    const Lane* d_w, const Lane& d_strength,
                                                    Lane* d_position) {
  if (light.directional) return;
  const float fall = points.falloff ? -2.0f : 0.0f;
  for (size_t i = 0; i < kBlock; ++i) {
    const float along = d_w[0][i] * t.w[0][i] + d_w[1][i] * t.w[1][i] + d_w[2][i] * t.w[2][i];
    // strength = (r0 / r)^2, r growing along w.
    const float radial = fall * t.strength[i] * d_strength[i] - along;
    d_position[0][i] -= (d_w[0][i] + radial * t.w[0][i]) * t.inverse_distance[i];
    d_position[1][i] -= (d_w[1][i] + radial * t.w[1][i]) * t.inverse_distance[i];
    d_position[2][i] -= (d_w[2][i] + radial * t.w[2][i]) * t.inverse_distance[i];
  }
}

// P_l times (2l + 1) / (4 pi), and its derivative, of the cosines between an axis and directions.
struct Bands {
  Lane value[kZonalBands], slope[kZonalBands];
};

[[gnu::always_inline]] inline void find_bands(const Lane* axis, const Lane* w, Bands& bands) {
  for (size_t i = 0; i < kBlock; ++i) {
    const float x = axis[0][i] * w[0][i] + axis[1][i] * w[1][i] + axis[2][i] * w[2][i];
    float p[kZonalBands], dp[kZonalBands];
    legendre(x, p, dp);
    for (size_t l = 0; l < kZonalBands; ++l) {
      bands.value[l][i] = zonal_factor<float>(l) * p[l];
      bands.slope[l][i] = zonal_factor<float>(l) * dp[l];
    }
  }
}

// E_l of an environment about an axis, r g b of each band.
struct BandLight {
  Lane rgb[kZonalBands][3];
};

// Calls term(l, coefficient, value, slope x, y, z) with arrays over the block for every harmonic of
// the axis (for_each_sh, a block at a time).
template <class Term>
[[gnu::always_inline]] inline void harmonics_of(const Lane* axis, const Term& term) {
  const Lane &x = axis[0], &y = axis[1], &z = axis[2];
  Lane c, s, c_before, s_before, p, dp, p_before, dp_before, value, sx, sy, sz;
  for (size_t i = 0; i < kBlock; ++i) {
    c[i] = 1.0f;
    s[i] = c_before[i] = s_before[i] = 0.0f;
  }
  float diagonal = 1.0f;
  for (int m = 0; m <= kZonalOrder; ++m) {
    const auto fm = static_cast<float>(m);
    for (size_t i = 0; i < kBlock; ++i) {
      p[i] = diagonal;
      dp[i] = p_before[i] = dp_before[i] = 0.0f;
    }
    for (int l = m; l <= kZonalOrder; ++l) {
      if (l > m) {
        const auto a = static_cast<float>(2 * l - 1), b = static_cast<float>(l + m - 1);
        const float scale = 1.0f / static_cast<float>(l - m);
        for (size_t i = 0; i < kBlock; ++i) {
          const float next = (a * z[i] * p[i] - b * p_before[i]) * scale;
          const float d_next = (a * (p[i] + z[i] * dp[i]) - b * dp_before[i]) * scale;
          p_before[i] = p[i];
          dp_before[i] = dp[i];
          p[i] = next;
          dp[i] = d_next;
        }
      }
      const auto k = static_cast<float>(detail::kShNorm[static_cast<size_t>(l * (l + 1) / 2 + m)]);
      for (size_t i = 0; i < kBlock; ++i) {
        const float kp = k * p[i];
        value[i] = kp * c[i];
        sx[i] = kp * fm * c_before[i];
        sy[i] = -kp * fm * s_before[i];
        sz[i] = k * dp[i] * c[i];
      }
      term(static_cast<size_t>(l), static_cast<size_t>(l * l + l + m), value, sx, sy, sz);
      if (m == 0) continue;
      for (size_t i = 0; i < kBlock; ++i) {
        const float kp = k * p[i];
        value[i] = kp * s[i];
        sx[i] = kp * fm * s_before[i];
        sy[i] = kp * fm * c_before[i];
        sz[i] = k * dp[i] * s[i];
      }
      term(static_cast<size_t>(l), static_cast<size_t>(l * l + l - m), value, sx, sy, sz);
    }
    diagonal *= -(2.0f * fm + 1.0f);
    for (size_t i = 0; i < kBlock; ++i) {
      c_before[i] = c[i];
      s_before[i] = s[i];
      c[i] = x[i] * c_before[i] - y[i] * s_before[i];
      s[i] = x[i] * s_before[i] + y[i] * c_before[i];
    }
  }
}

[[gnu::always_inline]] inline void find_band_light(const Lane* axis, const float* sh,
                                                   BandLight& e) {
  for (auto& band : e.rgb)
    for (auto& channel : band) std::fill_n(channel, kBlock, 0.0f);
  harmonics_of(axis,
               [&](size_t l, size_t k, const Lane& value, const Lane&, const Lane&, const Lane&) {
                 for (size_t ch = 0; ch < 3; ++ch) {
                   const float light = sh[3 * k + ch];
                   float* to = e.rgb[l][ch];
                   for (size_t i = 0; i < kBlock; ++i) to[i] += light * value[i];
                 }
               });
}

[[gnu::always_inline]] inline void look_up_band_light(const Lane* axis, size_t count,
                                                      const BandTable& bands, BandLight& e) {
  float numbers[BandTable::kNumbers];
  for (size_t i = 0; i < count; ++i) {
    bands.look_up(axis[0][i], axis[1][i], axis[2][i], numbers);
    for (size_t l = 0; l < kZonalBands; ++l)
      for (size_t ch = 0; ch < 3; ++ch) e.rgb[l][ch][i] = numbers[3 * l + ch];
  }
  for (auto& band : e.rgb)
    for (auto& channel : band) std::fill(channel + count, channel + kBlock, 0.0f);
}

struct DiffuseBlock {
  Lane axes[9], position[3], zonal[kZonalCoefficients];
};

void load_diffuse(const TransferView& view, size_t first, size_t count, DiffuseBlock& block) {
  load_planes(view.axes, view.count, first, count, 9, block.axes, 0.0f);
  load_planes(view.zonal, view.count, first, count, kZonalCoefficients, block.zonal, 0.0f);
  if (!view.position.empty())
    load_planes(view.position, view.count, first, count, 3, block.position, 0.0f);
}

// Sum of z_l times the bands of one axis, r g b.
[[gnu::always_inline]] inline void contract(const Lane* zonal, size_t axis, const Bands& bands,
                                            Lane* rgb) {
  for (size_t i = 0; i < kBlock; ++i) {
    float shared = 0.0f;
    for (size_t l = kZonalColourBands; l < kZonalBands; ++l)
      shared += zonal[zonal_index(axis, l, 0)][i] * bands.value[l][i];
    for (size_t ch = 0; ch < 3; ++ch) {
      float sum = shared;
      for (size_t l = 0; l < kZonalColourBands; ++l)
        sum += zonal[zonal_index(axis, l, ch)][i] * bands.value[l][i];
      rgb[ch][i] = sum;
    }
  }
}

EFFIGY_CLONES
void diffuse_range(const DiffuseLight& light, const TransferView& view, size_t begin, size_t end,
                   std::span<float> colour) {
  DiffuseBlock block;
  Towards towards;
  Bands bands;
  BandLight e;
  Lane sum[3], rgb[3];
  for (size_t first = begin; first < end; first += kBlock) {
    const size_t count = std::min(kBlock, end - first);
    load_diffuse(view, first, count, block);
    for (Lane& channel : sum) std::fill_n(channel, kBlock, 0.0f);
    for (const PointLight& point : light.points.lights) {
      find_towards(light.points, point, block.position, towards);
      for (size_t axis = 0; axis < 3; ++axis) {
        find_bands(block.axes + 3 * axis, towards.w, bands);
        contract(block.zonal, axis, bands, rgb);
        for (size_t ch = 0; ch < 3; ++ch) {
          const float intensity = point.intensity[static_cast<int>(ch)];
          for (size_t i = 0; i < kBlock; ++i)
            sum[ch][i] += intensity * towards.strength[i] * rgb[ch][i];
        }
      }
    }
    for (size_t axis = 0; axis < 3 && !light.sh.empty(); ++axis) {
      if (light.bands != nullptr)
        look_up_band_light(block.axes + 3 * axis, count, *light.bands, e);
      else
        find_band_light(block.axes + 3 * axis, light.sh.data(), e);
      for (size_t l = 0; l < kZonalBands; ++l)
        for (size_t ch = 0; ch < 3; ++ch) {
          const float* z = block.zonal[zonal_index(axis, l, ch)];
          for (size_t i = 0; i < kBlock; ++i) sum[ch][i] += z[i] * e.rgb[l][ch][i];
        }
    }
    for (size_t ch = 0; ch < 3; ++ch)
      std::copy_n(sum[ch], count, colour.data() + ch * view.count + first);
  }
}

struct DiffuseDerivatives {
  Lane axes[9], position[3], zonal[kZonalCoefficients];
};

// One axis under one point: from the derivative by the axis' colours to z, the axis and the
// direction.
[[gnu::always_inline]] inline void bands_backward(const DiffuseBlock& block, size_t axis,
                                                  const Bands& bands, const Lane* w,
                                                  const Lane* d_rgb, DiffuseDerivatives& d,
                                                  Lane* d_w) {
  for (size_t i = 0; i < kBlock; ++i) {
    const float all = d_rgb[0][i] + d_rgb[1][i] + d_rgb[2][i];
    float d_cosine = 0.0f;
    for (size_t l = kZonalColourBands; l < kZonalBands; ++l) {
      const size_t z = zonal_index(axis, l, 0);
      d.zonal[z][i] += all * bands.value[l][i];
      d_cosine += all * block.zonal[z][i] * bands.slope[l][i];
    }
    for (size_t l = 0; l < kZonalColourBands; ++l)
      for (size_t ch = 0; ch < 3; ++ch) {
        const size_t z = zonal_index(axis, l, ch);
        d.zonal[z][i] += d_rgb[ch][i] * bands.value[l][i];
        d_cosine += d_rgb[ch][i] * block.zonal[z][i] * bands.slope[l][i];
      }
    for (size_t c = 0; c < 3; ++c) {
      d.axes[3 * axis + c][i] += d_cosine * w[c][i];
      d_w[c][i] += d_cosine * block.axes[3 * axis + c][i];
    }
  }
}

// The environment's share for one axis.
[[gnu::always_inline]] inline void environment_backward(const DiffuseBlock& block, size_t axis,
                                                        const float* sh, const Lane* g,
                                                        DiffuseDerivatives& d) {
  BandLight d_e;  // dL/dE
  for (size_t l = 0; l < kZonalBands; ++l)
    for (size_t ch = 0; ch < 3; ++ch) {
      const float* z = block.zonal[zonal_index(axis, l, ch)];
      for (size_t i = 0; i < kBlock; ++i) d_e.rgb[l][ch][i] = g[ch][i] * z[i];
    }
  harmonics_of(block.axes + 3 * axis, [&](size_t l, size_t k, const Lane& value, const Lane& sx,
                                          const Lane& sy, const Lane& sz) {
    const float red = sh[3 * k], green = sh[3 * k + 1], blue = sh[3 * k + 2];
    const Lane* e = d_e.rgb[l];
    Lane &dx = d.axes[3 * axis], &dy = d.axes[3 * axis + 1], &dz = d.axes[3 * axis + 2];
    for (size_t i = 0; i < kBlock; ++i) {
      const float weight = red * e[0][i] + green * e[1][i] + blue * e[2][i];
      dx[i] += weight * sx[i];
      dy[i] += weight * sy[i];
      dz[i] += weight * sz[i];
    }
    for (size_t ch = 0; ch < 3; ++ch) {
      Lane& z = d.zonal[zonal_index(axis, l, ch)];
      for (size_t i = 0; i < kBlock; ++i) z[i] += g[ch][i] * sh[3 * k + ch] * value[i];
    }
  });
}

EFFIGY_CLONES
void diffuse_backward_range(const DiffuseLight& light, const TransferView& view,
                            std::span<const float> d_colour, size_t begin, size_t end,
                            const TransferGradients& gradients, double* d_intensity) {
  DiffuseBlock block;
  DiffuseDerivatives d;
  Towards towards;
  Bands bands;
  Lane g[3], rgb[3], d_rgb[3], d_w[3], d_strength;
  for (size_t first = begin; first < end; first += kBlock) {
    const size_t count = std::min(kBlock, end - first);
    load_diffuse(view, first, count, block);
    load_planes(d_colour, view.count, first, count, 3, g, 0.0f);
    d = {};
    for (size_t j = 0; j < light.points.lights.size(); ++j) {
      const PointLight& point = light.points.lights[j];
      find_towards(light.points, point, block.position, towards);
      for (Lane& c : d_w) std::fill_n(c, kBlock, 0.0f);
      std::fill_n(d_strength, kBlock, 0.0f);
      for (size_t ch = 0; ch < 3; ++ch)
        for (size_t i = 0; i < kBlock; ++i)
          d_rgb[ch][i] = point.intensity[static_cast<int>(ch)] * towards.strength[i] * g[ch][i];
      for (size_t axis = 0; axis < 3; ++axis) {
        find_bands(block.axes + 3 * axis, towards.w, bands);
        contract(block.zonal, axis, bands, rgb);
        for (size_t ch = 0; ch < 3; ++ch) {
          const float intensity = point.intensity[static_cast<int>(ch)];
          float sum = 0.0f;
          for (size_t i = 0; i < kBlock; ++i) {
            d_strength[i] += intensity * g[ch][i] * rgb[ch][i];
            sum += towards.strength[i] * g[ch][i] * rgb[ch][i];
          }
          if (d_intensity) d_intensity[3 * j + ch] += static_cast<double>(sum);
        }
        bands_backward(block, axis, bands, towards.w, d_rgb, d, d_w);
      }
      towards_backward(light.points, point, towards, d_w, d_strength, d.position);
    }
    for (size_t axis = 0; axis < 3 && !light.sh.empty(); ++axis)
      environment_backward(block, axis, light.sh.data(), g, d);
    add_planes(d.axes, view.count, first, count, 9, gradients.axes);
    add_planes(d.zonal, view.count, first, count, kZonalCoefficients, gradients.zonal);
    if (!gradients.position.empty())
      add_planes(d.position, view.count, first, count, 3, gradients.position);
  }
}

bool needs_position(const PointLights& points) {
  return std::any_of(points.lights.begin(), points.lights.end(),
                     [](const PointLight& p) { return !p.directional; });
}

void check_points(const PointLights& points, size_t positions, size_t count) {
  EFFIGY_CHECK(positions == 3 * count || (positions == 0 && !needs_position(points)));
}

void check_diffuse(const DiffuseLight& light, const TransferView& view) {
  EFFIGY_CHECK_EQ(view.axes.size(), 9 * view.count);
  EFFIGY_CHECK_EQ(view.zonal.size(), kZonalCoefficients * view.count);
  EFFIGY_CHECK(light.sh.empty() || light.sh.size() == 3 * kOrderCount);
  check_points(light.points, view.position.size(), view.count);
}

// Runs body(begin, end, intensity derivatives or null) on ranges of whole blocks and adds up what
// the slots found, in their order.
template <class Body>
void run_with_intensity(size_t count, size_t lights, std::span<float> d_intensity,
                        const Body& body) {
  EFFIGY_CHECK(d_intensity.empty() || d_intensity.size() == 3 * lights);
  std::vector<std::vector<double>> parts(static_cast<size_t>(thread_count()));
  const size_t blocks = (count + kBlock - 1) / kBlock;
  parallel_for(blocks, kGrain / kBlock, [&](size_t begin, size_t end, int slot) {
    std::vector<double>& part = parts[static_cast<size_t>(slot)];
    if (!d_intensity.empty()) part.assign(3 * lights, 0.0);
    body(begin * kBlock, std::min(count, end * kBlock), part.empty() ? nullptr : part.data());
  });
  for (size_t i = 0; i < d_intensity.size(); ++i) {
    double sum = 0.0;
    for (const std::vector<double>& part : parts) sum += part.empty() ? 0.0 : part[i];
    d_intensity[i] += static_cast<float>(sum);
  }
}

struct LobeBlock {
  Lane q[3], sigma[1], position[3], constant, d_constant;
};

void load_lobes(const LobeView& view, SgNorm norm, size_t first, size_t count, LobeBlock& block) {
  load_planes(view.lobe, view.count, first, count, 3, block.q, 0.0f);
  load_planes(view.sigma, view.count, first, count, 1, block.sigma, 1.0f);
  if (!view.position.empty())
    load_planes(view.position, view.count, first, count, 3, block.position, 0.0f);
  for (size_t i = 0; i < kBlock; ++i) {
    float& sigma = block.sigma[0][i];
    const bool lit = sigma > 0.0f;
    if (!lit) sigma = 1.0f;
    sg_constant(norm, sigma, block.constant[i], block.d_constant[i]);
    if (!lit) block.constant[i] = block.d_constant[i] = 0.0f;
  }
}

// exp(-theta^2 / 2 sigma^2), theta^2, and theta / sin theta of a block of lobes and directions.
struct LobeValues {
  Lane value, theta2, over_sine;
};

[[gnu::always_inline]] inline void find_lobes(const LobeBlock& block, const Lane* w,
                                              LobeValues& lobes) {
  for (size_t i = 0; i < kBlock; ++i) {
    const float x = w[0][i] - block.q[0][i], y = w[1][i] - block.q[1][i];
    const float z = w[2][i] - block.q[2][i];
    const float inverse = 1.0f / block.sigma[0][i];
    float theta2, over_sine;
    sg_angle(0.25f * (x * x + y * y + z * z), theta2, over_sine);
    lobes.theta2[i] = theta2;
    lobes.over_sine[i] = over_sine;
    lobes.value[i] = sg_exp2(-kSgHalfLog2E * theta2 * inverse * inverse);
  }
}

EFFIGY_CLONES
void specular_range(const SpecularLight& light, SgNorm norm, const LobeView& view, size_t begin,
                    size_t end, std::span<float> colour) {
  LobeBlock block;
  Towards towards;
  LobeValues lobes;
  Lane sum[3];
  for (size_t first = begin; first < end; first += kBlock) {
    const size_t count = std::min(kBlock, end - first);
    load_lobes(view, norm, first, count, block);
    for (Lane& channel : sum) std::fill_n(channel, kBlock, 0.0f);
    for (const PointLight& point : light.points.lights) {
      find_towards(light.points, point, block.position, towards);
      find_lobes(block, towards.w, lobes);
      for (size_t ch = 0; ch < 3; ++ch) {
        const float intensity = point.intensity[static_cast<int>(ch)];
        for (size_t i = 0; i < kBlock; ++i)
          sum[ch][i] += intensity * towards.strength[i] * block.constant[i] * lobes.value[i];
      }
    }
    for (size_t ch = 0; ch < 3; ++ch)
      std::copy_n(sum[ch], count, colour.data() + ch * view.count + first);
  }
}

EFFIGY_CLONES
void specular_backward_range(const SpecularLight& light, SgNorm norm, const LobeView& view,
                             std::span<const float> d_colour, size_t begin, size_t end,
                             const LobeGradients& gradients, double* d_intensity) {
  LobeBlock block;
  Towards towards;
  LobeValues lobes;
  Lane g[3], d_q[3], d_sigma[1];
  for (size_t first = begin; first < end; first += kBlock) {
    const size_t count = std::min(kBlock, end - first);
    load_lobes(view, norm, first, count, block);
    load_planes(d_colour, view.count, first, count, 3, g, 0.0f);
    for (Lane& c : d_q) std::fill_n(c, kBlock, 0.0f);
    std::fill_n(d_sigma[0], kBlock, 0.0f);
    for (size_t j = 0; j < light.points.lights.size(); ++j) {
      const PointLight& point = light.points.lights[j];
      find_towards(light.points, point, block.position, towards);
      find_lobes(block, towards.w, lobes);
      for (size_t ch = 0; ch < 3 && d_intensity; ++ch) {
        float sum = 0.0f;
        for (size_t i = 0; i < kBlock; ++i)
          sum += g[ch][i] * towards.strength[i] * block.constant[i] * lobes.value[i];
        d_intensity[3 * j + ch] += static_cast<double>(sum);
      }
      const float red = point.intensity.x(), green = point.intensity.y();
      const float blue = point.intensity.z();
      for (size_t i = 0; i < kBlock; ++i) {
        const float d_value =
            towards.strength[i] * (red * g[0][i] + green * g[1][i] + blue * g[2][i]);
        const float inverse = 1.0f / block.sigma[0][i], inverse2 = inverse * inverse;
        const float weight = block.constant[i] * lobes.value[i];
        d_sigma[0][i] += d_value * (block.d_constant[i] * lobes.value[i] +
                                    weight * lobes.theta2[i] * inverse2 * inverse);
        const float d_cosine = d_value * weight * lobes.over_sine[i] * inverse2;
        d_q[0][i] += d_cosine * towards.w[0][i];
        d_q[1][i] += d_cosine * towards.w[1][i];
        d_q[2][i] += d_cosine * towards.w[2][i];
      }
    }
    add_planes(d_q, view.count, first, count, 3, gradients.lobe);
    add_planes(d_sigma, view.count, first, count, 1, gradients.sigma);
  }
}

void check_specular(const SpecularLight& light, const LobeView& view) {
  EFFIGY_CHECK_EQ(view.lobe.size(), 3 * view.count);
  EFFIGY_CHECK_EQ(view.sigma.size(), view.count);
  check_points(light.points, view.position.size(), view.count);
}

}  // namespace

void shade_diffuse(const DiffuseLight& light, const TransferView& view, std::span<float> colour) {
  check_diffuse(light, view);
  EFFIGY_CHECK_EQ(colour.size(), 3 * view.count);
  run_with_intensity(view.count, 0, {}, [&](size_t begin, size_t end, double*) {
    diffuse_range(light, view, begin, end, colour);
  });
}

void shade_diffuse_backward(const DiffuseLight& light, const TransferView& view,
                            std::span<const float> d_colour, const TransferGradients& gradients) {
  check_diffuse(light, view);
  EFFIGY_CHECK_EQ(d_colour.size(), 3 * view.count);
  EFFIGY_CHECK_EQ(gradients.axes.size(), view.axes.size());
  EFFIGY_CHECK_EQ(gradients.zonal.size(), view.zonal.size());
  EFFIGY_CHECK(gradients.position.empty() || gradients.position.size() == 3 * view.count);
  run_with_intensity(view.count, light.points.lights.size(), gradients.intensity,
                     [&](size_t begin, size_t end, double* d_intensity) {
                       diffuse_backward_range(light, view, d_colour, begin, end, gradients,
                                              d_intensity);
                     });
}

void shade_specular(const SpecularLight& light, SgNorm norm, const LobeView& view,
                    std::span<float> colour) {
  check_specular(light, view);
  EFFIGY_CHECK_EQ(colour.size(), 3 * view.count);
  run_with_intensity(view.count, 0, {}, [&](size_t begin, size_t end, double*) {
    specular_range(light, norm, view, begin, end, colour);
    if (light.environment)
      light.environment->add(norm, end - begin, view.lobe.data() + begin, view.sigma.data() + begin,
                             view.count, colour.data() + begin);
  });
}

void shade_specular_backward(const SpecularLight& light, SgNorm norm, const LobeView& view,
                             std::span<const float> d_colour, const LobeGradients& gradients) {
  check_specular(light, view);
  EFFIGY_CHECK_EQ(d_colour.size(), 3 * view.count);
  EFFIGY_CHECK_EQ(gradients.lobe.size(), 3 * view.count);
  EFFIGY_CHECK_EQ(gradients.sigma.size(), view.count);
  run_with_intensity(
      view.count, light.points.lights.size(), gradients.intensity,
      [&](size_t begin, size_t end, double* d_intensity) {
        specular_backward_range(light, norm, view, d_colour, begin, end, gradients, d_intensity);
        if (light.environment)
          light.environment->add_backward(norm, end - begin, view.lobe.data() + begin,
                                          view.sigma.data() + begin, view.count,
                                          d_colour.data() + begin, gradients.lobe.data() + begin,
                                          gradients.sigma.data() + begin);
      });
}

void reflect_views(size_t count, std::span<const float> normal, std::span<const float> wo,
                   std::span<float> lobe) {
  const size_t n = count;
  parallel_for(count, 4096, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const float cosine =
          normal[i] * wo[i] + normal[n + i] * wo[n + i] + normal[2 * n + i] * wo[2 * n + i];
      for (size_t c = 0; c < 3; ++c)
        lobe[c * n + i] = 2.0f * cosine * normal[c * n + i] - wo[c * n + i];
    }
  });
}

void reflect_views_backward(size_t count, std::span<const float> normal, std::span<const float> wo,
                            std::span<const float> d_lobe, std::span<float> d_normal,
                            std::span<float> d_wo) {
  const size_t n = count;
  parallel_for(count, 4096, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      float cosine = 0.0f, along = 0.0f;
      for (size_t c = 0; c < 3; ++c) {
        cosine += normal[c * n + i] * wo[c * n + i];
        along += normal[c * n + i] * d_lobe[c * n + i];
      }
      for (size_t c = 0; c < 3; ++c) {
        const size_t k = c * n + i;
        d_normal[k] += 2.0f * (cosine * d_lobe[k] + along * wo[k]);
        d_wo[k] += 2.0f * along * normal[k] - d_lobe[k];
      }
    }
  });
}

}  // namespace effigy
