#include <algorithm>
#include <cmath>
#include <fstream>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/light/environment.h"

namespace effigy {
namespace {

// Radiance (#?RADIANCE) and OpenEXR files hold linear radiance; all other formats are sRGB.
bool is_linear_format(const Path& path) {
  unsigned char head[4] = {};
  std::ifstream file(path, std::ios::binary);
  file.read(reinterpret_cast<char*>(head), 4);
  return (head[0] == '#' && head[1] == '?') ||
         (head[0] == 0x76 && head[1] == 0x2f && head[2] == 0x31 && head[3] == 0x01);
}

}  // namespace

Image read_environment(const Path& path) {
  const Image file = read_image(path);
  const std::string name = "The environment " + path.string();
  if (file.width < 2 || std::abs(file.width - 2.0 * file.height) > 0.1 * file.width)
    throw Error(name + " is " + std::to_string(file.width) + " x " + std::to_string(file.height) +
                " pixels; it must be equirectangular, twice as wide as high.");
  const bool linear = is_linear_format(path);
  float largest = 0.0f;
  for (const float value : file.data)
    if (std::isfinite(value)) largest = std::max(largest, value);
  Image image(file.width, file.height, 3);
  for (int y = 0; y < file.height; ++y) {
    for (int x = 0; x < file.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        float value = file.at(x, y)[file.channels >= 3 ? c : 0];
        const auto where = [&] {
          return " at pixel (" + std::to_string(x) + ", " + std::to_string(y) + ")";
        };
        if (!std::isfinite(value))
          throw Error(name + " holds a value that is not finite" + where() +
                      "; clamp it in an image editor (half floats end at 65504).");
        // Lossy EXR compression leaves tiny negative values around bright spots.
        if (value < -0.01f * std::max(largest, 1.0f))
          throw Error(name + " holds negative radiance" + where() +
                      "; light cannot be negative, clamp it at zero.");
        value = std::max(value, 0.0f);
        image.at(x, y)[c] = linear ? value : linear_from_srgb(value);
      }
    }
  }
  if (largest <= 0.0f)
    throw Error(name + " is black everywhere; choose an environment with some light.");
  return image;
}

}  // namespace effigy
