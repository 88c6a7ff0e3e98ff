// Albedo prior (GTAvatar section 4.2, L_diff_albedo): the rendered albedo is compared with an image
// that a network or a path tracer predicts for this frame.
//   L = sum over pixels and channels of M |sRGB(A / alpha) - P| / (3 pixels of the image)
// with the accumulated albedo A (linear), the mask M in [0, 1] and the prior P (sRGB).
#pragma once

#include <span>

#include "effigy/image/image.h"

namespace effigy {

struct AlbedoPriorOptions {
  // Pixels with less alpha have no albedo to speak of and do not count.
  float min_alpha = 0.01f;
  // Divide by the sum of the mask (of pixels that count) instead of the image's pixels.
  bool mean_over_mask = false;
};

// `gbuffer` as render_surfels leaves it; `prior`: at least 3 planes of the same size; `mask`: one
// value a pixel, 0 where the prior says nothing. Returns the unweighted value; adds weight times
// the gradient to the albedo and alpha planes of `d_gbuffer` unless null. Does not depend on the
// thread count.
double albedo_prior_loss(const Planes& gbuffer, const Planes& prior, std::span<const float> mask,
                         const AlbedoPriorOptions& options, float weight, Planes* d_gbuffer);

}  // namespace effigy
