// Image files. Every reader treats its file as hostile and throws Error naming it; every writer
// writes beside and renames.
#pragma once

#include <map>
#include <span>
#include <string>

#include "effigy/base/file.h"
#include "effigy/image/image.h"

namespace effigy {

// Text chunks (PNG tEXt, EXR string attributes): provenance, "synthetic" marks.
using ImageMetadata = std::map<std::string, std::string>;

// 8-bit PNG, JPEG or AVIF by content; 16-bit PNGs are rounded. Keeps 1, 3 or 4 channels (grey+alpha
// becomes 4).
Image8 read_image8(const Path& path);
// Any of PNG (8/16 bit), JPEG, AVIF, EXR, Radiance HDR by content, as floats: integer formats in
// [0, 1] as encoded (no transfer function applied), EXR and HDR linear radiance.
Image read_image(const Path& path);
// PNG text chunks and EXR string attributes; empty for other formats.
ImageMetadata read_image_metadata(const Path& path);
// `fast`: a third of the time for a tenth more bytes; for the many frames of a capture.
void write_png8(const Path& path, const Image8& image, const ImageMetadata& metadata = {},
                bool fast = false);
// Clamps to [0, 1], rounds to 16 bit.
void write_png16(const Path& path, const Image& image, const ImageMetadata& metadata = {});
void write_jpeg(const Path& path, const Image8& image, int quality = 92);
// 16-bit half by default; channel names R G B A for 1..4 channels.
void write_exr(const Path& path, const Image& image, bool half = true,
               const ImageMetadata& metadata = {});
// In-memory JPEG/PNG for embedding in reports.
std::vector<uint8_t> encode_jpeg(const Image8& image, int quality = 90);
std::vector<uint8_t> encode_png8(const Image8& image);
// Decodes PNG or JPEG from memory (frames kept compressed); `name` is for messages.
Image8 decode_image8(std::span<const uint8_t> bytes, const std::string& name);

}  // namespace effigy
