// FLAME (Li et al., "Learning a model of facial shape and expression from 4D scans", 2017) from the
// user's own model file.
#pragma once

#include "effigy/rig/rig.h"

namespace effigy {

// Where the files stand that FLAME's .pkl does not hold. Each is looked for beside the .pkl, then
// in `folder`, then in $EFFIGY_DATA/face/flame_topology:
//   head_template.obj or head_template_mesh.obj   the UV layout; needed
//   l_eyelid.npy, r_eyelid.npy                    eyelid shapes; become two more expressions
//   mediapipe_landmark_embedding.npz              105 MediaPipe points
//   landmark_embedding_with_eyes.json             68 MultiPIE points
struct FlameAssets {
  Path folder;  // may be empty
};

// FLAME 2020 (generic_model.pkl), 2023 (flame2023.pkl) or 2023 Open (flame2023_Open.pkl), by a
// reader that executes nothing of the file (base/pickle.h). Which one it is, is told by the names
// of file and folder, else by the content; Rig::kind says it ("flame-2020", "flame-2023",
// "flame-2023-open"). Coefficients of one version mean nothing to another.
//
// All 300 identity and 100 expression directions ("expression_001" ...), then "eyelid_left" and
// "eyelid_right" where found; pose basis 36; joints root, neck, jaw and the eyes in FLAME's order,
// named by their side (left is the person's, +x). Teeth and mouth are added (rig/mouth.h).
//
// Throws Error naming the file for anything else: other models (SMPL, MANO, the variant without jaw
// rotation), missing or damaged arrays, a UV layout of another topology.
Rig load_flame(const Path& pkl, const FlameAssets& assets = {});

}  // namespace effigy
