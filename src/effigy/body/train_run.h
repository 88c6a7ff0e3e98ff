// The whole training run of a body avatar.
#pragma once

#include <string>

#include "effigy/body/losses.h"
#include "effigy/body/train_settings.h"
#include "effigy/capture/stage_capture.h"
#include "effigy/learn/ranks.h"

namespace effigy {

struct BodyTrainOptions {
  bool resume = false;
  std::string consent;         // overrides the capture's statement when not empty
  PictureDistance perceptual;  // the network that settings.perceptual names
};

// Trains (or resumes), with checkpoints in OUT/checkpoint.safetensors, and writes the avatar folder
// with training.json. Returns training.json. Many processes call it alike; `out` is the same folder
// for all, into which the first one writes; the others get an empty result.
Json train_body(const StageCapture& capture, const BodyTrainSettings& settings, const Path& out,
                const BodyTrainOptions& options, Ranks& ranks = one_process());

}  // namespace effigy
