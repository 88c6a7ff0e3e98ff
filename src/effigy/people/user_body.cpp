#include "effigy/people/user_body.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/atlas.h"
#include "effigy/geometry/gutter.h"
#include "effigy/image/colour.h"
#include "effigy/image/resample.h"
#include "effigy/people/body_rig.h"
#include "effigy/people/user_parts.h"

namespace effigy::people {
namespace {

// Parents first, one root: new number of each joint. Adds a root when there are several.
std::vector<int> sort_joints(UserSource& source) {
  std::vector<UserJoint>& joints = source.joints;
  std::vector<int> roots;
  for (size_t j = 0; j < joints.size(); ++j)
    if (joints[j].parent < 0) roots.push_back(static_cast<int>(j));
  if (roots.empty()) throw Error(source.file + ": the skeleton's joints go round in a circle.");
  if (roots.size() > 1) {
    for (const int r : roots)
      joints[static_cast<size_t>(r)].parent = static_cast<int>(joints.size());
    joints.push_back({"root", -1, Vec3d::Zero()});
    roots = {static_cast<int>(joints.size()) - 1};
  }
  std::vector<int> order = roots, number(joints.size(), -1);
  for (size_t i = 0; i < order.size(); ++i)
    for (size_t j = 0; j < joints.size(); ++j)
      if (joints[j].parent == order[i]) order.push_back(static_cast<int>(j));
  if (order.size() != joints.size())
    throw Error(source.file + ": the skeleton's joints go round in a circle.");
  std::vector<UserJoint> sorted;
  for (size_t i = 0; i < order.size(); ++i)
    number[static_cast<size_t>(order[i])] = static_cast<int>(i);
  for (const int j : order) {
    sorted.push_back(joints[static_cast<size_t>(j)]);
    if (sorted.back().parent >= 0)
      sorted.back().parent = number[static_cast<size_t>(sorted.back().parent)];
  }
  joints = std::move(sorted);
  return number;
}

void fill_weights(const UserSource& source, const std::vector<int>& number, Rig& rig) {
  const size_t joints = rig.parents.size(), count = source.weights.size();
  rig.weights.assign(count * joints, 0);
  for (size_t v = 0; v < count; ++v) {
    double sum = 0;
    for (const auto& [joint, weight] : source.weights[v]) {
      if (!(std::isfinite(weight) && weight >= 0))
        throw Error(source.file + ": vertex " + std::to_string(v) +
                    " has a skinning weight that is negative or not finite.");
      sum += static_cast<double>(weight);
    }
    float* row = rig.weights.data() + v * joints;
    if (sum < 1e-6) {
      row[0] = 1;
      continue;
    }
    for (const auto& [joint, weight] : source.weights[v])
      row[number[static_cast<size_t>(joint)]] +=
          static_cast<float>(static_cast<double>(weight) / sum);
  }
}

// The pictures of all materials in the new atlas; `old_uv` by UV vertex of the packed mesh.
void bake(const UserSource& source, const std::vector<Vec2f>& old_uv, int size, UserBody& body) {
  const Mesh& mesh = body.rig.mesh;
  const TexelMap map = texel_map(mesh, size);
  const std::vector<int> from = nearest_shown(map.size, map.triangle);
  body.albedo = Image(size, size, 3);
  body.roughness = Image(size, size, 1, 0.6f);
  body.alpha = Image(size, size, 1, 1.0f);
  std::vector<Image> pictures;
  for (const UserMaterial& m : source.materials) pictures.push_back(to_float(m.texture));
  for (size_t i = 0; i < from.size(); ++i) {
    if (from[i] < 0) continue;
    const size_t s = static_cast<size_t>(from[i]);
    const size_t f = static_cast<size_t>(map.triangle[s]);
    const size_t part = static_cast<size_t>(mesh.triangle_part[f]);
    const UserMaterial& material = source.materials[part];
    const auto corner = [&](int k) { return old_uv[static_cast<size_t>(mesh.uv_triangles[f][k])]; };
    const float b1 = map.barycentric[2 * s], b2 = map.barycentric[2 * s + 1];
    const Vec2f uv = (1 - b1 - b2) * corner(0) + b1 * corner(1) + b2 * corner(2);
    Vec4f colour = material.colour;
    const Image& picture = pictures[part];
    if (!picture.empty()) {
      float c[4] = {1, 1, 1, 1};
      // Textures repeat outside [0, 1].
      const double u = static_cast<double>(uv.x()) - std::floor(static_cast<double>(uv.x()));
      const double v = static_cast<double>(uv.y()) - std::floor(static_cast<double>(uv.y()));
      sample_bilinear(picture, u * picture.width, (1 - v) * picture.height, c);
      if (picture.channels == 1) c[1] = c[2] = c[0];
      for (int k = 0; k < 3; ++k) colour[k] *= linear_from_srgb(c[k]);
      if (picture.channels == 4) colour[3] *= c[3];
    }
    for (int k = 0; k < 3; ++k)
      body.albedo.data[3 * i + static_cast<size_t>(k)] = std::clamp(colour[k], 0.0f, 1.0f);
    body.roughness.data[i] = material.roughness;
    body.alpha.data[i] = std::clamp(colour[3], 0.0f, 1.0f);
  }
}

}  // namespace

UserBody finish_user_body(UserSource source, const std::string& kind, const std::string& licence,
                          int texture_size) {
  if (texture_size < 32 || texture_size > 8192)
    throw Error("The texture size of a body must be 32 to 8192, not " +
                std::to_string(texture_size) + ".");
  if (source.joints.empty())
    throw Error(source.file + ": the mesh has no skeleton; export it with its armature.");
  UserBody body;
  Rig& rig = body.rig;
  rig.kind = kind;
  rig.licence = licence;
  const std::vector<int> number = sort_joints(source);
  for (const UserJoint& j : source.joints) {
    rig.joint_names.push_back(j.name);
    rig.parents.push_back(j.parent);
  }
  rig.mesh = std::move(source.mesh);
  check_mesh(rig.mesh, source.file);
  const size_t count = static_cast<size_t>(rig.mesh.vertex_count());
  fill_weights(source, number, rig);
  rig.joint_regressor.assign(rig.parents.size() * count, 0);
  for (size_t j = 0; j < source.joints.size(); ++j)
    joint_row(rig.mesh, source.joints[j].position, rig.joint_regressor.data() + j * count);
  weld_uvs(rig.mesh);
  const std::vector<Vec2f> old_uv = rig.mesh.uvs;
  try {
    pack_atlas(rig.mesh, {std::vector<float>(rig.mesh.parts.size(), 1.0f), 256});
  } catch (const Error& error) {
    throw Error(source.file + ": its UVs cannot be packed into one atlas (" + error.what() + ")");
  }
  bake(source, old_uv, texture_size, body);
  check_rig(rig, source.file);
  return body;
}

}  // namespace effigy::people
