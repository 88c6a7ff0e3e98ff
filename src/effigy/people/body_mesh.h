// The built-in body's mesh: the form's surface in even triangles, sewn to the head at the neck,
// with parts and one atlas.
#pragma once

#include <vector>

#include "effigy/geometry/mesh.h"
#include "effigy/people/body_shape.h"
#include "effigy/rig/rig.h"

namespace effigy::people {

// Indices into BodyMesh::mesh.parts.
enum BodyPart {
  kFace,  // the head's skin
  kEyeLeft,
  kEyeRight,
  kTeeth,
  kMouth,
  kSkin,
  kHands,
  kTop,
  kBottom,
  kShoes,
  kHair,
  kBodyParts
};

struct BodyMesh {
  Mesh mesh;  // metres; the head's vertices come first, in the head's order
  int head_vertices = 0;
  int head_triangles = 0;  // the head's triangles come first
  std::vector<Vec2f>
      head_uvs;  // per UV vertex: where it is in the head's own atlas; (-1, -1) if not
};

// Where the head stands in the body's frame, millimetres, and its neck ring there.
Vec3d head_offset(const BodyBuild& build);
NeckRing neck_ring(const Rig& head, const Vec3d& offset);

// Moves the ring and the neck above it up to where the shoulders of `form`, made with the ring as
// it is, meet the neck.
void raise_neck(Rig& head, const Vec3d& offset, const BodyForm& form);

// Deterministic; a few seconds. Throws Error when the head has no neck ring.
BodyMesh build_body_mesh(const BodyForm& form, const Rig& head, const Vec3d& offset);

}  // namespace effigy::people
