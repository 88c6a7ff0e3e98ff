// Captures of the built-in head with known answers: true rig parameters, albedo, and the held-out
// frames under other lights.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/geometry/types.h"
#include "effigy/rig/rig.h"

namespace effigy {

struct SynthHeadOptions {
  int frames = 96;
  int size = 384;       // pixels a side
  int supersample = 2;  // rays per pixel a side
  int texture_size = 1024;
  uint64_t seed = 1;                                          // of the performance
  std::string light = "studio";                               // the capture's light
  std::vector<std::string> relight = {"overcast", "sunset"};  // truth of the held-out frames
  int relight_frames = 4;                                     // of the held-out frames, per light
};

// Writes a whole capture folder (docs/formats.md). An existing capture there is replaced; any other
// folder that is not empty is refused.
void synth_head_capture(const SynthHeadOptions& options, const Path& folder);

// The performance: talking, blinks, brows, gaze and head turns, smooth in time; expressions that
// the rig does not have are left out.
RigPose performance_pose(const Rig& rig, double seconds, uint64_t seed);

}  // namespace effigy
