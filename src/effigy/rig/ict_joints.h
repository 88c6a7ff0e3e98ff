// The skeleton that ICT-FaceKit lacks. Used by ict.cpp only.
#pragma once

#include "effigy/rig/rig.h"

namespace effigy::ict {

// Fills the joints (root, neck, eye_left, eye_right), their regressor, the skinning weights and the
// neck ring of a rig that has everything else, its parts named as in Rig. Eyeballs are rigid. The
// neck's weight is harmonic between the open ring (which follows the root) and the head.
void add_joints(Rig& rig);

}  // namespace effigy::ict
