// Rays of a pinhole camera, and the walk over its pixels that all passes share.
#pragma once

#include <algorithm>
#include <atomic>
#include <functional>
#include <mutex>

#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/geometry/types.h"

namespace effigy {

class CameraRays {
 public:
  explicit CameraRays(const Camera& camera)
      : origin_(camera.center().cast<float>()),
        forward_(camera.camera_from_world_rotation.row(2).transpose().cast<float>()) {
    const Mat3d world = camera.camera_from_world_rotation.transpose();
    corner_ = world * Vec3d(-camera.cx / camera.fx, -camera.cy / camera.fy, 1);
    right_ = world * Vec3d(1 / camera.fx, 0, 0);
    down_ = world * Vec3d(0, 1 / camera.fy, 0);
  }
  const Vec3f& origin() const { return origin_; }
  // The optical axis.
  const Vec3f& forward() const { return forward_; }
  // Unit direction through a continuous pixel position.
  Vec3f direction(double x, double y) const {
    return (corner_ + x * right_ + y * down_).normalized().cast<float>();
  }

 private:
  Vec3f origin_, forward_;
  Vec3d corner_, right_, down_;
};

// Calls body(x, y) for every pixel, tile by tile on all threads; whichever thread is free takes the
// next tile, so a pixel's result must not depend on the thread. Ends early with Interrupted.
template <typename Body>
void for_each_tile(const Camera& camera, int tile, Progress* progress, const Body& body) {
  const int across = (camera.width + tile - 1) / tile, down = (camera.height + tile - 1) / tile;
  std::atomic<int> next{0}, done{0};
  std::mutex mutex;
  run_slots(thread_count(), [&](int) {
    for (int t = next++; t < across * down; t = next++) {
      throw_if_interrupted();
      const int left = t % across * tile, top = t / across * tile;
      for (int y = top; y < std::min(top + tile, camera.height); ++y)
        for (int x = left; x < std::min(left + tile, camera.width); ++x) body(x, y);
      const int finished = ++done;
      if (progress == nullptr) continue;
      const std::lock_guard lock(mutex);
      progress->update(static_cast<int64_t>(finished) * camera.height / (across * down));
    }
  });
}

}  // namespace effigy
