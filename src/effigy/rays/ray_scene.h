// Ray queries on triangle meshes (Embree).
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy {

struct RayHit {
  int triangle = -1;  // -1: nothing hit
  float distance = 0;
  float b = 0, c = 0;  // barycentric weights of the triangle's 2nd and 3rd vertex
};

// What a mesh is indexed for: the fastest rays, none of which slips through an edge; or moving it
// again and again (the tree keeps its shape and only its boxes are fitted anew, in a tenth of the
// time).
enum class RayUse { kStill, kMoving };

// One triangle mesh, indexed for ray queries. Both sides of a triangle are hit. Directions need not
// be unit; distances are in lengths of the direction. Queries are safe from many threads.
class RayScene {
 public:
  // `vertices`: 3V floats. Copies what it needs. Throws Error when an index is out of range, a
  // position is not finite, or Embree cannot build the scene.
  RayScene(std::span<const float> vertices, const std::vector<Vec3i>& triangles,
           RayUse use = RayUse::kStill);
  ~RayScene();
  RayScene(RayScene&&) noexcept;
  RayScene& operator=(RayScene&&) noexcept;

  // The nearest hit with distance in [near, far].
  RayHit closest(const Vec3f& origin, const Vec3f& direction, float near = 0.0f,
                 float far = 1e30f) const;
  // Whether anything is hit with distance in [near, far].
  bool occluded(const Vec3f& origin, const Vec3f& direction, float near = 0.0f,
                float far = 1e30f) const;

  // Moves the vertices (same count); the index is built anew, or refitted for RayUse::kMoving.
  void move(std::span<const float> vertices);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace effigy
