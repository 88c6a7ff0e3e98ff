// MakeHuman's base mesh with its default rig and weights.

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>

#include "effigy/base/error.h"
#include "effigy/base/json.h"
#include "effigy/base/log.h"
#include "effigy/image/files.h"
#include "effigy/people/user_parts.h"

namespace effigy {
namespace {

constexpr double kMetres = 0.1;  // MakeHuman's unit is the decimetre

const Json& field(const Json& json, const std::string& key, const std::string& file) {
  if (!json.is_object() || !json.contains(key))
    throw Error(file + ": has no '" + key + "'; use MakeHuman's own file.");
  return json.at(key);
}

// Means of the cubes of vertices that mark the joints.
std::map<std::string, Vec3d> joint_places(const Json& skeleton, const Mesh& mesh,
                                          const std::string& file) {
  std::map<std::string, Vec3d> places;
  const Json& joints = field(skeleton, "joints", file);
  if (!joints.is_object()) throw Error(file + ": 'joints' is no object; use MakeHuman's own file.");
  for (const auto& [name, list] : joints.items()) {
    if (!list.is_array() || list.empty())
      throw Error(format("{}: joint '{}' names no vertices.", file, name));
    Vec3d sum = Vec3d::Zero();
    for (const Json& v : list) {
      if (!v.is_number_integer() || v.get<int64_t>() < 0 || v.get<int64_t>() >= mesh.vertex_count())
        throw Error(
            format("{}: joint '{}' names a vertex that base.obj does not have.", file, name));
      sum += mesh.vertex(v.get<int>()).cast<double>();
    }
    places[name] = kMetres * sum / static_cast<double>(list.size());
  }
  return places;
}

void add_bones(const Json& skeleton, const Mesh& mesh, const std::string& file,
               people::UserSource& source, std::map<std::string, int>& number) {
  const auto places = joint_places(skeleton, mesh, file);
  const Json& bones = field(skeleton, "bones", file);
  if (!bones.is_object()) throw Error(file + ": 'bones' is no object; use MakeHuman's own file.");
  for (const auto& [name, bone] : bones.items()) {
    const Json& head = field(bone, "head", file);
    if (!head.is_string() || places.count(head.get<std::string>()) == 0)
      throw Error(format("{}: bone '{}' has no head joint.", file, name));
    number[name] = static_cast<int>(source.joints.size());
    source.joints.push_back({name, -1, places.at(head.get<std::string>())});
  }
  for (const auto& [name, bone] : bones.items()) {
    const Json& parent = field(bone, "parent", file);
    if (parent.is_null()) continue;
    if (!parent.is_string() || number.count(parent.get<std::string>()) == 0)
      throw Error(format("{}: bone '{}' has a parent that does not exist.", file, name));
    source.joints[static_cast<size_t>(number[name])].parent = number[parent.get<std::string>()];
  }
}

struct Piece {
  const char *group, *part;
  Vec4f colour;  // where there is no picture
  float roughness;
};
const Vec4f kSkin(0.50f, 0.315f, 0.230f, 1), kEye(0.55f, 0.53f, 0.50f, 1),
    kTeeth(0.55f, 0.50f, 0.42f, 1), kTongue(0.42f, 0.16f, 0.14f, 1);
// What is filmed of the mesh; the rest helps to fit clothes. A body's mouth and eyes stay shut.
std::vector<Piece> pieces_of(people::UserKind kind) {
  if (kind == people::UserKind::kBody) return {{"body", "skin", kSkin, 0.5f}};
  return {{"body", "skin", kSkin, 0.5f},
          {"helper-l-eye", "eye_left", kEye, 0.15f},
          {"helper-r-eye", "eye_right", kEye, 0.15f},
          {"helper-upper-teeth", "teeth", kTeeth, 0.3f},
          {"helper-lower-teeth", "teeth", kTeeth, 0.3f},
          {"helper-tongue", "tongue", kTongue, 0.4f}};
}

// The faces of the pieces and the vertices they use; old number of each vertex in `kept`.
void keep_pieces(const Mesh& whole, const std::vector<Piece>& pieces, const std::string& file,
                 people::UserSource& source, std::vector<int>& kept) {
  if (whole.uv_triangles.empty())
    throw Error(file + ": the mesh has no UVs; use MakeHuman's own base.obj.");
  std::map<std::string, int> material;
  std::vector<int> material_of(whole.parts.size(), -1);
  for (const Piece& piece : pieces) {
    const auto [found, fresh] =
        material.emplace(piece.part, static_cast<int>(source.materials.size()));
    if (fresh) {
      people::UserMaterial m;
      m.name = piece.part;
      m.colour = piece.colour;
      m.roughness = piece.roughness;
      m.opaque = true;
      source.materials.push_back(std::move(m));
      source.mesh.parts.emplace_back(piece.part);
    }
    for (size_t p = 0; p < whole.parts.size(); ++p)
      if (whole.parts[p] == piece.group) material_of[p] = found->second;
  }
  if (std::find(material_of.begin(), material_of.end(), 0) == material_of.end())
    throw Error(file + ": has no group 'body'; use MakeHuman's own base.obj.");
  std::vector<int> number(static_cast<size_t>(whole.vertex_count()), -1),
      uv_number(whole.uvs.size(), -1);
  for (size_t f = 0; f < whole.triangles.size(); ++f) {
    const int part = material_of[static_cast<size_t>(whole.triangle_part[f])];
    if (part < 0) continue;
    Vec3i t, u;
    for (int k = 0; k < 3; ++k) {
      int& v = number[static_cast<size_t>(whole.triangles[f][k])];
      if (v < 0) {
        v = static_cast<int>(kept.size());
        kept.push_back(whole.triangles[f][k]);
        for (int c = 0; c < 3; ++c)
          source.mesh.vertices.push_back(static_cast<float>(kMetres) *
                                         whole.vertex(kept.back())[c]);
      }
      int& w = uv_number[static_cast<size_t>(whole.uv_triangles[f][k])];
      if (w < 0) {
        w = static_cast<int>(source.mesh.uvs.size());
        source.mesh.uvs.push_back(whole.uvs[static_cast<size_t>(whole.uv_triangles[f][k])]);
      }
      t[k] = v;
      u[k] = w;
    }
    source.mesh.triangles.push_back(t);
    source.mesh.uv_triangles.push_back(u);
    source.mesh.triangle_part.push_back(part);
  }
}

// The expression targets: a line a vertex, its number and offset in decimetres.
void add_shapes(const Path& folder, const std::vector<int>& kept, int vertices,
                people::UserSource& source) {
  if (!std::filesystem::is_directory(folder)) return;
  std::vector<Path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.path().extension() == ".target") files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  for (const Path& file : files) {
    std::vector<Vec3f> offset(static_cast<size_t>(vertices), Vec3f::Zero());
    std::istringstream text(read_text(file));
    std::string line;
    while (std::getline(text, line)) {
      if (line.empty() || line[0] == '#') continue;
      std::istringstream numbers(line);
      int64_t v = -1;
      Vec3f d;
      if (!(numbers >> v >> d[0] >> d[1] >> d[2]) || v < 0 || v >= vertices || !d.allFinite())
        throw Error(file.string() + ": the line '" + line.substr(0, 60) +
                    "' is no vertex of base.obj and its offset; use MakeHuman's own file.");
      offset[static_cast<size_t>(v)] = static_cast<float>(kMetres) * d;
    }
    people::UserShape shape{file.stem().string(), {}};
    for (const int v : kept)
      for (int c = 0; c < 3; ++c) shape.offsets.push_back(offset[static_cast<size_t>(v)][c]);
    source.shapes.push_back(std::move(shape));
  }
}

// The skin that lies in the folder itself; empty: none.
Path skin_in(const Path& folder) {
  std::vector<Path> found;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.path().filename().string().find("diffuse") != std::string::npos)
      found.push_back(entry.path());
  return found.empty() ? Path() : *std::min_element(found.begin(), found.end());
}

}  // namespace

