// Resizing and sampling. Pixel centres at +0.5.
#pragma once

#include <algorithm>

#include "effigy/image/image.h"

namespace effigy {

// A part of an Image or Image8 that lies inside it.
template <class Picture>
Picture cropped(const Picture& image, int left, int top, int width, int height) {
  Picture out(width, height, image.channels);
  for (int y = 0; y < height; ++y)
    std::copy_n(image.at(left, top + y), static_cast<size_t>(width) * image.channels, out.at(0, y));
  return out;
}

// Box-filtered when shrinking, bilinear when growing.
Image resize(const Image& image, int width, int height);
Image8 resize(const Image8& image, int width, int height);
// Rectangle [x, x+w) x [y, y+h) in pixels of `image` (may be fractional and leave the picture;
// outside is `outside`), resampled to out_w x out_h with an area filter when shrinking.
Image8 crop_resize(const Image8& image, double x, double y, double w, double h, int out_w,
                   int out_h, uint8_t outside = 0);
// Bilinear at continuous pixel position (x, y), clamped to the edge; writes image.channels values.
void sample_bilinear(const Image& image, double x, double y, float* out);
// Separable Gaussian blur, edge clamped.
Image gaussian_blur(const Image& image, double sigma);

}  // namespace effigy
