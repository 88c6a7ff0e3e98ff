#include "effigy/synth/head_scene.h"

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/people/user_head.h"
#include "effigy/synth/subsurface.h"
#include "effigy/synth/user_material.h"

namespace effigy {
namespace {

constexpr double kFieldOfView = 0.35;  // radians, at a metre
constexpr double kUsualDistance = 1.0;
// Of the user's own head: how much of the picture's height it fills, and how much wider a head is
// that turns.
constexpr double kFilled = 0.86, kTurnedWidth = 1.25;

SurfaceMaterial head_material(int size, uint64_t subject, bool subsurface) {
  HeadMaterials maps = builtin_head_materials(size, subject);
  SurfaceMaterial material;
  material.albedo = std::move(maps.albedo);
  material.roughness = std::move(maps.roughness);
  material.specular = std::move(maps.specular);
  material.normal = std::move(maps.normal);
  if (subsurface) {
    material.scatter = std::move(maps.scatter);
    material.scatter_radius = kSkinScatter;
  }
  return material;
}

// The user's own head; says on standard error what the file had.
SurfaceMaterial users_own(const std::string& file, int size, Rig& rig) {
  UserHead head = read_user_head(file, size);
  rig = std::move(head.look.rig);
  std::string joints;
  for (size_t j = 1; j < rig.joint_names.size(); ++j) joints += " " + rig.joint_names[j];
  log_info(
      format("{}: {} triangles{}, {} expressions ({} with known names), joints{}; no "
             "landmarks, which no file of this kind says",
             file, rig.mesh.triangle_count(), head.cut ? " of head and neck" : "",
             rig.expression_count, head.known_expressions, joints));
  return user_material(std::move(head.look));
}

}  // namespace

HeadScene::HeadScene(const SynthHeadOptions& options) : seed_(options.seed) {
  const bool own = !options.head.empty();
  SurfaceMaterial material;
  if (own) {
    material = users_own(options.head, options.texture_size, rig_);
  } else {
    rig_ = builtin_head_rig(options.subject);
    material = head_material(options.texture_size, options.subject, options.subsurface);
  }
  shape_ = shape_rig(rig_, {});
  Vec3f low = Vec3f::Constant(1e9f), high = -low;
  for (size_t v = 0; v + 2 < shape_.rest.size(); v += 3) {
    low = low.cwiseMin(Vec3f(&shape_.rest[v]));
    high = high.cwiseMax(Vec3f(&shape_.rest[v]));
  }
  offset_ = -0.5f * (low + high);
  offset_.z() = static_cast<float>(-options.distance);
  // Nearer or farther, the head keeps its size in the picture.
  double half = std::tan(0.5 * kFieldOfView);
  if (own) {
    const Vec3d size = (high - low).cast<double>();
    half = 0.5 * std::max(size.y(), kTurnedWidth * size.x()) / kFilled;
    offset_.z() -= 0.5f * (low + high).z();  // files put their origin anywhere
  }
  camera_.width = camera_.height = options.size;
  camera_.fx = camera_.fy =
      0.5 * options.size / half * std::max(options.distance, 1e-3) / kUsualDistance;
  camera_.cx = camera_.cy = 0.5 * options.size;
  camera_.camera_from_world_rotation = Vec3d(1, -1, -1).asDiagonal();
  const std::string name = own ? options.head : "the head";
  scene_.add_mesh(rig_.mesh, scene_.add_material(material, name), name);
}

RigPose HeadScene::performance(double seconds) const {
  RigPose pose = performance_pose(rig_, seconds, seed_);
  for (int c = 0; c < 3; ++c) pose.translation[static_cast<size_t>(c)] += offset_[c];
  return pose;
}

void HeadScene::pose(const RigPose& pose, int frame) {
  pose_vertices(shape_, pose, vertices_);
  try {
    scene_.pose(0, vertices_);
    scene_.commit();
    scene_.check_outside(camera_.center());
  } catch (const Error& error) {
    throw Error("Frame " + std::to_string(frame) + ": " + error.what(), error.blame());
  }
}

}  // namespace effigy
