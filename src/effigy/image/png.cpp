#include <png.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/image/codecs.h"

// libpng reports errors by longjmp: functions that call setjmp here own nothing with a destructor.
namespace effigy::detail {
namespace {

struct PngContext {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::span<const uint8_t> input;
  size_t offset = 0;
  std::vector<uint8_t> output;
  char message[160] = "";
};

[[noreturn]] void on_error(png_structp png, png_const_charp message) {
  auto* context = static_cast<PngContext*>(png_get_error_ptr(png));
  std::strncpy(context->message, message, sizeof(context->message) - 1);
  png_longjmp(png, 1);
}
void on_warning(png_structp, png_const_charp) {}

void read_bytes(png_structp png, png_bytep out, size_t count) {
  auto* context = static_cast<PngContext*>(png_get_io_ptr(png));
  if (count > context->input.size() - context->offset) png_error(png, "it ends too early");
  std::memcpy(out, context->input.data() + context->offset, count);
  context->offset += count;
}

void write_bytes(png_structp png, png_bytep bytes, size_t count) {
  auto* context = static_cast<PngContext*>(png_get_io_ptr(png));
  bool stored = false;
  try {
    context->output.insert(context->output.end(), bytes, bytes + count);
    stored = true;
  } catch (const std::bad_alloc&) {
  }
  if (!stored) png_error(png, "out of memory");
}
void flush_bytes(png_structp) {}

struct PngReader : PngContext {
  PngReader() {
    png = png_create_read_struct(PNG_LIBPNG_VER_STRING, static_cast<PngContext*>(this), on_error,
                                 on_warning);
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;
};

struct PngWriter : PngContext {
  PngWriter() {
    png = png_create_write_struct(PNG_LIBPNG_VER_STRING, static_cast<PngContext*>(this), on_error,
                                  on_warning);
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~PngWriter() { png_destroy_write_struct(&png, &info); }
  PngWriter(const PngWriter&) = delete;
  PngWriter& operator=(const PngWriter&) = delete;
};

// Reads up to the pixels and asks for 8- or 16-bit grey, RGB or RGBA.
bool read_header(PngContext* context, bool keep_wide) {
  png_structp png = context->png;
  if (setjmp(png_jmpbuf(png))) return false;
  png_set_user_limits(png, kMaxSide, kMaxSide);
  png_set_chunk_malloc_max(png, 64 << 20);
  png_set_read_fn(png, context, read_bytes);
  png_read_info(png, context->info);
  const int type = png_get_color_type(png, context->info);
  const bool transparent =
      png_get_valid(png, context->info, PNG_INFO_tRNS) != 0 || (type & PNG_COLOR_MASK_ALPHA) != 0;
  png_set_expand(png);
  if (png_get_bit_depth(png, context->info) == 16) {
    if (!keep_wide) {
      png_set_scale_16(png);
    } else if (std::endian::native == std::endian::little) {
      png_set_swap(png);
    }
  }
  if (transparent && (type & PNG_COLOR_MASK_COLOR) == 0) png_set_gray_to_rgb(png);
  png_set_interlace_handling(png);
  png_read_update_info(png, context->info);
  return true;
}

bool read_pixels(PngContext* context, png_bytep* rows) {
  if (setjmp(png_jmpbuf(context->png))) return false;
  png_read_image(context->png, rows);
  png_read_end(context->png, context->info);
  return true;
}

bool write_picture(PngContext* context, const Raster* raster, png_textp texts, int text_count,
                   int level, png_bytep* rows) {
  png_structp png = context->png;
  if (setjmp(png_jmpbuf(png))) return false;
  constexpr int types[] = {PNG_COLOR_TYPE_GRAY, PNG_COLOR_TYPE_GRAY_ALPHA, PNG_COLOR_TYPE_RGB,
                           PNG_COLOR_TYPE_RGB_ALPHA};
  png_set_write_fn(png, context, write_bytes, flush_bytes);
  png_set_compression_level(png, level);
  // Trying all five filters on each row takes as long as a fast deflate, and filtered photographs
  // hold few repeats longer than runs.
  if (level <= 2) {
    png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_UP);
    png_set_compression_strategy(png, Z_RLE);
  }
  png_set_IHDR(png, context->info, static_cast<png_uint_32>(raster->width),
               static_cast<png_uint_32>(raster->height), raster->wide ? 16 : 8,
               types[raster->channels - 1], PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  if (text_count > 0) png_set_text(png, context->info, texts, text_count);
  png_write_info(png, context->info);
  if (raster->wide && std::endian::native == std::endian::little) png_set_swap(png);
  png_write_image(png, rows);
  png_write_end(png, context->info);
  return true;
}

bool is_ascii(const std::string& text) {
  return std::all_of(text.begin(), text.end(),
                     [](char c) { return static_cast<unsigned char>(c) < 128; });
}

}  // namespace

Raster decode_png(std::span<const uint8_t> bytes, const std::string& name, bool keep_wide,
                  ImageMetadata* metadata) {
  PngReader reader;
  if (reader.png == nullptr || reader.info == nullptr)
    throw Error("Out of memory while reading " + name + ".", Blame::kResource);
  reader.input = bytes;
  const auto damaged = [&] {
    fail_read(name, std::string("damaged PNG (") + reader.message + ")");
  };
  if (!read_header(&reader, keep_wide)) damaged();
  Raster raster;
  const int64_t width = png_get_image_width(reader.png, reader.info);
  const int64_t height = png_get_image_height(reader.png, reader.info);
  check_picture_size(name, width, height);
  raster.width = static_cast<int>(width);
  raster.height = static_cast<int>(height);
  raster.channels = png_get_channels(reader.png, reader.info);
  raster.wide = png_get_bit_depth(reader.png, reader.info) == 16;
  const size_t line = png_get_rowbytes(reader.png, reader.info);
  // zlib shrinks by at most 1032; a header that promises more pixels than the file can hold is
  // refused before memory is taken.
  if (line / 16 * static_cast<size_t>(height) / 1100 > bytes.size())
    fail_read(name, "its header promises " + std::to_string(width) + " x " +
                        std::to_string(height) + " pixels, more than the file can hold");
  std::vector<png_bytep> rows(static_cast<size_t>(height));
  if (raster.wide) {
    raster.words.resize(line / 2 * rows.size());
  } else {
    raster.bytes.resize(line * rows.size());
  }
  auto* base = raster.wide ? reinterpret_cast<png_bytep>(raster.words.data()) : raster.bytes.data();
  for (size_t y = 0; y < rows.size(); ++y) rows[y] = base + y * line;
  if (!read_pixels(&reader, rows.data())) damaged();
  if (metadata != nullptr) {
    png_textp texts = nullptr;
    int count = 0;
    png_get_text(reader.png, reader.info, &texts, &count);
    for (int i = 0; i < count; ++i)
      (*metadata)[texts[i].key] = texts[i].text != nullptr ? texts[i].text : "";
  }
  return raster;
}

std::vector<uint8_t> encode_png(const Raster& raster, const ImageMetadata& metadata, int level) {
  EFFIGY_CHECK(raster.channels >= 1 && raster.channels <= 4);
  EFFIGY_CHECK(raster.width > 0 && raster.height > 0);
  PngWriter writer;
  if (writer.png == nullptr || writer.info == nullptr)
    throw Error("Out of memory while writing a PNG.", Blame::kResource);
  std::vector<png_text> texts;
  for (const auto& [key, value] : metadata) {
    EFFIGY_CHECK(!key.empty() && key.size() < 80 && is_ascii(key));
    png_text text{};
    text.compression = is_ascii(value) ? PNG_TEXT_COMPRESSION_NONE : PNG_ITXT_COMPRESSION_NONE;
    text.key = const_cast<char*>(key.c_str());
    text.text = const_cast<char*>(value.c_str());
    texts.push_back(text);
  }
  const auto* base =
      raster.wide ? reinterpret_cast<const uint8_t*>(raster.words.data()) : raster.bytes.data();
  const size_t line = static_cast<size_t>(raster.width) * static_cast<size_t>(raster.channels) *
                      (raster.wide ? 2 : 1);
  std::vector<png_bytep> rows(static_cast<size_t>(raster.height));
  for (size_t y = 0; y < rows.size(); ++y) rows[y] = const_cast<png_bytep>(base + y * line);
  if (!write_picture(&writer, &raster, texts.data(), static_cast<int>(texts.size()), level,
                     rows.data()))
    throw Error(std::string("Cannot write a PNG: ") + writer.message + ".", Blame::kResource);
  return std::move(writer.output);
}

}  // namespace effigy::detail
