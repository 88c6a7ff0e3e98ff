#include "effigy/base/npy.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/base/half.h"
#include "effigy/base/utf8.h"
#include "effigy/base/zip_archive.h"

namespace effigy {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr size_t kMostDimensions = 32;
constexpr int64_t kMostElements = int64_t{1} << 32;
constexpr int kMostItemBytes = 1 << 20;
constexpr size_t kMostHeader = 1 << 20;
constexpr uint64_t kMostArchiveBytes = uint64_t{4} << 30;

[[noreturn]] void damaged(const std::string& name, const std::string& why) {
  throw Error(name + ": not a readable NumPy array (" + why + "); save it again with numpy.save.");
}

struct ItemType {
  char kind;
  int bytes;
  bool swap;  // stored big-endian
};

// "<f8", "|u1", ">i4", "|S24", "<U4", "|b1"; NumPy's short names "f8", "u4", "b1" too.
ItemType parse_type(const std::string& descr, const std::string& name) {
  std::string text = descr;
  bool big_endian = false;
  if (!text.empty() && std::strchr("<>|=", text[0]) != nullptr) {
    big_endian = text[0] == '>';
    text.erase(0, 1);
  }
  ItemType type{text.empty() ? '?' : text[0], 0, false};
  if (type.kind == 'O') damaged(name, "it holds Python objects, which are not read");
  int64_t size = 0;
  for (size_t i = 1; i < text.size(); ++i) {
    if (text[i] < '0' || text[i] > '9' || i > 8) damaged(name, "unknown type '" + descr + "'");
    size = 10 * size + (text[i] - '0');
  }
  if (text.size() < 2) damaged(name, "unknown type '" + descr + "'");
  const auto one_of = [&](std::initializer_list<int64_t> sizes) {
    return std::find(sizes.begin(), sizes.end(), size) != sizes.end();
  };
  bool known = false;
  switch (type.kind) {
    case 'f':
      known = one_of({2, 4, 8});
      break;
    case 'i':
    case 'u':
      known = one_of({1, 2, 4, 8});
      break;
    case 'b':
      known = size == 1;
      break;
    case 'S':
      known = size >= 1 && size <= kMostItemBytes;
      break;
    case 'U':
      size *= 4;
      known = size >= 1 && size <= kMostItemBytes;
      break;
    default:
      break;
  }
  if (!known) damaged(name, "unsupported type '" + descr + "'");
  type.bytes = static_cast<int>(size);
  type.swap = big_endian && type.kind != 'S' && type.bytes > 1;
  return type;
}

int64_t checked_count(const std::vector<int64_t>& shape, const std::string& name) {
  if (shape.size() > kMostDimensions) damaged(name, "more than 32 dimensions");
  int64_t count = 1;
  bool empty = false;
  for (const int64_t length : shape) {
    if (length < 0) damaged(name, "a negative dimension");
    if (length == 0) empty = true;
    if (length > 0 && count > kMostElements / length) damaged(name, "an impossible shape");
    if (length > 0) count *= length;
  }
  return empty ? 0 : count;
}

void swap_bytes(std::vector<uint8_t>& bytes, size_t unit) {
  for (size_t i = 0; i + unit <= bytes.size(); i += unit)
    std::reverse(bytes.begin() + static_cast<std::ptrdiff_t>(i),
                 bytes.begin() + static_cast<std::ptrdiff_t>(i + unit));
}

// Fortran order (first index fastest) to C order.
std::vector<uint8_t> to_c_order(std::span<const uint8_t> in, const std::vector<int64_t>& shape,
                                size_t item) {
  std::vector<uint8_t> out(in.size());
  const size_t dimensions = shape.size();
  std::vector<int64_t> index(dimensions, 0);
  std::vector<size_t> stride(dimensions, item);
  for (size_t d = 1; d < dimensions; ++d)
    stride[d] = stride[d - 1] * static_cast<size_t>(shape[d - 1]);
  for (size_t at = 0; at < out.size(); at += item) {
    size_t from = 0;
    for (size_t d = 0; d < dimensions; ++d) from += static_cast<size_t>(index[d]) * stride[d];
    std::memcpy(out.data() + at, in.data() + from, item);
    for (size_t d = dimensions; d-- > 0;) {
      if (++index[d] < shape[d]) break;
      index[d] = 0;
    }
  }
  return out;
}

template <typename From, typename To>
void convert(const std::vector<uint8_t>& bytes, std::vector<To>& out) {
  for (size_t i = 0; i < out.size(); ++i) {
    From value;
    std::memcpy(&value, bytes.data() + i * sizeof(From), sizeof(From));
    out[i] = static_cast<To>(value);
  }
}

template <typename To>
std::vector<To> numbers(const NpyArray& a) {
  std::vector<To> out(static_cast<size_t>(a.count()));
  EFFIGY_CHECK_EQ(a.bytes.size(), out.size() * static_cast<size_t>(a.item_bytes));
  const int code = a.kind * 16 + a.item_bytes;
  switch (code) {
    case 'f' * 16 + 4:
      convert<float>(a.bytes, out);
      break;
    case 'f' * 16 + 8:
      convert<double>(a.bytes, out);
      break;
    case 'i' * 16 + 1:
      convert<int8_t>(a.bytes, out);
      break;
    case 'i' * 16 + 2:
      convert<int16_t>(a.bytes, out);
      break;
    case 'i' * 16 + 4:
      convert<int32_t>(a.bytes, out);
      break;
    case 'i' * 16 + 8:
      convert<int64_t>(a.bytes, out);
      break;
    case 'b' * 16 + 1:
    case 'u' * 16 + 1:
      convert<uint8_t>(a.bytes, out);
      break;
    case 'u' * 16 + 2:
      convert<uint16_t>(a.bytes, out);
      break;
    case 'u' * 16 + 4:
      convert<uint32_t>(a.bytes, out);
      break;
    case 'u' * 16 + 8:
      convert<uint64_t>(a.bytes, out);
      break;
    case 'f' * 16 + 2:
      for (size_t i = 0; i < out.size(); ++i) {
        uint16_t bits;
        std::memcpy(&bits, a.bytes.data() + 2 * i, 2);
        out[i] = static_cast<To>(half_to_double(bits));
      }
      break;
    default:
      throw Error("A NumPy array holds text where numbers are expected; use another file.");
  }
  return out;
}

// The header: a Python dictionary with exactly the keys descr, fortran_order and shape.
class HeaderParser {
 public:
  HeaderParser(std::string_view text, const std::string& name) : text_(text), name_(name) {}

