// Captures: one folder format for real and synthetic recordings (docs/formats.md).
//   capture.json  images/<camera>/<frame>.png  masks/<camera>/<frame>.png
//   tracking.safetensors  rig.safetensors  [albedo/... normals/... ground-truth layers]
#pragma once

#include <map>
#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/base/json.h"
#include "effigy/geometry/types.h"
#include "effigy/image/colour.h"
#include "effigy/image/image.h"
#include "effigy/rig/rig.h"

namespace effigy {

struct CaptureFrame {
  int64_t number = 0;  // original frame number in the source
  double seconds = 0;
  Path image, mask;   // relative to the capture folder
  Path albedo;        // optional prior or ground truth (sRGB), empty when absent
  bool test = false;  // held out
  bool tracked = true;
};

struct Capture {
  Path folder;
  std::string source;  // what it was made from
  std::string licence = "not stated";
  std::string consent = "not stated";
  DisplayTransform display = DisplayTransform::kSrgb;
  double frames_per_second = 25;
  Camera camera;  // one camera (heads); camera_from_world fixed
  std::vector<CaptureFrame> frames;
  Rig rig;
  std::vector<float> identity;  // rig identity coefficients
  std::vector<RigPose> poses;   // one per frame
  std::vector<float>
      landmarks;  // [frames][478 or 468][2] pixels in the capture's images; may be empty
  int landmark_count = 0;
  std::vector<float> scores;  // [frames][score_count] expression scores in [0, 1]; may be empty
  int score_count = 0;        // 52 of MediaPipe's network
  Json extra;                 // further fields of capture.json, kept

  std::vector<int> train_frames() const;  // indices into frames, tracked only
  std::vector<int> test_frames() const;
  // 3-channel image; 1-channel mask (255 = head). Throw Error naming the file.
  Image8 load_image(int frame) const;
  Image8 load_mask(int frame) const;
};

// Reads and checks everything but the pixels.
Capture read_capture(const Path& folder);
// Writes capture.json, tracking.safetensors and rig.safetensors into an existing folder that
// already holds the images named by `frames`.
void write_capture(const Capture& capture, const Path& folder);
// Marks the test split: the last quarter of the frames, at most 350 (count < 0), or the last
// `count`.
void split_test_frames(Capture& capture, int count = -1);

}  // namespace effigy
