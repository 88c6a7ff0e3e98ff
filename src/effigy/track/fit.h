// Fitting a rig to the landmarks of a video: one focal length and one identity for all frames, pose
// and expression for each (Ceres).
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/rig/rig.h"
#include "effigy/track/face.h"
#include "effigy/track/photo.h"
#include "effigy/track/torso.h"

namespace effigy {

struct FitOptions {
  int key_frames = 24;  // frames that decide focal length and identity
  // Standard deviations of the model. Distances in the picture are relative to the distance between
  // the outer corners of the eyes.
  double landmark_sigma = 0.012;
  // Of the networks' depths, in landmark_sigma: the picture alone hardly tells a nod from an
  // expression.
  double depth_sigma = 1.5;
  // Of the contrast of a point of the skin (track/photo.h); 0: landmarks alone.
  double photo_sigma = 0.01;
  double photo_landmarks = 0.4;  // landmarks and depths count by so much beside it
  double robust_at = 3.0;        // soft-L1 beyond this many sigmas
  // Radians. The head turns on the neck; the root, which carries the shoulders, hardly turns from
  // its median over the video.
  double torso_sigma = 0.03, neck_sigma = 0.6;
  // Where the torso is seen: its points, relative to landmark_sigma; radians that the root may turn
  // to follow it; metres by which the neck may turn elsewhere than in the rig, sideways and in its
  // plane of symmetry.
  double torso_point_sigma = 0.5, followed_torso_sigma = 0.1;
  double neck_side_sigma = 0.003, neck_shift_sigma = 0.015;
  // Metres that a landmark's point of this person may lie beside the rig's, over the whole video.
  double point_sigma = 0.003;
  double expression_sigma = 0.25;  // of its range, about the network's score (0 without one)
  double distance = 1.0;          // metres from camera to face, typically: decides the focal length
  double log_focal_sigma = 0.05;  // about the focal length that belongs to that distance
  double smooth_translation = 0.0015, smooth_depth = 0.004;  // metres, to the neighbours' mean
  double smooth_rotation = 0.006;                            // radians
  double smooth_expression = 0.12;                           // of the range
  bool hold_out = true;  // every fifth landmark stays unseen, for an honest error
};

// What is seen beside the landmarks; each one a frame, or empty.
struct FitViews {
  std::vector<TorsoMotion> torso;
  std::vector<PhotoWindow> photos;
};

struct FitResult {
  double focal = 0;                  // pixels of the frame; the principal point is its centre
  std::vector<float> identity;       // rig.identity_count
  std::vector<RigPose> poses;        // one a frame; untracked frames repeat their nearest neighbour
  Vec3d neck_shift = Vec3d::Zero();  // the joint "neck" of the rest pose has to be moved by it
  // Per frame, pixels of the frame, -1 when untracked: mean distance between network and projected
  // rig over the inner 51 of the 68 landmarks, and over the landmarks that were kept out of the
  // fit.
  std::vector<double> error, heldout_error;
  std::vector<int> key_frames;
  int heldout_points = 0;
};

// The camera of the fit: at the origin, looking along -z of the world (y up).
Camera fit_camera(double focal, int width, int height);

// `width`, `height`: of the frames in which the landmarks were seen. Landmarks of frames with
// found == false are not used. `torso`: one a frame, or empty. Throws Error when no frame has a
// face or the rig has fewer than 12 landmark points.
FitResult fit_rig(const Rig& rig, const std::vector<FaceObservation>& frames, const FitViews& views,
                  int width, int height, const FitOptions& options);

// The network's scores as a starting guess for a rig's expression: matched by ARKit name ("_L" and
// "_R" endings count as Left and Right; unsided scores serve both sides). 0 where nothing matches.
// `matched[e]` tells which did, when not null.
std::vector<float> expression_from_scores(const Rig& rig, const std::vector<float>& scores,
                                          std::vector<bool>* matched = nullptr);

}  // namespace effigy
