// From what tracking and its networks know of a frame to the parameters that make this avatar look
// like it: the counterpart of the paper's fine-tuned expression encoder (GTAvatar section 4). It
// is trained with the avatar (head/trainer.h) and sees no picture:
//   inputs     x: the tracked parameters, how the networks' landmarks lie beside the rig's (turned
//              into the head's frame), the networks' expression scores
//   code       c = clamp(projection (x - mean), -limit, limit): the main ways in which the training
//              frames differ; the limits keep frames unlike any of them from being led astray
//   correction weights c, added to the tracked parameters
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/capture/capture.h"
#include "effigy/rig/rig.h"

namespace effigy {

struct FrameEncoder {
  int expression_count = 0, joint_count = 0;  // of the rig
  int score_count = 0;                        // 0: no scores
  std::vector<int32_t> landmarks;  // entries of rig.mediapipe that are looked at; may be empty
  std::vector<float> mean;         // D, of the inputs
  std::vector<float> projection;   // [K][D]
  std::vector<float> weights;      // [P][K]; P: expression, joint rotations, translation
  std::vector<float> limit;        // [K] largest size of a code's entries

  size_t pose_size() const;   // P
  size_t input_size() const;  // D
  size_t code_size() const { return input_size() > 0 ? projection.size() / input_size() : 0; }

  // Whether it corrects more than encoded_entries(rig, false).
  bool corrects_head_pose(const Rig& rig) const;
  // D inputs of a frame of `capture`, whose rig must have the encoder's expressions and joints.
  // Landmarks or scores that the capture lacks are as in the mean, so that they say nothing.
  std::vector<float> inputs(const Capture& capture, int frame) const;
  // K entries; `inputs` has D.
  std::vector<float> code(std::span<const float> inputs) const;
  // `pose` with the correction of `code` added.
  RigPose corrected(const RigPose& pose, std::span<const float> code) const;
  // Adds to `d_weights` (as weights) the derivative of a loss whose derivative with respect to the
  // corrected pose, packed as P, is `d_pose`.
  void backward(std::span<const float> code, std::span<const float> d_pose,
                std::span<float> d_weights) const;
};

// Which of a pose's P entries an encoder may correct: expression and jaw, as the paper's; all of
// them with `head_pose`.
std::vector<uint8_t> encoded_entries(const Rig& rig, bool head_pose);

// The poses of `frames` as the encoder corrects the tracked ones.
std::vector<RigPose> encoded_poses(const FrameEncoder& encoder, const Capture& capture,
                                   const std::vector<int>& frames);

// encoder.safetensors of an avatar (docs/formats.md). Reading throws Error naming the file unless
// every array is there, finite, of the sizes that the rig asks for.
void write_frame_encoder(const Path& path, const FrameEncoder& encoder);
FrameEncoder read_frame_encoder(const Path& path, const Rig& rig);

}  // namespace effigy
