// The materials of the built-in body below the head as functions of a place on its surface.
#pragma once

#include "effigy/people/body_model.h"

namespace effigy::people {

struct BodyPlace {
  Vec3d p = Vec3d::Zero();  // rest, millimetres
  Vec3d normal = Vec3d::Zero();
  double texel = 1;  // millimetres a texel covers; finer relief is left out
};

struct BodyPaint {
  Vec3d albedo = Vec3d::Zero();  // linear
  double roughness = 0.6, specular = 0.035;
  double scatter = 0;  // how far light spreads below the surface, relative to bare skin
  double height = 0;   // millimetres, of the fine relief
  int part = kSkin;    // BodyPart
};

// `skin`: the colour of the head's neck, linear.
BodyPaint paint_body(const BodyModel& model, const Vec3d& skin, const BodyPlace& place);

}  // namespace effigy::people
