// Head mattes: person segmentation, steadied over time, sharpened by the picture, cut at the neck.
#pragma once

#include <array>
#include <vector>

#include "effigy/image/image.h"
#include "effigy/infer/models.h"
#include "effigy/infer/network.h"

namespace effigy {

// MediaPipe's selfie segmentation of a picture of any size: 256 x 256 x 1, the probability of a
// person, stretched over the whole picture. Not to be used from two threads at once.
class PersonSegmenter {
 public:
  explicit PersonSegmenter(const ModelSet& models);
  Image segment(const Image8& picture);

 private:
  Network network_;
  Array input_;
};

// A similarity of the plane: (x, y) -> (a x - b y + u, b x + a y + v).
struct PlaneSimilarity {
  double a = 1, b = 0, u = 0, v = 0;
};
// Least squares from points to points (x, y pairs).
PlaneSimilarity fit_similarity(const std::vector<double>& from, const std::vector<double>& to);

// The mean of a coarse matte and its two neighbours in time (weights 1, 2, 1), each neighbour moved
// along with the head: here_from_* map pixels of the neighbour to pixels of `here`, in units of the
// matte. Either neighbour may be null.
Image steady_matte(const Image& here, const Image* before, const PlaneSimilarity& before_from_here,
                   const Image* after, const PlaneSimilarity& after_from_here);

// Guided filter (He et al. 2013) with the colour picture as guide: the coarse matte at the
// picture's size, its edge on the picture's edges. Coefficients are computed at no more than
// `working_side` pixels a side. 1 channel, [0, 1].
Image refine_matte(const Image8& picture, const Image& coarse, int working_side = 256,
                   double radius = 0.02, double epsilon = 2e-4);

// What is kept of a person: the part of `matte` above the projected neck ring, connected with the
// head. All in pixels.
struct HeadRegion {
  std::vector<double> neck_ring;  // x, y pairs in order around the ring; empty: nothing is cut
  double head_x = 0, head_y = 0;  // a point inside the head
  double softness = 10;           // height of the soft edge
};
// 8-bit matte of the head: `matte` times a soft cut below the front of the neck ring, without what
// is not connected with the head.
Image8 head_matte(const Image& matte, const HeadRegion& region);

}  // namespace effigy
