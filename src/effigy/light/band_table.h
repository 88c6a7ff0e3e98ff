// Bands of an environment's harmonics, looked up by direction:
//   E_l(a) = sum over m of L_lm Y_lm(a),  l = 0 .. kZonalOrder, r g b,
// all that zonal lobes about the axis a ask of light (light/zonal.h), found beforehand at the nodes
// of a grid on the cube and interpolated between them.
#pragma once

#include <span>
#include <vector>

#include "effigy/light/zonal.h"

namespace effigy {

class BandTable {
 public:
  static constexpr size_t kNumbers = 3 * kZonalBands;

  // sh: r g b of every coefficient (sh_of_cubemap); `side`: cells along a face's edge, 2 or more.
  // With 64 (2.7 MB) a band is within 0.7 % of its largest value everywhere, lower bands much
  // nearer, Lambert's colour within 2e-4 of its largest.
  explicit BandTable(std::span<const float> sh, int side = 64);

  // Writes E_l, r g b, of a direction that is not zero to e[3 l + c].
  void look_up(float x, float y, float z, float* e) const;
  int side() const { return side_; }

 private:
  int side_;
  std::vector<float> nodes_;  // [6][side + 1][side + 1][kNumbers]
};

}  // namespace effigy
