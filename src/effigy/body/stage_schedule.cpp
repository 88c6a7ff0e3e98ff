#include "effigy/body/stage_schedule.h"

#include <algorithm>
#include <utility>

#include "effigy/base/error.h"
#include "effigy/base/random.h"

namespace effigy {
namespace {

uint64_t mixed(uint64_t a, uint64_t b) {
  return Random(a, b).bits();
}

}  // namespace

uint64_t shuffled(uint64_t index, uint64_t count, uint64_t key) {
  EFFIGY_CHECK(index < count);
  int half = 1;  // bits of each half
  while (half < 31 && (uint64_t{1} << (2 * half)) < count) ++half;
  const uint64_t mask = (uint64_t{1} << half) - 1;
  uint64_t at = index;
  do {
    uint64_t left = at >> half, right = at & mask;
    for (uint64_t round = 0; round < 8; ++round) {
      const uint64_t next = left ^ (mixed(key + round, right) & mask);
      left = right;
      right = next;
    }
    at = left << half | right;
  } while (at >= count);
  return at;
}

StageSchedule::StageSchedule(const StageCapture& capture, const std::vector<int>& frames,
                             const std::vector<int>& cameras, int views_per_frame)
    : views_per_frame_(static_cast<uint64_t>(views_per_frame)) {
  EFFIGY_CHECK(views_per_frame > 0);
  const bool alike = std::all_of(frames.begin(), frames.end(), [&](int frame) {
    return capture.frames.at(static_cast<size_t>(frame)).cameras.empty();
  });
  if (alike) cameras_.push_back(cameras);
  for (const int frame : frames) {
    std::vector<int> saw = capture.cameras_of(frame, cameras);
    if (saw.empty()) continue;
    frames_.push_back(frame);
    blocks_.push_back(blocks_.back() + (saw.size() + views_per_frame_ - 1) / views_per_frame_);
    if (!alike) cameras_.push_back(std::move(saw));
  }
  if (frames_.empty())
    throw Error(capture.folder.string() +
                ": it has no view of the kind wanted (no such frames, or no such cameras); choose "
                "other frames or another capture.");
}

StageSchedule StageSchedule::random(const StageCapture& capture, const std::vector<int>& frames,
                                    const std::vector<int>& cameras, uint64_t seed,
                                    int views_per_frame) {
  StageSchedule schedule(capture, frames, cameras, views_per_frame);
  schedule.seed_ = seed;
  schedule.random_ = true;
  return schedule;
}

StageSchedule StageSchedule::in_order(const StageCapture& capture, const std::vector<int>& frames,
                                      const std::vector<int>& cameras) {
  return {capture, frames, cameras, 1};
}

StageViewKey StageSchedule::view(uint64_t number) const {
  const uint64_t epoch = number / size(), place = number % size();
  const uint64_t key = mixed(seed_, 2 * epoch);
  // Blocks of views of one frame are shuffled; which cameras they hold is shuffled for each frame.
  const uint64_t block = random_ ? shuffled(place / views_per_frame_, blocks_.back(), key) : place;
  const auto frame = static_cast<size_t>(std::upper_bound(blocks_.begin(), blocks_.end(), block) -
                                         blocks_.begin() - 1);
  const std::vector<int>& cameras = cameras_[cameras_.size() > 1 ? frame : 0];
  const uint64_t slot =
      ((block - blocks_[frame]) * views_per_frame_ + place % views_per_frame_) % cameras.size();
  const uint64_t camera = random_ ? shuffled(slot, cameras.size(), mixed(key, 1 + frame)) : slot;
  return {frames_[frame], cameras[camera]};
}

}  // namespace effigy
