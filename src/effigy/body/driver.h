// Drives a body avatar by the parameters of its rig: which point of the posed rig each keypoint is,
// found from the frames of a capture, so that any pose (a track, a BVH file) gives keypoints.
#pragma once

#include <span>
#include <vector>

#include "effigy/base/safetensors.h"
#include "effigy/body/moment.h"
#include "effigy/capture/stage_capture.h"
#include "effigy/rig/rig.h"

namespace effigy {

// A keypoint follows a joint, or a point of the surface with an offset that a joint turns.
struct KeypointBinding {
  int joint = 0;
  int triangle = -1;  // -1: the joint alone
  Vec3f barycentric = Vec3f::Zero();
  Vec3f rest = Vec3f::Zero();  // joint: position at rest; surface: offset at rest
};

// Where a keypoint is, from posed vertices and joint_transforms().
Vec3f keypoint_position(const KeypointBinding& binding, const std::vector<Vec3i>& triangles,
                        std::span<const float> vertices, std::span<const float> transforms);

class BodyDriver {
 public:
  // Fits bindings over the training frames. Throws Error when the rig has no joints.
  explicit BodyDriver(const StageCapture& capture);
  // From the tensors that save() has written; throws Error when they do not fit the rig.
  BodyDriver(const Rig& rig, const TensorFile& file);
  void save(TensorFile& file) const;

  // Vertices and keypoints of a pose.
  BodyMoment moment(const RigPose& pose) const;
  // Rig and bindings of body and face keypoints, for fitting poses to keypoints.
  const RigShape& shape() const { return shape_; }
  const std::vector<Vec3i>& triangles() const { return triangles_; }
  const std::vector<KeypointBinding>& body() const { return body_; }
  const std::vector<KeypointBinding>& face() const { return face_; }
  // Largest distance between a bound keypoint and the capture's over the frames of the fit, metres.
  double worst() const { return worst_; }

 private:
  void bind(const StageCapture& capture, std::span<const float> all, size_t count,
            const std::vector<int>& frames, std::vector<KeypointBinding>& bindings);
  RigShape shape_;
  std::vector<Vec3i> triangles_;
  int body_root_ = 0, face_root_ = 0;  // joints in whose frames keypoints are given
  std::vector<KeypointBinding> body_, face_;
  double worst_ = 0;
};

}  // namespace effigy
