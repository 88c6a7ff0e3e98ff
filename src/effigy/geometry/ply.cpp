#include "effigy/geometry/ply.h"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cstring>
#include <limits>
#include <string_view>
#include <utility>

#include "effigy/base/error.h"

namespace effigy {
namespace {

static_assert(std::endian::native == std::endian::little, "values are little-endian");

constexpr size_t kLargestHeader = size_t{1} << 20;
constexpr size_t kMostProperties = 4096;

enum class Type { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

struct TypeName {
  const char* name;
  Type type;
};
constexpr TypeName kTypes[] = {
    {"char", Type::kInt8},      {"int8", Type::kInt8},     {"uchar", Type::kUint8},
    {"uint8", Type::kUint8},    {"short", Type::kInt16},   {"int16", Type::kInt16},
    {"ushort", Type::kUint16},  {"uint16", Type::kUint16}, {"int", Type::kInt32},
    {"int32", Type::kInt32},    {"uint", Type::kUint32},   {"uint32", Type::kUint32},
    {"float", Type::kFloat},    {"float32", Type::kFloat}, {"double", Type::kDouble},
    {"float64", Type::kDouble},
};

size_t size_of(Type type) {
  switch (type) {
    case Type::kInt8:
    case Type::kUint8:
      return 1;
    case Type::kInt16:
    case Type::kUint16:
      return 2;
    case Type::kDouble:
      return 8;
    default:
      return 4;
  }
}

template <class T>
double load_as(const uint8_t* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof(value));
  return static_cast<double>(value);
}

double load_number(Type type, const uint8_t* bytes) {
  switch (type) {
    case Type::kInt8:
      return load_as<int8_t>(bytes);
    case Type::kUint8:
      return load_as<uint8_t>(bytes);
    case Type::kInt16:
      return load_as<int16_t>(bytes);
    case Type::kUint16:
      return load_as<uint16_t>(bytes);
    case Type::kInt32:
      return load_as<int32_t>(bytes);
    case Type::kUint32:
      return load_as<uint32_t>(bytes);
    case Type::kFloat:
      return load_as<float>(bytes);
    default:
      return load_as<double>(bytes);
  }
}

struct Property {
  std::string name;
  Type type = Type::kFloat;
  bool list = false;
  Type length = Type::kUint8;  // of a list
};

struct Element {
  std::string name;
  size_t count = 0;
  std::vector<Property> properties;
};

class PlyReader {
 public:
  PlyReader(std::vector<uint8_t> bytes, std::string name)
      : name_(std::move(name)), bytes_(std::move(bytes)) {}

