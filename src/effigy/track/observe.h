// The first pass over a video: landmarks of every frame. Private to track/.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "effigy/infer/models.h"
#include "effigy/track/fit.h"
#include "effigy/track/track.h"

namespace effigy {

struct VideoObservation {
  int width = 0, height = 0;
  double frames_per_second = 0;
  std::vector<double> seconds;          // of each frame
  std::vector<FaceObservation> frames;  // landmarks smoothed over time
  FitViews views;                       // torso and look of each frame
  int landmark_count = 0, most_faces = 0;
  int tracked() const;
};

// Throws Error when there are too few frames with a face, and, unless options.tolerant, when the
// picture shows several people or the face is away for long. `each_frame` is called after every
// frame; what it throws ends the pass.
VideoObservation observe_video(const Path& video, const ModelSet& models,
                               const TrackOptions& options,
                               const std::function<void()>& each_frame = {});

// The checks alone.
void check_observation(const VideoObservation& seen, const std::string& video, bool tolerant);

}  // namespace effigy
