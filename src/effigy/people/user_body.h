// The user's own bodies: skinned meshes with textures from glTF files, and MakeHuman's base mesh.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/image/image.h"
#include "effigy/rig/rig.h"

namespace effigy {

struct UserBody {
  Rig rig;          // kind "gltf" or "makehuman"; no expressions; parts are the materials' names
  Image albedo;     // 3, linear, in the rig's own new atlas; row 0 = top
  Image roughness;  // 1
  Image alpha;      // 1; below 1 on cards such as hair
  Image normal;     // 3, tangent space, unit, OpenGL (not encoded); empty: no normal maps
};

// glTF 2.0, .gltf or .glb: every triangle mesh of the default scene in its rest pose, all skins as
// one skeleton, four weights a vertex; base colours, roughness and normal maps brought into one
// atlas of texture_size x texture_size whose islands do not overlap. Throws Error naming the file
// and what is wrong: no skin, no UVs, an accessor outside its buffer, an index that does not
// exist ...
UserBody read_gltf_body(const Path& path, int texture_size = 1024);

// A MakeHuman folder: 3dobjs/base.obj (group "body"), rigs/default.mhskel and default_weights.mhw;
// without a skin picture (for base.obj's UVs) one of the folder's own is taken whose name has
// "diffuse" in it, else one colour.
UserBody read_makehuman_body(const Path& folder, const Path& skin = {}, int texture_size = 1024);

}  // namespace effigy
