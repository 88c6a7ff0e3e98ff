// Simple shapes for the path tracer's proofs.
#pragma once

#include <cmath>
#include <numbers>

#include "effigy/geometry/mesh.h"

namespace effigy::test {

// A UV sphere, its poles on the y axis.
inline Mesh sphere(double radius, int rings, const Vec3d& centre = Vec3d::Zero()) {
  Mesh mesh;
  const int segments = 2 * rings;
  for (int r = 0; r <= rings; ++r)
    for (int s = 0; s < segments; ++s) {
      const double theta = std::numbers::pi * r / rings, phi = 2 * std::numbers::pi * s / segments;
      const Vec3d p = centre + radius * Vec3d(std::sin(theta) * std::sin(phi), std::cos(theta),
                                              std::sin(theta) * std::cos(phi));
      for (int c = 0; c < 3; ++c) mesh.vertices.push_back(static_cast<float>(p[c]));
    }
  const auto at = [&](int r, int s) { return r * segments + s % segments; };
  for (int r = 0; r < rings; ++r)
    for (int s = 0; s < segments; ++s) {
      if (r > 0) mesh.triangles.emplace_back(at(r, s), at(r + 1, s), at(r, s + 1));
      if (r + 1 < rings) mesh.triangles.emplace_back(at(r, s + 1), at(r + 1, s), at(r + 1, s + 1));
    }
  return mesh;
}

// A square in the plane z = `z`, facing +z, UVs over all of it.
inline Mesh square(double half, double z = 0) {
  Mesh mesh;
  const float h = static_cast<float>(half), d = static_cast<float>(z);
  mesh.vertices = {-h, -h, d, h, -h, d, h, h, d, -h, h, d};
  mesh.triangles = {Vec3i(0, 1, 2), Vec3i(0, 2, 3)};
  mesh.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  mesh.uv_triangles = mesh.triangles;
  return mesh;
}

}  // namespace effigy::test
