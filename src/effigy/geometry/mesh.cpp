#include "effigy/geometry/mesh.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"

namespace effigy {
namespace {

void check_indices(const std::vector<Vec3i>& triangles, size_t count, const std::string& name,
                   const char* field) {
  for (size_t f = 0; f < triangles.size(); ++f)
    for (int corner = 0; corner < 3; ++corner) {
      const int index = triangles[f][corner];
      if (index < 0 || static_cast<size_t>(index) >= count)
        throw Error(name + ": " + field + " " + std::to_string(f) + " has index " +
                    std::to_string(index) + ", but there are only " + std::to_string(count) +
                    "; write the mesh again.");
    }
}

}  // namespace

// The cross product of two edges is the unit normal times twice the area, so plain sums weight by
// area.
std::vector<float> vertex_normals(std::span<const float> vertices,
                                  const std::vector<Vec3i>& triangles) {
  std::vector<float> normals(vertices.size(), 0.0f);
  for (const Vec3i& t : triangles) {
    const Eigen::Map<const Vec3f> a(vertices.data() + 3 * static_cast<size_t>(t[0]));
    const Eigen::Map<const Vec3f> b(vertices.data() + 3 * static_cast<size_t>(t[1]));
    const Eigen::Map<const Vec3f> c(vertices.data() + 3 * static_cast<size_t>(t[2]));
    const Vec3f normal = (b - a).cross(c - a);
    for (int corner = 0; corner < 3; ++corner)
      Eigen::Map<Vec3f>(normals.data() + 3 * static_cast<size_t>(t[corner])) += normal;
  }
  for (size_t i = 0; i + 2 < normals.size(); i += 3) {
    Eigen::Map<Vec3f> normal(normals.data() + i);
    const float length = normal.norm();
    // A vertex without any face of positive area gets +y, so that every normal is a unit vector.
    if (length > 0)
      normal /= length;
    else
      normal = Vec3f::UnitY();
  }
  return normals;
}

void check_mesh(const Mesh& mesh, const std::string& name) {
  if (mesh.vertices.size() % 3 != 0)
    throw Error(name + ": the vertex positions are not 3 numbers each; write the mesh again.");
  if (mesh.vertices.empty() || mesh.triangles.empty())
    throw Error(name + ": the mesh has no vertices or no triangles; write the mesh again.");
  for (size_t i = 0; i < mesh.vertices.size(); ++i)
    if (!std::isfinite(mesh.vertices[i]))
      throw Error(name + ": vertex " + std::to_string(i / 3) +
                  " is not a finite number; write the mesh again.");
  for (size_t i = 0; i < mesh.uvs.size(); ++i)
    if (!mesh.uvs[i].allFinite())
      throw Error(name + ": UV vertex " + std::to_string(i) +
                  " is not a finite number; write the mesh again.");
  check_indices(mesh.triangles, mesh.vertices.size() / 3, name, "triangle");
  if (!mesh.uv_triangles.empty() && mesh.uv_triangles.size() != mesh.triangles.size())
    throw Error(name + ": " + std::to_string(mesh.uv_triangles.size()) + " UV triangles for " +
                std::to_string(mesh.triangles.size()) + " triangles; write the mesh again.");
  check_indices(mesh.uv_triangles, mesh.uvs.size(), name, "UV triangle");
  if (!mesh.triangle_part.empty() && mesh.triangle_part.size() != mesh.triangles.size())
    throw Error(name + ": " + std::to_string(mesh.triangle_part.size()) + " part numbers for " +
                std::to_string(mesh.triangles.size()) + " triangles; write the mesh again.");
  for (const int part : mesh.triangle_part)
    if (part < 0 || static_cast<size_t>(part) >= mesh.parts.size())
      throw Error(name + ": part number " + std::to_string(part) +
                  " of a triangle, but there are " + std::to_string(mesh.parts.size()) +
                  " parts; write the mesh again.");
}

std::vector<std::pair<int, int>> mesh_edges(const std::vector<Vec3i>& triangles, int vertex_count) {
  std::vector<std::pair<int, int>> edges;
  edges.reserve(3 * triangles.size());
  for (const Vec3i& t : triangles)
    for (int corner = 0; corner < 3; ++corner) {
      const int a = t[corner], b = t[(corner + 1) % 3];
      EFFIGY_CHECK(a >= 0 && b >= 0 && a < vertex_count && b < vertex_count);
      if (a != b) edges.emplace_back(std::min(a, b), std::max(a, b));
    }
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  return edges;
}

}  // namespace effigy
