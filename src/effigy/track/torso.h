// Motion of the torso in the picture, which no face landmark tells: without it the shoulders hang
// on the head. Private to track/.
#pragma once

#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/image/image.h"
#include "effigy/track/face.h"
#include "effigy/track/matte.h"

namespace effigy {

struct TorsoMotion {
  bool found = false;
  PlaneSimilarity here_from_start;  // pixels of the first frame that shows the torso to this one's
};

// Aligns what lies below the chin to how it looked at first: inverse compositional Lucas-Kanade
// (Baker and Matthews 2004) for a similarity, gain and offset, from coarse to fine, with Tukey's
// weights against hair, hands and the neck that turns. Always against the first view, so that
// nothing drifts.
class TorsoFollower {
 public:
  // `segmenter` tells person from background in the first view; without one (nullptr) all of the
  // picture below the chin counts. Kept by reference.
  explicit TorsoFollower(PersonSegmenter* segmenter) : segmenter_(segmenter) {}
  // Call with consecutive frames of one size.
  TorsoMotion follow(const Image8& picture, const FaceObservation& face);

 private:
  // One level of detail: chosen pixels of the first view with their derivatives.
  struct Level {
    double sigma = 0;  // blur in working pixels
    std::vector<float> x, y, value, weight;
    std::vector<float> along[4];  // change of value with each parameter of the similarity
  };
  void begin(const Image8& picture, const FaceObservation& face);
  Image window(const Image8& picture) const;
  bool align(const Level& level, const Image& image, int steps, PlaneSimilarity& motion) const;

  PersonSegmenter* segmenter_;
  // The part of the picture that is looked at, and working pixels per pixel of the picture.
  double left_ = 0, top_ = 0, width_ = 0, height_ = 0, scale_ = 1;
  int columns_ = 0, rows_ = 0;
  Vec2d center_ = Vec2d::Zero();  // working pixels
  std::vector<Level> levels_;     // coarse to fine; empty before the torso was seen
  PlaneSimilarity last_;          // working pixels about center_
};

}  // namespace effigy
