#include "effigy/splat/scene_file.h"

#include <cstring>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/json.h"
#include "effigy/splat/scene_parts.h"

namespace effigy {

using namespace scene_parts;

namespace {

constexpr size_t kMostSurfels = 10'000'000;
constexpr int kTextureChannels = 7;

constexpr Output kOutputs[] = {
    {"alpha", kAlpha, 1},
    {"depth", kDepth, 1},
    {"material", kAlbedo, 5},
    {"normal", kNormal, 3},
    {"mapped_normal", kMappedNormal, 3},
    {"uv", kUv, 2},
    {"uv_distortion", kUvDistortion, 1},
};

MaterialTexture read_texture(const Json& object, const Path& folder, const Path& file) {
  if (!object.is_object()) refuse(file, "'texture' is missing or not an object.");
  MaterialTexture texture(read_side(object, "width", file), read_side(object, "height", file));
  const Path name = json_field<std::string>(object, "file", file);
  if (name.empty() || name.is_absolute() || name.has_parent_path() || name == "..")
    refuse(file, "'texture.file' must be the name of a file in the scene's folder.");
  const size_t texels = texture.texels.size() / 8;
  const std::vector<float> values = read_floats(folder / name, texels * kTextureChannels);
  for (size_t i = 0; i < texels; ++i)
    std::memcpy(&texture.texels[8 * i], &values[kTextureChannels * i],
                sizeof(float) * kTextureChannels);
  return texture;
}

}  // namespace

SplatSceneKind splat_scene_kind(const Path& folder) {
  const Path file = folder / "scene.json";
  const auto kind = json_field_or<std::string>(read_json(file), "kind", file, "surfels");
  if (kind == "surfels") return SplatSceneKind::kSurfels;
  if (kind == "gaussians") return SplatSceneKind::kGaussians;
  refuse(file, "'kind' is '" + kind + "'; it must be 'surfels' or 'gaussians'.");
}

Camera read_scene_camera(const Path& file) {
  const Json json = read_json(file);
  return read_camera(json.is_object() && json.contains("camera") ? json["camera"] : json, file);
}

SplatScene read_splat_scene(const Path& folder) {
  const Path file = folder / "scene.json";
  const Json json = read_json(file);
  if (!json.is_object()) refuse(file, "must be a JSON object with camera, texture and surfels.");
  SplatScene scene;
  scene.camera = read_camera(json.contains("camera") ? json["camera"] : Json(), file);
  scene.texture = read_texture(json.contains("texture") ? json["texture"] : Json(), folder, file);
  if (!json.contains("surfels") || !json["surfels"].is_array())
    refuse(file, "'surfels' is missing or not an array.");
  const Json& surfels = json["surfels"];
  if (surfels.size() > kMostSurfels)
    refuse(file, "more than " + std::to_string(kMostSurfels) + " surfels cannot be drawn.");
  PosedSurfels& posed = scene.surfels;
  for (size_t i = 0; i < surfels.size(); ++i) {
    const Json& surfel = surfels[i];
    const std::string owner = "surfels[" + std::to_string(i) + "].";
    if (!surfel.is_object()) refuse(file, "'surfels[" + std::to_string(i) + "]' is not an object.");
    append_numbers(surfel, "center", 1, 3, file, owner, posed.center);
    append_numbers(surfel, "s", 1, 3, file, owner, posed.s);
    append_numbers(surfel, "t", 1, 3, file, owner, posed.t);
    append_numbers(surfel, "uv", 1, 2, file, owner, posed.uv);
    append_numbers(surfel, "uv_per_st", 2, 2, file, owner, posed.uv_per_st);
    append_numbers(surfel, "frame", 3, 3, file, owner, posed.frame);
    posed.opacity.push_back(read_opacity(surfel, owner, file));
  }
  return scene;
}

SurfelRasterOptions splat_scene_options() {
  SurfelRasterOptions options;
  options.low_pass = false;
  options.near = 0.01f;
  options.uv_distortion = UvDistortion::kNorm;
  options.uv_distortion_threshold = 0.0f;
  return options;
}

Planes read_splat_upstream(const Path& folder, const Camera& camera) {
  Planes planes(camera.width, camera.height, kGBufferPlanes);
  bool any = false;
  for (const Output& output : kOutputs) any = read_upstream(folder, output, planes) || any;
  if (!any) refuse_without_upstream(folder);
  return planes;
}

void write_splat_outputs(const Path& folder, const Planes& gbuffer) {
  for (const Output& output : kOutputs) write_output(folder, output, gbuffer);
}

void write_splat_gradients(const Path& folder, const PosedSurfels& d_surfels,
                           const std::vector<float>& d_texels) {
  write_floats(folder / "grad_center.f32", d_surfels.center);
  write_floats(folder / "grad_s.f32", d_surfels.s);
  write_floats(folder / "grad_t.f32", d_surfels.t);
  write_floats(folder / "grad_opacity.f32", d_surfels.opacity);
  write_floats(folder / "grad_uv.f32", d_surfels.uv);
  write_floats(folder / "grad_uv_per_st.f32", d_surfels.uv_per_st);
  write_floats(folder / "grad_frame.f32", d_surfels.frame);
  std::vector<float> texture(d_texels.size() / 8 * kTextureChannels);
  for (size_t i = 0; i < d_texels.size() / 8; ++i)
    std::memcpy(&texture[kTextureChannels * i], &d_texels[8 * i], sizeof(float) * kTextureChannels);
  write_floats(folder / "grad_texture.f32", texture);
}

}  // namespace effigy
