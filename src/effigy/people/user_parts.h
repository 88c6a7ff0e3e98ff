// What the importers of the user's bodies and heads share.
#pragma once

#include <string>
#include <vector>

#include "effigy/geometry/mesh.h"
#include "effigy/people/user_body.h"

namespace effigy::people {

struct UserMaterial {
  std::string name;
  Vec4f colour = Vec4f(1, 1, 1, 1);  // linear, times the texture
  float roughness = 0.6f;            // times the texture's green channel
  float normal_scale = 1;
  bool opaque = false;       // alpha means nothing
  Image8 texture;            // sRGB, 3 or 4 channels; may be empty
  Image8 roughness_texture;  // 3 or 4 channels; may be empty
  Image8 normal_texture;     // 3 or 4 channels, OpenGL; may be empty
};

struct UserJoint {
  std::string name;
  int parent = -1;                 // any order; -1: a root
  Vec3d position = Vec3d::Zero();  // metres
};

struct UserShape {
  std::string name;
  std::vector<float> offsets;  // 3V, metres
};

struct UserSource {
  std::string file;  // for messages
  Mesh mesh;         // metres; triangle_part = material
  std::vector<UserMaterial> materials;
  std::vector<UserJoint> joints;
  // Up to any number of (joint, weight) per vertex; sums need not be 1.
  std::vector<std::vector<std::pair<int, float>>> weights;
  std::vector<UserShape> shapes;
};

// What is in the files, in the rest pose. A head may have no skin; it keeps morph targets, and of
// MakeHuman's mesh eyes, teeth and tongue.
enum class UserKind { kBody, kHead };
UserSource read_gltf(const Path& path, UserKind kind);
UserSource read_makehuman(const Path& folder, const Path& skin, UserKind kind);

// Parents first, one root (added when there are several); weights follow. Throws Error for joints
// that go round in a circle.
void sort_joints(UserSource& source);

// Sorts the joints, fills the rig, packs the atlas and brings the pictures into it.
UserBody finish_user_body(UserSource source, const std::string& kind, const std::string& licence,
                          int texture_size);

// The pictures of all materials in the atlas of body.rig.mesh; `old_uv`: for each of its UV
// vertices the place in the material's own pictures.
void bake_user_maps(const std::vector<UserMaterial>& materials, const std::vector<Vec2f>& old_uv,
                    int size, UserBody& body);

}  // namespace effigy::people
