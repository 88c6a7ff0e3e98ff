// How near an avatar's materials, normals, geometry and light come to a synthetic capture's truth
// (capture/truth.h), each after the freedom that a single video leaves.
#pragma once

#include <optional>

#include "effigy/avatar/renderer.h"
#include "effigy/capture/truth.h"

namespace effigy {

// Means over the pixels that the true head covers whole and the avatar covers, below.
struct TruthScores {
  double albedo_error = 0;       // absolute sRGB difference, after one scale a frame
  double roughness_error = 0;    // absolute difference
  double specular_error = 0;     // absolute difference of F0
  double normal_degrees = 0;     // angle between normals, both with the normal map
  double depth_error_mm = 0;     // absolute difference along the camera's axis
  double environment_error = 0;  // of the light's irradiance over all directions: L1 of the
                                 // difference over L1 of the truth, after one global scale
  Json to_json() const;
};

// The last score alone, of two cubemaps of one size.
double light_error(const Cubemap& light, const Cubemap& truth);

// `frames`: indices into capture.frames, drawn with the capture's tracked poses. Empty when the
// capture has no layers.
std::optional<TruthScores> score_truth(const HeadAvatar& avatar, const Capture& capture,
                                       const std::vector<int>& frames);

}  // namespace effigy
