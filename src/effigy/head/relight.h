// Relighting scores where a synthetic capture holds the truth: its held-out frames under other
// lights.
#pragma once

#include <map>
#include <string>

#include "effigy/avatar/renderer.h"
#include "effigy/capture/capture.h"

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

struct RelightScores {
  double psnr = 0, ssim = 0;
  double psnr_aligned = 0;  // after the one global scale that albedo/light ambiguity leaves free
  double scale = 1;
  double psnr_unlit = 0;  // the same frames left in the training light, scale-aligned
  Json to_json() const;
};
RelightScores score_relight(const HeadAvatar& avatar, const Capture& capture,
                            const RelightSet& set);

}  // namespace effigy
