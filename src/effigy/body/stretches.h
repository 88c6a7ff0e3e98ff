// Of a picture whose body covers little, only what is covered.
#pragma once

#include <algorithm>
#include <span>

#include "effigy/base/threads.h"

namespace effigy {

// Calls body(begin, end) for stretches of pixels, on all threads, but for those whose alpha is zero
// throughout.
template <class Body>
void for_covered_stretches(std::span<const float> alpha, const Body& body) {
  constexpr size_t kStretch = 128, kTogether = 16;
  const size_t pixels = alpha.size(), stretches = (pixels + kStretch - 1) / kStretch;
  parallel_for(stretches, kTogether, [&](size_t first, size_t last, int) {
    for (size_t s = first; s < last; ++s) {
      const size_t begin = s * kStretch, end = std::min(begin + kStretch, pixels);
      const auto part = alpha.subspan(begin, end - begin);
      if (std::any_of(part.begin(), part.end(), [](float a) { return a != 0.0f; }))
        body(begin, end);
    }
  });
}

}  // namespace effigy
