// The user's own head as a rig for captures: cut from a body's skinned mesh, or a head alone.
#pragma once

#include "effigy/people/user_body.h"

namespace effigy {

struct UserHead {
  // Rig of kind "user": metres, facing +z where the skeleton tells; joints root, neck and, where
  // the file has them, jaw, eye_left and eye_right; a joint that is none of these moves with the
  // one above it. Expressions are the morph targets that move the head, under the names of
  // known_expression where they have one, from 0 to 1; no identity modes. Parts: skin, eye_left,
  // eye_right, teeth, mouth, hair, cloth, by weights and materials' names. The landmark embeddings
  // are empty: where the points of a network lie on anybody's mesh is not in the file.
  UserBody look;
  int known_expressions = 0;  // of all expressions those whose names say what they are
  bool cut = false;           // out of a body
};

// A glTF 2.0 file (.gltf, .glb; a head without skin turns as a whole), or a MakeHuman folder with
// its expression targets, eyes, teeth and tongue. A body, whose skeleton has arms or legs, is cut
// where the weights of neck and head fall below three tenths; vertices that an exporter doubled at
// the seams of UVs become one. Throws Error as read_gltf_body does, and when
// the body has no joint for its head or what is left is not of a head's size.
UserHead read_user_head(const Path& path, int texture_size = 1024);

}  // namespace effigy
