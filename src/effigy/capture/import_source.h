// What an importer of stage recordings tells about its source. Metres, but in the source's own
// world (import_stage turns it upright).
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "effigy/capture/import_stage.h"
#include "effigy/capture/stage_capture.h"

namespace effigy {

inline constexpr const char* kEvenLight = "lights/even.exr";

// The tracked person at one time.
struct ImportedMoment {
  std::vector<float> vertices;   // 3V
  std::vector<float> keypoints;  // 3K, or empty where the source has none
  // Root frame of the head, world from its own space, 3 x 4 row-major. Without it: the rigid motion
  // of the mesh from the template.
  std::optional<std::array<float, 12>> root;
};

struct ImportedView {
  Image8 image;  // 3 channels, sRGB, on black (or background)
  Image8 mask;   // 1 channel
};

struct ImportedStage {
  // Set: source, licence, frames_per_second, cameras (of the full images), lights, frames and
  // rig.mesh (the template with texture coordinates).
  StageCapture capture;
  std::vector<std::string> keypoint_names;  // empty: points of the mesh stand in
  // Intensities are irradiance at the stage's centre (as light stages tell them) instead of at one
  // metre.
  bool lights_at_center = false;
  // No light is known but that it comes from everywhere: all frames name kEvenLight.
  bool lit_evenly = false;
  std::string up = "y";
  // Frames known to be incomplete before any was read.
  int frames_left_out = 0;
  std::string first_problem;

  // Throws Error for a frame that has to be left out.
  std::function<ImportedMoment(int frame)> moment;
  // Reader of a camera's views, used by one thread; throws Error for a view that is missing or
  // damaged.
  std::function<std::function<ImportedView(int frame)>(int camera)> open;
  // What is behind the body in a camera's fully lit pictures, which then are not put on black; an
  // image without pixels where there is no photograph of it. May be empty: none has one.
  std::function<Image8(int camera)> background;
};

ImportedStage open_goliath(const Path& source, const StageImportOptions& options);
ImportedStage open_humanolat(const Path& source, const StageImportOptions& options);
ImportedStage open_transforms(const Path& source, const StageImportOptions& options);

// For importers.

// The mesh of --mesh, or of `fallback` (empty: none); throws Error when it has no texture
// coordinates or there is none. `lacking`: the sentence that says so.
Mesh imported_mesh(const StageImportOptions& options, const Path& fallback,
                   const std::string& lacking);
// Holds out every fifth camera and every tenth of the frames to train on that lights are named of.
void hold_out(StageCapture& capture);
// A rotation as near as floats come to `m`; throws Error beginning with `name` when m is none.
Mat3d checked_rotation(const Mat3d& m, const std::string& name);
// Numbers separated by white space or commas. Throws Error naming `name` for anything else.
std::vector<double> parse_table(const std::string& text, const std::string& name);
// Black where the mask is, in the image's encoding.
void put_on_black(const Image8& mask, Image8& image);

}  // namespace effigy
