// Mesh simplification by half-edge collapse: every vertex that stays is a vertex of the input, so
// blendshapes, skinning weights and landmarks are carried along by picking rows.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy {

struct DecimateOptions {
  // Further positions of the same vertices (3V each), such as blendshapes at full strength. The
  // surface must stay within `tolerance` in all of them, not only in mesh.vertices ("Deformation
  // sensitive decimation", Mohr and Gleicher 2003).
  std::vector<std::vector<float>> poses;
  // V: the wanted edge length at each vertex, metres; no edge longer than stretch * size is made
  // (an edge's size is the mean of its ends'). Empty: no limit.
  std::vector<float> size;
  float stretch = 1.5f;
  // V: 1 = never removed. Empty: none.
  std::vector<uint8_t> locked;
  // Edges of the mesh that stay chains of edges, like seams: lines that must keep their course.
  std::vector<std::pair<int, int>> creases;
  // Largest root-mean-square distance, metres, of a vertex to the planes of all the input triangles
  // it has come to stand for (quadric error metric, Garland and Heckbert 1997), in the worst pose.
  float tolerance = 3e-4f;
  std::vector<float> vertex_tolerance;  // V, instead of `tolerance`, where some parts matter less
  // Stop at this many triangles; 0: go on as long as the limits allow.
  int target_triangles = 0;
};

struct Decimated {
  Mesh mesh;                // unused vertices and UV vertices removed
  std::vector<int> vertex;  // V', the input vertex of each vertex
};

// Collapses edges from short and flat to long and curved. Kept: manifoldness (an input edge with
// three triangles is never touched), the boundary, borders between parts, UV seams and creases
// (their vertices move along them only, their end and branch points stay), the orientation of every
// triangle in space, in all poses and in UV. Deterministic. Throws Error (through check_mesh) for a
// broken mesh; sizes in `options` that do not match are defects of the caller.
Decimated decimate(const Mesh& mesh, const DecimateOptions& options);

}  // namespace effigy
