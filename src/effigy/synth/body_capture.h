// Captures of a body in a light stage with known answers (docs/synth.md). Interrupted
// ones go on where they ended.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/synth/body_scene.h"
#include "effigy/synth/light_stage.h"

namespace effigy {

struct SynthBodyOptions {
  StageOptions stage;
  uint64_t subject = 1;
  std::string body;                    // the user's own (BodySceneOptions::body); empty: built-in
  std::string motion, unseen_motion;   // BVH files; empty: built-in
  std::string environment = "studio";  // of lighting "environment": a built-in light or a file
  // Lights under which moments of the unseen motion are seen again, and how many moments.
  std::vector<std::string> relight;
  int relight_frames = 2;
  int samples = 64, bounces = 4;
  int texture_size = 1024;
  bool true_mesh = false;  // the mesh handed to training: the true surface, or the tracked one
  bool layers = true;
  bool subsurface = true;  // light spreads below the built-in body's skin (docs/synth.md)
  double tracking_error = 0;
};

// What a capture will be, before it is made.
struct SynthBodyPlan {
  int cameras = 0, test_cameras = 0, lights = 0;
  int frames = 0, train = 0, held_out_lights = 0, unseen = 0, relit = 0, fully_lit = 0;
  int64_t images = 0, samples = 0, bytes = 0;  // bytes: of all files, about
  double seconds = 0;                          // on this machine, from a probe
};
// Renders one small view to know the time.
SynthBodyPlan plan_body_capture(const SynthBodyOptions& options);

struct SynthBodyResult {
  int frames = 0, images = 0, kept = 0;  // kept: images of an earlier, interrupted run
  double seconds = 0;
};
// Writes a stage capture. Until it is whole it stands in FOLDER.partial; the same options go on
// with what is there, others are refused. An existing capture is replaced in the end; any other
// folder that is not empty is refused.
SynthBodyResult synth_body_capture(const SynthBodyOptions& options, const Path& folder);

}  // namespace effigy
