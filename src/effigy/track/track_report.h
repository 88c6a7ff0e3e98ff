// track.html: how well the rig follows the video. Private to track/.
#pragma once

#include "effigy/capture/capture.h"
#include "effigy/track/fit.h"

namespace effigy {

// `to_512`: factor from pixels of the video to pixels of a 512-pixel frame. Reads the pictures
// of `capture` from `folder`.
void write_track_report(const Capture& capture, const FitResult& fit, double to_512,
                        const Json& summary, const Path& folder);

}  // namespace effigy