  PlyVertices read() {
    read_header();
    bool found = false;
    for (const Element& element : elements_) {
      const bool wanted = element.name == "vertex" && !found;
      found = found || wanted;
      read_element(element, wanted);
    }
    if (!found) fail("has no element 'vertex'");
    if (ascii_)
      while (at_ < bytes_.size() && is_space(bytes_[at_])) ++at_;
    if (at_ != bytes_.size())
      fail("is " + std::to_string(bytes_.size() - at_) + " bytes longer than its header says");
    return std::move(vertices_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw Error(name_ + ": " + what + "; write the PLY file again.");
  }

  static bool is_space(uint8_t c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; }

  // The next line of the header, without its end.
  std::string_view header_line() {
    const auto* text = reinterpret_cast<const char*>(bytes_.data());
    const std::string_view rest(
        text + at_, std::min(bytes_.size(), kLargestHeader) - std::min(at_, kLargestHeader));
    const size_t end = rest.find('\n');
    if (end == std::string_view::npos) fail("has no complete PLY header");
    at_ += end + 1;
    std::string_view line = rest.substr(0, end);
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    return line;
  }

  static std::vector<std::string> words(std::string_view line) {
    std::vector<std::string> result;
    for (size_t at = 0; at < line.size();) {
      const size_t begin = line.find_first_not_of(" \t", at);
      if (begin == std::string_view::npos) break;
      const size_t end = std::min(line.find_first_of(" \t", begin), line.size());
      result.emplace_back(line.substr(begin, end - begin));
      at = end;
    }
    return result;
  }

  Type type_named(const std::string& name) const {
    for (const TypeName& t : kTypes)
      if (name == t.name) return t.type;
    fail("has a property of the unknown type '" + name + "'");
  }

  void read_property(const std::vector<std::string>& line) {
    if (elements_.empty()) fail("has a property before the first element");
    Property property;
    if (line.size() == 3) {
      property.type = type_named(line[1]);
    } else if (line.size() == 5 && line[1] == "list") {
      property.list = true;
      property.length = type_named(line[2]);
      property.type = type_named(line[3]);
      if (property.length == Type::kFloat || property.length == Type::kDouble)
        fail("has a list whose length is not a whole number");
    } else {
      fail("has a property line that is not understood");
    }
    property.name = line.back();
    std::vector<Property>& all = elements_.back().properties;
    for (const Property& p : all)
      if (p.name == property.name) fail("has the property '" + property.name + "' twice");
    if (all.size() == kMostProperties) fail("has too many properties");
    all.push_back(property);
  }

  void read_header() {
    const char magic[] = {'p', 'l', 'y'};
    if (bytes_.size() < 4 || std::memcmp(bytes_.data(), magic, 3) != 0 || header_line() != "ply")
      fail("is not a PLY file");
    bool format = false;
    while (true) {
      const std::string_view text = header_line();
      const std::vector<std::string> line = words(text);
      if (line.empty() || line[0] == "obj_info") continue;
      if (line[0] == "end_header") break;
      if (line[0] == "comment") {
        const size_t begin = text.find_first_not_of(" \t", text.find("comment") + 7);
        vertices_.comments.emplace_back(begin == std::string_view::npos ? "" : text.substr(begin));
      } else if (line[0] == "format" && line.size() == 3) {
        if (line[1] != "ascii" && line[1] != "binary_little_endian")
          fail("has the format '" + line[1] +
               "', and only ascii and binary_little_endian are read");
        ascii_ = line[1] == "ascii";
        format = true;
      } else if (line[0] == "element" && line.size() == 3) {
        Element element;
        element.name = line[1];
        const char* end = line[2].data() + line[2].size();
        const auto [stop, code] = std::from_chars(line[2].data(), end, element.count);
        if (code != std::errc() || stop != end) fail("has a count that is not a number");
        elements_.push_back(element);
      } else if (line[0] == "property") {
        read_property(line);
      } else {
        fail("has the header line '" + line[0].substr(0, 40) + "', which is not understood");
      }
    }
    if (!format) fail("has no format line");
  }

  const uint8_t* take(size_t count) {
    if (bytes_.size() - at_ < count) fail("ends before its last element");
    const uint8_t* bytes = bytes_.data() + at_;
    at_ += count;
    return bytes;
  }

  double number(Type type) {
    if (!ascii_) return load_number(type, take(size_of(type)));
    while (at_ < bytes_.size() && is_space(bytes_[at_])) ++at_;
    const auto* begin = reinterpret_cast<const char*>(bytes_.data()) + at_;
    size_t length = 0;
    while (at_ + length < bytes_.size() && !is_space(bytes_[at_ + length])) ++length;
    if (length == 0) fail("ends before its last element");
    at_ += length;
    const char* end = begin + length;
    if (*begin == '+') ++begin;
    double value = 0;
    const auto [stop, code] = std::from_chars(begin, end, value);
    if (stop != end || (code != std::errc() && code != std::errc::result_out_of_range))
      fail("has '" + std::string(begin, std::min<size_t>(length, 40)) + "' where a number belongs");
    if (code == std::errc::result_out_of_range) value = std::numeric_limits<double>::infinity();
    return value;
  }

  void read_element(const Element& element, bool wanted) {
    // The least that a row takes: refuses absurd counts before anything is allocated.
    size_t least = 0;
    for (const Property& p : element.properties) {
      if (p.list && wanted) fail("has a list in its vertices");
      least += ascii_ ? 2 : size_of(p.list ? p.length : p.type);
    }
    if (element.properties.empty()) {
      if (wanted && element.count > 0) fail("has vertices without properties");
      return;
    }
    if (element.count > (bytes_.size() - at_ + 2) / least) fail("ends before its last element");
    if (wanted) {
      for (const Property& p : element.properties) vertices_.columns.push_back(p.name);
      vertices_.values.reserve(element.count * element.properties.size());
    }
    for (size_t row = 0; row < element.count; ++row) {
      for (const Property& p : element.properties) {
        if (!p.list) {
          const double value = number(p.type);
          if (wanted) vertices_.values.push_back(static_cast<float>(value));
          continue;
        }
        const double length = number(p.length);
        if (!(length >= 0.0 && length <= static_cast<double>(bytes_.size())))
          fail("has a list of impossible length");
        for (size_t k = 0; k < static_cast<size_t>(length); ++k) number(p.type);
      }
    }
  }

  std::string name_;
  std::vector<uint8_t> bytes_;
  size_t at_ = 0;
  bool ascii_ = false;
  std::vector<Element> elements_;
  PlyVertices vertices_;
};

}  // namespace

int PlyVertices::find(const std::string& column) const {
  const auto found = std::find(columns.begin(), columns.end(), column);
  return found == columns.end() ? -1 : static_cast<int>(found - columns.begin());
}

PlyVertices read_ply_vertices(const Path& path) {
  return parse_ply_vertices(read_file(path), path.string());
}
PlyVertices parse_ply_vertices(std::vector<uint8_t> bytes, const std::string& name) {
  return PlyReader(std::move(bytes), name).read();
}

void write_ply_vertices(const Path& path, const PlyVertices& vertices) {
  std::string header = "ply\nformat binary_little_endian 1.0\n";
  for (const std::string& comment : vertices.comments) header += "comment " + comment + "\n";
  header += "element vertex " + std::to_string(vertices.count()) + "\n";
  for (const std::string& column : vertices.columns) header += "property float " + column + "\n";
  header += "end_header\n";
  std::vector<uint8_t> bytes(header.begin(), header.end());
  const auto* values = reinterpret_cast<const uint8_t*>(vertices.values.data());
  bytes.insert(bytes.end(), values, values + vertices.values.size() * sizeof(float));
  write_file(path, bytes);
}

}  // namespace effigy
