// What texels between the islands of an atlas show.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace effigy {

// `shown`: one a texel of a size x size picture, negative where it shows no point of the surface
// (TexelMap's triangles are such numbers). Returns for each texel the nearest one that does (itself
// where it does), counted in steps along rows and columns; -1 when none does.
std::vector<int> nearest_shown(int size, std::span<const int32_t> shown);

}  // namespace effigy
