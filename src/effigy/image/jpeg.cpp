#include <cstdio>
// jpeglib.h needs size_t and FILE first.
#include <jerror.h>
#include <jpeglib.h>

#include <csetjmp>
#include <cstdlib>

#include "effigy/base/error.h"
#include "effigy/image/codecs.h"

// libjpeg reports errors by longjmp: functions that call setjmp here own nothing with a destructor.
namespace effigy {
namespace {

struct JpegErrors {
  jpeg_error_mgr manager;  // first: libjpeg hands back a pointer to it
  std::jmp_buf jump;
  char message[JMSG_LENGTH_MAX];
};

[[noreturn]] void on_error(j_common_ptr jpeg) {
  auto* errors = reinterpret_cast<JpegErrors*>(jpeg->err);
  jpeg->err->format_message(jpeg, errors->message);
  std::longjmp(errors->jump, 1);
}

// Missing data is an error; other warnings (stray bytes) are not.
void on_message(j_common_ptr jpeg, int level) {
  if (level < 0 && (jpeg->err->msg_code == JWRN_HIT_MARKER || jpeg->err->msg_code == JWRN_JPEG_EOF))
    on_error(jpeg);
}

// A few bytes can describe thousands of scans over a huge picture.
void on_progress(j_common_ptr jpeg) {
  if (jpeg->is_decompressor && reinterpret_cast<j_decompress_ptr>(jpeg)->input_scan_number > 200)
    ERREXIT(jpeg, JERR_BAD_LENGTH);
}

void set_errors(JpegErrors* errors) {
  jpeg_std_error(&errors->manager);
  errors->manager.error_exit = on_error;
  errors->manager.emit_message = on_message;
  errors->message[0] = 0;
}

struct JpegReader {
  jpeg_decompress_struct jpeg{};
  JpegErrors errors{};
  jpeg_progress_mgr progress{};
  ~JpegReader() { jpeg_destroy_decompress(&jpeg); }
};

bool read_header(JpegReader* reader, const uint8_t* bytes, size_t size) {
  if (setjmp(reader->errors.jump)) return false;
  jpeg_create_decompress(&reader->jpeg);
  reader->progress.progress_monitor = on_progress;
  reader->jpeg.progress = &reader->progress;
  jpeg_mem_src(&reader->jpeg, bytes, size);
  jpeg_read_header(&reader->jpeg, TRUE);
  if (reader->jpeg.num_components == 1) {
    reader->jpeg.out_color_space = JCS_GRAYSCALE;
  } else if (reader->jpeg.num_components == 4) {
    reader->jpeg.out_color_space = JCS_CMYK;
  } else {
    reader->jpeg.out_color_space = JCS_RGB;
  }
  jpeg_calc_output_dimensions(&reader->jpeg);
  return true;
}

bool read_pixels(JpegReader* reader, uint8_t* out, size_t line) {
  if (setjmp(reader->errors.jump)) return false;
  jpeg_start_decompress(&reader->jpeg);
  while (reader->jpeg.output_scanline < reader->jpeg.output_height) {
    JSAMPROW row = out + line * reader->jpeg.output_scanline;
    jpeg_read_scanlines(&reader->jpeg, &row, 1);
  }
  jpeg_finish_decompress(&reader->jpeg);
  return true;
}

struct JpegWriter {
  jpeg_compress_struct jpeg{};
  JpegErrors errors{};
  unsigned char* buffer = nullptr;
  unsigned long size = 0;
  ~JpegWriter() {
    jpeg_destroy_compress(&jpeg);
    std::free(buffer);
  }
};

bool write_picture(JpegWriter* writer, const uint8_t* in, int width, int height, int channels,
                   int quality) {
  if (setjmp(writer->errors.jump)) return false;
  jpeg_create_compress(&writer->jpeg);
  jpeg_mem_dest(&writer->jpeg, &writer->buffer, &writer->size);
  writer->jpeg.image_width = static_cast<JDIMENSION>(width);
  writer->jpeg.image_height = static_cast<JDIMENSION>(height);
  writer->jpeg.input_components = channels;
  writer->jpeg.in_color_space =
      channels == 1 ? JCS_GRAYSCALE : (channels == 3 ? JCS_RGB : JCS_EXT_RGBX);
  jpeg_set_defaults(&writer->jpeg);
  jpeg_set_quality(&writer->jpeg, quality, TRUE);
  writer->jpeg.optimize_coding = TRUE;
  if (quality >= 90) {  // full chroma resolution where quality is asked for
    writer->jpeg.comp_info[0].h_samp_factor = 1;
    writer->jpeg.comp_info[0].v_samp_factor = 1;
  }
  jpeg_start_compress(&writer->jpeg, TRUE);
  const size_t line = static_cast<size_t>(width) * static_cast<size_t>(channels);
  while (writer->jpeg.next_scanline < writer->jpeg.image_height) {
    JSAMPROW row = const_cast<JSAMPROW>(in + line * writer->jpeg.next_scanline);
    jpeg_write_scanlines(&writer->jpeg, &row, 1);
  }
  jpeg_finish_compress(&writer->jpeg);
  return true;
}

// CMYK of Adobe's JPEGs, stored inverted, over paper white.
void rgb_from_inverted_cmyk(std::vector<uint8_t>& pixels) {
  size_t out = 0;
  for (size_t in = 0; in + 3 < pixels.size(); in += 4) {
    const int key = pixels[in + 3];
    for (size_t c = 0; c < 3; ++c)
      pixels[out++] = static_cast<uint8_t>((pixels[in + c] * key + 127) / 255);
  }
  pixels.resize(out);
}

}  // namespace

namespace detail {

Raster decode_jpeg(std::span<const uint8_t> bytes, const std::string& name) {
  JpegReader reader;
  set_errors(&reader.errors);
  reader.jpeg.err = &reader.errors.manager;
  const auto damaged = [&] {
    fail_read(name, std::string("damaged JPEG (") + reader.errors.message + ")");
  };
  if (!read_header(&reader, bytes.data(), bytes.size())) damaged();
  check_picture_size(name, reader.jpeg.output_width, reader.jpeg.output_height);
  Raster raster;
  raster.width = static_cast<int>(reader.jpeg.output_width);
  raster.height = static_cast<int>(reader.jpeg.output_height);
  raster.channels = reader.jpeg.out_color_components;
  const size_t line = static_cast<size_t>(raster.width) * static_cast<size_t>(raster.channels);
  raster.bytes.resize(line * static_cast<size_t>(raster.height));
  if (!read_pixels(&reader, raster.bytes.data(), line)) damaged();
  if (raster.channels == 4) {
    if (!reader.jpeg.saw_Adobe_marker)
      for (uint8_t& value : raster.bytes) value = static_cast<uint8_t>(255 - value);
    rgb_from_inverted_cmyk(raster.bytes);
    raster.channels = 3;
  }
  return raster;
}

}  // namespace detail

std::vector<uint8_t> encode_jpeg(const Image8& image, int quality) {
  EFFIGY_CHECK(image.channels == 1 || image.channels == 3 || image.channels == 4);
  EFFIGY_CHECK(!image.empty() && quality >= 1 && quality <= 100);
  JpegWriter writer;
  set_errors(&writer.errors);
  writer.jpeg.err = &writer.errors.manager;
  if (!write_picture(&writer, image.data.data(), image.width, image.height, image.channels,
                     quality))
    throw Error(std::string("Cannot write a JPEG: ") + writer.errors.message + ".",
                Blame::kResource);
  return {writer.buffer, writer.buffer + writer.size};
}

}  // namespace effigy
