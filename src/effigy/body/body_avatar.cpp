#include "effigy/body/body_avatar.h"

#include <algorithm>
#include <cmath>

#include "effigy/avatar/kind.h"
#include "effigy/base/error.h"
#include "effigy/geometry/gutter.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/image/resample.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

constexpr int kFormatVersion = 1;

Json camera_json(const Camera& camera) {
  Json rotation = Json::array(), translation = Json::array();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) rotation.push_back(camera.camera_from_world_rotation(r, c));
    translation.push_back(camera.camera_from_world_translation[r]);
  }
  return {{"width", camera.width}, {"height", camera.height},   {"fx", camera.fx},
          {"fy", camera.fy},       {"cx", camera.cx},           {"cy", camera.cy},
          {"rotation", rotation},  {"translation", translation}};
}

Camera camera_from(const Json& json, const Path& file) {
  Camera camera;
  camera.width = json_field<int>(json, "width", file);
  camera.height = json_field<int>(json, "height", file);
  camera.fx = json_field<double>(json, "fx", file);
  camera.fy = json_field<double>(json, "fy", file);
  camera.cx = json_field<double>(json, "cx", file);
  camera.cy = json_field<double>(json, "cy", file);
  const auto rotation = json_field<std::vector<double>>(json, "rotation", file);
  const auto translation = json_field<std::vector<double>>(json, "translation", file);
  bool good = rotation.size() == 9 && translation.size() == 3 && camera.width >= 1 &&
              camera.height >= 1 && camera.width <= 16384 && camera.height <= 16384 &&
              camera.fx > 0 && camera.fy > 0 && std::isfinite(camera.cx + camera.cy);
  if (good) {
    camera.camera_from_world_rotation =
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotation.data());
    camera.camera_from_world_translation = Vec3d(translation.data());
    const Mat3d& r = camera.camera_from_world_rotation;
    good = (r * r.transpose() - Mat3d::Identity()).norm() < 1e-4 && r.determinant() > 0 &&
           camera.camera_from_world_translation.allFinite();
  }
  if (!good) throw Error(file.string() + ": field 'camera' is impossible; train the avatar again.");
  return camera;
}

// One channel more or less, square, of the wanted side.
Image fitted(const Image& image, int side, int channels, const Path& path) {
  if (image.width != image.height || image.width < 8 || image.width > 8192)
    throw Error(path.string() + ": a texture must be square, 8 to 8192 pixels, not " +
                std::to_string(image.width) + "x" + std::to_string(image.height) + "; resize it.");
  Image out(image.width, image.height, channels);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      for (int c = 0; c < channels; ++c)
        out.at(x, y)[c] = image.at(x, y)[image.channels >= 3 ? c : 0];
  return image.width == side ? out : resize(out, side, side);
}

}  // namespace

BodyMapImages to_images(const UvTexels& texels, const BodyMaps& maps) {
  const int side = texels.size;
  std::vector<int32_t> shown(static_cast<size_t>(side) * static_cast<size_t>(side), -1);
  for (size_t i = 0; i < texels.count(); ++i)
    shown[static_cast<size_t>(texels.texel[i])] = static_cast<int32_t>(i);
  const std::vector<int> nearest = nearest_shown(side, shown);
  BodyMapImages images{Image(side, side, 3), Image(side, side, 1)};
  for (size_t p = 0; p < shown.size(); ++p) {
    const auto i = static_cast<size_t>(shown[static_cast<size_t>(nearest[p])]);
    for (size_t c = 0; c < 3; ++c)
      images.albedo.data[3 * p + c] = srgb_from_linear(maps.albedo[3 * i + c]);
    images.roughness.data[p] = std::exp(maps.log_roughness[i]);
  }
  return images;
}

