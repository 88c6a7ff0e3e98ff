// The colour guided filter, at a working size of its own. Private to track/.
#pragma once

#include <span>
#include <vector>

#include "effigy/image/image.h"

namespace effigy {

// Box mean of a plane, window (2 radius + 1)^2 cut at the border.
void box_mean(std::span<const float> in, int width, int height, int radius, std::span<float> out);

// Local linear model of `matte` in the colours of `guide` (3 channels, same size): He, Sun and
// Tang, "Guided Image Filtering", PAMI 2013, equations 14-16. Returns the averaged coefficients
// interleaved, [height][width][4]: matte = a_r r + a_g g + a_b b + c with colours in [0, 1].
std::vector<float> guided_coefficients(const Image8& guide, const Image& matte, int radius,
                                       float epsilon);

// The model applied to a picture of another size: coefficients of `width` x `height` pixels are
// interpolated bilinearly, the result clamped to [low, high] and stretched to [0, 1].
Image apply_guided(const Image8& picture, std::span<const float> coefficients, int width,
                   int height, float low, float high);

}  // namespace effigy
