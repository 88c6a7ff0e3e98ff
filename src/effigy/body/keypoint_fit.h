// Poses of a body from its keypoints in the world.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "effigy/body/driver.h"

namespace effigy {

struct KeypointTrack {
  double frames_per_second = 30;
  size_t frames = 0;
  std::vector<float> body, face;  // [frames][keypoints][3], metres, world
};

// A .safetensors file with the tensors body_keypoints [F, B, 3] and face_keypoints [F, C, 3] in the
// order of the capture that the avatar was trained on, and, if it likes, frames_per_second in its
// metadata. Nothing when the file holds a rig's poses or no keypoints. Throws Error when counts
// differ from the driver's or a number is not finite.
std::optional<KeypointTrack> read_keypoint_track(const Path& path, const BodyDriver& driver);

// The pose of every frame: Levenberg-Marquardt over joint rotations, expression and translation,
// warm from the frame before; what keypoints leave open stays as it was there. `left_mean`: the
// mean distance that is left between keypoints, metres. `progress` is called after each frame.
std::vector<RigPose> fit_keypoints(const BodyDriver& driver, const Rig& rig,
                                   const KeypointTrack& track, double& left_mean,
                                   const std::function<void(size_t)>& progress = {});

}  // namespace effigy
