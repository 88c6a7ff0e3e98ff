#include "effigy/track/frame_source.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "effigy/image/resample.h"

namespace effigy {
namespace {

constexpr double kSquare = 0.005;  // pixels that differ less from squares are taken as they are

}  // namespace

FrameSource::FrameSource(const Path& path, int most, int ahead)
    : reader_(path), most_(most), ahead_(ahead), thread_([this] { decode(); }) {}

FrameSource::~FrameSource() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void FrameSource::decode() {
  std::exception_ptr problem;
  try {
    for (int number = 0; most_ == 0 || number < most_; ++number) {
      Frame frame;
      frame.number = number;
      if (!reader_.next(frame.picture, &frame.seconds)) break;
      const double aspect = reader_.info().pixel_aspect;
      if (std::abs(aspect - 1) > kSquare)
        frame.picture = resize(
            frame.picture, std::max(1, static_cast<int>(std::lround(frame.picture.width * aspect))),
            frame.picture.height);
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return stop_ || static_cast<int>(ready_.size()) < ahead_; });
      if (stop_) return;
      ready_.push_back(std::move(frame));
      lock.unlock();
      changed_.notify_all();
    }
  } catch (...) {
    problem = std::current_exception();
  }
  {
    const std::lock_guard lock(mutex_);
    ended_ = true;
    problem_ = problem;
  }
  changed_.notify_all();
}

bool FrameSource::next(Frame& frame) {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return ended_ || !ready_.empty(); });
  if (ready_.empty()) {
    if (problem_) std::rethrow_exception(std::exchange(problem_, nullptr));
    return false;
  }
  frame = std::move(ready_.front());
  ready_.pop_front();
  lock.unlock();
  changed_.notify_all();
  return true;
}

}  // namespace effigy
