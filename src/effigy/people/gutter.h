// What texels between the islands of an atlas show.
#pragma once

#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy::people {

// The nearest texel that shows a point of the surface, for each texel of the map (itself where it
// does), counted in steps along rows and columns; -1 when none does.
std::vector<int> nearest_shown(const TexelMap& map);

}  // namespace effigy::people
