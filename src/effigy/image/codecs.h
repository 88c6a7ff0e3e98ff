// The image formats behind files.h: one reader each, on bytes in memory (EXR: on its file).
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "effigy/image/files.h"

namespace effigy::detail {

// Larger pictures are refused before memory is taken for them.
inline constexpr int kMaxSide = 65536;
inline constexpr int64_t kMaxPixels = int64_t{512} << 20;
inline constexpr int64_t kMaxFloatPixels = int64_t{128} << 20;  // EXR and Radiance, 16384 x 8192

enum class ImageFormat { kUnknown, kPng, kJpeg, kAvif, kExr, kRadiance };
// By the first bytes of the file.
ImageFormat sniff_format(std::span<const uint8_t> bytes);

// Decoded integers, interleaved: 8 bits a value in bytes, or 16 bits in words when `wide`.
struct Raster {
  int width = 0, height = 0, channels = 0;
  bool wide = false;
  std::vector<uint8_t> bytes;
  std::vector<uint16_t> words;
};

// "Cannot read NAME: WHY; REMEDY."
[[noreturn]] void fail_read(const std::string& name, const std::string& why,
                            const std::string& remedy = "export or copy the picture again");
// Throws for pictures of no or too many pixels.
void check_picture_size(const std::string& name, int64_t width, int64_t height,
                        int64_t most = kMaxPixels);

// `keep_wide`: 16-bit (AVIF: 10- and 12-bit) files stay wide; otherwise they are rounded to 8.
Raster decode_png(std::span<const uint8_t> bytes, const std::string& name, bool keep_wide,
                  ImageMetadata* metadata = nullptr);
Raster decode_jpeg(std::span<const uint8_t> bytes, const std::string& name);
Raster decode_avif(std::span<const uint8_t> bytes, const std::string& name, bool keep_wide);
Image decode_radiance(std::span<const uint8_t> bytes, const std::string& name);
Image read_exr(const Path& path);
ImageMetadata read_exr_metadata(const Path& path);

// Channels 1..4 of 8 or (wide) 16 bits. `level`: zlib's 0..9; up to 2 with one
// filter for all rows.
std::vector<uint8_t> encode_png(const Raster& raster, const ImageMetadata& metadata, int level);

}  // namespace effigy::detail
