// How the look of the users' own bodies and heads is traced.
#pragma once

#include "effigy/people/user_body.h"
#include "effigy/synth/scene.h"

namespace effigy {

inline SurfaceMaterial user_material(UserBody&& look) {
  SurfaceMaterial material;
  material.albedo = std::move(look.albedo);
  material.roughness = std::move(look.roughness);
  material.opacity = std::move(look.alpha);
  material.normal = std::move(look.normal);
  material.specular = Image(1, 1, 1, 0.04f);  // skin's and cloth's, about; no file says it
  return material;
}

}  // namespace effigy
