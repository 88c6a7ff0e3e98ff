// What the fit knows before it starts: points, weights, priors, first guesses. Private to track/.
#pragma once

#include <vector>

#include "effigy/track/fit.h"
#include "effigy/track/fit_cost.h"

namespace effigy {

class FitSetup {
 public:
  FitSetup(const Rig& rig, const std::vector<FaceObservation>& frames, int width, int height,
           const FitOptions& options);

  const FitModel& model() const { return model_; }            // points of the fit
  const FitModel& all_points() const { return all_points_; }  // all points of rig.mediapipe
  double typical_focal() const { return typical_focal_; }
  double pixel_sigma() const { return pixel_sigma_; }  // of a landmark
  int neck() const { return neck_; }                   // joint that turns the head; 0: the root
  const Vec3d& torso() const { return torso_; }        // the root's rotation, median of the video
  Vec2d center() const { return {center_x_, center_y_}; }       // principal point
  const std::vector<int>& tracked() const { return tracked_; }  // frames with a face
  const std::vector<bool>& inner() const { return inner_; }     // per entry of rig.mediapipe
  const std::vector<bool>& held_out() const { return held_out_; }

  // Share of options.point_sigma by which a point of model() may lie elsewhere on this person. Lips
  // and lids hardly: the mean expression would go there. Irises not.
  double freedom(int point) const;
  // Everything about frame f but the temporal prior. `rotation`: rough head rotation, for
  // visibility.
  FrameTarget target(int f) const;
  // Similarity of the network's 3D points to the rig's neutral points: pose and expression guess.
  // `model` has its identity folded in (or is at identity zero).
  Eigen::VectorXd first_guess(int f, const FitModel& model, double focal) const;
  // Spread over time and over poses and expressions.
  std::vector<int> choose_key_frames(int count) const;
  // Pixels of the frame from the principal point.
  Vec2d seen(int f, int network_point) const;
  RigPose pose_of(const Eigen::VectorXd& frame) const;
  // 1 / sigma of each frame parameter towards the mean of its neighbours in time.
  Eigen::VectorXd smoothness() const;

 private:
  Mat3d similarity(int f, const FitModel& model, double* scale, Vec3d* model_center,
                   Vec3d* seen_center) const;

  const Rig& rig_;
  const std::vector<FaceObservation>& frames_;
  FitOptions options_;
  double center_x_, center_y_, typical_focal_ = 1, pixel_sigma_ = 1;
  int neck_ = 0;                 // joint that turns the head; 0 when the rig has only a root
  Vec3d torso_ = Vec3d::Zero();  // rotation of the root, median over the video
  std::vector<int> tracked_;
  std::vector<bool> inner_, held_out_;
  std::vector<int> used_;           // entries of rig.mediapipe in the fit
  std::vector<double> importance_;  // per used point
  std::vector<Vec3d> normal_;       // per used point, rest pose
  FitModel model_, all_points_;
};

}  // namespace effigy
