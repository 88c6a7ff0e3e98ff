// Wavefront OBJ: positions, UVs and faces; normals, curves and material files are passed over.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <map>
#include <string_view>

#include "effigy/base/error.h"
#include "effigy/geometry/mesh.h"

namespace effigy {
namespace {

constexpr size_t kMostCorners = 4096;  // of one polygon
constexpr const char* kUnnamedPart = "default";

// One corner of a face: 0-based indices, uv -1 when absent.
struct Corner {
  int vertex = -1, uv = -1;
};

class ObjReader {
 public:
  explicit ObjReader(const Path& path) : path_(path), text_(read_text(path)) {}

  Mesh read() {
    std::string joined;
    for (size_t at = 0; at < text_.size();) {
      std::string_view line = next_line(at);
      if (!line.empty() && line.back() == '\\') {  // continued on the next line
        joined.assign(line.substr(0, line.size() - 1));
        while (at < text_.size()) {
          line = next_line(at);
          const bool more = !line.empty() && line.back() == '\\';
          joined += ' ';
          joined.append(line.substr(0, line.size() - (more ? 1 : 0)));
          if (!more) break;
        }
        line = joined;
      }
      read_line(line);
    }
    return finish();
  }

 private:
  std::string_view next_line(size_t& at) {
    const size_t end = std::min(text_.find('\n', at), text_.size());
    std::string_view line(text_.data() + at, end - at);
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    at = end + 1;
    ++line_number_;
    return line;
  }

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(path_.string() + ": line " + std::to_string(line_number_) + ": " + what +
                "; export the OBJ file again.");
  }

  static std::string_view next_word(std::string_view& rest) {
    const size_t begin = std::min(rest.find_first_not_of(" \t"), rest.size());
    rest.remove_prefix(begin);
    const size_t end = std::min(rest.find_first_of(" \t"), rest.size());
    const std::string_view word = rest.substr(0, end);
    rest.remove_prefix(end);
    return word;
  }

  float number(std::string_view& rest) const {
    std::string_view word = next_word(rest);
    if (!word.empty() && word.front() == '+') word.remove_prefix(1);
    double value = 0;
    const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (code != std::errc() || end != word.data() + word.size())
      fail("'" + std::string(word) + "' is not a number");
    const float result = static_cast<float>(value);
    if (!std::isfinite(result)) fail("a coordinate is not a finite number");
    return result;
  }

  // 1-based, or negative from the end of what has been read so far.
  int index(std::string_view word, size_t count, const char* of) const {
    int64_t value = 0;
    const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (code != std::errc() || end != word.data() + word.size())
      fail("'" + std::string(word) + "' is not an index");
    const int64_t size = static_cast<int64_t>(count);
    if (value < 0) value += size + 1;
    if (value < 1 || value > size)
      fail("index '" + std::string(word) + "' is outside the " + std::to_string(count) + " " + of +
           " read so far");
    return static_cast<int>(value - 1);
  }

  Corner corner(std::string_view word) const {
    Corner result;
    const size_t slash = word.find('/');
    result.vertex = index(word.substr(0, slash), mesh_.vertices.size() / 3, "vertices");
    if (slash == std::string_view::npos) return result;
    word.remove_prefix(slash + 1);
    const std::string_view uv = word.substr(0, word.find('/'));
    if (!uv.empty()) result.uv = index(uv, mesh_.uvs.size(), "texture coordinates");
    return result;
  }

  void read_face(std::string_view rest) {
    corners_.clear();
    for (std::string_view word = next_word(rest); !word.empty(); word = next_word(rest)) {
      corners_.push_back(corner(word));
      if (corners_.size() > kMostCorners) fail("a face has more than 4096 corners");
    }
    if (corners_.size() < 3) fail("a face has fewer than 3 corners");
    const bool has_uv = corners_.front().uv >= 0;
    for (const Corner& c : corners_)
      if ((c.uv >= 0) != has_uv) fail("a face has texture coordinates at some corners only");
    if (!mesh_.triangles.empty() && has_uv == mesh_.uv_triangles.empty())
      fail("some faces have texture coordinates and others have none");
    for (size_t i = 2; i < corners_.size(); ++i) {
      mesh_.triangles.emplace_back(corners_[0].vertex, corners_[i - 1].vertex, corners_[i].vertex);
      if (has_uv)
        mesh_.uv_triangles.emplace_back(corners_[0].uv, corners_[i - 1].uv, corners_[i].uv);
      materials_.push_back(material_);
      groups_.push_back(group_);
    }
  }

