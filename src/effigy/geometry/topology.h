// How the triangles of a mesh hang together.
#pragma once

#include <vector>

#include "effigy/geometry/types.h"

namespace effigy {

// The closed loops of edges that belong to an odd number of triangles (one, on a proper mesh), as
// vertices in order along the boundary; longest first, each starting at its smallest vertex and
// running in the direction of the triangles' own edges. Loops that touch in a vertex are separated.
std::vector<std::vector<int>> boundary_loops(const std::vector<Vec3i>& triangles, int vertex_count);

// Number of the connected piece of every vertex (pieces numbered by their smallest vertex, from 0);
// vertices of no triangle are pieces of their own.
std::vector<int> connected_pieces(const std::vector<Vec3i>& triangles, int vertex_count);

}  // namespace effigy
