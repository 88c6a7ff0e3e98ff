#include "effigy/synth/scene_file.h"

#include <cmath>
#include <map>
#include <numbers>

#include "effigy/base/json.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/synth/truth_image.h"

namespace effigy {
namespace {

constexpr int kMostPixels = 16384;

Vec3d three(const Json& json, const std::string& field, const Path& file) {
  const auto values = json_field<std::vector<double>>(json, field, file);
  if (values.size() != 3 || !std::isfinite(values[0] + values[1] + values[2]))
    throw Error(file.string() + ": field '" + field +
                "' must be three finite numbers; correct it.");
  return {values[0], values[1], values[2]};
}

// A number, a colour or an image file. 8- and 16-bit images of colour are sRGB.
Image map_from(const Json& json, const std::string& field, int channels, const Path& file) {
  const Json& value = json.at(field);
  if (value.is_string()) {
    const Path path = file.parent_path() / value.get<std::string>();
    Image image = read_image(path);
    if (image.channels < channels)
      throw Error(path.string() + ": it has " + std::to_string(image.channels) +
                  " channels, field '" + field + "' needs " + std::to_string(channels) + ".");
    const std::string extension = path.extension().string();
    const bool encoded = extension != ".exr" && extension != ".hdr";
    Image map(image.width, image.height, channels);
    for (size_t i = 0; i < map.data.size(); ++i) {
      const size_t n = static_cast<size_t>(channels);
      const float v = image.data[i / n * static_cast<size_t>(image.channels) + i % n];
      map.data[i] = !encoded            ? v
                    : field == "normal" ? 2 * v - 1
                    : field == "albedo" ? linear_from_srgb(v)
                                        : v;
    }
    return map;
  }
  Image map(1, 1, channels);
  if (channels == 3) {
    const Vec3d colour = three(json, field, file);
    for (size_t c = 0; c < 3; ++c) map.data[c] = static_cast<float>(colour[static_cast<int>(c)]);
  } else {
    map.data[0] = json_field<float>(json, field, file);
  }
  return map;
}

SurfaceMaterial material_from(const Json& json, const Path& file) {
  SurfaceMaterial material = constant_material(Vec3f::Constant(0.5f), 0.5f, 0.04f);
  const auto take = [&](const char* field, int channels, Image& map) {
    if (json.contains(field)) map = map_from(json, field, channels, file);
  };
  take("albedo", 3, material.albedo);
  take("roughness", 1, material.roughness);
  take("specular", 1, material.specular);
  take("normal", 3, material.normal);
  take("opacity", 1, material.opacity);
  take("scatter", 1, material.scatter);
  if (json.contains("scatter_radius"))
    material.scatter_radius = three(json, "scatter_radius", file).cast<float>();
  material.specular_lobe = json_field_or<bool>(json, "specular_lobe", file, true);
  return material;
}

Camera camera_from(const Json& json, const Path& file) {
  const int width = json_field<int>(json, "width", file),
            height = json_field<int>(json, "height", file);
  const double fov = json_field<double>(json, "fov_y", file);
  const Vec3d eye = three(json, "eye", file), target = three(json, "target", file);
  if (width < 1 || height < 1 || width > kMostPixels || height > kMostPixels || !(fov > 0) ||
      fov >= 180 || (eye - target).norm() == 0)
    throw Error(file.string() +
                ": field 'camera' must have a size of 1 .. 16384 pixels, fov_y in "
                "0 .. 180 degrees, and an eye that is not its target; correct it.");
  return look_at(eye, target, fov * std::numbers::pi / 180, width, height);
}

void add_lights(const Json& json, const Path& file, TraceScene& scene) {
  if (json.contains("environment")) {
    const Json sky = json_field<Json>(json, "environment", file);
    const std::string name = json_field<std::string>(sky, "file", file);
    const Path beside = file.parent_path() / name;
    // As it is, unlike the lights of captures, which are brought to one brightness.
    Image light = std::filesystem::exists(beside) ? read_environment(beside) : synth_light(name);
    const double scale = json_field_or<double>(sky, "scale", file, 1.0);
    if (!(scale >= 0) || !std::isfinite(scale))
      throw Error(file.string() + ": field 'scale' must be a number from 0 on; correct it.");
    for (float& value : light.data) value *= static_cast<float>(scale);
    scene.set_environment(std::make_shared<EnvironmentSampler>(
        light, json_field_or<double>(sky, "rotation", file, 0.0) * std::numbers::pi / 180));
  }
  std::vector<StageLight> lights;
  for (const Json& lamp : json_field_or<std::vector<Json>>(json, "point_lights", file, {}))
    lights.push_back({three(lamp, "position", file).cast<float>(),
                      three(lamp, "intensity", file).cast<float>()});
  scene.set_point_lights(std::move(lights));
}

}  // namespace

DescribedScene read_scene(const Path& path) {
  const Json json = read_json(path);
  DescribedScene described;
  described.camera = camera_from(json_field<Json>(json, "camera", path), path);
  std::map<std::string, int> materials;
  for (const auto& [name, entry] : json_field<std::map<std::string, Json>>(json, "materials", path))
    materials[name] = described.scene.add_material(material_from(entry, path),
                                                   path.string() + ": material '" + name + "'");
  for (const Json& entry : json_field<std::vector<Json>>(json, "meshes", path)) {
    const Path file = path.parent_path() / json_field<std::string>(entry, "file", path);
    const auto material = json_field<std::string>(entry, "material", path);
    if (!materials.count(material))
      throw Error(path.string() + ": field 'material' names '" + material +
                  "', which the scene does not have; correct it.");
    described.scene.add_mesh(read_obj(file), materials[material], file.string());
  }
  add_lights(json, path, described.scene);
  described.scene.commit();
  TraceOptions& options = described.options;
  options.samples = json_field_or<int>(json, "samples", path, options.samples);
  options.bounces = json_field_or<int>(json, "bounces", path, options.bounces);
  options.seed = json_field_or<uint64_t>(json, "seed", path, options.seed);
  if (!json_field_or<bool>(json, "shadows", path, true)) options.transport = Transport::kUnshadowed;
  return described;
}

}  // namespace effigy
