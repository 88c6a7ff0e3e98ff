// Triangle meshes with a UV atlas, and what is computed from them.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/geometry/types.h"

namespace effigy {

// Positions are flat (3 per vertex) because kernels work on plain arrays.
struct Mesh {
  std::vector<float> vertices;      // 3V, metres
  std::vector<Vec3i> triangles;     // F, vertex indices, counter-clockwise from outside
  std::vector<Vec2f> uvs;           // UV vertices, v = 0 at the bottom row of the image
  std::vector<Vec3i> uv_triangles;  // F, indices into uvs (empty: no UVs)
  std::vector<int> triangle_part;   // F, index into parts (empty: one part)
  std::vector<std::string> parts;   // names: OBJ groups/materials or rig parts

  int vertex_count() const { return static_cast<int>(vertices.size() / 3); }
  int triangle_count() const { return static_cast<int>(triangles.size()); }
  Vec3f vertex(int i) const { return Vec3f(vertices.data() + 3 * static_cast<size_t>(i)); }
};

// Wavefront OBJ; polygons are fanned into triangles; parts from `usemtl` (else `g`/`o`). Throws
// Error naming file and line for bad indices, values that are not finite, or no faces.
Mesh read_obj(const Path& path);
void write_obj(const Path& path, const Mesh& mesh);

// Area-weighted unit vertex normals, 3V.
std::vector<float> vertex_normals(std::span<const float> vertices,
                                  const std::vector<Vec3i>& triangles);
// Throws Error(message prefixed by `name`) unless all indices are in range and values finite.
void check_mesh(const Mesh& mesh, const std::string& name);
// Unique undirected edges.
std::vector<std::pair<int, int>> mesh_edges(const std::vector<Vec3i>& triangles, int vertex_count);

// 1 where the texel's centre is inside a UV triangle (row 0 of the result = top of the image,
// v = 1), size x size; `dilate` grows it by that many texels.
std::vector<uint8_t> uv_coverage(const Mesh& mesh, int size, int dilate = 0);

// The point of the surface that each texel of a size x size texture shows (row 0 = top, v = 1).
struct TexelMap {
  int size = 0;
  std::vector<int32_t> triangle;   // per texel; -1: its centre is in no triangle
  std::vector<float> barycentric;  // 2 per texel: weights of the triangle's second and third corner
};
// Where triangles overlap in the atlas the first one counts.
TexelMap texel_map(const Mesh& mesh, int size);

}  // namespace effigy
