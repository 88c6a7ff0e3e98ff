// How near an avatar's materials, normals, geometry and light come to a synthetic capture's truth
// (capture/truth.h), each after the freedom that a single video leaves.
#pragma once

#include <optional>

#include "effigy/avatar/renderer.h"
#include "effigy/capture/truth.h"
#include "effigy/capture/truth_scores.h"

namespace effigy {

struct TruthScores {
  SurfaceScores surface;
  double environment_error = 0;  // of the light's irradiance over all directions: L1 of the
                                 // difference over L1 of the truth, after one global scale
  Json to_json() const;          // all in one object
};

// The last score alone, of two cubemaps of one size.
double light_error(const Cubemap& light, const Cubemap& truth);

// `frames`: indices into capture.frames, drawn in the poses of the protocol `tracked`. Empty when
// the capture has no layers.
std::optional<TruthScores> score_truth(const HeadAvatar& avatar, const Capture& capture,
                                       const std::vector<int>& frames);

}  // namespace effigy
