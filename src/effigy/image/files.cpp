#include "effigy/image/files.h"

#include <cmath>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/image/codecs.h"

namespace effigy {
namespace detail {

ImageFormat sniff_format(std::span<const uint8_t> bytes) {
  const auto starts = [&](size_t offset, std::string_view text) {
    return bytes.size() >= offset + text.size() &&
           std::memcmp(bytes.data() + offset, text.data(), text.size()) == 0;
  };
  if (starts(0, "\x89PNG\r\n\x1a\n")) return ImageFormat::kPng;
  if (starts(0, "\xff\xd8\xff")) return ImageFormat::kJpeg;
  if (starts(4, "ftypavif") || starts(4, "ftypavis") || starts(4, "ftypmif1") ||
      starts(4, "ftypmiaf"))
    return ImageFormat::kAvif;
  if (starts(0, "\x76\x2f\x31\x01")) return ImageFormat::kExr;
  if (starts(0, "#?RADIANCE") || starts(0, "#?RGBE")) return ImageFormat::kRadiance;
  return ImageFormat::kUnknown;
}

void fail_read(const std::string& name, const std::string& why, const std::string& remedy) {
  throw Error("Cannot read " + name + ": " + why + "; " + remedy + ".");
}

void check_picture_size(const std::string& name, int64_t width, int64_t height, int64_t most) {
  if (width <= 0 || height <= 0) fail_read(name, "it has no pixels");
  if (width > kMaxSide || height > kMaxSide || width * height > most)
    fail_read(name,
              "its " + std::to_string(width) + " x " + std::to_string(height) +
                  " pixels are more than " + std::to_string(kMaxSide) + " a side or " +
                  std::to_string(most >> 20) + " million in all",
              "scale it down");
}

}  // namespace detail

namespace {

using detail::ImageFormat;
using detail::Raster;

// Radiance files and photographs stay far below.
constexpr uint64_t kMaxFileBytes = uint64_t{4} << 30;

Raster decode_integers(std::span<const uint8_t> bytes, const std::string& name, bool keep_wide,
                       ImageFormat format) {
  switch (format) {
    case ImageFormat::kPng:
      return detail::decode_png(bytes, name, keep_wide);
    case ImageFormat::kJpeg:
      return detail::decode_jpeg(bytes, name);
    case ImageFormat::kAvif:
      return detail::decode_avif(bytes, name, keep_wide);
    default:
      break;
  }
  if (bytes.empty()) detail::fail_read(name, "it is empty (0 bytes)");
  if (format == ImageFormat::kUnknown)
    detail::fail_read(name, "it is not a PNG, JPEG, AVIF, EXR or Radiance picture",
                      "convert it to PNG");
  detail::fail_read(name, "an 8-bit picture is expected here, not a high dynamic range one",
                    "convert it to PNG");
}

Image8 image8_from(Raster&& raster) {
  Image8 image;
  image.width = raster.width;
  image.height = raster.height;
  image.channels = raster.channels;
  image.data = std::move(raster.bytes);
  return image;
}

// Memory that cannot be had is an error like others, not the end of the program.
template <typename Function>
auto with_memory(const std::string& name, Function&& function) {
  try {
    return function();
  } catch (const std::bad_alloc&) {
    throw Error("Out of memory while reading " + name + "; close other programs or scale it down.",
                Blame::kResource);
  }
}

Raster raster_view(const Image8& image) {
  Raster raster;
  raster.width = image.width;
  raster.height = image.height;
  raster.channels = image.channels;
  raster.bytes = image.data;
  return raster;
}

}  // namespace

Image8 decode_image8(std::span<const uint8_t> bytes, const std::string& name) {
  return with_memory(name, [&] {
    return image8_from(decode_integers(bytes, name, false, detail::sniff_format(bytes)));
  });
}

Image8 read_image8(const Path& path) {
  const auto bytes = read_file(path, kMaxFileBytes);
  return decode_image8(bytes, path.string());
}

Image read_image(const Path& path) {
  const std::string name = path.string();
  const auto bytes = read_file(path, kMaxFileBytes);
  const ImageFormat format = detail::sniff_format(bytes);
  return with_memory(name, [&] {
    if (format == ImageFormat::kExr) return detail::read_exr(path);
    if (format == ImageFormat::kRadiance) return detail::decode_radiance(bytes, name);
    Raster raster = decode_integers(bytes, name, true, format);
    if (!raster.wide) return to_float(image8_from(std::move(raster)));
    Image image(raster.width, raster.height, raster.channels);
    for (size_t i = 0; i < image.data.size(); ++i)
      image.data[i] = static_cast<float>(raster.words[i]) / 65535.0f;
    return image;
  });
}

ImageMetadata read_image_metadata(const Path& path) {
  const auto bytes = read_file(path, kMaxFileBytes);
  ImageMetadata metadata;
  const ImageFormat format = detail::sniff_format(bytes);
  if (format == ImageFormat::kPng) {
    detail::decode_png(bytes, path.string(), false, &metadata);
  } else if (format == ImageFormat::kExr) {
    metadata = detail::read_exr_metadata(path);
  }
  return metadata;
}

// Level 4: within a few percent of zlib's default in size, in half its time.
constexpr int kPngLevel = 4, kFastPngLevel = 2;

void write_png8(const Path& path, const Image8& image, const ImageMetadata& metadata, bool fast) {
  write_file(path,
             detail::encode_png(raster_view(image), metadata, fast ? kFastPngLevel : kPngLevel));
}

void write_png16(const Path& path, const Image& image, const ImageMetadata& metadata) {
  Raster raster;
  raster.width = image.width;
  raster.height = image.height;
  raster.channels = image.channels;
  raster.wide = true;
  raster.words.resize(image.data.size());
  for (size_t i = 0; i < image.data.size(); ++i) {
    const float low = image.data[i] > 0.0f ? image.data[i] : 0.0f;  // not a number becomes 0
    raster.words[i] = static_cast<uint16_t>(std::lround(std::min(low, 1.0f) * 65535.0f));
  }
  write_file(path, detail::encode_png(raster, metadata, kPngLevel));
}

void write_jpeg(const Path& path, const Image8& image, int quality) {
  write_file(path, encode_jpeg(image, quality));
}

std::vector<uint8_t> encode_png8(const Image8& image) {
  return detail::encode_png(raster_view(image), {}, kPngLevel);
}

}  // namespace effigy