  void parse() {
    expect('{');
    while (!accept('}')) {
      const std::string key = quoted();
      expect(':');
      if (key == "descr") {
        if (peek() == '[') damaged(name_, "structured types are not read");
        descr = quoted();
        ++found_;
      } else if (key == "fortran_order") {
        fortran_order = boolean();
        ++found_;
      } else if (key == "shape") {
        read_shape();
        ++found_;
      } else {
        damaged(name_, "unknown header field '" + key + "'");
      }
      if (!accept(',')) {
        expect('}');
        break;
      }
    }
    if (found_ != 3 || peek() != '\0') damaged(name_, "an incomplete header");
  }

  std::string descr;
  bool fortran_order = false;
  std::vector<int64_t> shape;

 private:
  char peek() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\n')) ++at_;
    return at_ < text_.size() ? text_[at_] : '\0';
  }
  bool accept(char c) {
    if (peek() != c) return false;
    ++at_;
    return true;
  }
  void expect(char c) {
    if (!accept(c)) damaged(name_, "a header that is not a dictionary");
  }
  std::string quoted() {
    const char quote = peek();
    if (quote != '\'' && quote != '"') damaged(name_, "a header that is not a dictionary");
    const size_t end = text_.find(quote, at_ + 1);
    if (end == std::string_view::npos) damaged(name_, "a header that is not a dictionary");
    const std::string value(text_.substr(at_ + 1, end - at_ - 1));
    at_ = end + 1;
    return value;
  }
  bool boolean() {
    peek();
    for (const std::string_view word : {"True", "False"})
      if (text_.substr(at_, word.size()) == word) {
        at_ += word.size();
        return word == "True";
      }
    damaged(name_, "a fortran_order that is neither True nor False");
  }
  void read_shape() {
    expect('(');
    while (!accept(')')) {
      int64_t length = 0;
      int digits = 0;
      for (char c = peek(); c >= '0' && c <= '9' && digits < 12;
           c = at_ < text_.size() ? text_[at_] : '\0') {
        length = 10 * length + (c - '0');
        ++at_;
        ++digits;
      }
      accept('L');  // Python 2 writes long integers so
      if (digits == 0 || digits >= 12 || shape.size() >= kMostDimensions)
        damaged(name_, "an impossible shape");
      shape.push_back(length);
      if (!accept(',')) {
        expect(')');
        break;
      }
    }
  }

  std::string_view text_;
  const std::string& name_;
  size_t at_ = 0;
  int found_ = 0;
};

// The header of .npy bytes; returns the offset of the data.
size_t parse_header(std::span<const uint8_t> bytes, const std::string& name, std::string& header) {
  static constexpr uint8_t kMagic[6] = {0x93, 'N', 'U', 'M', 'P', 'Y'};
  if (bytes.size() < 10 || std::memcmp(bytes.data(), kMagic, 6) != 0)
    damaged(name, "it does not begin like one");
  const int version = bytes[6];
  if (version < 1 || version > 3) damaged(name, "unknown version " + std::to_string(version));
  const size_t width = version == 1 ? 2 : 4;
  if (bytes.size() < 8 + width) damaged(name, "truncated");
  size_t length = 0;
  for (size_t i = 0; i < width; ++i) length |= size_t{bytes[8 + i]} << (8 * i);
  const size_t start = 8 + width;
  if (length > kMostHeader || length > bytes.size() - start) damaged(name, "truncated");
  header.assign(reinterpret_cast<const char*>(bytes.data()) + start, length);
  return start + length;
}

}  // namespace

