// Cuts the body's surface into pieces that lie flat, as a tailor would, and flattens them.
#pragma once

#include <vector>

#include "effigy/people/body_shape.h"
#include "effigy/people/isosurface.h"

namespace effigy::people {

struct ChartedSurface {
  std::vector<Vec2d> uvs;
  std::vector<Vec3i> uv_triangles;  // per triangle of the surface
};

// Charts: front and back of trunk, arms, legs, hands and fingers; sides and sole of
// the shoes. Every chart is a disc. `parts`: BodyPart of each triangle.
ChartedSurface unwrap_body(const BodyForm& form, const Surface& surface,
                           const std::vector<int>& parts);

}  // namespace effigy::people
