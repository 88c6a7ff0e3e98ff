// Pictures that tests make up.
#pragma once

#include <cmath>
#include <vector>

#include "effigy/base/random.h"
#include "effigy/image/image.h"

namespace effigy::test {

// Smooth colours with some edges, in [0, 1]: something like a photograph.
inline Image smooth_picture(int width, int height, int channels, double phase = 0.0) {
  Image image(width, height, channels);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int c = 0; c < channels; ++c) {
        const double wave = std::sin(0.11 * x + 0.9 * c + phase) * std::cos(0.07 * y - 0.4 * c);
        const double disc = std::hypot(x - 0.5 * width, y - 0.45 * height) < 0.25 * height ? .2 : 0;
        image.at(x, y)[c] = static_cast<float>(0.4 + 0.35 * wave + disc);
      }
  return image;
}

inline Image noise_picture(int width, int height, int channels, uint64_t seed) {
  Image image(width, height, channels);
  Random random(seed);
  for (float& value : image.data) value = static_cast<float>(random.uniform());
  return image;
}

inline Image8 noise_picture8(int width, int height, int channels, uint64_t seed) {
  Image8 image(width, height, channels);
  Random random(seed);
  for (uint8_t& value : image.data) value = static_cast<uint8_t>(random.below(256));
  return image;
}

}  // namespace effigy::test
