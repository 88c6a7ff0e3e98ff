// Colour encodings and display transforms. Inside the program colour is linear.
#pragma once

#include <string>

#include "effigy/image/image.h"

namespace effigy {

// IEC 61966-2-1 transfer function; odd extension below zero.
float srgb_from_linear(float linear);
float linear_from_srgb(float srgb);

// How a capture's linear radiance became its image values (decisions.md, "display transform").
enum class DisplayTransform {
  kSrgb,          // sRGB(min(x, 1))
  kReinhardSrgb,  // sRGB(x / (1 + x))
};
DisplayTransform display_transform_from_name(const std::string& name);  // throws Error
std::string to_string(DisplayTransform transform);

// Rec. 709 luminance of linear RGB.
inline float luminance(float r, float g, float b) {
  return 0.2126f * r + 0.7152f * g + 0.0722f * b;
}

}  // namespace effigy
