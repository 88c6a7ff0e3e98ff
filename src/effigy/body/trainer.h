// Trains a body avatar on a light-stage capture (Relightable Full-Body Gaussian Codec Avatars).
#pragma once

#include <memory>
#include <vector>

#include "effigy/body/losses.h"
#include "effigy/body/model.h"
#include "effigy/body/moments.h"
#include "effigy/body/train_settings.h"
#include "effigy/capture/stage_capture.h"
#include "effigy/learn/ranks.h"

namespace effigy {

// Thrown by step() when the loss is not finite or many times what it was.
class Diverged : public Error {
 public:
  using Error::Error;
};

class BodyTrainer {
 public:
  // Keeps references to `capture` and `ranks`. `perceptual`: the network that settings.perceptual
  // names. settings.batch are the views of all processes together, which take turns; every process
  // makes the same calls and holds the same model. Throws Error when the capture has nothing to
  // train on, the network is not given, or the batch does not divide.
  BodyTrainer(const StageCapture& capture, const BodyTrainSettings& settings,
              PictureDistance perceptual = {}, Ranks& ranks = one_process());
  ~BodyTrainer();

  int64_t iteration() const;
  // One iteration on the next views of the shuffled order. Mean losses of the batch. The same bits
  // for every number of processes.
  BodyLossValues step();
  // After going back to a checkpoint: other views from here on.
  void change_order();

  const BodyTrainSettings& settings() const;
  // For drawing between steps; the moments are the training's.
  BodyModel& model();
  StageMoments& moments();
  const StageSource& source() const;
  const std::vector<CameraColour>& camera_colours() const;

  // A number of all that is trained and of what it is trained on: alike on all processes.
  uint64_t fingerprint() const;
  // Everything needed to go on bit for bit, with any number of processes. Loading checks that the
  // checkpoint belongs to this capture and these settings.
  void save_checkpoint(const Path& path) const;
  void load_checkpoint(const Path& path);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace effigy
