// What the view-independent decoder makes for every texel: 65 numbers, in this order
// (Relightable Full-Body Gaussian Codec Avatars, Eq. 4).
#pragma once

#include <cstddef>

namespace effigy {

struct GaussianChannels {
  static constexpr size_t kOffset = 0;     // 3: delta t, in the texel's tangent frame
  static constexpr size_t kRotation = 3;   // 4: delta R, quaternion (w, x, y, z)
  static constexpr size_t kScale = 7;      // 3
  static constexpr size_t kOpacity = 10;   // 1
  static constexpr size_t kColoured = 11;  // 36: zonal harmonics [axis t, b, n][band 0..3][rgb]
  static constexpr size_t kMono = 47;      // 15: zonal harmonics [axis t, b, n][band 4..8]
  static constexpr size_t kNormal = 62;    // 3: delta n
  static constexpr size_t kCount = 65;
  // With other coefficients than zonal harmonics between kColoured and the normal: their number,
  // and where the normal is, of `count` channels.
  static constexpr size_t transfer_of(size_t count) { return count - 14; }
  static constexpr size_t normal_of(size_t count) { return count - 3; }
};

}  // namespace effigy
