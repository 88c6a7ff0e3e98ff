// UV atlases: islands, and packing them into one unit square.
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy {

// The island of each triangle (F), numbered from 0 in the order of their first triangle: triangles
// that share a UV vertex are of one island.
std::vector<int> uv_islands(const Mesh& mesh);

// Makes one UV vertex of those that lie at the same place (closer than `tolerance`) on the same
// vertex and in the same part, so that an island cut in two by an exporter is whole again.
void weld_uvs(Mesh& mesh, float tolerance = 1e-5f);

struct AtlasOptions {
  // By part (mesh.parts): texels per metre relative to the other parts. Islands keep their shape
  // and are scaled so that sqrt(UV area / surface area) is in these proportions.
  std::vector<float> density;
  // Cells of the packing raster along each side; islands are kept at least one cell apart (4 texels
  // of a 1024 texture for 256 cells).
  int cells = 256;
};

// Moves every island into [0, 1]^2 without overlaps, as large as the proportions allow: turned by
// multiples of 90 degrees, mirrored where its UVs ran clockwise. The largest island goes to the
// lower left corner, the others fill what is left, concavities included. Deterministic.
// Throws Error when an island has no area in UV or in space.
void pack_atlas(Mesh& mesh, const AtlasOptions& options);

// How a UV layout behaves at size x size texels: the share of texels whose centre is inside a
// triangle, inside more than one island or triangle (overlaps; shared edges do not count), and
// the number of triangles that run clockwise or have no area.
struct AtlasReport {
  double coverage = 0;
  int64_t overlaps = 0;
  int clockwise = 0;
};
AtlasReport inspect_atlas(const Mesh& mesh, int size);

}  // namespace effigy
