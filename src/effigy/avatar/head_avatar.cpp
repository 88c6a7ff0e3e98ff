#include "effigy/avatar/head_avatar.h"

#include <algorithm>
#include <cmath>

#include "effigy/avatar/kind.h"
#include "effigy/avatar/textures.h"
#include "effigy/base/safetensors.h"
#include "effigy/image/files.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

constexpr int kFormatVersion = 1;
constexpr int kEnvironmentSize = 32;  // cubemap size of the learned light
constexpr const char* kEncoderFile = "encoder.safetensors";

template <typename T>
Tensor tensor(const std::vector<T>& values, std::vector<int64_t> shape) {
  return Tensor::from(std::span<const T>(values), std::move(shape));
}

void write_splats(const Path& path, const HeadAvatar& avatar) {
  const BoundSurfels& s = avatar.surfels;
  const auto n = static_cast<int64_t>(s.count());
  TensorFile file;
  file.metadata = {{"format", "effigy-splats"}, {"kind", "bound textured 2D Gaussians"}};
  file.tensors["triangle"] = tensor(s.triangle, {n});
  file.tensors["barycentric"] = tensor(s.barycentric, {n, 2});
  file.tensors["displacement"] = tensor(s.displacement, {n});
  file.tensors["rotation"] = tensor(s.rotation, {n, 4});
  file.tensors["log_scale"] = tensor(s.log_scale, {n, 2});
  file.tensors["opacity_logit"] = tensor(s.opacity_logit, {n});
  file.tensors["joints"] = tensor(avatar.shape.joints, {avatar.rig.joint_count(), 3});
  write_safetensors(path, file);
}

void read_splats(const Path& path, HeadAvatar& avatar) {
  const TensorFile file = read_safetensors(path);
  BoundSurfels& s = avatar.surfels;
  s.triangle = file.ints("triangle", {-1});
  const auto n = static_cast<int64_t>(s.triangle.size());
  const int triangles = avatar.rig.mesh.triangle_count();
  for (int64_t i = 0; i < n; ++i)
    if (s.triangle[i] < 0 || s.triangle[i] >= triangles)
      throw Error(path.string() + ": tensor 'triangle' names triangle " +
                  std::to_string(s.triangle[i]) + " of " + std::to_string(triangles) +
                  "; train the avatar again.");
  s.barycentric = file.floats("barycentric", {n, 2});
  s.displacement = file.floats("displacement", {n});
  s.rotation = file.floats("rotation", {n, 4});
  s.log_scale = file.floats("log_scale", {n, 2});
  s.opacity_logit = file.floats("opacity_logit", {n});
  avatar.shape.joints = file.floats("joints", {avatar.rig.joint_count(), 3});
}

Json camera_json(const Camera& camera) {
  return {{"width", camera.width}, {"height", camera.height}, {"fx", camera.fx},
          {"fy", camera.fy},       {"cx", camera.cx},         {"cy", camera.cy}};
}

Camera camera_from_json(const Json& json, const Path& file) {
  Camera camera;
  camera.width = json_field<int>(json, "width", file);
  camera.height = json_field<int>(json, "height", file);
  camera.fx = json_field<double>(json, "fx", file);
  camera.fy = json_field<double>(json, "fy", file);
  camera.cx = json_field<double>(json, "cx", file);
  camera.cy = json_field<double>(json, "cy", file);
  if (camera.width < 1 || camera.height < 1 || camera.width > 16384 || camera.height > 16384 ||
      !(camera.fx > 0) || !(camera.fy > 0) || !std::isfinite(camera.cx + camera.cy))
    throw Error(file.string() + ": field 'camera' is impossible; train the avatar again.");
  // The capture's camera looks along -z of a y-up world (docs/conventions.md).
  camera.camera_from_world_rotation = Vec3d(1, -1, -1).asDiagonal();
  return camera;
}

}  // namespace

Track read_track(const Path& path, const Rig& rig) {
  const TensorFile file = read_safetensors(path);
  const auto numbers = file.longs("number", {-1});
  const auto frames = static_cast<int64_t>(numbers.size());
  const int64_t expressions = rig.expression_count, rotations = 3 * rig.joint_count();
  const auto expression = file.floats("expression", {frames, expressions});
  const auto rotation = file.floats("joint_rotation", {frames, rotations});
  const auto translation = file.floats("translation", {frames, 3});
  Track track;
  track.numbers = numbers;
  const auto rate = file.metadata.find("frames_per_second");
  if (rate != file.metadata.end())
    track.frames_per_second = std::strtod(rate->second.c_str(), nullptr);
  if (!(track.frames_per_second > 0 && track.frames_per_second < 1000))
    track.frames_per_second = 25;
  for (int64_t f = 0; f < frames; ++f) {
    RigPose pose;
    pose.expression.assign(expression.begin() + f * expressions,
                           expression.begin() + (f + 1) * expressions);
    pose.joint_rotation.assign(rotation.begin() + f * rotations,
                               rotation.begin() + (f + 1) * rotations);
    std::copy_n(translation.begin() + f * 3, 3, pose.translation.begin());
    track.poses.push_back(std::move(pose));
  }
  return track;
}

