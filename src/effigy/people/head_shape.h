// The outer form of the built-in head as a signed distance function: smooth unions of ellipsoids
// and round cones set to adult anthropometric means (head breadth 152 mm, length 194 mm, height 228
// mm, interpupillary 63 mm). Millimetres; origin between the ear canals' plane and eye level, y up,
// face +z, subject's left +x; mirror-symmetric.
#pragma once

#include "effigy/geometry/types.h"

namespace effigy::people {

// Landmarks of the form that other files build on (left side; millimetres).
inline constexpr double kEyeX = 31.5, kEyeY = 0.0, kEyeZ = 69.0;  // eyeball centre
inline constexpr double kEyeRadius = 12.0, kCorneaHeight = 0.9;   // how far the cornea stands out
inline constexpr double kMouthY = -72.5, kMouthHalfWidth = 25.0;
inline constexpr double kNeckBottom = -172.0;

// Negative inside. Smooth except at the mirror plane's far side; not an exact distance, but its
// gradient is at most about 1, so marching by 0.7 of it is safe.
double head_distance(const Vec3d& p);
// Unit gradient.
Vec3d head_normal(const Vec3d& p);
// First surface point from `origin` (outside) along the unit `direction` within `length`; the last
// point marched to when nothing is hit.
Vec3d march_head(const Vec3d& origin, const Vec3d& direction, double length);

}  // namespace effigy::people
