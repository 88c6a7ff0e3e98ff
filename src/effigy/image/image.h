// Image containers: interleaved float images for files, planar float images for kernels.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace effigy {

// Row-major, interleaved, row 0 at the top. Values are in whatever encoding the function that made
// it says (linear unless it says sRGB).
struct Image {
  int width = 0, height = 0, channels = 0;
  std::vector<float> data;  // height * width * channels

  Image() = default;
  Image(int w, int h, int c, float value = 0.0f)
      : width(w), height(h), channels(c), data(static_cast<size_t>(w) * h * c, value) {}
  bool empty() const { return data.empty(); }
  float* at(int x, int y) { return data.data() + (static_cast<size_t>(y) * width + x) * channels; }
  const float* at(int x, int y) const {
    return data.data() + (static_cast<size_t>(y) * width + x) * channels;
  }
};

// 8 bits a channel, interleaved, row 0 at the top: how frames are kept in memory and in files.
struct Image8 {
  int width = 0, height = 0, channels = 0;
  std::vector<uint8_t> data;

  Image8() = default;
  Image8(int w, int h, int c, uint8_t value = 0)
      : width(w), height(h), channels(c), data(static_cast<size_t>(w) * h * c, value) {}
  bool empty() const { return data.empty(); }
  uint8_t* at(int x, int y) {
    return data.data() + (static_cast<size_t>(y) * width + x) * channels;
  }
  const uint8_t* at(int x, int y) const {
    return data.data() + (static_cast<size_t>(y) * width + x) * channels;
  }
};

// Planar float image: plane c is height * width floats, row 0 at the top. What kernels work on.
struct Planes {
  int width = 0, height = 0, count = 0;
  std::vector<float> data;

  Planes() = default;
  Planes(int w, int h, int planes, float value = 0.0f)
      : width(w), height(h), count(planes), data(static_cast<size_t>(w) * h * planes, value) {}
  size_t pixels() const { return static_cast<size_t>(width) * height; }
  float* plane(int c) { return data.data() + pixels() * c; }
  const float* plane(int c) const { return data.data() + pixels() * c; }
};

Planes to_planes(const Image& image);
Image to_image(const Planes& planes);
// value / 255, and round(clamp(value, 0, 1) * 255).
Image to_float(const Image8& image);
Image8 to_8bit(const Image& image);

}  // namespace effigy
