#include "effigy/geometry/gutter.h"

#include <utility>

#include "effigy/base/error.h"

namespace effigy {

std::vector<int> nearest_shown(int size, std::span<const int32_t> shown) {
  EFFIGY_CHECK_EQ(shown.size(), static_cast<size_t>(size) * static_cast<size_t>(size));
  std::vector<int> from(shown.size(), -1), front;
  for (size_t i = 0; i < from.size(); ++i)
    if (shown[i] >= 0) {
      from[i] = static_cast<int>(i);
      front.push_back(static_cast<int>(i));
    }
  while (!front.empty()) {
    std::vector<int> next;
    for (const int i : front) {
      const int x = i % size, y = i / size;
      for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
        const int nx = x + dx, ny = y + dy;
        if (nx < 0 || ny < 0 || nx >= size || ny >= size) continue;
        const size_t n = static_cast<size_t>(ny) * static_cast<size_t>(size) + nx;
        if (from[n] >= 0) continue;
        from[n] = from[static_cast<size_t>(i)];
        next.push_back(static_cast<int>(n));
      }
    }
    front = std::move(next);
  }
  return from;
}

}  // namespace effigy
