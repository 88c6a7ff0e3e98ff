// Light-stage recordings of others become stage captures (docs/body-data.md says what each kind of
// source must hold).
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

struct StageImportOptions {
  // OBJ with texture coordinates: the tracked mesh, or (Goliath, whose meshes come without) its
  // triangles and texture coordinates.
  Path mesh;
  // Axis of the source's world that points up: x, y, z, -x, -y or -z; empty: the kind's usual one.
  std::string up;
  double scale = 1.0;  // images are shrunk by this factor, in (0, 1]
  // Factor on the source's light intensities; 0: so that surfaces come out with a mean albedo of
  // kImportedAlbedo, for sources without a unit of light.
  double light_scale = 0.0;
  std::vector<std::string> cameras;  // by name; empty: all
  int every = 1;                     // of the frames every n-th
  int frames = 0;                    // and at most so many, evenly spread; 0: all
  std::string consent;               // what the person agreed to, for the record
};
inline constexpr double kImportedAlbedo = 0.4;

struct StageImportReport {
  int cameras = 0, frames = 0;  // imported
  size_t views = 0;
  // Left out: frames without tracking, light or picture; views whose picture or matte is missing or
  // damaged.
  int frames_left_out = 0;
  size_t views_left_out = 0;
  std::string first_problem;  // of those
  double light_scale = 1.0;
};

// "goliath", "humanolat", "transforms".
const std::vector<std::string>& stage_import_kinds();

// Reads the source, writes a stage capture. Partial frames are left out and counted; more than half
// of the views missing is an error. Throws Error naming the file, what is wrong or lacking and the
// option that supplies it; nothing is left under the final name then.
StageImportReport import_stage(const std::string& kind, const Path& source,
                               const StageImportOptions& options, const Path& output);

}  // namespace effigy
