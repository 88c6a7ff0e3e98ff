// From a video of one person to a capture: frames, mattes, landmarks, rig parameters, camera.
#pragma once

#include <optional>
#include <string>

#include "effigy/base/file.h"
#include "effigy/base/json.h"

namespace effigy {

struct TrackOptions {
  std::optional<Path> rig;     // else ICT-FaceKit in $EFFIGY_DATA/face, else the built-in head
  std::optional<Path> models;  // infer/models.h
  std::optional<Path> matte;   // a folder of the user's own mattes, one picture a frame, used as is
  bool crop_head = true;       // one fixed square around all head motion; else the whole frame
  int size = 512;              // of the square crop, pixels
  int most_frames = 0;         // 0: all
  int test_frames = -1;        // split_test_frames()
  bool tolerant = false;       // go on with several people or long times without a face
  std::string consent = "not stated";
  std::string licence = "not stated";
};

// Writes the capture folder `output` (complete or not at all) with track.json and track.html in it,
// and returns track.json: frames, tracked, rig, networks, landmark_error_median_px,
// heldout_landmark_error_median_px, milliseconds_per_frame, and more. Memory does not grow with the
// pictures of the video. Throws Error for videos without a usable face.
Json track_video(const Path& video, const Path& output, const TrackOptions& options);

}  // namespace effigy
