// Putting the points of the landmark networks onto a rig's surface.
#pragma once

#include <array>

#include "effigy/rig/canonical_face.h"
#include "effigy/rig/rig.h"

namespace effigy {

// The MediaPipe point that stands at each of the 68 MultiPIE/iBUG landmarks.
const std::array<int, 68>& mediapipe_of_multipie();

// All MediaPipe points (468, and 10 of the irises when the rig has the parts "eye_left" and
// "eye_right") on the rig's template. The canonical face is brought onto the template by a
// similarity and a thin-plate spline through the rig's 68 landmarks, then drawn onto the part
// "skin" (the whole mesh when there is no such part) by closest points with a smooth displacement.
// Points on the rims of lids and lips lie on the mesh edges between the landmarks of the same rim,
// so that they follow the right lid and the right lip. Iris points: 468/473 the front of the
// subject's right/left eyeball as it looks to +z, then left (+x), top, right, bottom of the limbus.
// Throws Error when the rig has no 68 landmarks or the canonical face is empty.
LandmarkEmbedding embed_canonical(const Rig& rig, const CanonicalFace& face);

// Only the MediaPipe points that correspond to one of the rig's 68 landmarks, placed there; for
// users without the canonical face. Irises as above.
LandmarkEmbedding embed_corresponding(const Rig& rig);

}  // namespace effigy
