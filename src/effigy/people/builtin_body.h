// The built-in body: a clothed person made by code, for captures of known answers. One closed mesh
// with hands, shoes and the built-in head, one UV atlas, a skeleton with fingers, painted
// materials, keypoints, and cloth that wrinkles with a lag which the rig (the "tracked mesh") does
// not show. Metres, y up, face +z, standing on y = 0; rest pose with the arms 45 degrees down.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "effigy/image/image.h"
#include "effigy/rig/rig.h"

namespace effigy {

namespace people {
struct BodyModel;
}

// What a place of the surface is; stored in label images.
enum class BodyLabel : uint8_t {
  kNone,
  kSkin,
  kHair,
  kEyes,
  kTeeth,
  kMouth,
  kHands,
  kCloth,
  kShoes
};

struct BuiltinBody {
  uint64_t subject = 1;
  // kind "builtin-body". Parts: face, eye_left, eye_right, teeth, mouth, skin, hands, top, bottom,
  // shoes, hair. Expressions: the head's, by the same names, then the shapes that
  // drive_body_helpers() sets. Joints: 0 "hips", then VRM's humanoid names with _left and _right
  // and the twist joints "upper_arm_twist_*", "lower_arm_twist_*", "upper_leg_twist_*".
  // rig.multipie are the 68 face landmarks.
  Rig rig;
  RigShape shape;            // shape_rig(rig, {})
  int head_vertices = 0;     // the head's vertices are the first
  int face_expressions = 0;  // the head's expressions are the first
  std::shared_ptr<const people::BodyModel> model;
};

// Deterministic by subject: form, skin, hair and clothes. Subjects 1 to 5 are the standard ones, of
// which 1, 2 and 3 are scored. Seconds; made once per subject and process.
const BuiltinBody& builtin_body(uint64_t subject = 1);

struct BodyMaterials {
  // size x size, row 0 = top of the image (v = 1).
  Image albedo;                 // 3, linear
  Image roughness;              // 1
  Image specular;               // 1, F0
  Image normal;                 // 3, tangent space, unit, OpenGL (not encoded)
  Image scatter;                // 1: how far light spreads below the surface, relative to bare skin
  std::vector<uint8_t> labels;  // size * size BodyLabel, kNone outside the islands
};
// Throws Error unless size is 32 .. 8192.
BodyMaterials builtin_body_materials(const BuiltinBody& body, int size);

// Label of each part of rig.mesh.parts.
BodyLabel body_part_label(const std::string& part);

// Sets the twist joints and the head's pose shapes from the other joints. Call it last when making
// a pose; poses of body motions have it done.
void drive_body_helpers(const BuiltinBody& body, RigPose& pose);

// Names and positions (3 per keypoint, metres, world) in one pose. Body: every joint but the twist
// joints and the face's, then the finger tips, the tips of toes and the heels. Face: the 68
// landmarks and the eyes.
struct BodyKeypoints {
  std::vector<float> body, face;
};
std::vector<std::string> body_keypoint_names(const BuiltinBody& body);
BodyKeypoints body_keypoints(const BuiltinBody& body, const RigPose& pose);
// Joints in whose frames the body paper expresses keypoints: "hips" and "head".
struct BodyFrames {
  int body = 0, face = 0;
};
BodyFrames body_frames(const BuiltinBody& body);

// The true surface over time: the tracked mesh plus wrinkles and the swing of loose cloth. Wrinkles
// stand where the tracked mesh is compressed against its rest shape, across the direction of
// compression, and follow it with a lag; at rest there are none.
class BodyCloth {
 public:
  explicit BodyCloth(const BuiltinBody& body);
  // As if the pose had been held for long.
  void settle(const RigPose& pose);
  // `seconds` after the pose before; the first call settles.
  void advance(const RigPose& pose, double seconds);

  const std::vector<float>& tracked() const { return tracked_; }    // 3V
  const std::vector<float>& vertices() const { return vertices_; }  // 3V, the truth
  // Metres along the normal, V: the wrinkles alone.
  const std::vector<float>& wrinkles() const { return wrinkles_; }

 private:
  void pose_tracked(const RigPose& pose);
  void compress(std::vector<float>& wanted) const;
  void swing(double seconds);
  void displace();

  const BuiltinBody& body_;
  bool started_ = false;
  std::vector<float> tracked_, before_, vertices_, wrinkles_;
  std::vector<float> fold_;                           // [V][directions], filtered compression
  std::vector<float> speed_, offset_, offset_speed_;  // 3V
};

}  // namespace effigy
