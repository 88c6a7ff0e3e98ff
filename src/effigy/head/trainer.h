// Trains a head avatar (GTAvatar section 4) on a capture.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>

#include "effigy/head/frames.h"
#include "effigy/head/model.h"

namespace effigy {

// Unweighted loss values of one iteration, by the names of LossWeights.
using LossValues = std::map<std::string, double>;

class HeadTrainer {
 public:
  // Keeps a reference to `capture`.
  HeadTrainer(const Capture& capture, const TrainSettings& settings);
  ~HeadTrainer();

  int64_t iteration() const;
  // One iteration on the next frame of the shuffled order. Throws Error when the loss stops being
  // finite.
  LossValues step();

  // The avatar as it stands.
  HeadAvatar avatar() const;
  // The same, with what no training frame shows put back in order (head/unseen.h).
  HeadAvatar finished_avatar() const;
  const TrainSettings& settings() const;

  // Everything needed to go on bit for bit. Loading checks that the checkpoint belongs to this
  // capture and these settings.
  void save_checkpoint(const Path& path) const;
  void load_checkpoint(const Path& path);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

struct TrainOptions {
  bool resume = false;
  std::string consent;  // overrides the capture's statement when not empty
};

// The whole run: trains (or resumes), with checkpoints in OUT/checkpoint.safetensors, and writes
// the avatar folder with training.json. Returns training.json.
Json train_head(const Capture& capture, const TrainSettings& settings, const Path& out,
                const TrainOptions& options);

}  // namespace effigy
