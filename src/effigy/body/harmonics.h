// Diffuse transfer as full spherical harmonics, forward and backward on planar arrays. Each
// Gaussian has coefficients d (113: bands 0-3 in colour, 4-8 grey).
//
// The paper's baseline does not turn them: light comes to all Gaussians from where it comes to the
// body's root, in the root's frame, and colour = sum over (l, m) of d_lm L_lm.
// A row of our own beside it turns them with the surface: d is in the Gaussian's own frame and
//   colour = sum over lamps j of I_j sum over (l, m) of d_lm Y_lm(a_0.w_j, a_1.w_j, a_2.w_j),
// a its axes, w_j each Gaussian's own direction to the lamp, I_j with its falloff. With the d of
// zonal lobes about the axes this is shade_diffuse (shade/transfer.h).
#pragma once

#include <span>
#include <vector>

#include "effigy/light/point_light.h"
#include "effigy/light/zonal.h"

namespace effigy {

inline constexpr size_t kHarmonics = sh_count(kZonalOrder), kColouredHarmonics = 16;
inline constexpr size_t kHarmonicCoefficients =
    3 * kColouredHarmonics + kHarmonics - kColouredHarmonics;
// Where coefficient i of channel c is: the coloured ones first.
constexpr size_t harmonic_index(size_t i, size_t c) {
  return i < kColouredHarmonics ? 3 * i + c : 2 * kColouredHarmonics + i;
}

// L_lm of the lamps in the root's frame, r g b of each.
std::vector<float> root_harmonics(PointLights lights, const Mat3f& world_from_root,
                                  const Vec3f& root);
// light: root_harmonics(); transfer: kHarmonicCoefficients planes. Writes colour (3 planes), which
// may be negative; backward adds.
void shade_harmonics(std::span<const float> light, size_t count, std::span<const float> transfer,
                     std::span<float> colour);
void shade_harmonics_backward(std::span<const float> light, size_t count,
                              std::span<const float> d_colour, std::span<float> d_transfer);

struct TurnedView {
  size_t count = 0;
  std::span<const float> axes;      // 9 planes
  std::span<const float> position;  // 3 planes, world
  std::span<const float> transfer;  // kHarmonicCoefficients planes
};

struct TurnedGradients {  // backward adds to them
  std::span<float> axes, position, transfer;
};

// Writes colour (3 planes), which may be negative. The same bits for every thread count.
void shade_turned_harmonics(const PointLights& lights, const TurnedView& view,
                            std::span<float> colour);
void shade_turned_harmonics_backward(const PointLights& lights, const TurnedView& view,
                                     std::span<const float> d_colour,
                                     const TurnedGradients& gradients);

}  // namespace effigy
