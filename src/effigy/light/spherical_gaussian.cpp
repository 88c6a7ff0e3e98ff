#include "effigy/light/spherical_gaussian.h"

#include <string>

namespace effigy {

SgNorm sg_norm_named(const char* name) {
  const std::string text = name;
  if (text == "code") return SgNorm::kCode;
  if (text == "pi32") return SgNorm::kPi32;
  if (text == "unit") return SgNorm::kUnit;
  throw Error("The normalisation of spherical Gaussians must be code, pi32 or unit, not '" + text +
              "'.");
}

}  // namespace effigy
