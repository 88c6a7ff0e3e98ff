// Isotropic remeshing: triangles of even, chosen size and good shape on a smooth surface.
#pragma once

#include <functional>
#include <vector>

#include "effigy/people/isosurface.h"

namespace effigy::people {

struct RemeshOptions {
  std::function<double(const Vec3d&)> size;    // wanted edge length
  std::function<Vec3d(const Vec3d&)> project;  // onto the surface
  std::vector<char> fixed;                     // per point: stays, with its edges to fixed points
  int rounds = 6;
};

// Splits long edges, collapses short ones, flips towards even valence and moves points along the
// surface (Botsch and Kobbelt 2004), `rounds` times. Fixed points keep their numbers when they are
// the first ones. Boundary points are treated as fixed. Deterministic.
Surface remesh(const Surface& surface, const RemeshOptions& options);

}  // namespace effigy::people
