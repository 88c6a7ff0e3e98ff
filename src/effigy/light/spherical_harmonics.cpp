#include "effigy/light/spherical_harmonics.h"

#include <cmath>
#include <numbers>

namespace effigy::detail {
namespace {

std::array<double, (kMostShOrder + 1) * (kMostShOrder + 2) / 2> make_norms() {
  std::array<double, (kMostShOrder + 1) * (kMostShOrder + 2) / 2> norms{};
  for (int l = 0; l <= kMostShOrder; ++l)
    for (int m = 0; m <= l; ++m) {
      double ratio = 1.0;  // (l + m)! / (l - m)!
      for (int k = l - m + 1; k <= l + m; ++k) ratio *= k;
      norms[static_cast<size_t>(l * (l + 1) / 2 + m)] =
          std::sqrt((m > 0 ? 2.0 : 1.0) * (2 * l + 1) / (4.0 * std::numbers::pi * ratio));
    }
  return norms;
}

}  // namespace

const std::array<double, (kMostShOrder + 1) * (kMostShOrder + 2) / 2> kShNorm = make_norms();

}  // namespace effigy::detail
