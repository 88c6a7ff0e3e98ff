// Running a test with the kernels of one instruction set after the other, and timing them.
#pragma once

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include "effigy/base/random.h"
#include "effigy/geometry/types.h"
#include "effigy/image/image.h"
#include "effigy/splat/kernel_choice.h"

namespace effigy {

// Uses the kernels of one instruction set; 0: the separately compiled one-lane source.
class UseTarget {
 public:
  explicit UseTarget(int64_t target) {
    choose_splat_kernels(target == 0 ? KernelChoice::kScalar : KernelChoice::kBest);
    hwy::SetSupportedTargetsForTest(target);
  }
  ~UseTarget() {
    choose_splat_kernels(KernelChoice::kBest);
    hwy::SetSupportedTargetsForTest(0);
  }
};

// Normal numbers for every pixel of `planes` planes: derivatives of a loss.
inline Planes random_upstream(const Camera& camera, int planes, uint64_t seed) {
  Planes upstream(camera.width, camera.height, planes);
  Random random(seed, 17);
  for (float& x : upstream.data) x = static_cast<float>(random.normal());
  return upstream;
}

inline std::string target_name(int64_t target) {
  return target == 0 ? "one lane" : hwy::TargetName(target);
}

// The harness's third mode. draw() returns something with a `frame` that counts pairs, which
// go_back(drawn) takes. The bound is far below what the vector units give, so that a busy machine
// passes.
template <typename Draw, typename GoBack>
void expect_faster_than_one_lane(const std::vector<int64_t>& targets, const Draw& draw,
                                 const GoBack& go_back) {
  struct Speed {
    double forward = 1e9, backward = 1e9;
  };
  const auto measure = [&](int64_t target) {
    const UseTarget use(target);
    Speed best;
    int64_t pairs = 1;
    for (int k = 0; k < 3; ++k) {
      const auto start = std::chrono::steady_clock::now();
      const auto drawn = draw();
      const auto middle = std::chrono::steady_clock::now();
      go_back(drawn);
      const auto stop = std::chrono::steady_clock::now();
      pairs = drawn.frame.pairs();
      const std::chrono::duration<double, std::nano> forward = middle - start;
      const std::chrono::duration<double, std::nano> backward = stop - middle;
      best.forward = std::min(best.forward, forward.count() / static_cast<double>(pairs));
      best.backward = std::min(best.backward, backward.count() / static_cast<double>(pairs));
    }
    std::printf("%-9s forward %6.2f, backward %6.2f ns per pair (%lld pairs)\n",
                target_name(target).c_str(), best.forward, best.backward,
                static_cast<long long>(pairs));
    return best;
  };
  const Speed one_lane = measure(0);
  Speed best;
  for (const int64_t target : targets) {
    const Speed speed = measure(target);
    best.forward = std::min(best.forward, speed.forward);
    best.backward = std::min(best.backward, speed.backward);
  }
  if (targets.size() < 2) GTEST_SKIP() << "this machine has no vector unit that is compiled in";
  EXPECT_LT(best.forward, one_lane.forward / 1.5);
  EXPECT_LT(best.backward, one_lane.backward / 1.5);
}

}  // namespace effigy
