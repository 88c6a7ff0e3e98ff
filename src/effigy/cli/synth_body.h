// effigy synth body: a light stage with known answers.
#pragma once

#include <optional>

#include "effigy/cli/command_line.h"
#include "effigy/synth/body_capture.h"

namespace effigy {

// The command's options as they are given; the preset's values stand where none is.
struct BodyCommand {
  SynthBodyOptions options;
  std::string output, stage = "small", lighting = "mixed", mesh = "tracked", light_file, framing,
                      light_up = "auto";
  std::optional<int> cameras, lights, frames, unseen_frames;
  std::optional<double> radius, frames_per_second;
  std::vector<int> size;
  bool no_layers = false, no_subsurface = false, plan = false;
};
void add_synth_body(CLI::App& app, BodyCommand& command);
int synth_body(BodyCommand& command, const CommonOptions& common);

}  // namespace effigy
