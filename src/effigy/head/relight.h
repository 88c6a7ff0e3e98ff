// Relighting scores where a synthetic capture holds the truth: its held-out frames under other
// lights.
#pragma once

#include <map>
#include <string>

#include "effigy/avatar/renderer.h"
#include "effigy/capture/capture.h"
#include "effigy/capture/truth_scores.h"

namespace effigy {

// One light of capture.extra["relight"]: NAME -> {"light": file, "images": {frame number: file}}.
struct RelightSet {
  std::string name;
  Path light;                  // inside the capture
  std::map<int, Path> images;  // index into capture.frames -> image inside the capture
};
// Throws Error naming the field when it is malformed. Empty for captures without.
std::vector<RelightSet> relight_sets(const Capture& capture);

// The path in `field` of `json`, which stands in `file`; throws Error unless it stays inside the
// capture.
Path file_inside(const Json& json, const std::string& field, const Path& file);

// In the poses of the protocol `tracked`. The avatar's own light is what `psnr_unlit` leaves it in.
RelightScores score_relight(const HeadAvatar& avatar, const Capture& capture,
                            const RelightSet& set);

}  // namespace effigy
