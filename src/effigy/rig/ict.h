// ICT-FaceKit (Li et al., "Learning Formation of Physically-Based Face Attributes", CVPR 2020;
// MIT licence) as a head Rig.
#pragma once

#include "effigy/rig/rig.h"

namespace effigy {

// True when `folder` (or folder/FaceXModel) holds ICT-FaceKit's neutral mesh and index file.
bool is_ict_folder(const Path& folder);

// The rig, in metres. `folder` (or folder/FaceXModel) holds generic_neutral_mesh.obj,
// vertex_indices.json and either ict_shapes_i16.npz (names, scale, delta: vertex = neutral + sum of
// weight * scale * delta) or the original OBJ files, one per shape (<expression>.obj and
// identity000.obj, ... at least one, the first 20 are used).
//
// What is made of it:
// - Kept: face, head and neck, mouth and eye sockets, gums and tongue, teeth, the outer shells of
//   the eyeballs (sclera and cornea, over the inner iris ball, which nothing opaque ever shows).
//   Left out: lacrimal fluid, eye blend and occlusion, lashes.
// - Parts "skin", "eye_left", "eye_right", "teeth", "mouth" (gums, tongue, sockets); left is the
//   subject's, +x.
// - Decimated to FLAME's triangle size (geometry/decimate.h) so that surfels fit their triangles;
//   finer at lids and lips. All 68 landmark vertices stay.
// - One atlas without overlaps, most of it the face.
// - Joints root, neck, eye_left, eye_right with smooth weights of our own. No jaw joint: the jaw
//   moves by jawOpen, jawLeft, jawRight, jawForward. Eyeballs turn by their joints; eyeLook* move
//   only the lids.
// - 20 identity modes, 53 expressions in 0..1, 68 MultiPIE landmarks, and the MediaPipe points
//   (rig/embedding.h) by the geometry file found in `models` (rig/canonical_face.h), or, when there
//   is none, only those that correspond to one of the 68.
//
// Takes 1-3 seconds. Throws Error naming the file for anything missing, damaged or of another
// topology.
Rig load_ict(const Path& folder, const Path& models);

}  // namespace effigy
