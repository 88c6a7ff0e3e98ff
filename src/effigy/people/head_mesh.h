// The built-in head's mesh: topology, rest positions, atlas and, for every vertex, what it is, so
// that expressions, weights and paint can be written as rules.
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy::people {

enum class Region : uint8_t {
  kSkin,         // free skin between the rings
  kEyeRing,      // loops around an eye opening; ring 0 = lid rim, 3 = crease, 6 = outermost,
                 // < 0 inside
  kMouthRing,    // loops around the mouth; ring 0 = line of the lips, 2 = vermilion border, < 0
                 // inside
  kEarRing,      // loops of an ear; ring 0 = where it leaves the head
  kNostrilRing,  // loops into a nostril; ring 0 = its rim
  kEyeball,
  kUpperTeeth,
  kLowerTeeth,
  kTongue,
};

// Eye rings have kEyeLoop points: 0 = inner corner, over the upper lid to kEyeLoop / 2 = outer
// corner, back along the lower lid. Mouth rings, per half: 0 = middle above, kLipCorner = corner,
// 2 kLipCorner = middle below.
inline constexpr int kEyeLoop = 24, kLipCorner = 7, kEarLoop = 28, kNostrilLoop = 10;
inline constexpr int kEyeRings = 7, kMouthRings = 5;

struct HeadVertex {
  Vec3d p = Vec3d::Zero();  // rest, millimetres
  Region region = Region::kSkin;
  int side = 1;    // +1 subject's left (x > 0), -1 right, 0 on the mirror plane
  int ring = 0;    // of its region
  int index = 0;   // place in the ring (right half: that of its mirror vertex)
  int mirror = 0;  // the vertex across the mirror plane
};

struct HeadMesh {
  Mesh mesh;  // metres; parts skin, eye_left, eye_right, teeth, mouth
  std::vector<HeadVertex> vertices;
  std::vector<int> neck_ring;  // in order, starting in front, towards the subject's left
  // The vertex of a ring on a side; -1 when there is none.
  int find(Region region, int ring, int index, int side) const;
};

// Deterministic; about a second.
HeadMesh build_head_mesh();
// The same, built once.
const HeadMesh& shared_head_mesh();

}  // namespace effigy::people
