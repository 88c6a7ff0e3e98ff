// The 68 MultiPIE/iBUG landmarks on the built-in head, by construction.
#pragma once

#include "effigy/people/head_mesh.h"
#include "effigy/rig/rig.h"

namespace effigy::people {

LandmarkEmbedding multipie_landmarks(const HeadMesh& head);

}  // namespace effigy::people
