// MakeHuman's base mesh with its default rig and weights.

#include <algorithm>
#include <cmath>
#include <map>

#include "effigy/base/error.h"
#include "effigy/base/json.h"
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
      throw Error(file + ": joint '" + name + "' names no vertices.");
    Vec3d sum = Vec3d::Zero();
    for (const Json& v : list) {
      if (!v.is_number_integer() || v.get<int64_t>() < 0 || v.get<int64_t>() >= mesh.vertex_count())
        throw Error(file + ": joint '" + name + "' names a vertex that base.obj does not have.");
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
      throw Error(file + ": bone '" + name + "' has no head joint.");
    number[name] = static_cast<int>(source.joints.size());
    source.joints.push_back({name, -1, places.at(head.get<std::string>())});
  }
  for (const auto& [name, bone] : bones.items()) {
    const Json& parent = field(bone, "parent", file);
    if (parent.is_null()) continue;
    if (!parent.is_string() || number.count(parent.get<std::string>()) == 0)
      throw Error(file + ": bone '" + name + "' has a parent that does not exist.");
    source.joints[static_cast<size_t>(number[name])].parent = number[parent.get<std::string>()];
  }
}

// The body's faces and the vertices they use; old number of each vertex in `kept`.
void keep_body(const Mesh& whole, const std::string& file, people::UserSource& source,
               std::vector<int>& kept) {
  int body = -1;
  for (size_t p = 0; p < whole.parts.size(); ++p)
    if (whole.parts[p] == "body") body = static_cast<int>(p);
  if (body < 0) throw Error(file + ": has no group 'body'; use MakeHuman's own base.obj.");
  if (whole.uv_triangles.empty())
    throw Error(file + ": the mesh has no UVs; use MakeHuman's own base.obj.");
  std::vector<int> number(static_cast<size_t>(whole.vertex_count()), -1),
      uv_number(whole.uvs.size(), -1);
  for (size_t f = 0; f < whole.triangles.size(); ++f) {
    if (whole.triangle_part[f] != body) continue;
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
    source.mesh.triangle_part.push_back(0);
  }
  source.mesh.parts = {"skin"};
}

}  // namespace

UserBody read_makehuman_body(const Path& folder, const Path& skin, int texture_size) {
  const Path obj = folder / "3dobjs" / "base.obj", skeleton = folder / "rigs" / "default.mhskel";
  const Path weights = folder / "rigs" / "default_weights.mhw";
  const Mesh whole = read_obj(obj);
  people::UserSource source;
  source.file = folder.string();
  std::vector<int> kept;
  keep_body(whole, obj.string(), source, kept);
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
  people::UserMaterial material;
  material.name = "skin";
  material.roughness = 0.5f;
  if (skin.empty())
    material.colour = Vec4f(0.50f, 0.315f, 0.230f, 1);
  else
    material.texture = read_image8(skin);
  source.materials.push_back(std::move(material));
  return people::finish_user_body(std::move(source), "makehuman", "CC0-1.0", texture_size);
}

}  // namespace effigy
