// Losses between a rendered frame and the recorded one (GTAvatar section 4.1, Eq. 9), with their
// exact gradients:
//   L1   = mean |colour - target| over the whole image and its three channels
//   DSSIM = 1 - mean SSIM, SSIM as in image/metrics.h (Wang et al. 2004: Gaussian window 11,
//          sigma 1.5, zero padding, K1 .01, K2 .03, mean over the whole image and channels)
//   mask = mean |alpha - mask| over the whole image
#pragma once

#include <span>

#include "effigy/image/image.h"

namespace effigy {

struct PhotometricWeights {
  float l1 = 0.8f, dssim = 0.2f, mask = 0.1f;
};

// Unweighted values.
struct PhotometricLoss {
  double l1 = 0, dssim = 0, mask = 0;
  double total(const PhotometricWeights& weights) const {
    return weights.l1 * l1 + weights.dssim * dssim + weights.mask * mask;
  }
};

// Pixels [x0, x1) x [y0, y1).
struct PixelBox {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  bool empty() const { return x1 <= x0 || y1 <= y0; }
  bool operator==(const PixelBox&) const = default;
};

// The smallest box that holds every pixel where one of the first three planes of `colour` or
// `target`, or `alpha` or `mask`, is not zero. Empty when all are zero.
PixelBox nonzero_box(const Planes& colour, const Planes& target, std::span<const float> alpha,
                     std::span<const float> mask);

// `colour` (rendered) and `target`: at least 3 planes each of the same size, in the encoding the
// loss is taken in, about [0, 1]; `alpha` and `mask`: one value a pixel, or both empty (no mask
// loss). Adds the gradient of weights . values to the first three planes of `d_colour` and to
// `d_alpha`; with `d_colour` null only the values are computed (then `d_alpha` may be empty).
//
// `box` (not empty) promises that both images, alpha and mask are zero outside it: values and
// gradients are those of the whole image, in less time (the gradient outside the box, grown by 10
// pixels, is zero).
// Gradient of |x| at 0 is 0. Results do not depend on the thread count.
PhotometricLoss photometric_loss(const Planes& colour, const Planes& target,
                                 std::span<const float> alpha, std::span<const float> mask,
                                 const PhotometricWeights& weights, Planes* d_colour,
                                 std::span<float> d_alpha, const PixelBox& box = {});

}  // namespace effigy
