// A prefiltered environment laid out for lookups: RGBA float texels, every face widened by one
// texel on each side, so that a seamless bilinear lookup (sample_cubemap) is four loads from one
// face.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "effigy/light/environment.h"

namespace effigy {

// One cubemap of the pack: texel (x, y) of face f, x and y in -1 .. size, is at
// 4 (offset + (f (size + 2) + y + 1) (size + 2) + x + 1).
struct PackedCubemap {
  int size = 0;
  size_t offset = 0;  // in texels
  size_t texels() const { return static_cast<size_t>(6) * (size + 2) * (size + 2); }
};

struct PackedEnvironment {
  std::vector<float> texels;  // RGBA, A = 0
  PackedCubemap diffuse;
  std::vector<PackedCubemap> specular;
  std::vector<float> roughness;  // as in PrefilteredEnvironment
};

PackedEnvironment pack_environment(const PrefilteredEnvironment& light);

// Transpose of pack_environment: adds a gradient with respect to pack.texels to `d_light` (shaped
// like the light that was packed).
void add_packed_gradient(const PackedEnvironment& pack, std::span<const float> d_texels,
                         PrefilteredEnvironment& d_light);

}  // namespace effigy