people::UserSource people::read_makehuman(const Path& folder, const Path& skin, UserKind kind) {
  const Path obj = folder / "3dobjs" / "base.obj", skeleton = folder / "rigs" / "default.mhskel";
  const Path weights = folder / "rigs" / "default_weights.mhw";
  const Mesh whole = read_obj(obj);
  people::UserSource source;
  source.file = folder.string();
  std::vector<int> kept;
  keep_pieces(whole, pieces_of(kind), obj.string(), source, kept);
  std::map<std::string, int> number;
  add_bones(read_json(skeleton), whole, skeleton.string(), source, number);
  const Json file = read_json(weights);
  const Json& lists = field(file, "weights", weights.string());
  std::vector<std::vector<std::pair<int, float>>> rows(static_cast<size_t>(whole.vertex_count()));
  if (!lists.is_object())
    throw Error(weights.string() + ": 'weights' is no object; use MakeHuman's own file.");
  for (const auto& [bone, list] : lists.items()) {
    const auto joint = number.find(bone);
    if (joint == number.end() || !list.is_array())
      throw Error(weights.string() + ": has weights of the unknown bone '" + bone + "'.");
    for (const Json& pair : list) {
      if (!pair.is_array() || pair.size() != 2 || !pair[0].is_number_integer() ||
          !pair[1].is_number() || pair[0].get<int64_t>() < 0 ||
          pair[0].get<int64_t>() >= whole.vertex_count())
        throw Error(weights.string() + ": bone '" + bone +
                    "' has an entry that is no (vertex, weight).");
      rows[pair[0].get<size_t>()].emplace_back(joint->second, pair[1].get<float>());
    }
  }
  for (const int v : kept) source.weights.push_back(std::move(rows[static_cast<size_t>(v)]));
  const Path picture = skin.empty() ? skin_in(folder) : skin;
  if (!picture.empty()) {
    source.materials[0].texture = read_image8(picture);
    source.materials[0].colour = Vec4f::Ones();
  }
  if (kind == UserKind::kHead)
    add_shapes(folder / "targets/expression/units/caucasian", kept, whole.vertex_count(), source);
  return source;
}

UserBody read_makehuman_body(const Path& folder, const Path& skin, int texture_size) {
  return people::finish_user_body(people::read_makehuman(folder, skin, people::UserKind::kBody),
                                  "makehuman", "CC0-1.0", texture_size);
}

}  // namespace effigy