int64_t NpyArray::count() const {
  int64_t count = 1;
  for (const int64_t length : shape) count *= length;
  return count;
}

std::vector<float> NpyArray::floats() const {
  return numbers<float>(*this);
}
std::vector<double> NpyArray::doubles() const {
  return numbers<double>(*this);
}

std::vector<int64_t> NpyArray::integers() const {
  if (kind != 'i' && kind != 'u' && kind != 'b')
    throw Error("A NumPy array holds no integers where integers are expected; use another file.");
  std::vector<int64_t> values = numbers<int64_t>(*this);
  if (kind == 'u' && item_bytes == 8)
    for (const int64_t value : values)
      if (value < 0) throw Error("A NumPy array holds integers above 2^63 - 1; use another file.");
  return values;
}

std::vector<std::string> NpyArray::strings() const {
  if (kind != 'S' && kind != 'U')
    throw Error("A NumPy array holds numbers where texts are expected; use another file.");
  std::vector<std::string> texts(static_cast<size_t>(count()));
  const size_t item = static_cast<size_t>(item_bytes);
  for (size_t i = 0; i < texts.size(); ++i) {
    const uint8_t* at = bytes.data() + i * item;
    if (kind == 'S') {
      size_t length = item;
      while (length > 0 && at[length - 1] == 0) --length;
      texts[i].assign(reinterpret_cast<const char*>(at), length);
      continue;
    }
    std::vector<uint32_t> codes(item / 4);
    if (!codes.empty()) std::memcpy(codes.data(), at, item);
    while (!codes.empty() && codes.back() == 0) codes.pop_back();
    for (const uint32_t code : codes) append_utf8(code, texts[i]);
  }
  return texts;
}

NpyArray make_npy_array(const std::string& descr, std::vector<int64_t> shape, bool fortran_order,
                        std::span<const uint8_t> memory, const std::string& name) {
  const ItemType type = parse_type(descr, name);
  const int64_t count = checked_count(shape, name);
  // No overflow: at most 2^32 elements of at most 2^20 bytes.
  if (static_cast<uint64_t>(count) * static_cast<uint64_t>(type.bytes) != memory.size())
    damaged(name, "its data are not as long as its shape says");
  NpyArray array;
  array.shape = std::move(shape);
  array.kind = type.kind;
  array.item_bytes = type.bytes;
  if (fortran_order && array.shape.size() > 1)
    array.bytes = to_c_order(memory, array.shape, static_cast<size_t>(type.bytes));
  else
    array.bytes.assign(memory.begin(), memory.end());
  if (type.swap) swap_bytes(array.bytes, type.kind == 'U' ? 4 : static_cast<size_t>(type.bytes));
  return array;
}

NpyArray parse_npy(std::span<const uint8_t> bytes, const std::string& name) {
  std::string text;
  const size_t start = parse_header(bytes, name, text);
  HeaderParser header(text, name);
  header.parse();
  const ItemType type = parse_type(header.descr, name);
  const uint64_t size =
      static_cast<uint64_t>(checked_count(header.shape, name)) * static_cast<uint64_t>(type.bytes);
  if (size > bytes.size() - start) damaged(name, "truncated");
  return make_npy_array(header.descr, std::move(header.shape), header.fortran_order,
                        bytes.subspan(start, static_cast<size_t>(size)), name);
}

NpyArray read_npy(const Path& path) {
  return parse_npy(read_file(path), path.string());
}

std::map<std::string, NpyArray> read_npz(const Path& path) {
  const ZipArchive archive(path, ".npz archive",
                           "check the path, or save it again with numpy.savez");
  std::map<std::string, NpyArray> arrays;
  uint64_t budget = kMostArchiveBytes;
  for (const std::string& name : archive.names()) {
    if (name.size() < 5 || name.compare(name.size() - 4, 4, ".npy") != 0) continue;
    const std::string full_name = path.string() + ": " + name;
    const std::vector<uint8_t> bytes = archive.read(name, budget);
    budget -= bytes.size();
    std::string text;
    parse_header(bytes, full_name, text);
    HeaderParser header(text, full_name);
    header.parse();
    if (header.descr == "|O" || header.descr == "O") continue;
    arrays[name.substr(0, name.size() - 4)] = parse_npy(bytes, full_name);
  }
  return arrays;
}

}  // namespace effigy