void write_track(const Path& path, const Track& track, const Rig& rig) {
  std::vector<float> expression, rotation, translation;
  for (const RigPose& pose : track.poses) {
    expression.insert(expression.end(), pose.expression.begin(), pose.expression.end());
    rotation.insert(rotation.end(), pose.joint_rotation.begin(), pose.joint_rotation.end());
    translation.insert(translation.end(), pose.translation.begin(), pose.translation.end());
  }
  const auto frames = static_cast<int64_t>(track.poses.size());
  TensorFile file;
  file.metadata = {{"format", "effigy-track"},
                   {"rig", rig.kind},
                   {"frames_per_second", std::to_string(track.frames_per_second)}};
  file.tensors["number"] = tensor(track.numbers, {frames});
  file.tensors["expression"] = tensor(expression, {frames, rig.expression_count});
  file.tensors["joint_rotation"] = tensor(rotation, {frames, 3 * rig.joint_count()});
  file.tensors["translation"] = tensor(translation, {frames, 3});
  write_safetensors(path, file);
}

HeadAvatar read_head_avatar(const Path& folder) {
  const Path file = folder / "avatar.json";
  HeadAvatar avatar;
  avatar.info = read_avatar_json(folder);
  const auto kind = json_field<std::string>(avatar.info, "kind", file);
  if (kind != "head")
    throw Error(file.string() + ": field 'kind' is '" + kind + "', a head avatar is needed here.");
  avatar.display =
      display_transform_from_name(json_field_or<std::string>(avatar.info, "display", file, "srgb"));
  avatar.camera = camera_from_json(json_field<Json>(avatar.info, "camera", file), file);
  const Json bind = json_field_or<Json>(avatar.info, "bind", file, Json::object());
  avatar.bind.interpolated_normals = json_field_or(bind, "interpolated_normals", file, false);
  avatar.bind.splat_normal_frame = json_field_or(bind, "splat_normal_frame", file, false);
  avatar.rig = read_rig(folder / "rig.safetensors");
  avatar.shape = shape_rig(avatar.rig, {});
  read_splats(folder / "splats.safetensors", avatar);
  avatar.material = read_material(folder / "textures");
  avatar.environment =
      cubemap_from_equirectangular(read_environment(folder / "environment.exr"), kEnvironmentSize);
  if (std::filesystem::exists(folder / kEncoderFile))
    avatar.encoder = read_frame_encoder(folder / kEncoderFile, avatar.rig);
  if (std::filesystem::is_directory(folder / "tracks"))
    for (const auto& entry : std::filesystem::directory_iterator(folder / "tracks"))
      if (entry.path().extension() == ".safetensors")
        avatar.tracks[entry.path().stem().string()] = read_track(entry.path(), avatar.rig);
  return avatar;
}

void write_head_avatar(const HeadAvatar& avatar, const Path& folder) {
  make_folder(folder / "textures");
  make_folder(folder / "tracks");
  write_rig(folder / "rig.safetensors", avatar.rig);
  write_splats(folder / "splats.safetensors", avatar);
  write_material(folder / "textures", avatar.material);
  write_exr(
      folder / "environment.exr",
      equirectangular_from_cubemap(avatar.environment, 8 * kEnvironmentSize, 4 * kEnvironmentSize),
      false);
  if (avatar.encoder) {
    write_frame_encoder(folder / kEncoderFile, *avatar.encoder);
  } else {
    std::error_code ignored;  // of an avatar that was here before
    std::filesystem::remove(folder / kEncoderFile, ignored);
  }
  for (const auto& [name, track] : avatar.tracks)
    write_track(folder / "tracks" / (name + ".safetensors"), track, avatar.rig);
  Json info = avatar.info.is_object() ? avatar.info : Json::object();
  info["format"] = "effigy-avatar";
  info["version"] = kFormatVersion;
  info["kind"] = "head";
  info["rig"] = {{"kind", avatar.rig.kind}, {"licence", avatar.rig.licence}};
  info["display"] = to_string(avatar.display);
  info["camera"] = camera_json(avatar.camera);
  info["bind"] = {{"interpolated_normals", avatar.bind.interpolated_normals},
                  {"splat_normal_frame", avatar.bind.splat_normal_frame}};
  info["surfels"] = avatar.surfels.count();
  write_json(folder / "avatar.json", info);
}

RigPose retarget(const RigPose& pose, const Rig& from, const Rig& to) {
  RigPose out = RigPose::rest(to);
  for (int e = 0; e < from.expression_count; ++e) {
    const int target = to.expression(from.expression_names[e]);
    if (target >= 0) out.expression[target] = pose.expression[e];
  }
  for (int j = 0; j < from.joint_count(); ++j) {
    const int target = to.joint(from.joint_names[j]);
    if (target >= 0)
      std::copy_n(pose.joint_rotation.begin() + 3 * j, 3, out.joint_rotation.begin() + 3 * target);
  }
  out.translation = pose.translation;
  return out;
}

}  // namespace effigy
