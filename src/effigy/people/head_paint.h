// The built-in head's materials as functions of a place on its surface.
#pragma once

#include <cstdint>

#include "effigy/geometry/types.h"
#include "effigy/people/head_subject.h"

namespace effigy::people {

enum class PaintPart : uint8_t { kSkin, kEye, kTeeth, kMouth };

struct Place {
  Vec3d p = Vec3d::Zero();  // rest, millimetres on the mean head, x as it is
  PaintPart part = PaintPart::kSkin;
  double lip = 0;      // 1 on the vermilion, 0 on skin
  double lash = 0;     // 1 on the rim of the lids
  double inside = 0;   // 1 inside lids or lips
  double ear = 0;      // 1 on the ears
  double nostril = 0;  // 1 inside a nostril
  double along = 0;    // teeth: position along the arch in teeth; 0 = the middle
  double gum = 0;      // teeth: 1 at the gum
};

struct Paint {
  Vec3d albedo = Vec3d::Zero();  // linear
  double roughness = 0.5, specular = 0.028;
  double scatter = 1;  // relative to bare skin
  double height = 0;   // millimetres, of the fine relief
};

// `texel`: millimetres a texel covers; relief finer than that is left out.
Paint paint_at(const Place& place, double texel, const Subject& subject);

// Its parts (head_paint_parts.cpp): eyeballs; teeth and gums; tongue and inside of the mouth.
Paint paint_eye(const Place& place, const Subject& subject);
Paint paint_teeth(const Place& place);
Paint paint_mouth(const Place& place);

}  // namespace effigy::people
