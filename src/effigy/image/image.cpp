#include "effigy/image/image.h"

#include "effigy/base/simd.h"

namespace effigy {
namespace {

EFFIGY_CLONES void floats_from_bytes(const uint8_t* in, float* out, size_t count) {
  for (size_t i = 0; i < count; ++i) out[i] = static_cast<float>(in[i]) / 255.0f;
}

EFFIGY_CLONES void bytes_from_floats(const float* in, uint8_t* out, size_t count) {
  for (size_t i = 0; i < count; ++i) {
    // Not a number compares false and becomes 0.
    const float low = in[i] > 0.0f ? in[i] : 0.0f;
    const float clamped = low < 1.0f ? low : 1.0f;
    out[i] = static_cast<uint8_t>(static_cast<int>(clamped * 255.0f + 0.5f));
  }
}

}  // namespace

Planes to_planes(const Image& image) {
  Planes planes(image.width, image.height, image.channels);
  const size_t pixels = planes.pixels();
  const int channels = image.channels;
  for (int c = 0; c < channels; ++c) {
    const float* in = image.data.data() + c;
    float* out = planes.plane(c);
    for (size_t i = 0; i < pixels; ++i) out[i] = in[i * static_cast<size_t>(channels)];
  }
  return planes;
}

Image to_image(const Planes& planes) {
  Image image(planes.width, planes.height, planes.count);
  const size_t pixels = planes.pixels();
  const int channels = planes.count;
  for (int c = 0; c < channels; ++c) {
    const float* in = planes.plane(c);
    float* out = image.data.data() + c;
    for (size_t i = 0; i < pixels; ++i) out[i * static_cast<size_t>(channels)] = in[i];
  }
  return image;
}

Image to_float(const Image8& image) {
  Image result(image.width, image.height, image.channels);
  floats_from_bytes(image.data.data(), result.data.data(), result.data.size());
  return result;
}

Image8 to_8bit(const Image& image) {
  Image8 result(image.width, image.height, image.channels);
  bytes_from_floats(image.data.data(), result.data.data(), result.data.size());
  return result;
}

}  // namespace effigy
