// Coordinates on the head's surface. Half of the head (subject's left, x >= 0) is covered by
// (azimuth, level), both in degrees: azimuth 0 in front .. 180 behind; level 90 at the crown, the
// elevation seen from the head's centre down to -55, then the way down the neck to -115 (the open
// ring). Also the atlas layout: where each place lies in UV.
#pragma once

#include "effigy/geometry/types.h"

namespace effigy::people {

inline constexpr double kLevelTop = 90, kLevelBottom = -115;

// The skin point, millimetres (head_shape.h).
Vec3d point_at(double azimuth, double level);
// (azimuth, level) of a point near the skin, x >= 0.
Vec2d domain_of(const Vec3d& point);
// UV of a place on the left half; the right half mirrors u about 1/2.
Vec2d uv_at(double azimuth, double level);

}  // namespace effigy::people
