// What moves on the built-in head: expression shapes, identity modes, jaw weights. All are rules on
// HeadVertex, in millimetres; one side is written down, the other is its mirror image.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "effigy/people/head_mesh.h"

namespace effigy::people {

struct Shape {
  std::string name;
  std::vector<Vec3d> offsets;  // per vertex
};

// Share of the jaw's motion that a vertex follows, 0..1.
std::vector<double> jaw_weights(const HeadMesh& head);
// The hinge of the jaw on the mirror plane, millimetres.
inline const Vec3d kJawHinge(0, -20, 6);
// Where the neck turns.
inline const Vec3d kNeckJoint(0, -112, -28);

// ARKit's names with _L and _R, ordered as ICT-FaceKit lists them.
std::vector<Shape> expression_shapes(const HeadMesh& head);
// One unit is one standard deviation of adults, roughly.
std::vector<Shape> identity_shapes(const HeadMesh& head);

// Corrections of linear blend skinning, one for each entry of vec(R_j - I) of the joints neck, jaw,
// eye_left, eye_right (rig.h: pose_basis). `weights` per vertex: root, neck, jaw.
std::vector<std::vector<Vec3d>> pose_shapes(const HeadMesh& head,
                                            const std::vector<std::array<double, 3>>& weights);

// A vertex as rules see it: mirrored so that the side in question is x > 0.
struct Site {
  Vec3d p = Vec3d::Zero();
  const HeadVertex* vertex = nullptr;
  bool same_side = true;  // the vertex belongs to the side in question (or to the mirror plane)
  double jaw = 0;         // jaw_weights
  double lower = 0;       // 0 above the line of the lips, 1 below, smooth beyond the corners
};
std::vector<Site> sites(const HeadMesh& head, int side);

}  // namespace effigy::people
