// Fills what is not known on a texture from what is near it on the surface, whatever lies between
// them in the atlas.
#pragma once

#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy {

// `values`: [texel][channels] of a size x size texture with row 0 = v 0 (MaterialTexture's order),
// `weights`: one a texel. value = w value + (1 - w) surroundings with w = min(1, weight / enough);
// texels of at least that weight, and texels in no triangle or next to one, keep their bits. The
// surroundings are the weighted values of the same part of the mesh, spread through space by
// pull-push (Gortler et al. 1996) on a grid of some millimetres. A part without any weight is left
// as it is.
void fill_over_surface(const Mesh& mesh, int size, int channels, float enough,
                       const std::vector<float>& weights, std::vector<float>& values);

}  // namespace effigy
