// The built-in head's materials as functions of a place on its surface.
#pragma once

#include <cstdint>

#include "effigy/geometry/types.h"

namespace effigy::people {

enum class PaintPart : uint8_t { kSkin, kEye, kTeeth, kMouth };

struct Place {
  Vec3d p = Vec3d::Zero();  // rest, millimetres, x as it is
  PaintPart part = PaintPart::kSkin;
  double lip = 0;     // 1 on the vermilion, 0 on skin
  double lash = 0;    // 1 on the rim of the lids
  double inside = 0;  // 1 inside lids or lips
  double ear = 0;     // 1 on the ears
  double along = 0;   // teeth: position along the arch in teeth; 0 = the middle
  double gum = 0;     // teeth: 1 at the gum
};

struct Paint {
  Vec3d albedo = Vec3d::Zero();  // linear
  double roughness = 0.5, specular = 0.028;
  double height = 0;  // millimetres, of the fine relief
};

// `texel`: millimetres a texel covers; relief finer than that is left out.
Paint paint_at(const Place& place, double texel);

}  // namespace effigy::people
