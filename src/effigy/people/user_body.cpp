#include "effigy/people/user_body.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/atlas.h"
#include "effigy/people/body_rig.h"
#include "effigy/people/user_parts.h"

namespace effigy::people {
namespace {

void fill_weights(const UserSource& source, Rig& rig) {
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
      row[joint] += static_cast<float>(static_cast<double>(weight) / sum);
  }
}

void fill_shapes(const UserSource& source, Rig& rig) {
  rig.expression_count = static_cast<int>(source.shapes.size());
  for (const UserShape& shape : source.shapes) {
    rig.expression_names.push_back(shape.name);
    rig.expression_basis.insert(rig.expression_basis.end(), shape.offsets.begin(),
                                shape.offsets.end());
  }
  rig.expression_low.assign(source.shapes.size(), 0.0f);
  rig.expression_high.assign(source.shapes.size(), 1.0f);
}

}  // namespace

void sort_joints(UserSource& source) {
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
  for (auto& row : source.weights)
    for (auto& [joint, weight] : row) joint = number[static_cast<size_t>(joint)];
}

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
  sort_joints(source);
  for (const UserJoint& j : source.joints) {
    rig.joint_names.push_back(j.name);
    rig.parents.push_back(j.parent);
  }
  rig.mesh = std::move(source.mesh);
  check_mesh(rig.mesh, source.file);
  const size_t count = static_cast<size_t>(rig.mesh.vertex_count());
  fill_weights(source, rig);
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
  fill_shapes(source, rig);
  bake_user_maps(source.materials, old_uv, texture_size, body);
  check_rig(rig, source.file);
  return body;
}

}  // namespace effigy::people
