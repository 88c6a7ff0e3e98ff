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

class RayScene {
 public:
  RayScene(std::span<const float> vertices, const std::vector<Vec3i>& triangles);
  ~RayScene();
  RayHit closest(const Vec3f& origin, const Vec3f& direction, float near = 0.0f,
                 float far = 1e30f) const;
  bool occluded(const Vec3f& origin, const Vec3f& direction, float near = 0.0f,
                float far = 1e30f) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace effigy
