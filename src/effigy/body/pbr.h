// Physically based appearance on a body's Gaussians, the paper's baseline: for each pixel Lambert
// and a Cook-Torrance lobe under every lamp, forward and backward on planar arrays.
//
//   C = sum over lamps of I max(0, n.l) (albedo / pi + weight D G2 F / (4 n.l n.v))
// GGX D of alpha = roughness^2, height-correlated Smith G2, Schlick F with F0 = 0.04 (the material
// model of docs/conventions.md). Positions and directions to the camera have no gradient.
#pragma once

#include <span>

#include "effigy/light/point_light.h"

namespace effigy {

struct PbrView {
  size_t count = 0;
  std::span<const float> normal;     // 3 planes, unit
  std::span<const float> to_camera;  // 3 planes, unit
  std::span<const float> position;   // 3 planes, world
  std::span<const float> albedo;     // 3 planes, times the pixel's alpha
  std::span<const float> weight;     // the pixel's alpha
  std::span<const float> roughness;
};

struct PbrGradients {  // backward adds to them
  std::span<float> normal, albedo, weight, roughness;
};

// Writes colour (3 planes).
void shade_pbr(const PointLights& lights, const PbrView& view, std::span<float> colour);
void shade_pbr_backward(const PointLights& lights, const PbrView& view,
                        std::span<const float> d_colour, const PbrGradients& gradients);

}  // namespace effigy
