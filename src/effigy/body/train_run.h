// The whole training run of a body avatar.
#pragma once

#include <string>

#include "effigy/body/losses.h"
#include "effigy/body/train_settings.h"
#include "effigy/capture/stage_capture.h"

namespace effigy {

struct BodyTrainOptions {
  bool resume = false;
  std::string consent;         // overrides the capture's statement when not empty
  PictureDistance perceptual;  // the network that settings.perceptual names
};

// Trains (or resumes), with checkpoints in OUT/checkpoint.safetensors, and writes the avatar folder
// with training.json. Returns training.json.
Json train_body(const StageCapture& capture, const BodyTrainSettings& settings, const Path& out,
                const BodyTrainOptions& options);

}  // namespace effigy
