// The second pass over a video: crops, mattes and the frames of the capture. Private to track/.
#pragma once

#include <vector>

#include "effigy/capture/capture.h"
#include "effigy/infer/models.h"
#include "effigy/track/fit.h"
#include "effigy/track/observe.h"

namespace effigy {

// Where in the video's frames the capture's pictures lie, in pixels of the frame.
struct CropBox {
  double x = 0, y = 0, width = 0, height = 0;
  int out_width = 0, out_height = 0;
  double scale() const { return out_width / width; }
};
// One square around the head (with hair, neck and margin) over all frames, or the whole frame.
CropBox choose_crop(const Rig& rig, const FitResult& fit, const VideoObservation& seen,
                    const TrackOptions& options);

// The user's own mattes in the order of their names; throws Error when there are fewer than frames.
std::vector<Path> list_own_mattes(const Path& folder, size_t frames);

// Writes images/cam0 and masks/cam0 into `folder` and fills capture.frames.
void write_frames(const Path& video, const ModelSet& models, const TrackOptions& options,
                  const VideoObservation& seen, const FitResult& fit, const CropBox& crop,
                  const Path& folder, Capture& capture);

}  // namespace effigy
