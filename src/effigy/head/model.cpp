#include "effigy/head/model.h"

#include <algorithm>
#include <cmath>

#include "effigy/head/encoder_start.h"
#include "effigy/head/frames.h"
#include "effigy/head/silhouette.h"
#include "effigy/head/start_texture.h"

namespace effigy {
namespace {

// Share of `frames` in which each triangle faces the camera.
std::vector<float> triangle_visibility(const Capture& capture, const RigShape& shape,
                                       const std::vector<int>& frames) {
  const auto& triangles = capture.rig.mesh.triangles;
  std::vector<float> seen(triangles.size(), 0.0f), vertices;
  const Vec3f eye = capture.camera.center().cast<float>();
  for (int frame : frames) {
    pose_vertices(shape, capture.poses[frame], vertices);
    const auto vertex = [&](int i) { return Vec3f(&vertices[3 * static_cast<size_t>(i)]); };
    for (size_t t = 0; t < triangles.size(); ++t) {
      const Vec3f a = vertex(triangles[t][0]);
      const Vec3f normal = (vertex(triangles[t][1]) - a).cross(vertex(triangles[t][2]) - a);
      if (normal.dot(eye - a) > 0) seen[t] += 1.0f / static_cast<float>(frames.size());
    }
  }
  return seen;
}

}  // namespace

size_t pose_size(const Rig& rig) {
  return static_cast<size_t>(rig.expression_count) + 3 * rig.joint_count() + 3;
}

void pack_pose(const RigPose& pose, std::span<float> flat) {
  auto at = std::copy(pose.expression.begin(), pose.expression.end(), flat.begin());
  at = std::copy(pose.joint_rotation.begin(), pose.joint_rotation.end(), at);
  std::copy(pose.translation.begin(), pose.translation.end(), at);
}

void unpack_pose(std::span<const float> flat, RigPose& pose) {
  auto at = flat.begin();
  std::copy_n(at, pose.expression.size(), pose.expression.begin());
  at += static_cast<std::ptrdiff_t>(pose.expression.size());
  std::copy_n(at, pose.joint_rotation.size(), pose.joint_rotation.begin());
  at += static_cast<std::ptrdiff_t>(pose.joint_rotation.size());
  std::copy_n(at, 3, pose.translation.begin());
}

UvMask uv_mask(const Mesh& mesh, int size) {
  return UvMask(uv_coverage(mesh, size, 1), size, size, true);
}

HeadModel initial_model(const Capture& capture, const TrainSettings& settings) {
  const std::vector<int> frames = capture.train_frames();
  if (frames.size() < 2)
    throw Error(capture.folder.string() + ": " + std::to_string(frames.size()) +
                " tracked training frame(s), at least 2 are needed; record a longer video or hold "
                "fewer frames out (--test).");
  HeadModel model;
  model.original = shape_rig(capture.rig, capture.identity);
  if (settings.fit_silhouette)
    apply_offsets(capture.rig.mesh,
                  silhouette_offsets(capture, model.original, spread_frames(frames, 40)),
                  model.original);
  model.shape = model.original;
  model.poses = capture.poses;
  if (settings.encoder)
    model.encoder = start_encoder(capture, frames, settings.encoder_codes, settings.encoder_reach);
  std::vector<float> weight =
      triangle_visibility(capture, model.original, spread_frames(frames, 40));
  for (float& w : weight) w = 0.1f + 0.9f * w;
  Mesh mesh = capture.rig.mesh;
  mesh.vertices = model.original.rest;
  model.surfels = sample_surfels(mesh, settings.surfels, settings.seed, weight);
  model.start = model.surfels;
  model.material = make_texture_parameters(uv_mask(mesh, settings.texture_size), {}, {},
                                           TextureLossSettings{}.outside);
  model.environment.assign(static_cast<size_t>(6) * kEnvironmentSize * kEnvironmentSize * 3,
                           std::log(0.7f));
  if (settings.start_from_frames)
    start_from_frames(capture, settings, spread_frames(frames, 40), model);
  return model;
}

Cubemap environment_radiance(const std::vector<float>& log_radiance) {
  Cubemap cubemap(kEnvironmentSize);
  for (size_t i = 0; i < log_radiance.size(); ++i)
    cubemap.texels[i] = std::exp(std::clamp(log_radiance[i], -12.0f, 12.0f));
  return cubemap;
}

}  // namespace effigy
