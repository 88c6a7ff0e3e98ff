// 3D Gaussians in PLY files as 3DGS (Kerbl et al. 2023) writes them: columns x y z, opacity
// (logit), scale_0..2 (natural logarithm), rot_0..3 (w first, any length), f_dc_0..2 and f_rest_*
// (spherical harmonics of the colour, channel after channel). Columns may come in any order; others
// are passed over.
#pragma once

#include <vector>

#include "effigy/base/file.h"
#include "effigy/splat/gaussian_raster.h"

namespace effigy {

struct GaussianModel {
  // center, rotation, scale and opacity as the rasterizer reads them; features are empty.
  Gaussians gaussians;
  int sh_degree = 0;         // 0..4
  std::vector<float> sh;     // n * (sh_degree + 1)^2 * 3: r g b of each coefficient
  bool antialiased = false;  // made for an opacity that is compensated for the blur
  size_t left_out = 0;       // read, but with values that cannot be drawn
  size_t count() const { return gaussians.count(); }
};

// Gaussians with a position, rotation, scale or colour that is not finite, or a quaternion of
// length zero, are left out and counted; an infinite opacity logit is taken as 0 or 1. Throws Error
// naming the file when columns are missing or nothing remains.
GaussianModel read_gaussian_ply(const Path& path);
// Binary little-endian floats in Inria's order, with the render mode as a comment.
void write_gaussian_ply(const Path& path, const GaussianModel& model);

// Colours as seen from `eye`: max(0, 1/2 + sum of the harmonics at the direction from the eye),
// into three features. Display-referred, as trained on sRGB images.
void colour_gaussians(const GaussianModel& model, const Vec3d& eye, std::vector<float>& features);

}  // namespace effigy
