// Head templates are bald; people are not. Before training, the template outside the face is moved
// along its normals to the silhouette that the mattes show, so that surfels start where the hair
// is.
#pragma once

#include <vector>

#include "effigy/capture/capture.h"

namespace effigy {

// Offset along the rest normal of each vertex, metres, in [-0.01, 0.05]; 0 on the face (near the
// rig's landmarks), in the eyes, the teeth and the mouth. Where a vertex lies near the outline of
// some training frames, the offset is the median distance from the surface to the matte's border
// there; elsewhere it is spread from the neighbours.
std::vector<float> silhouette_offsets(const Capture& capture, const RigShape& shape,
                                      const std::vector<int>& frames);

// Moves shape.rest by the offsets along its vertex normals.
void apply_offsets(const Mesh& mesh, const std::vector<float>& offsets, RigShape& shape);

}  // namespace effigy
