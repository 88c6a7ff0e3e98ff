// Neck and shoulders: where the neck turns, and the root's rotation in each frame, from the torso's
// motion in the picture. Private to track/.
#pragma once

#include <vector>

#include "effigy/track/fit_setup.h"
#include "effigy/track/torso.h"

namespace effigy {

// Points of the rig's torso and where they belong in each frame.
struct TorsoTargets {
  Vec3d neck_shift = Vec3d::Zero();
  std::vector<Vec3d> anchors;            // rest pose; empty when the torso tells nothing
  std::vector<std::vector<Vec2d>> seen;  // [frame of frames][anchor], pixels from the principal
                                         // point; empty where the torso was not seen
};

// `frames[i]` is the solution of frame setup.tracked()[i] by the landmarks alone, for `model` (with
// its identity folded in). The head stays where it is; the neck joint moves by one shift for the
// whole video and the root turns in each frame, so that the torso moves as it was seen to: `model`,
// `frames` become that. `ring`: rest positions of the rig's neck ring.
TorsoTargets follow_torso(const FitSetup& setup, const std::vector<TorsoMotion>& torso,
                          const std::vector<Vec3d>& ring, double focal, const FitOptions& options,
                          FitModel& model, std::vector<Eigen::VectorXd>& frames);

}  // namespace effigy
