// Numbers of the synth commands, checked one by one.
#pragma once

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/log.h"

namespace effigy {

inline constexpr int kMostSamples = 1 << 20, kMostBounces = 1000, kMostFrames = 1'000'000,
                     kMostPixels = 16384, kLeastTexels = 32, kMostTexels = 8192;

// Throws Error naming the option unless low <= value <= high.
template <typename T>
void check_range(const char* option, T value, T low, T high) {
  if (!(value >= low && value <= high))
    throw Error(format("{} is {}, but it lies in {} .. {}; correct it.", option, value, low, high));
}

}  // namespace effigy
