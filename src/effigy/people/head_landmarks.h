// Landmarks on the built-in head.
#pragma once

#include "effigy/people/head_mesh.h"
#include "effigy/rig/rig.h"

namespace effigy::people {

// The 68 of MultiPIE/iBUG, by construction.
LandmarkEmbedding multipie_landmarks(const HeadMesh& head);
// The 468 of MediaPipe's face mesh; the irises are not among them.
LandmarkEmbedding network_landmarks(const HeadMesh& head);

}  // namespace effigy::people
