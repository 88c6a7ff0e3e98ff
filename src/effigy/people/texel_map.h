// Which place of a mesh each texel of its atlas shows.
#pragma once

#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy::people {

struct TexelMap {
  int size = 0;
  std::vector<int> triangle;       // size * size, row 0 = top; -1 outside the islands
  std::vector<Vec3f> barycentric;  // of the triangle's corners
  size_t at(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(size) + static_cast<size_t>(x);
  }
};
// Texel centres; those within half a texel of an island count to it, so that edges leave no gaps.
TexelMap map_texels(const Mesh& mesh, int size);

// The nearest texel that shows something, for each texel (itself where it does); -1 when none does.
std::vector<int> nearest_shown(const TexelMap& map);

}  // namespace effigy::people
