// AVIF pictures for tests of their readers.
#pragma once

#include <avif/avif.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "effigy/image/image.h"

namespace effigy::test {

inline bool can_write_avif() {
  return avifCodecName(AVIF_CODEC_CHOICE_AUTO, AVIF_CODEC_FLAG_CAN_ENCODE) != nullptr;
}

// 3 or 4 channels. `exact`: without loss (8 bits), else at high quality.
inline std::vector<uint8_t> avif_bytes(const Image8& picture, int depth = 8, bool exact = false) {
  avifImage* image =
      avifImageCreate(static_cast<uint32_t>(picture.width), static_cast<uint32_t>(picture.height),
                      static_cast<uint32_t>(depth), AVIF_PIXEL_FORMAT_YUV444);
  if (exact) image->matrixCoefficients = AVIF_MATRIX_COEFFICIENTS_IDENTITY;
  avifRGBImage rgb;
  avifRGBImageSetDefaults(&rgb, image);
  rgb.format = picture.channels == 4 ? AVIF_RGB_FORMAT_RGBA : AVIF_RGB_FORMAT_RGB;
  rgb.depth = 8;
  rgb.pixels = const_cast<uint8_t*>(picture.data.data());
  rgb.rowBytes = static_cast<uint32_t>(picture.width * picture.channels);
  EXPECT_EQ(avifImageRGBToYUV(image, &rgb), AVIF_RESULT_OK);
  avifEncoder* encoder = avifEncoderCreate();
  encoder->minQuantizer = encoder->maxQuantizer = exact ? 0 : 4;
  encoder->speed = 10;
  avifRWData data = AVIF_DATA_EMPTY;
  EXPECT_EQ(avifEncoderWrite(encoder, image, &data), AVIF_RESULT_OK);
  std::vector<uint8_t> bytes(data.data, data.data + data.size);
  avifRWDataFree(&data);
  avifEncoderDestroy(encoder);
  avifImageDestroy(image);
  return bytes;
}

}  // namespace effigy::test
