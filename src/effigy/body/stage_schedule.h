// In which order a body's training looks at the views of a stage capture.
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/capture/stage_capture.h"

namespace effigy {

struct StageViewKey {
  int frame = 0, camera = 0;  // indices into the capture's
};

// Views by number: pairs of a frame and a camera that saw it. Random: number 0, 1, 2 … go through
// all of them once an epoch, in another order each time; any number is answered at once, so that a
// resumed run needs to know nothing but where it was. The same seed gives the same order on every
// machine.
class StageSchedule {
 public:
  // views_per_frame: so many numbers in a row (from multiples of it) show one frame from different
  // cameras, and share what is computed per frame; where that does not divide a frame's cameras, an
  // epoch shows some of them again. Throws Error when nothing is left: no frame, no camera.
  static StageSchedule random(const StageCapture& capture, const std::vector<int>& frames,
                              const std::vector<int>& cameras, uint64_t seed,
                              int views_per_frame = 1);
  // Each pair once an epoch, frame by frame.
  static StageSchedule in_order(const StageCapture& capture, const std::vector<int>& frames,
                                const std::vector<int>& cameras);

  // Numbers of one epoch.
  uint64_t size() const { return blocks_.back() * views_per_frame_; }
  StageViewKey view(uint64_t number) const;

 private:
  StageSchedule(const StageCapture& capture, const std::vector<int>& frames,
                const std::vector<int>& cameras, int views_per_frame);

  std::vector<int> frames_;                // that a camera saw
  std::vector<std::vector<int>> cameras_;  // of each frame, or one for all
  // Blocks of views_per_frame_ numbers before each frame, and in all.
  std::vector<uint64_t> blocks_{0};
  uint64_t views_per_frame_, seed_ = 0;
  bool random_ = false;
};

// Position of `index` after a shuffle of 0 .. count - 1 that `key` names: a Feistel network over
// the next power of four, walked until it lands below `count` (Black and Rogaway 2002). Constant
// time and memory. index < count.
uint64_t shuffled(uint64_t index, uint64_t count, uint64_t key);

}  // namespace effigy
