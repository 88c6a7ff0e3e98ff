#include "effigy/synth/head_scene.h"

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/synth/subsurface.h"

namespace effigy {
namespace {

constexpr double kFieldOfView = 0.35;  // radians, at a metre
constexpr double kUsualDistance = 1.0;

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

}  // namespace

HeadScene::HeadScene(const SynthHeadOptions& options)
    : rig_(builtin_head_rig(options.subject)), shape_(shape_rig(rig_, {})), seed_(options.seed) {
  // Nearer or farther, the head keeps its size in the picture.
  camera_.width = camera_.height = options.size;
  camera_.fx = camera_.fy = 0.5 * options.size / std::tan(0.5 * kFieldOfView) *
                            std::max(options.distance, 1e-3) / kUsualDistance;
  camera_.cx = camera_.cy = 0.5 * options.size;
  camera_.camera_from_world_rotation = Vec3d(1, -1, -1).asDiagonal();
  Vec3f low = Vec3f::Constant(1e9f), high = -low;
  for (size_t v = 0; v + 2 < shape_.rest.size(); v += 3) {
    low = low.cwiseMin(Vec3f(&shape_.rest[v]));
    high = high.cwiseMax(Vec3f(&shape_.rest[v]));
  }
  offset_ = -0.5f * (low + high);
  offset_.z() = static_cast<float>(-options.distance);
  const int material = scene_.add_material(
      head_material(options.texture_size, options.subject, options.subsurface), "the head");
  scene_.add_mesh(rig_.mesh, material, "the head");
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
