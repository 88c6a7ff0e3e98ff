// Faces in pictures: detection, dense landmarks, blendshape scores, and following one face through
// a video. Networks and their pre- and post-processing are MediaPipe's (BlazeFace short range, Face
// Mesh, Blendshape V2).
#pragma once

#include <algorithm>
#include <optional>
#include <vector>

#include "effigy/image/image.h"
#include "effigy/infer/models.h"
#include "effigy/infer/network.h"

namespace effigy {

// One detected face, in pixels of the frame.
struct FaceBox {
  double x = 0, y = 0, width = 0, height = 0;
  double score = 0;
  // Right eye, left eye, nose tip, mouth, right ear, left ear (the person's right): x, y.
  double points[6][2] = {};
};

// What the networks say about one frame.
struct FaceObservation {
  bool found = false;
  double presence = 0;           // probability of a face in the crop
  std::vector<float> landmarks;  // 3 a point: x, y in pixels of the frame, z on the same scale
  std::vector<float> scores;     // 52 (mediapipe::kBlendshapeNames) or empty
  int faces = 0;                 // how many were confirmed, when the detector looked (else 0)
};

class FaceDetector {
 public:
  explicit FaceDetector(const ModelSet& models);
  // All faces of the 3-channel frame with a score of at least 0.5, best first. `thorough` also
  // looks into overlapping parts of the frame, for small faces.
  std::vector<FaceBox> detect(const Image8& frame, bool thorough);

 private:
  std::vector<FaceBox> detect_in(const Image8& frame, double x, double y, double side);
  Network network_;
  Array input_;
};

// Follows one face: the largest and most central one at first, afterwards the one where it was.
class FaceTracker {
 public:
  explicit FaceTracker(const ModelSet& models);
  // Call with consecutive frames.
  FaceObservation observe(const Image8& frame);
  // The two parts of observe. Only `locate` needs the frame before; `score` may run on another
  // thread while the next frame is located (one at a time).
  FaceObservation locate(const Image8& frame);
  void score(FaceObservation& observation);

  int landmark_count() const { return landmark_count_; }
  // People in the picture at once: faces of at least a third of the followed one's size that the
  // landmark network confirms, in two looks (the detector looks at every 25th frame).
  int most_faces() const { return crowded_looks_ >= 2 ? most_faces_ : std::min(most_faces_, 1); }

 private:
  // A square turned by `angle` (radians) about its centre.
  struct Region {
    double x = 0, y = 0, side = 0, angle = 0;
  };
  static Region region_of(const FaceBox& box);
  Region region_of(const std::vector<float>& landmarks) const;
  bool measure(const Image8& frame, const Region& region, FaceObservation& observation);
  int count_faces(const Image8& frame, const Region& followed);
  std::optional<FaceBox> choose(const std::vector<FaceBox>& boxes, const Image8& frame) const;

  FaceDetector detector_;
  Network landmarks_;
  std::optional<Network> blendshapes_;
  Array input_;
  int landmark_count_ = 0;
  std::optional<Region> next_;        // where to look in the next frame
  std::optional<Region> last_known_;  // where the face was last
  int frame_ = 0, lost_ = 0, most_faces_ = 0, crowded_looks_ = 0;
};

// Weighted non-maximum suppression (BlazeFace): boxes that overlap the best remaining one by more
// than `overlap` (intersection over union) are averaged into it, weighted by their scores.
std::vector<FaceBox> suppress_overlaps(std::vector<FaceBox> boxes, double overlap);

// Zero-phase smoothing over time of observed landmarks, in place: a Gaussian of `sigma` frames
// whose weights fall with the distance that the point moved, so that blinks and syllables stay.
// Never mixes across frames without a face. `scale`: the distance in pixels at which a neighbour
// counts little, e.g. 1.5 % of the face's width.
void smooth_landmarks(std::vector<FaceObservation>& frames, double sigma, double scale);

}  // namespace effigy
