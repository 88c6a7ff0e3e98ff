// The trainable state of a head avatar: parameters, per-frame rig parameters, and how they start.
#pragma once

#include <optional>
#include <vector>

#include "effigy/avatar/head_avatar.h"
#include "effigy/capture/capture.h"
#include "effigy/head/settings.h"
#include "effigy/learn/texture_losses.h"

namespace effigy {

// Size of the learned environment cubemap (paper: 6 x 32^2).
inline constexpr int kEnvironmentSize = 32;

struct HeadModel {
  BoundSurfels surfels;
  BoundSurfels start;                   // the surfels before training
  RigShape shape;                       // tuned: rest, bases, weights
  RigShape original;                    // as tracked
  TextureParameters material;           // raw texture parameters and their moments
  std::vector<float> environment;       // log radiance, 6 * 32^2 * 3
  std::vector<RigPose> poses;           // per frame of the capture, refined for training frames
  std::optional<FrameEncoder> encoder;  // its correction comes on top of `poses`
};

// Parameters of one pose in one flat array: expression, joint rotations, translation.
size_t pose_size(const Rig& rig);
void pack_pose(const RigPose& pose, std::span<float> flat);
void unpack_pose(std::span<const float> flat, RigPose& pose);

// UV islands of the rig at the texture size, grown by a texel so that bilinear lookups at borders
// stay inside.
UvMask uv_mask(const Mesh& mesh, int size);

// Start of training. Surfels are spread by area, with more on triangles that the training frames
// show.
HeadModel initial_model(const Capture& capture, const TrainSettings& settings);

// Linear radiance from the log parameters (positive before prefiltering, docs/decisions.md).
Cubemap environment_radiance(const std::vector<float>& log_radiance);

}  // namespace effigy
