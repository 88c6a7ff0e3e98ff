#include "effigy/image/files.h"

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfRgbaFile.h>
#include <gtest/gtest.h>
#include <png.h>
#include <zlib.h>

#include <cmath>
#include <cstdlib>
#include <cstring>

#include "base/temp_folder.h"
#include "effigy/base/error.h"
#include "effigy/image/metrics.h"
#include "image/pictures.h"
#include "write_avif.h"

namespace effigy {
namespace {

using test::noise_picture;
using test::noise_picture8;
using test::smooth_picture;
using test::TempFolder;

// A PNG of any type, through libpng.
struct AnyPng {
  int width, height, bits, type, interlace;
  std::vector<uint8_t> rows;  // packed as in the file
  int transparent = -1;       // palette entry (or grey value) that is fully transparent
};

void write_any_png(const Path& path, const AnyPng& any) {
  FILE* file = std::fopen(path.c_str(), "wb");
  ASSERT_NE(file, nullptr);
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_init_io(png, file);
  png_set_IHDR(png, info, static_cast<png_uint_32>(any.width), static_cast<png_uint_32>(any.height),
               any.bits, any.type, any.interlace, 0, 0);
  png_color palette[4] = {{10, 20, 30}, {40, 50, 60}, {70, 80, 90}, {255, 0, 128}};
  if (any.type == PNG_COLOR_TYPE_PALETTE) png_set_PLTE(png, info, palette, 4);
  if (any.transparent >= 0) {
    png_byte alpha[4] = {255, 255, 255, 255};
    alpha[any.transparent & 3] = 0;
    png_color_16 grey{};
    grey.gray = static_cast<png_uint_16>(any.transparent);
    png_set_tRNS(png, info, alpha, any.type == PNG_COLOR_TYPE_PALETTE ? 4 : 0, &grey);
  }
  const size_t line = any.rows.size() / static_cast<size_t>(any.height);
  std::vector<png_bytep> rows;
  for (size_t y = 0; y < static_cast<size_t>(any.height); ++y)
    rows.push_back(const_cast<png_bytep>(any.rows.data() + y * line));
  png_set_rows(png, info, rows.data());
  png_write_png(png, info, PNG_TRANSFORM_IDENTITY, nullptr);
  png_destroy_write_struct(&png, &info);
  std::fclose(file);
}

TEST(Png, EightBitRoundTrip) {
  const TempFolder folder;
  for (int channels : {1, 3, 4}) {
    const Image8 image = noise_picture8(13, 9, channels, 1);
    write_png8(folder / "a.png", image, {{"Comment", "synthetic"}, {"Author", "J\xc3\xbcrgen"}});
    const Image8 back = read_image8(folder / "a.png");
    EXPECT_EQ(back.channels, channels);
    EXPECT_EQ(back.data, image.data);
    EXPECT_EQ(decode_image8(encode_png8(image), "memory").data, image.data);
    const auto metadata = read_image_metadata(folder / "a.png");
    EXPECT_EQ(metadata.at("Comment"), "synthetic");
    EXPECT_EQ(metadata.at("Author"), "J\xc3\xbcrgen");
  }
  // Grey with alpha is written as such and read as RGBA.
  const Image8 grey = noise_picture8(5, 4, 2, 2);
  write_png8(folder / "b.png", grey);
  const Image8 back = read_image8(folder / "b.png");
  ASSERT_EQ(back.channels, 4);
  EXPECT_EQ(back.at(3, 2)[0], grey.at(3, 2)[0]);
  EXPECT_EQ(back.at(3, 2)[2], grey.at(3, 2)[0]);
  EXPECT_EQ(back.at(3, 2)[3], grey.at(3, 2)[1]);
}

TEST(Png, SixteenBitRoundTrip) {
  const TempFolder folder;
  for (int channels : {1, 3, 4}) {
    const Image image = noise_picture(13, 9, channels, 3);
    write_png16(folder / "a.png", image);
    const Image back = read_image(folder / "a.png");
    ASSERT_EQ(back.channels, channels);
    for (size_t i = 0; i < image.data.size(); ++i)
      ASSERT_NEAR(back.data[i], image.data[i], 0.5001 / 65535);
    const Image8 rounded = read_image8(folder / "a.png");
    for (size_t i = 0; i < image.data.size(); ++i)
      ASSERT_NEAR(rounded.data[i], image.data[i] * 255.0f, 0.51);
  }
  Image odd(4, 1, 1);
  odd.data = {-1.0f, 7.0f, std::nanf(""), 0.5f};
  write_png16(folder / "b.png", odd);
  const Image back = read_image(folder / "b.png");
  EXPECT_EQ(back.data[0], 0.0f);
  EXPECT_EQ(back.data[1], 1.0f);
  EXPECT_EQ(back.data[2], 0.0f);
  EXPECT_NEAR(back.data[3], 0.5f, 1e-5f);
}

TEST(Png, EveryKind) {
  const TempFolder folder;
  // Palette, 2 bits a pixel: entries 0 1 2 3.
  write_any_png(folder / "p.png", {4, 1, 2, PNG_COLOR_TYPE_PALETTE, 0, {0x1b}});
  Image8 image = read_image8(folder / "p.png");
  ASSERT_EQ(image.channels, 3);
  EXPECT_EQ(image.data, (std::vector<uint8_t>{10, 20, 30, 40, 50, 60, 70, 80, 90, 255, 0, 128}));
  write_any_png(folder / "t.png", {4, 1, 2, PNG_COLOR_TYPE_PALETTE, 0, {0x1b}, 2});
  image = read_image8(folder / "t.png");
  ASSERT_EQ(image.channels, 4);
  EXPECT_EQ(image.at(2, 0)[3], 0);
  EXPECT_EQ(image.at(3, 0)[3], 255);
  // One bit grey.
  write_any_png(folder / "g.png", {8, 2, 1, PNG_COLOR_TYPE_GRAY, 0, {0x80, 0x01}});
  image = read_image8(folder / "g.png");
  ASSERT_EQ(image.channels, 1);
  EXPECT_EQ(image.at(0, 0)[0], 255);
  EXPECT_EQ(image.at(1, 0)[0], 0);
  EXPECT_EQ(image.at(7, 1)[0], 255);
  // Interlaced 16-bit RGB, big-endian in the file.
  AnyPng wide{5, 5, 16, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_ADAM7, std::vector<uint8_t>(5 * 5 * 6)};
  for (size_t i = 0; i < wide.rows.size(); ++i) wide.rows[i] = static_cast<uint8_t>(i * 7);
  write_any_png(folder / "w.png", wide);
  const Image floats = read_image(folder / "w.png");
  const size_t at = static_cast<size_t>((3 * 5 + 2) * 3 + 1);
  EXPECT_NEAR(floats.data[at], (wide.rows[2 * at] * 256 + wide.rows[2 * at + 1]) / 65535.0, 1e-6);
}

TEST(Jpeg, RoundTrip) {
  const TempFolder folder;
  for (int channels : {1, 3}) {
    const Image8 image = to_8bit(smooth_picture(70, 51, channels));
    write_jpeg(folder / "a.jpg", image);
    const Image8 back = read_image8(folder / "a.jpg");
    ASSERT_EQ(back.width, 70);
    ASSERT_EQ(back.height, 51);
    ASSERT_EQ(back.channels, channels);
    EXPECT_GT(psnr(to_float(back), to_float(image)), 38.0);
    EXPECT_EQ(decode_image8(encode_jpeg(image, 92), "memory").data, back.data);
    EXPECT_LT(encode_jpeg(image, 50).size(), encode_jpeg(image, 95).size());
  }
  // A fourth channel is left out.
  Image8 rgba = to_8bit(smooth_picture(16, 16, 4));
  EXPECT_EQ(decode_image8(encode_jpeg(rgba), "memory").channels, 3);
}

TEST(Avif, EightAndTenBits) {
  if (!test::can_write_avif()) GTEST_SKIP() << "libavif was built without an encoder";
  const TempFolder folder;
  for (const int depth : {8, 10})
    for (const bool alpha : {false, true}) {
      const Image picture = smooth_picture(40, 30, alpha ? 4 : 3);
      write_file(folder / "a.avif", test::avif_bytes(to_8bit(picture), depth));
      const Image8 back = read_image8(folder / "a.avif");
      ASSERT_EQ(back.channels, picture.channels);
      EXPECT_GT(psnr(to_float(back), picture), 38.0) << depth;
      EXPECT_GT(psnr(read_image(folder / "a.avif"), picture), 38.0) << depth;
      // Cut short or with a broken start: an error, not a crash.
      auto file = read_file(folder / "a.avif");
      file.resize(file.size() / 2);
      EXPECT_THROW(decode_image8(file, "cut"), Error);
    }
}

TEST(Exr, RoundTripAndMetadata) {
  const TempFolder folder;
  for (int channels = 1; channels <= 4; ++channels) {
    Image image = noise_picture(19, 11, channels, 5);
    for (float& value : image.data) value = 100.0f * value - 3.0f;
    write_exr(folder / "full.exr", image, false, {{"comments", "made by a test"}});
    EXPECT_EQ(read_image(folder / "full.exr").data, image.data);
    EXPECT_EQ(read_image_metadata(folder / "full.exr").at("comments"), "made by a test");
    write_exr(folder / "half.exr", image);
    const Image half = read_image(folder / "half.exr");
    ASSERT_EQ(half.channels, channels);
    for (size_t i = 0; i < image.data.size(); ++i)
      ASSERT_NEAR(half.data[i], image.data[i], 1e-3 * std::fabs(image.data[i]) + 1e-6);
  }
  Image bright(1, 1, 3, 1e9f);
  write_exr(folder / "bright.exr", bright);
  EXPECT_EQ(read_image(folder / "bright.exr").data[0], 65504.0f);
  EXPECT_THROW(read_image8(folder / "bright.exr"), Error);
}

void write_exr_as(const Path& path, const Image& image, Imf::Compression compression,
                  const Imath::V2i& offset, const Imath::Box2i& display, const std::string& layer) {
  Imf::Header header(image.width, image.height);
  header.dataWindow() = {offset, {offset.x + image.width - 1, offset.y + image.height - 1}};
  header.displayWindow() = display;
  header.compression() = compression;
  Imf::FrameBuffer frame;
  const char* names[] = {"R", "G", "B"};
  for (size_t c = 0; c < 3; ++c) {
    header.channels().insert(layer + names[c], Imf::Channel(Imf::FLOAT));
    frame.insert(layer + names[c],
                 Imf::Slice::Make(Imf::FLOAT, image.data.data() + c, header.dataWindow(), 12,
                                  12 * static_cast<size_t>(image.width)));
  }
  Imf::OutputFile file(path.c_str(), header);
  file.setFrameBuffer(frame);
  file.writePixels(image.height);
}

TEST(Exr, OtherPeoplesFiles) {
  const TempFolder folder;
  const Image image = smooth_picture(40, 30, 3);
  const Imath::Box2i whole({0, 0}, {39, 29});
  for (const auto compression : {Imf::DWAA_COMPRESSION, Imf::DWAB_COMPRESSION, Imf::PIZ_COMPRESSION,
                                 Imf::RLE_COMPRESSION, Imf::NO_COMPRESSION}) {
    write_exr_as(folder / "a.exr", image, compression, {0, 0}, whole, "");
    EXPECT_GT(psnr(read_image(folder / "a.exr"), image), 45.0) << compression;
  }
  // Channels of a layer; pixels stored for a part of the picture only, and beyond it.
  write_exr_as(folder / "l.exr", image, Imf::ZIP_COMPRESSION, {0, 0}, whole, "beauty.");
  EXPECT_EQ(read_image(folder / "l.exr").data, image.data);
  write_exr_as(folder / "c.exr", image, Imf::ZIP_COMPRESSION, {10, -5}, {{0, 0}, {99, 19}}, "");
  const Image placed = read_image(folder / "c.exr");
  ASSERT_EQ(placed.width, 100);
  ASSERT_EQ(placed.height, 20);
  EXPECT_EQ(placed.at(9, 3)[0], 0.0f);
  EXPECT_EQ(placed.at(12, 3)[1], image.at(2, 8)[1]);
  EXPECT_EQ(placed.at(50, 3)[0], 0.0f);
  // Luminance and chroma.
  std::vector<Imf::Rgba> pixels(40 * 30, Imf::Rgba(0.25f, 0.5f, 1.5f));
  {
    Imf::RgbaOutputFile file((folder / "y.exr").c_str(), 40, 30, Imf::WRITE_YC);
    file.setFrameBuffer(pixels.data(), 1, 40);
    file.writePixels(30);
  }
  const Image chroma = read_image(folder / "y.exr");
  ASSERT_EQ(chroma.channels, 3);
  EXPECT_NEAR(chroma.at(20, 15)[0], 0.25f, 0.01f);
  EXPECT_NEAR(chroma.at(20, 15)[2], 1.5f, 0.02f);
}

std::vector<uint8_t> radiance(const std::string& header, const std::vector<uint8_t>& pixels) {
  std::vector<uint8_t> bytes(header.begin(), header.end());
  bytes.insert(bytes.end(), pixels.begin(), pixels.end());
  return bytes;
}

TEST(Radiance, FlatAndCodedAndTurned) {
  const TempFolder folder;
  const std::string head = "#?RADIANCE\n# by a test\nFORMAT=32-bit_rle_rgbe\n";
  // 2 x 2, flat: (1, .5, .25), 0; 2, (256, 0, 0).
  const std::vector<uint8_t> flat = {128, 64,  32,  129, 0,   0, 0, 0,
                                     128, 128, 128, 130, 128, 0, 0, 137};
  write_file(folder / "a.hdr", radiance(head + "\n-Y 2 +X 2\n", flat));
  Image image = read_image(folder / "a.hdr");
  ASSERT_EQ(image.width, 2);
  EXPECT_EQ(image.data, (std::vector<float>{1, .5f, .25f, 0, 0, 0, 2, 2, 2, 256, 0, 0}));
  // The same upside down, mirrored, turned, and with an exposure.
  write_file(folder / "b.hdr", radiance(head + "\n+Y 2 +X 2\n", flat));
  EXPECT_EQ(read_image(folder / "b.hdr").at(0, 1)[0], 1.0f);
  write_file(folder / "b.hdr", radiance(head + "\n-Y 2 -X 2\n", flat));
  EXPECT_EQ(read_image(folder / "b.hdr").at(1, 0)[0], 1.0f);
  write_file(folder / "b.hdr", radiance(head + "\n+X 2 -Y 2\n", flat));
  image = read_image(folder / "b.hdr");
  EXPECT_EQ(image.at(0, 0)[0], 1.0f);
  EXPECT_EQ(image.at(1, 0)[0], 2.0f);
  EXPECT_EQ(image.at(1, 1)[0], 256.0f);
  write_file(folder / "b.hdr", radiance(head + "EXPOSURE=2\n\n-Y 2 +X 2\n", flat));
  EXPECT_EQ(read_image(folder / "b.hdr").at(0, 0)[0], 0.5f);
  // Old runs: one pixel, then repeat it 7 times.
  write_file(folder / "c.hdr", radiance(head + "\n-Y 1 +X 8\n", {128, 64, 32, 129, 1, 1, 1, 7}));
  EXPECT_EQ(read_image(folder / "c.hdr").at(7, 0)[1], 0.5f);
  // New runs: red a run of 10, the others literal and run.
  std::vector<uint8_t> coded = {2,  2,  0,       10, 128 + 10, 128, 3,        64,
                                64, 64, 128 + 7, 64, 128 + 10, 32,  128 + 10, 129};
  write_file(folder / "d.hdr", radiance(head + "\n-Y 1 +X 10\n", coded));
  image = read_image(folder / "d.hdr");
  for (int x = 0; x < 10; ++x) EXPECT_EQ(image.at(x, 0)[1], 0.5f);
}

TEST(Radiance, HostileFiles) {
  const TempFolder folder;
  const std::string head = "#?RADIANCE\n";
  for (const auto& bytes : {
           radiance(head + "\n-Y 2 +X 2\n", {1, 2, 3}),
           radiance(head + "\n-Y 99999 +X 99999\n", {}),
           radiance(head + "\n-Y 60000 +X 60000\n", {}),
           radiance(head + "\n-Y 0 +X 2\n", {}),
           radiance(head + "\n-Y -4 +X 2\n", {}),
           radiance(head + "\n-Y 2 +Y 2\n", {0, 0, 0, 0}),
           radiance(head + "\nwhatever\n", {}),
           radiance(head + "FORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n", {0, 0, 0, 0}),
           radiance(head + "\n-Y 1 +X 2\n", {1, 1, 1, 200, 0, 0, 0, 0}),
           radiance(head + "\n-Y 1 +X 8\n", {2, 2, 0, 8, 255, 0, 0, 0, 0, 0, 0, 0}),
           radiance(head + "\n-Y 1 +X 8\n", {2, 2, 0, 9, 136, 0, 136, 0, 136, 0, 136, 0}),
           radiance("#?RADIANCE", {}),
       }) {
    write_file(folder / "a.hdr", bytes);
    EXPECT_THROW(read_image(folder / "a.hdr"), Error);
  }
}

// Every prefix and many damaged copies: an Error or a picture, nothing else.
void attack(const std::vector<uint8_t>& good, const Path& path, int tries) {
  const auto read = [&](const std::vector<uint8_t>& bytes) {
    write_file(path, bytes);
    try {
      const Image image = read_image(path);
      EXPECT_FALSE(image.empty());
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find(path.filename().string()), std::string::npos);
    }
  };
  Random random(11);
  for (int i = 0; i < tries; ++i) {
    auto cut = good;
    cut.resize(good.size() * static_cast<size_t>(i) / static_cast<size_t>(tries));
    read(cut);
    auto damaged = good;
    for (uint64_t k = 0; k <= random.below(8); ++k)
      damaged[random.below(i % 2 ? good.size() : std::min<size_t>(good.size(), 200))] =
          static_cast<uint8_t>(random.below(256));
    read(damaged);
  }
}

TEST(Hostile, DamagedFilesOfEveryFormat) {
  const TempFolder folder;
  const Image picture = smooth_picture(33, 21, 3);
  write_png8(folder / "a.png", to_8bit(picture));
  attack(read_file(folder / "a.png"), folder / "x.png", 150);
  write_jpeg(folder / "a.jpg", to_8bit(picture));
  attack(read_file(folder / "a.jpg"), folder / "x.jpg", 150);
  write_exr(folder / "a.exr", picture);
  attack(read_file(folder / "a.exr"), folder / "x.exr", 150);
}

TEST(Hostile, CutFilesAreErrors) {
  const TempFolder folder;
  const Image picture = smooth_picture(64, 64, 3);
  write_png8(folder / "a.png", to_8bit(picture));
  write_jpeg(folder / "a.jpg", to_8bit(picture));
  write_exr(folder / "a.exr", picture);
  for (const char* name : {"a.png", "a.jpg", "a.exr"}) {
    auto bytes = read_file(folder / name);
    bytes.resize(bytes.size() * 3 / 4);
    write_file(folder / name, bytes);
    EXPECT_THROW(read_image(folder / name), Error) << name;
  }
}

TEST(Hostile, BombsAreRefusedAtOnce) {
  const TempFolder folder;
  auto bytes = encode_png8(Image8(8, 8, 3));
  const auto claim = [&](uint32_t width, uint32_t height) {
    const auto put = [&](size_t at, uint32_t value) {
      for (size_t i = 0; i < 4; ++i) bytes[at + i] = static_cast<uint8_t>(value >> (24 - 8 * i));
    };
    put(16, width);
    put(20, height);
    put(29, static_cast<uint32_t>(crc32(0, bytes.data() + 12, 17)));
    write_file(folder / "bomb.png", bytes);
  };
  for (const auto& [width, height] :
       {std::pair{70000u, 10u}, {65536u, 65536u}, {65000u, 8000u}, {0u, 5u}}) {
    claim(width, height);
    EXPECT_THROW(read_image8(folder / "bomb.png"), Error) << width;
  }
  claim(8, 8);
  EXPECT_EQ(read_image8(folder / "bomb.png").width, 8);
}

std::string sentence(const Path& path) {
  try {
    read_image8(path);
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

TEST(Hostile, SentencesNameTheFile) {
  const TempFolder folder;
  EXPECT_NE(sentence(folder / "none.png").find("there is no such file"), std::string::npos);
  write_text(folder / "empty.png", "");
  EXPECT_NE(sentence(folder / "empty.png").find("empty (0 bytes)"), std::string::npos);
  write_text(folder / "text.png", "hello");
  EXPECT_NE(sentence(folder / "text.png").find("it is not a PNG"), std::string::npos);
  EXPECT_NE(sentence(folder / "text.png").find("text.png"), std::string::npos);
}

TEST(Files, RealLightProbes) {
  const char* data = std::getenv("EFFIGY_DATA");
  if (data == nullptr) GTEST_SKIP() << "EFFIGY_DATA is not set";
  int count = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(Path(data) / "hdri")) {
    const auto extension = entry.path().extension();
    if (extension != ".hdr" && extension != ".exr") continue;
    if (entry.file_size() > 8 << 20 || count >= 4) continue;
    const Image image = read_image(entry.path());
    EXPECT_GE(image.channels, 3) << entry.path();
    EXPECT_EQ(image.width, 2 * image.height) << entry.path();
    double sum = 0.0;
    for (float value : image.data) sum += value;
    EXPECT_TRUE(std::isfinite(sum) && sum > 0.0) << entry.path();
    ++count;
  }
  EXPECT_GT(count, 0);
}

}  // namespace
}  // namespace effigy
