// What a body does at one moment, as the networks are told.
#pragma once

#include <vector>

namespace effigy {

struct BodyMoment {
  std::vector<float> vertices;        // 3V, posed, metres, world
  std::vector<float> body_keypoints;  // 3 a keypoint, metres, in the body's root frame
  std::vector<float> face_keypoints;  // in the head's
};

}  // namespace effigy