  static std::string name_of(std::string_view rest) {
    const size_t begin = std::min(rest.find_first_not_of(" \t"), rest.size());
    rest.remove_prefix(begin);
    const size_t end = rest.find_last_not_of(" \t");
    return std::string(rest.substr(0, end == std::string_view::npos ? 0 : end + 1));
  }

  int intern(const std::string& name) {
    if (name.empty()) return -1;
    const auto [entry, is_new] = number_of_name_.try_emplace(name, static_cast<int>(names_.size()));
    if (is_new) names_.push_back(name);
    return entry->second;
  }

  void read_line(std::string_view line) {
    const std::string_view word = next_word(line);
    if (word == "v") {
      for (int axis = 0; axis < 3; ++axis) mesh_.vertices.push_back(number(line));
    } else if (word == "vt") {
      const float u = number(line);
      mesh_.uvs.emplace_back(u, number(line));
    } else if (word == "f") {
      read_face(line);
    } else if (word == "usemtl") {
      material_ = intern(name_of(line));
    } else if (word == "g" || word == "o") {
      group_ = intern(name_of(line));
    }
  }

  Mesh finish() {
    if (mesh_.triangles.empty())
      throw Error(path_.string() + ": the OBJ file has no faces; export it again.");
    const auto named = [](int name) { return name >= 0; };
    const bool by_material = std::any_of(materials_.begin(), materials_.end(), named);
    if (!by_material && std::none_of(groups_.begin(), groups_.end(), named)) return mesh_;
    std::map<int, int> part_of_name;
    for (const int name : by_material ? materials_ : groups_) {
      const auto [entry, is_new] =
          part_of_name.try_emplace(name, static_cast<int>(mesh_.parts.size()));
      if (is_new)
        mesh_.parts.push_back(name < 0 ? kUnnamedPart : names_[static_cast<size_t>(name)]);
      mesh_.triangle_part.push_back(entry->second);
    }
    return mesh_;
  }

  const Path& path_;
  std::string text_;
  size_t line_number_ = 0;
  Mesh mesh_;
  std::vector<Corner> corners_;
  std::map<std::string, int> number_of_name_;
  std::vector<std::string> names_;
  int material_ = -1, group_ = -1;       // numbers of names, -1 for none
  std::vector<int> materials_, groups_;  // per triangle
};

}  // namespace

Mesh read_obj(const Path& path) {
  return ObjReader(path).read();
}

void write_obj(const Path& path, const Mesh& mesh) {
  check_mesh(mesh, path.string());
  std::string text;
  char line[128];
  for (size_t i = 0; i < mesh.vertices.size(); i += 3) {
    std::snprintf(line, sizeof line, "v %.9g %.9g %.9g\n", static_cast<double>(mesh.vertices[i]),
                  static_cast<double>(mesh.vertices[i + 1]),
                  static_cast<double>(mesh.vertices[i + 2]));
    text += line;
  }
  for (const Vec2f& uv : mesh.uvs) {
    std::snprintf(line, sizeof line, "vt %.9g %.9g\n", static_cast<double>(uv.x()),
                  static_cast<double>(uv.y()));
    text += line;
  }
  int part = -1;
  for (size_t f = 0; f < mesh.triangles.size(); ++f) {
    if (!mesh.triangle_part.empty() && mesh.triangle_part[f] != part) {
      part = mesh.triangle_part[f];
      text += "usemtl " + mesh.parts[static_cast<size_t>(part)] + "\n";
    }
    text += "f";
    for (int corner = 0; corner < 3; ++corner) {
      text += " " + std::to_string(mesh.triangles[f][corner] + 1);
      if (!mesh.uv_triangles.empty())
        text += "/" + std::to_string(mesh.uv_triangles[f][corner] + 1);
    }
    text += "\n";
  }
  write_text(path, text);
}

}  // namespace effigy
