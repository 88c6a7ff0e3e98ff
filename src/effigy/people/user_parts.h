// What the importers of the user's bodies share.
#pragma once

#include <string>
#include <vector>

#include "effigy/geometry/mesh.h"
#include "effigy/image/image.h"
#include "effigy/people/user_body.h"

namespace effigy::people {

struct UserMaterial {
  std::string name;
  Vec4f colour = Vec4f(1, 1, 1, 1);  // linear, times the texture
  float roughness = 0.6f;
  Image8 texture;  // sRGB, 3 or 4 channels; may be empty
};

struct UserJoint {
  std::string name;
  int parent = -1;                 // any order; -1: a root
  Vec3d position = Vec3d::Zero();  // metres
};

struct UserSource {
  std::string file;  // for messages
  Mesh mesh;         // metres; triangle_part = material
  std::vector<UserMaterial> materials;
  std::vector<UserJoint> joints;
  // Up to any number of (joint, weight) per vertex; sums need not be 1.
  std::vector<std::vector<std::pair<int, float>>> weights;
};

// Sorts the joints, fills the rig, packs the atlas and brings the pictures into it.
UserBody finish_user_body(UserSource source, const std::string& kind, const std::string& licence,
                          int texture_size);

}  // namespace effigy::people
