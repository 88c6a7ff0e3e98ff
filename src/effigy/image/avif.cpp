#include <avif/avif.h>

#include <memory>

#include "effigy/image/codecs.h"

namespace effigy::detail {

Raster decode_avif(std::span<const uint8_t> bytes, const std::string& name, bool keep_wide) {
  const std::unique_ptr<avifDecoder, decltype(&avifDecoderDestroy)> decoder(avifDecoderCreate(),
                                                                            avifDecoderDestroy);
  decoder->maxThreads = 2;
  decoder->ignoreExif = AVIF_TRUE;
  decoder->ignoreXMP = AVIF_TRUE;
  decoder->imageDimensionLimit = kMaxSide;
  // libavif's own ceiling (16384 x 16384) is lower than kMaxPixels and may not be raised.
  decoder->imageCountLimit = 1 << 16;
  const auto require = [&](avifResult result) {
    if (result != AVIF_RESULT_OK)
      fail_read(name, std::string("damaged AVIF (") + avifResultToString(result) + ")");
  };
  require(avifDecoderSetIOMemory(decoder.get(), bytes.data(), bytes.size()));
  require(avifDecoderParse(decoder.get()));
  check_picture_size(name, decoder->image->width, decoder->image->height);
  require(avifDecoderNextImage(decoder.get()));
  const avifImage* image = decoder->image;
  const bool alpha = image->alphaPlane != nullptr;
  const bool grey = image->yuvFormat == AVIF_PIXEL_FORMAT_YUV400 && !alpha;

  Raster raster;
  raster.width = static_cast<int>(image->width);
  raster.height = static_cast<int>(image->height);
  raster.wide = keep_wide && image->depth > 8;
  const int decoded_channels = alpha ? 4 : 3;
  const size_t pixels = static_cast<size_t>(image->width) * image->height;
  const size_t count = pixels * static_cast<size_t>(decoded_channels);
  avifRGBImage rgb;
  avifRGBImageSetDefaults(&rgb, image);
  rgb.format = alpha ? AVIF_RGB_FORMAT_RGBA : AVIF_RGB_FORMAT_RGB;
  rgb.depth = raster.wide ? 16 : 8;
  if (raster.wide) {
    raster.words.resize(count);
    rgb.pixels = reinterpret_cast<uint8_t*>(raster.words.data());
  } else {
    raster.bytes.resize(count);
    rgb.pixels = raster.bytes.data();
  }
  rgb.rowBytes = image->width * static_cast<uint32_t>(decoded_channels) * (raster.wide ? 2 : 1);
  require(avifImageYUVToRGB(image, &rgb));
  raster.channels = decoded_channels;
  if (grey) {
    for (size_t i = 0; i < pixels; ++i) {
      if (raster.wide) {
        raster.words[i] = raster.words[3 * i];
      } else {
        raster.bytes[i] = raster.bytes[3 * i];
      }
    }
    raster.channels = 1;
    raster.words.resize(raster.wide ? pixels : 0);
    raster.bytes.resize(raster.wide ? 0 : pixels);
  }
  return raster;
}

}  // namespace effigy::detail
