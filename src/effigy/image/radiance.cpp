// Radiance RGBE pictures (.hdr), Ward, "Real Pixels", Graphics Gems II: a text header, a resolution
// line, and scanlines of shared-exponent pixels, run-length coded a component at a time.
#include <charconv>
#include <cmath>
#include <cstring>
#include <string_view>

#include "effigy/image/codecs.h"

namespace effigy::detail {
namespace {

class Cursor {
 public:
  Cursor(std::span<const uint8_t> bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  uint8_t next() {
    if (at_ >= bytes_.size()) fail_read(name_, "damaged Radiance picture (it ends too early)");
    return bytes_[at_++];
  }
  // Up to the end of line, which is consumed.
  std::string_view line() {
    const size_t begin = at_;
    while (next() != '\n')
      if (at_ - begin > 4096) fail_read(name_, "damaged Radiance picture (endless header line)");
    return {reinterpret_cast<const char*>(bytes_.data()) + begin, at_ - begin - 1};
  }
  size_t left() const { return bytes_.size() - at_; }
  uint8_t peek(size_t ahead) const { return bytes_[at_ + ahead]; }

 private:
  std::span<const uint8_t> bytes_;
  const std::string& name_;
  size_t at_ = 0;
};

// How the file walks over the picture: first (slow) axis, then second (fast) axis.
struct Resolution {
  int slow = 0, fast = 0;
  bool slow_is_y = true, slow_positive = false, fast_positive = true;
};

Resolution parse_resolution(std::string_view line, const std::string& name) {
  Resolution resolution;
  const auto damaged = [&] {
    fail_read(name, "damaged Radiance picture (unusable resolution line)");
  };
  const auto axis = [&](bool& is_y, bool& positive, int& length) {
    while (!line.empty() && line.front() == ' ') line.remove_prefix(1);
    if (line.size() < 4 || (line[0] != '+' && line[0] != '-') || (line[1] != 'X' && line[1] != 'Y'))
      damaged();
    positive = line[0] == '+';
    is_y = line[1] == 'Y';
    line.remove_prefix(2);
    while (!line.empty() && line.front() == ' ') line.remove_prefix(1);
    const auto [end, error] = std::from_chars(line.data(), line.data() + line.size(), length);
    if (error != std::errc()) damaged();
    line.remove_prefix(static_cast<size_t>(end - line.data()));
  };
  bool fast_is_y = false;
  axis(resolution.slow_is_y, resolution.slow_positive, resolution.slow);
  axis(fast_is_y, resolution.fast_positive, resolution.fast);
  if (fast_is_y == resolution.slow_is_y) damaged();
  check_picture_size(name, resolution.fast, resolution.slow, kMaxFloatPixels);
  return resolution;
}

// Run-length coding of old files: a pixel 1 1 1 n repeats the one before.
void read_old_scanline(Cursor& cursor, std::vector<uint8_t>& rgbe, const std::string& name) {
  size_t filled = 0;
  int shift = 0;
  while (filled < rgbe.size()) {
    uint8_t pixel[4];
    for (uint8_t& value : pixel) value = cursor.next();
    if (pixel[0] == 1 && pixel[1] == 1 && pixel[2] == 1) {
      const size_t count = shift <= 24 ? static_cast<size_t>(pixel[3]) << shift : 0;
      if (filled == 0 || count > (rgbe.size() - filled) / 4 || shift > 24)
        fail_read(name, "damaged Radiance picture (run over the end of a line)");
      for (size_t i = 0; i < 4 * count; ++i) rgbe[filled + i] = rgbe[filled - 4 + i % 4];
      filled += 4 * count;
      shift += 8;
    } else {
      std::memcpy(rgbe.data() + filled, pixel, 4);
      filled += 4;
      shift = 0;
    }
  }
}

void read_scanline(Cursor& cursor, std::vector<uint8_t>& rgbe, const std::string& name) {
  const size_t width = rgbe.size() / 4;
  const bool coded = width >= 8 && width < 32768 && cursor.left() >= 4 && cursor.peek(0) == 2 &&
                     cursor.peek(1) == 2 && cursor.peek(2) < 128;
  if (!coded) return read_old_scanline(cursor, rgbe, name);
  cursor.next();
  cursor.next();
  const size_t high = cursor.next();
  if (high * 256 + cursor.next() != width)
    fail_read(name, "damaged Radiance picture (a line of another width)");
  for (size_t c = 0; c < 4; ++c) {
    size_t x = 0;
    while (x < width) {
      size_t count = cursor.next();
      const bool run = count > 128;
      if (run) count -= 128;
      if (count == 0 || count > width - x)
        fail_read(name, "damaged Radiance picture (run over the end of a line)");
      uint8_t value = run ? cursor.next() : uint8_t{0};
      for (size_t i = 0; i < count; ++i, ++x) {
        if (!run) value = cursor.next();
        rgbe[4 * x + c] = value;
      }
    }
  }
}

}  // namespace

Image decode_radiance(std::span<const uint8_t> bytes, const std::string& name) {
  Cursor cursor(bytes, name);
  cursor.line();  // #?RADIANCE or #?RGBE
  double exposure = 1.0;
  for (std::string_view line = cursor.line(); !line.empty() && line != "\r"; line = cursor.line()) {
    if (line.starts_with("FORMAT=") && line.find("32-bit_rle_rgbe") == std::string_view::npos)
      fail_read(name, "it is a Radiance picture in XYZ, only RGB is read", "convert it to RGBE");
    if (line.starts_with("EXPOSURE=")) {
      double value = 0.0;
      std::string_view text = line.substr(9);
      while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
      const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
      if (parsed.ec == std::errc() && std::isfinite(value) && value > 0.0) exposure *= value;
    }
  }
  const Resolution resolution = parse_resolution(cursor.line(), name);
  const int width = resolution.slow_is_y ? resolution.fast : resolution.slow;
  const int height = resolution.slow_is_y ? resolution.slow : resolution.fast;
  // A coded line takes at least 4 + 8 bytes for each 127 pixels, an old one 4 bytes for 2^24.
  if (static_cast<size_t>(resolution.slow) * 4 > cursor.left())
    fail_read(name, "damaged Radiance picture (it ends too early)");
  Image image(width, height, 3);
  std::vector<uint8_t> rgbe(static_cast<size_t>(resolution.fast) * 4);
  const auto scale = static_cast<float>(1.0 / exposure);
  for (int i = 0; i < resolution.slow; ++i) {
    read_scanline(cursor, rgbe, name);
    // "-Y": the first line is the top; "+X": the first pixel of a line is the left one.
    const bool slow_forward = resolution.slow_positive != resolution.slow_is_y;
    const bool fast_forward = resolution.fast_positive == resolution.slow_is_y;
    const int slow = slow_forward ? i : resolution.slow - 1 - i;
    for (int j = 0; j < resolution.fast; ++j) {
      const uint8_t* p = rgbe.data() + 4 * static_cast<size_t>(j);
      if (p[3] == 0) continue;
      const int fast = fast_forward ? j : resolution.fast - 1 - j;
      float* out = resolution.slow_is_y ? image.at(fast, slow) : image.at(slow, fast);
      const float unit = std::ldexp(scale, p[3] - (128 + 8));
      for (int c = 0; c < 3; ++c) out[c] = static_cast<float>(p[c]) * unit;
    }
  }
  return image;
}

}  // namespace effigy::detail
