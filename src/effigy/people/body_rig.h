// Skeleton and skinning weights of the built-in body.
#pragma once

#include <string>
#include <vector>

#include "effigy/people/body_mesh.h"

namespace effigy::people {

struct BodyBone {
  std::string name;
  int parent = -1;
  Vec3d joint = Vec3d::Zero();  // millimetres
  // The stretches of the body that follow it, and how thick the body is there; none: the head's
  // own joints, whose weights come from the head.
  std::vector<std::pair<Vec3d, Vec3d>> segments;
  double radius = 1;
};

// 62 joints: VRM's humanoid names with _left and _right, and twist joints that share the turning
// of upper arms, forearms and thighs. Joint 0 is "hips".
std::vector<BodyBone> body_bones(const BodyForm& form, const Rig& head, const Vec3d& offset);

// [V][J]: diffusion of "follows the nearest bone" over the surface (bone heat, Baran and Popovic
// 2007); the head keeps its own weights above the neck.
std::vector<float> body_weights(const BodyMesh& body, const Rig& head,
                                const std::vector<BodyBone>& bones);

// [J][V]: each joint from the vertices around it.
std::vector<float> body_regressor(const BodyMesh& body, const Rig& head,
                                  const std::vector<BodyBone>& bones);

// A row of a joint regressor: the nearest vertices' smallest change of equal weights that gives
// `joint` exactly. `row` has one entry per vertex.
void joint_row(const Mesh& mesh, const Vec3d& joint, float* row);

}  // namespace effigy::people
