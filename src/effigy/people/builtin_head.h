// The built-in head: a closed mesh made by code with UV atlas, neck, jaw and eye joints, identity
// modes, expression shapes with ARKit names, pose shapes, landmark embeddings and painted
// materials, so that the program is whole without any download (docs/people.md).
#pragma once

#include <cstdint>
#include <string>

#include "effigy/image/image.h"
#include "effigy/rig/rig.h"

namespace effigy {

struct HeadMaterials {
  // size x size, row 0 = top of the image (v = 1).
  Image albedo;     // 3, linear
  Image roughness;  // 1
  Image specular;   // 1, F0
  Image normal;     // 3, tangent space, unit, OpenGL (not encoded)
  Image scatter;    // 1: how far light spreads below the surface, relative to bare skin
};

// The standard subjects are 1 to kStandardSubjects; every other number is somebody at random.
inline constexpr uint64_t kStandardSubjects = 5;

// Deterministic; the same topology, atlas, modes and shapes for every subject, whose own form (hair
// included) is the template. Subject 1 is of average shape. Parts: skin, eye_left, eye_right,
// teeth, mouth. Joints: root neck jaw eye_left eye_right, with pose shapes. 52 ARKit expression
// names with _L and _R.
Rig builtin_head_rig(uint64_t subject = 1);
// All 478 points of MediaPipe's networks (irises from 468 on), for every subject. The rig itself
// carries those that correspond to the 68 landmarks, which no table stands behind.
LandmarkEmbedding builtin_head_network_points();
// Throws Error unless size is 8 .. 8192.
HeadMaterials builtin_head_materials(int size, uint64_t subject = 1);

}  // namespace effigy
