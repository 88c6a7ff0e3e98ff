// Albedo images as training's prior (capture frames' `albedo`), made from the truth: whole, or
// degraded in known ways, so that a loss is judged apart from the prior that it follows.
#pragma once

#include <string>

#include "effigy/image/image.h"

namespace effigy {

// kind: "truth", or "degraded" as a network might have it: blurred by 1/48 of the picture's width,
// a third of the way to its mean colour, a quarter darker, and tinted by (1.1, 1, 0.85). `albedo`
// is linear, zero where alpha is; the result sRGB. Throws Error for another kind.
Image8 albedo_prior_image(const Image& albedo, const Image& alpha, const std::string& kind);

}  // namespace effigy
