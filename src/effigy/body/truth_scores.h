// A body avatar's surface beside a synthetic capture's truth (capture/truth_scores.h).
#pragma once

#include <optional>

#include "effigy/body/evaluate.h"
#include "effigy/capture/truth_scores.h"

namespace effigy {

// What `viewer` drew last: albedo as it is splatted, normals of the deferred shading, blended
// depth. The lobe's width s (radians, about the mirrored direction) is compared as the roughness
// sqrt(s): near its peak a GGX lobe of alpha = roughness^2 falls off as exp(-theta^2 / (2
// alpha^2)).
SurfaceImages drawn_surface(const BodyViewer& viewer);

// The truth of that picture; empty where the capture lacks one of the layers. Throws Error naming a
// damaged file.
std::optional<SurfaceImages> true_surface(const StageCapture& capture, const StageView& view);

// Both compared; empty without truth.
std::optional<SurfaceScores> score_surface(const BodyViewer& viewer, const StageCapture& capture);

}  // namespace effigy
