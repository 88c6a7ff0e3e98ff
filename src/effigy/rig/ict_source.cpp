#include "effigy/rig/ict_source.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <map>
#include <string_view>

#include "effigy/base/error.h"
#include "effigy/base/json.h"
#include "effigy/base/npy.h"
#include "effigy/geometry/atlas.h"

namespace effigy::ict {

namespace {

constexpr const char* kNeutral = "generic_neutral_mesh.obj";
constexpr const char* kIndices = "vertex_indices.json";
constexpr const char* kPacked = "ict_shapes_i16.npz";
constexpr size_t kVertices = 26719;
constexpr size_t kIdentities = 20;
constexpr float kMetresPerUnit = 0.01f;
// Vertex ranges of the topology (begin, end), as its authors number them.
constexpr int kMouthSocketRange[2] = {11248, 13294};
constexpr int kEyeSocketLeftRange[2] = {13294, 13678};
constexpr int kEyeSocketRightRange[2] = {13678, 14062};

bool in_range(int v, const int range[2]) {
  return v >= range[0] && v < range[1];
}

bool touches(const Vec3i& f, const int range[2]) {
  return in_range(f[0], range) || in_range(f[1], range) || in_range(f[2], range);
}

// The group of each triangle, -1 for what is left out.
std::vector<int> classify(const Mesh& mesh, const Path& path) {
  const std::map<std::string, int> by_material = {
      {"M_Face", kFace},   {"M_BackHead", kSkull},     {"M_GumsTongue", kGums},
      {"M_Teeth", kTeeth}, {"M_ScleraLeft", kEyeLeft}, {"M_ScleraRight", kEyeRight}};
  std::vector<int> of_part;
  std::vector<bool> seen(kGroupCount, false);
  for (const std::string& part : mesh.parts) {
    const auto found = by_material.find(part);
    of_part.push_back(found == by_material.end() ? -1 : found->second);
    if (found != by_material.end()) seen[static_cast<size_t>(found->second)] = true;
  }
  for (const auto& [material, group] : by_material)
    if (!seen[static_cast<size_t>(group)])
      throw Error(path.string() + ": material " + material +
                  " is missing; take the file as it is in ICT-FaceKit's FaceXModel folder.");
  // The lower neck is the UV island of the back of the head that reaches the open ring.
  const std::vector<int> island = uv_islands(mesh);
  int lowest_island = -1;
  float lowest = 1e30f;
  std::vector<int> group(mesh.triangles.size(), -1);
  for (size_t t = 0; t < group.size(); ++t) {
    const Vec3i& f = mesh.triangles[t];
    group[t] = of_part[static_cast<size_t>(mesh.triangle_part[t])];
    if (group[t] != kSkull) continue;
    if (touches(f, kMouthSocketRange)) group[t] = kMouthSocket;
    if (touches(f, kEyeSocketLeftRange)) group[t] = kEyeSocketLeft;
    if (touches(f, kEyeSocketRightRange)) group[t] = kEyeSocketRight;
    for (int k = 0; k < 3; ++k)
      if (mesh.vertex(f[k]).y() < lowest) {
        lowest = mesh.vertex(f[k]).y();
        lowest_island = island[t];
      }
  }
  for (size_t t = 0; t < group.size(); ++t)
    if (group[t] == kSkull && island[t] == lowest_island) group[t] = kNeck;
  return group;
}

Mesh read_neutral(const Path& path) {
  Mesh mesh = read_obj(path);
  if (mesh.vertices.size() != 3 * kVertices)
    throw Error(path.string() + ": has " + std::to_string(mesh.vertex_count()) +
                " vertices instead of 26719; take the file as it is in ICT-FaceKit's FaceXModel "
                "folder.");
  if (mesh.uv_triangles.empty() || mesh.triangle_part.empty())
    throw Error(path.string() +
                ": has no UVs or no materials; take the file as it is in "
                "ICT-FaceKit's FaceXModel folder.");
  for (float& x : mesh.vertices) x *= kMetresPerUnit;
  const std::vector<int> group = classify(mesh, path);
  Mesh kept;
  kept.vertices = std::move(mesh.vertices);
  kept.uvs = std::move(mesh.uvs);
  kept.parts = {"face", "skull", "neck",     "mouth_socket", "eye_socket_left", "eye_socket_right",
                "gums", "teeth", "eye_left", "eye_right"};
  for (size_t t = 0; t < group.size(); ++t) {
    if (group[t] < 0) continue;
    kept.triangles.push_back(mesh.triangles[t]);
    kept.uv_triangles.push_back(mesh.uv_triangles[t]);
    kept.triangle_part.push_back(group[t]);
  }
  weld_uvs(kept);
  return kept;
}

// The positions of an OBJ file, without the rest of it.
std::vector<float> read_obj_positions(const Path& path) {
  const std::string text = read_text(path);
  std::vector<float> out;
  out.reserve(3 * kVertices);
  for (size_t at = 0; at < text.size();) {
    const size_t end = std::min(text.find('\n', at), text.size());
    if (end - at > 2 && text[at] == 'v' && (text[at + 1] == ' ' || text[at + 1] == '\t')) {
      const char* p = text.data() + at + 2;
      const char* const last = text.data() + end;
      for (int k = 0; k < 3; ++k) {
        while (p < last && (*p == ' ' || *p == '\t' || *p == '+')) ++p;
        double value = 0;
        const auto [next, code] = std::from_chars(p, last, value);
        if (code != std::errc() || !std::isfinite(value))
          throw Error(path.string() + ": vertex " + std::to_string(out.size() / 3 + 1) +
                      " is not three numbers; fetch the file again.");
        p = next;
        out.push_back(static_cast<float>(value));
      }
    }
    at = end + 1;
  }
  if (out.size() != 3 * kVertices)
    throw Error(path.string() + ": has " + std::to_string(out.size() / 3) +
                " vertices, the neutral mesh has 26719; fetch the file again.");
  return out;
}

std::string identity_name(size_t index) {
  const std::string digits = std::to_string(index);
  return "identity" + std::string(3 - digits.size(), '0') + digits;
}

// Shapes by name from the packed file.
class PackedShapes {
 public:
  explicit PackedShapes(const Path& path) : path_(path), arrays_(read_npz(path)) {
    for (const char* name : {"names", "scale", "delta"})
      if (!arrays_.count(name))
        throw Error(path.string() + ": array '" + name + "' is missing; pack the shapes again.");
    names_ = arrays_.at("names").strings();
    scale_ = arrays_.at("scale").doubles();
    const NpyArray& delta = arrays_.at("delta");
    const int64_t count = static_cast<int64_t>(names_.size());
    const std::vector<int64_t> shape = {count, static_cast<int64_t>(kVertices), 3};
    if (delta.kind != 'i' || delta.item_bytes != 2 || delta.shape != shape ||
        scale_.size() != names_.size() ||
        delta.bytes.size() != names_.size() * kVertices * 3 * sizeof(int16_t))
      throw Error(path.string() +
                  ": 'delta' must be int16 [names, 26719, 3] and 'scale' one number "
                  "per name; pack the shapes again.");
    for (const double s : scale_)
      if (!std::isfinite(s))
        throw Error(path.string() + ": 'scale' holds a value that is not finite; pack again.");
  }
  bool has(const std::string& name) const {
    return std::find(names_.begin(), names_.end(), name) != names_.end();
  }
  std::vector<float> shape(const std::string& name) const {
    const size_t index =
        static_cast<size_t>(std::find(names_.begin(), names_.end(), name) - names_.begin());
    if (index == names_.size())
      throw Error(path_.string() + ": shape '" + name + "' is missing; pack the shapes again.");
    std::vector<int16_t> raw(3 * kVertices);
    std::memcpy(raw.data(), arrays_.at("delta").bytes.data() + index * raw.size() * sizeof(int16_t),
                raw.size() * sizeof(int16_t));
    const double scale = scale_[index] * static_cast<double>(kMetresPerUnit);
    std::vector<float> out(raw.size());
    for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<float>(scale * raw[i]);
    return out;
  }

