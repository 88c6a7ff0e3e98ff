// Radiance transfer of body avatars (RFGCA, Wang et al. 2025), forward and backward, on planar
// arrays: component c of element i of an array of n elements is at [c * n + i].
//
// Diffuse (Eq. 7-9), per Gaussian with unit axes a_0 a_1 a_2 and zonal harmonics z (light/zonal.h):
//   colour_ch = sum over axes k and bands l of z_{k,l,ch} E_{l,ch}(a_k),
// E_l from points, each with its own direction (and falloff) for every Gaussian, plus E_l from the
// spherical harmonics of an environment. Albedo is not included.
//
// Specular (Eq. 10-13), per pixel with a unit lobe direction q and width sigma:
//   colour = sum over lights of I G(w; q, sigma)   (light/spherical_gaussian.h)
// plus the environment filtered by the lobe (light/lobe_environment.h). Visibility is not included;
// directions to point lights are taken as given (no derivative by position).
#pragma once

#include <span>
#include <vector>

#include "effigy/light/band_table.h"
#include "effigy/light/lobe_environment.h"
#include "effigy/light/point_light.h"
#include "effigy/light/spherical_gaussian.h"
#include "effigy/light/zonal.h"

namespace effigy {

inline constexpr size_t kZonalColourBands = 4;  // bands 0..3 have a colour, 4..8 only one number
inline constexpr size_t kZonalCoefficients = 51;
// Where a coefficient is in the 51: the colour bands of all axes first. `channel` does not matter
// for the others.
constexpr size_t zonal_index(size_t axis, size_t band, size_t channel) {
  return band < kZonalColourBands
             ? (axis * kZonalColourBands + band) * 3 + channel
             : 9 * kZonalColourBands + axis * (kZonalBands - kZonalColourBands) + band -
                   kZonalColourBands;
}

struct DiffuseLight {
  PointLights points;
  std::vector<float> sh;  // sh_of_cubemap of an environment, or empty
  // Of the same environment: then colours are looked up in it instead of found from `sh`. Their
  // derivatives are always those of `sh`.
  const BandTable* bands = nullptr;
};

struct TransferView {
  size_t count = 0;
  std::span<const float> axes;      // 9 planes: x y z of a_0, of a_1, of a_2; unit
  std::span<const float> position;  // 3 planes, world; may be empty when no light is a point
  std::span<const float> zonal;     // kZonalCoefficients planes
};

struct TransferGradients {     // backward adds to them
  std::span<float> axes;       // 9 planes
  std::span<float> position;   // 3 planes, or empty: not wanted
  std::span<float> zonal;      // kZonalCoefficients planes
  std::span<float> intensity;  // r g b of every point, or empty: not wanted
};

// colour: 3 planes; may be negative (zonal lobes are).
void shade_diffuse(const DiffuseLight& light, const TransferView& view, std::span<float> colour);
// The same bits for every thread count but for `intensity`, which has them for a given one.
void shade_diffuse_backward(const DiffuseLight& light, const TransferView& view,
                            std::span<const float> d_colour, const TransferGradients& gradients);

struct SpecularLight {
  PointLights points;
  const LobeEnvironment* environment = nullptr;  // or none
};

struct LobeView {
  size_t count = 0;
  std::span<const float> lobe;      // 3 planes, unit
  std::span<const float> sigma;     // 1 plane, > 0
  std::span<const float> position;  // 3 planes; may be empty when no light is a point
};

struct LobeGradients {  // backward adds to them
  std::span<float> lobe, sigma;
  std::span<float> intensity;  // r g b of every point, or empty: not wanted
};

// Elements whose sigma is not positive are dark.
void shade_specular(const SpecularLight& light, SgNorm norm, const LobeView& view,
                    std::span<float> colour);
void shade_specular_backward(const SpecularLight& light, SgNorm norm, const LobeView& view,
                             std::span<const float> d_colour, const LobeGradients& gradients);

// Lobe direction q = 2 (n.w) n - w of unit normals n and unit directions w to the camera, 3 planes
// each; backward adds.
void reflect_views(size_t count, std::span<const float> normal, std::span<const float> wo,
                   std::span<float> lobe);
void reflect_views_backward(size_t count, std::span<const float> normal, std::span<const float> wo,
                            std::span<const float> d_lobe, std::span<float> d_normal,
                            std::span<float> d_wo);

}  // namespace effigy
