// The built-in head, or the user's own, as a scene for the path tracer, and the camera that looks
// at it.
#pragma once

#include "effigy/people/builtin_head.h"
#include "effigy/synth/head_capture.h"
#include "effigy/synth/path_tracer.h"

namespace effigy {

class HeadScene {
 public:
  // Throws Error for files of the user's that cannot be used (people/user_head.h).
  explicit HeadScene(const SynthHeadOptions& options);
  const Rig& rig() const { return rig_; }
  const Camera& camera() const { return camera_; }
  TraceScene& scene() { return scene_; }
  // The performance in front of the camera: the head's middle comes to rest on its axis.
  RigPose performance(double seconds) const;
  // Poses the head and indexes it for rays. Throws Error (naming the frame) when the pose is not
  // finite or puts the camera inside the head.
  void pose(const RigPose& pose, int frame);

 private:
  Rig rig_;
  RigShape shape_;
  Camera camera_;
  TraceScene scene_;
  Vec3f offset_;
  uint64_t seed_;
  std::vector<float> vertices_;
};

}  // namespace effigy
