// Image quality measures. Images have the same size, values in [0, 1].
#pragma once

#include "effigy/image/image.h"

namespace effigy {

// 10 log10(1 / MSE) over all channels; `mask` (1 channel, weights) restricts and weights pixels.
// Identical images give 100.
double psnr(const Image& a, const Image& b, const Image* mask = nullptr);
// Mean SSIM (Wang et al. 2004): Gaussian window 11, sigma 1.5, zero padding, K1 .01, K2 .03, per
// channel, averaged over the whole image, as the field's reference code does.
double ssim(const Image& a, const Image& b);
// Mean LDR-FLIP (Andersson et al. 2020) of two sRGB images at 67 pixels per degree.
double flip(const Image& reference, const Image& test);

}  // namespace effigy
