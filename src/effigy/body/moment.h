// What a body does at one moment, as the networks are told.
#pragma once

#include <vector>

#include "effigy/geometry/types.h"

namespace effigy {

struct BodyMoment {
  std::vector<float> vertices;        // 3V, posed, metres, world
  std::vector<float> body_keypoints;  // 3 a keypoint, metres, in the body's root frame
  std::vector<float> face_keypoints;  // in the head's
  // The body's root frame: world from rest pose.
  Mat3f world_from_root = Mat3f::Identity();
  Vec3f root = Vec3f::Zero();
};

}  // namespace effigy
