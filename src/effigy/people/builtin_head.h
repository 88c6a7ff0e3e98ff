// The plain built-in head: a closed mesh made by code with UV atlas, neck, jaw and eye joints,
// expression shapes with ARKit names, landmark embeddings and painted materials, so that the
// program is whole without any download.
#pragma once

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
};

// Deterministic. Parts: skin, eye_left, eye_right, teeth, mouth. Joints: root neck jaw eye_left
// eye_right. 52 ARKit expression names (those it has no shape for are left out; at least 10).
Rig builtin_head_rig();
HeadMaterials builtin_head_materials(int size);

}  // namespace effigy
