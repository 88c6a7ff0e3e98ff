#include "effigy/body/stage_schedule.h"

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

StageSchedule::StageSchedule(std::vector<int> frames, std::vector<int> cameras, int views_per_frame)
    : frames_(std::move(frames)),
      cameras_(std::move(cameras)),
      views_per_frame_(static_cast<uint64_t>(views_per_frame)) {
  if (frames_.empty()) throw Error("The capture has no frames of the kind wanted; add some.");
  if (cameras_.empty()) throw Error("The capture has no cameras of the kind wanted; add some.");
  EFFIGY_CHECK(views_per_frame > 0);
}

StageSchedule StageSchedule::random(std::vector<int> frames, std::vector<int> cameras,
                                    uint64_t seed, int views_per_frame) {
  StageSchedule schedule(std::move(frames), std::move(cameras), views_per_frame);
  schedule.seed_ = seed;
  schedule.random_ = true;
  return schedule;
}

StageSchedule StageSchedule::in_order(std::vector<int> frames, std::vector<int> cameras) {
  return {std::move(frames), std::move(cameras), 1};
}

uint64_t StageSchedule::size() const {
  const uint64_t blocks = (cameras_.size() + views_per_frame_ - 1) / views_per_frame_;
  return frames_.size() * blocks * views_per_frame_;
}

StageViewKey StageSchedule::view(uint64_t number) const {
  const uint64_t epoch = number / size(), place = number % size();
  if (!random_) return {frames_[place / cameras_.size()], cameras_[place % cameras_.size()]};
  const uint64_t frames = frames_.size(), cameras = cameras_.size();
  const uint64_t key = mixed(seed_, 2 * epoch);
  // Blocks of views of one frame are shuffled; which cameras they hold is shuffled for each frame.
  const uint64_t block = shuffled(place / views_per_frame_, size() / views_per_frame_, key);
  const uint64_t frame = block % frames;
  const uint64_t slot = block / frames * views_per_frame_ + place % views_per_frame_;
  const uint64_t camera = shuffled(slot % cameras, cameras, mixed(key, 1 + frame));
  return {frames_[frame], cameras_[camera]};
}

}  // namespace effigy
