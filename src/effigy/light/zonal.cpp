#include "effigy/light/zonal.h"

#include <cmath>

namespace effigy {

const std::array<double, kZonalBands>& lambert_zonal() {
  // A_l / pi (Ramamoorthi and Hanrahan 2001): A = pi, 2 pi / 3, pi / 4, 0, -pi / 24, 0, pi / 64, 0,
  // -pi / 128.
  static const std::array<double, kZonalBands> z = {
      1.0, 2.0 / 3.0, 1.0 / 4.0, 0.0, -1.0 / 24.0, 0.0, 1.0 / 64.0, 0.0, -1.0 / 128.0};
  return z;
}

double zonal_from_sloan(size_t l) {
  return std::sqrt(1.0 / zonal_factor<double>(l));
}

}  // namespace effigy