void from_images(const BodyMapImages& images, const UvTexels& texels, BodyMaps& maps) {
  EFFIGY_CHECK(images.albedo.width == texels.size && images.roughness.width == texels.size);
  maps.albedo.resize(3 * texels.count());
  maps.log_roughness.resize(texels.count());
  for (size_t i = 0; i < texels.count(); ++i) {
    const auto p = static_cast<size_t>(texels.texel[i]);
    for (size_t c = 0; c < 3; ++c)
      maps.albedo[3 * i + c] = linear_from_srgb(images.albedo.data[3 * p + c]);
    maps.log_roughness[i] =
        std::log(std::clamp(images.roughness.data[p], kLeastRoughness, kMostRoughness));
  }
}

BodyAvatar read_body_avatar(const Path& folder) {
  const Path file = folder / "avatar.json";
  Json info = read_avatar_json(folder);
  const auto kind = json_field<std::string>(info, "kind", file);
  if (kind != "body")
    throw Error(file.string() + ": field 'kind' is '" + kind + "', a body avatar is needed here.");
  Rig rig = read_rig(folder / "rig.safetensors");
  const TensorFile tensors = read_safetensors(folder / "networks.safetensors");
  BodyModel model(rig.mesh, tensors);
  BodyDriver driver(rig, tensors);
  BodyAvatar avatar{std::move(rig), std::move(model), std::move(driver), {}, {}, {}, {}, {}};
  const auto settings = json_field_or<Json>(info, "settings", file, Json::object());
  from_json_checked(settings, file.string(), avatar.settings);
  avatar.display =
      display_transform_from_name(json_field_or<std::string>(info, "display", file, "srgb"));
  avatar.camera = camera_from(json_field<Json>(info, "camera", file), file);
  avatar.model.set_mesh_normals(avatar.settings.normals == "mesh");
  if (avatar.settings.appearance == "sh_turned") avatar.model.set_turned_harmonics();
  const int side = avatar.model.texels().size;
  const Path albedo = folder / "textures/albedo.png", roughness = folder / "textures/roughness.png";
  from_images({fitted(read_image(albedo), side, 3, albedo),
               fitted(read_image(roughness), side, 1, roughness)},
              avatar.model.texels(), avatar.model.maps());
  if (std::filesystem::is_directory(folder / "tracks"))
    for (const auto& entry : std::filesystem::directory_iterator(folder / "tracks"))
      if (entry.path().extension() == ".safetensors")
        avatar.tracks[entry.path().stem().string()] = read_track(entry.path(), avatar.rig);
  avatar.info = std::move(info);
  return avatar;
}

void write_body_avatar(const BodyAvatar& avatar, const Path& folder) {
  make_folder(folder / "textures");
  make_folder(folder / "tracks");
  write_rig(folder / "rig.safetensors", avatar.rig);
  TensorFile tensors;
  tensors.metadata = {{"format", "effigy-body-networks"}, {"zh_convention", "d_lm = z_l Y_lm"}};
  avatar.model.save(tensors);
  avatar.driver.save(tensors);
  write_safetensors(folder / "networks.safetensors", tensors);
  const BodyMapImages images = to_images(avatar.model.texels(), avatar.model.maps());
  write_png16(folder / "textures/albedo.png", images.albedo);
  write_png16(folder / "textures/roughness.png", images.roughness);
  for (const auto& [name, track] : avatar.tracks)
    write_track(folder / "tracks" / (name + ".safetensors"), track, avatar.rig);
  Json info = avatar.info.is_object() ? avatar.info : Json::object();
  info["format"] = "effigy-avatar";
  info["version"] = kFormatVersion;
  info["kind"] = "body";
  info["rig"] = {{"kind", avatar.rig.kind}, {"licence", avatar.rig.licence}};
  info["display"] = to_string(avatar.display);
  info["camera"] = camera_json(avatar.camera);
  info["settings"] = to_json(avatar.settings);
  info["gaussians"] = avatar.model.texels().count();
  write_json(folder / "avatar.json", info);
}

}  // namespace effigy
