// A body as a scene for the path tracer: its motions, the true surface over time, and what a
// tracker would have seen of it. The built-in body, or one of the user's own.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "effigy/people/body_motion.h"
#include "effigy/synth/path_tracer.h"

namespace effigy {

struct BodySceneOptions {
  uint64_t subject = 1;
  // A skinned glTF file or a MakeHuman folder of the user's instead of the built-in body; empty:
  // none. Without a motion it sways; it has no cloth of its own, and its keypoints are its joints.
  std::string body;
  int texture_size = 1024;
  double frames_per_second = 10;
  int frames = 1, unseen_frames = 0;  // of the training motion, then of unseen motion
  // BVH files of the user's instead of the built-in motions; empty: none. The body stays where the
  // stage's middle is.
  std::string motion, unseen_motion;
  uint64_t seed = 1;
  double tracking_error = 0;  // synth/tracking_error.h
  bool subsurface = true;     // light spreads below the built-in body's skin
};

class BodyScene {
 public:
  // Throws Error for broken files, for BVH files that are shorter than asked for or have no known
  // limbs, and for bodies that are not of a person's size.
  explicit BodyScene(const BodySceneOptions& options);

  const Rig& rig() const { return rig_; }
  TraceScene& scene() { return scene_; }
  const std::vector<RigPose>& true_poses() const { return poses_; }
  const std::vector<RigPose>& tracked_poses() const { return tracked_; }
  // Where the surface comes in all frames, metres, to a centimetre; the swing of cloth left out.
  std::vector<Vec3f> reach() const;

  // Throws Error naming the frame and the camera when one is inside the body. The swing of cloth is
  // left out; trace_image sees it.
  void check_outside(const std::vector<StageCamera>& cameras);

  // Goes on to the next frame: moves the cloth and poses nothing yet. Frames come in order.
  void advance();
  // The true surface of the frame, 3V: with wrinkles and swinging cloth.
  const std::vector<float>& truth() const { return cloth_ ? cloth_->vertices() : truth_; }
  // What the tracked parameters say, 3V: skinning without wrinkles.
  const std::vector<float>& tracked() const { return tracked_vertices_; }
  // Puts a surface before the rays. Throws Error naming the frame when it is not finite.
  void show(const std::vector<float>& vertices);

  std::vector<std::string> body_keypoint_names() const;
  std::vector<std::string> face_keypoint_names() const;
  BodyKeypoints keypoints() const;  // of the tracked pose
  // World from rest pose of the joints in whose frames keypoints are expressed: body, face.
  std::array<std::array<float, 12>, 2> root_frames() const;

  // Names of label k at [k - 1], and the label of a point of the surface (0: none).
  std::vector<std::string> label_names() const;
  uint8_t label(const Vec2f& uv, int part) const;

 private:
  void load_builtin();
  void load_users_own();
  std::vector<RigPose> motion_of(const std::string& file, bool unseen, int frames) const;
  void add_motion(const std::vector<RigPose>& motion, int frames);

  BodySceneOptions options_;
  const BuiltinBody* builtin_ = nullptr;  // null: the user's own
  Rig rig_;
  RigShape shape_;
  std::array<float, 3> place_{};  // brings the user's own to the middle of the stage
  int substeps_;                  // of the cloth, a frame
  std::vector<RigPose> steps_, poses_, tracked_;
  std::vector<char> starts_;  // per step: the cloth settles here
  std::optional<BodyCloth> cloth_;
  std::vector<float> tracked_vertices_, truth_;
  std::vector<uint8_t> labels_;
  int label_size_ = 0, frame_ = -1;
  TraceScene scene_;
};

}  // namespace effigy