 private:
  Path path_;
  std::map<std::string, NpyArray> arrays_;
  std::vector<std::string> names_;
  std::vector<double> scale_;
};

std::vector<float> obj_shape(const Path& path, const Mesh& neutral) {
  std::vector<float> out = read_obj_positions(path);
  for (size_t i = 0; i < out.size(); ++i) out[i] = out[i] * kMetresPerUnit - neutral.vertices[i];
  return out;
}

}  // namespace

Path find_folder(const Path& folder) {
  std::error_code ignored;
  for (const Path& place : {folder, folder / "FaceXModel"})
    if (std::filesystem::is_regular_file(place / kNeutral, ignored)) return place;
  return {};
}

Source read_source(const Path& where) {
  const Path folder = find_folder(where);
  if (folder.empty())
    throw Error(where.string() + ": holds no " + kNeutral +
                "; give the folder of ICT-FaceKit's FaceXModel files.");
  Source source;
  source.mesh = read_neutral(folder / kNeutral);
  const Path indices = folder / kIndices;
  const Json json = read_json(indices);
  source.landmarks = json_field<std::vector<int>>(json, "idx_to_landmark_verts", indices);
  source.expression_names = json_field<std::vector<std::string>>(json, "expressions", indices);
  if (source.landmarks.size() != 68)
    throw Error(indices.string() + ": 'idx_to_landmark_verts' must list 68 vertices.");
  for (const int v : source.landmarks)
    if (v < 0 || v >= static_cast<int>(kVertices))
      throw Error(indices.string() + ": 'idx_to_landmark_verts' names a vertex that is not there.");
  if (source.expression_names.empty() || source.expression_names.size() > 1000)
    throw Error(indices.string() + ": 'expressions' must list the expression names.");
  std::error_code ignored;
  if (std::filesystem::is_regular_file(folder / kPacked, ignored)) {
    const PackedShapes packed(folder / kPacked);
    for (const std::string& name : source.expression_names)
      source.expressions.push_back(packed.shape(name));
    for (size_t i = 0; i < kIdentities && packed.has(identity_name(i)); ++i)
      source.identities.push_back(packed.shape(identity_name(i)));
  } else {
    for (const std::string& name : source.expression_names) {
      if (name.find_first_of("/\\") != std::string::npos)
        throw Error(indices.string() + ": expression '" + name + "' is not a file name.");
      source.expressions.push_back(obj_shape(folder / (name + ".obj"), source.mesh));
    }
    for (size_t i = 0; i < kIdentities; ++i) {
      const Path path = folder / (identity_name(i) + ".obj");
      if (!std::filesystem::is_regular_file(path, ignored)) break;
      source.identities.push_back(obj_shape(path, source.mesh));
    }
  }
  if (source.identities.empty())
    throw Error(folder.string() + ": holds no identity shapes (" + kPacked +
                " or identity000.obj, ...); fetch them from ICT-FaceKit.");
  return source;
}

}  // namespace effigy::ict
