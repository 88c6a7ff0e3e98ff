// Diffuse transfer as full spherical harmonics that turn with the surface: a row of our own beside
// the paper's baseline, whose harmonics do not turn. Forward and backward on planar arrays.
//
// Each Gaussian has coefficients d in its own frame (113: bands 0-3 in colour, 4-8 grey), so
//   colour = sum over lamps j of I_j sum over (l, m) of d_lm Y_lm(a_0.w_j, a_1.w_j, a_2.w_j),
// a its axes, w_j each Gaussian's own direction to the lamp, I_j with its falloff. With the d of
// zonal lobes about the axes this is shade_diffuse (shade/transfer.h).
#pragma once

#include <span>

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
