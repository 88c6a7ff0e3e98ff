// The last stage of the fit: pose and expression so that every point of the skin looks in each
// frame as it does in the others. Private to track/.
#pragma once

#include <vector>

#include "effigy/track/fit_setup.h"
#include "effigy/track/photo.h"

namespace effigy {

class PhotoFit {
 public:
  // Adds points to `model` (identity folded in), behind its landmarks. `photos`: one a frame of the
  // video; kept by reference.
  PhotoFit(const Rig& rig, const std::vector<float>& identity, const FitSetup& setup,
           const std::vector<PhotoWindow>& photos, double focal, const FitOptions& options,
           FitModel& model);

  // Gathers what the points look like over the video, seen from the present `frames` (one for each
  // of setup.tracked()), and makes it part of `targets`.
  void expect(const std::vector<Eigen::VectorXd>& frames, std::vector<FrameTarget>& targets) const;

 private:
  struct Look {
    std::vector<float> value, weight;  // of each point; weight 0: not seen
  };
  Look look(size_t i, const Eigen::VectorXd& frame) const;

  const FitSetup& setup_;
  const std::vector<PhotoWindow>& photos_;
  const FitModel& model_;
  FitOptions options_;
  double focal_;
  int first_;                  // point of the model
  std::vector<Vec3d> normal_;  // rest pose
};

}  // namespace effigy
