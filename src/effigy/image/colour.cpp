#include "effigy/image/colour.h"

#include <cmath>

#include "effigy/base/error.h"

namespace effigy {

float srgb_from_linear(float linear) {
  const float x = std::fabs(linear);
  const float y = x <= 0.0031308f ? 12.92f * x : 1.055f * std::pow(x, 1.0f / 2.4f) - 0.055f;
  return std::copysign(y, linear);
}

float linear_from_srgb(float srgb) {
  const float x = std::fabs(srgb);
  const float y = x <= 0.04045f ? x / 12.92f : std::pow((x + 0.055f) / 1.055f, 2.4f);
  return std::copysign(y, srgb);
}

DisplayTransform display_transform_from_name(const std::string& name) {
  if (name == "srgb") return DisplayTransform::kSrgb;
  if (name == "reinhard-srgb") return DisplayTransform::kReinhardSrgb;
  throw Error("Unknown display transform '" + name + "'; use srgb or reinhard-srgb.");
}

std::string to_string(DisplayTransform transform) {
  return transform == DisplayTransform::kSrgb ? "srgb" : "reinhard-srgb";
}

}  // namespace effigy
