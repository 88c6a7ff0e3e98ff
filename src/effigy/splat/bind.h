// Surfels bound to the triangles of a rig (GTAvatar section 3.3-3.4): from vertices and per-surfel
// parameters to what the rasterizer draws, and back.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy {

// Per-surfel parameters, N surfels. Plain arrays so that an optimiser can walk over them.
struct BoundSurfels {
  std::vector<int32_t> triangle;     // N
  std::vector<float> barycentric;    // 2N: weights of vertices B and C; A's is 1 - b - c; unclamped
  std::vector<float> displacement;   // N, metres along the triangle's normal
  std::vector<float> rotation;       // 4N, quaternion w x y z, normalised on use
  std::vector<float> log_scale;      // 2N, natural log of the standard deviation in metres
  std::vector<float> opacity_logit;  // N
  size_t count() const { return triangle.size(); }
};

// Posed surfels: what the rasterizer draws.
struct PosedSurfels {
  std::vector<float> center;     // 3N, world
  std::vector<float> s, t;       // 3N each, world vectors of one standard deviation
  std::vector<float> opacity;    // N, in [0, 1]
  std::vector<float> uv;         // 2N, at the centre
  std::vector<float> uv_per_st;  // 4N: du/ds du/dt dv/ds dv/dt (paper Eq. 1)
  std::vector<float> frame;      // 9N: tangent, bitangent, normal (unit, world) of the normal map
  size_t count() const { return opacity.size(); }
  void resize(size_t n);
};

struct BindOptions {
  // Displacement along the triangle's normal, or along the interpolated vertex normals.
  bool interpolated_normals = false;
  // Normal map in the UV-aligned tangent frame, or in the surfel's own frame (Eq. 7).
  bool splat_normal_frame = false;
  // Let the pseudo-inverse's gradient reach the vertices (decisions.md; off by default).
  bool jacobian_to_vertices = false;
};

// Surfels distributed by triangle area to `count` in all (triangles in `weight` = 0 get none;
// empty: all 1), uniform inside each triangle, scales covering their share of area, opacity
// `opacity`.
BoundSurfels sample_surfels(const Mesh& mesh, int count, uint64_t seed,
                            std::span<const float> triangle_weight = {}, float opacity = 0.9f);

void pose_surfels(const Mesh& mesh, std::span<const float> vertices, const BoundSurfels& surfels,
                  const BindOptions& options, PosedSurfels& posed);

// Gradients with respect to BoundSurfels (same sizes) and vertices (3V).
struct BoundSurfelGradients {
  std::vector<float> barycentric, displacement, rotation, log_scale, opacity_logit;
  std::vector<float> vertices;
  void clear(const BoundSurfels& surfels, size_t vertex_floats);
};
// `d_posed` holds derivatives of the loss with respect to each field of PosedSurfels. Adds to
// `gradients`. Bit-reproducible for a given thread count.
void pose_surfels_backward(const Mesh& mesh, std::span<const float> vertices,
                           const BoundSurfels& surfels, const BindOptions& options,
                           const PosedSurfels& d_posed, BoundSurfelGradients& gradients);

}  // namespace effigy
