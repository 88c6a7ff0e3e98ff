#include "effigy/splat/gaussian_scene_file.h"

#include <string>

#include "effigy/splat/scene_parts.h"

namespace effigy {

using namespace scene_parts;

namespace {

constexpr size_t kMostGaussians = 10'000'000;
constexpr size_t kMostChannels = 64;

Output alpha_output() {
  return {"alpha", 0, 1};
}
Output features_output(int planes) {
  return {"features", 1, planes - 1};
}

}  // namespace

GaussianScene read_gaussian_scene(const Path& folder) {
  const Path file = folder / "scene.json";
  const Json json = read_json(file);
  if (!json.is_object()) refuse(file, "must be a JSON object with camera and gaussians.");
  GaussianScene scene;
  scene.camera = read_camera(json.contains("camera") ? json["camera"] : Json(), file);
  if (!json.contains("gaussians") || !json["gaussians"].is_array())
    refuse(file, "'gaussians' is missing or not an array.");
  const Json& list = json["gaussians"];
  if (list.size() > kMostGaussians)
    refuse(file, "more than " + std::to_string(kMostGaussians) + " Gaussians cannot be drawn.");
  Gaussians& g = scene.gaussians;
  for (size_t i = 0; i < list.size(); ++i) {
    const std::string owner = "gaussians[" + std::to_string(i) + "].";
    const Json& one = list[i];
    if (!one.is_object()) refuse(file, "'gaussians[" + std::to_string(i) + "]' is not an object.");
    append_numbers(one, "center", 1, 3, file, owner, g.center);
    append_numbers(one, "rotation", 1, 4, file, owner, g.rotation);
    append_numbers(one, "scale", 1, 3, file, owner, g.scale);
    if (i == 0) {
      const size_t channels =
          one.contains("features") && one["features"].is_array() ? one["features"].size() : 0;
      if (channels < 1 || channels > kMostChannels)
        refuse(file, "'" + owner + "features' must be an array of 1 to " +
                         std::to_string(kMostChannels) + " numbers.");
      g.channels = static_cast<int>(channels);
    }
    append_numbers(one, "features", 1, static_cast<size_t>(g.channels), file, owner, g.features);
    g.opacity.push_back(read_opacity(one, owner, file));
  }
  return scene;
}

Planes read_gaussian_upstream(const Path& folder, const GaussianScene& scene) {
  Planes planes(scene.camera.width, scene.camera.height, 1 + scene.gaussians.channels);
  const bool alpha = read_upstream(folder, alpha_output(), planes);
  const bool features = read_upstream(folder, features_output(planes.count), planes);
  if (!alpha && !features) refuse_without_upstream(folder);
  return planes;
}

void write_gaussian_outputs(const Path& folder, const Planes& image) {
  write_output(folder, alpha_output(), image);
  write_output(folder, features_output(image.count), image);
}

void write_gaussian_gradients(const Path& folder, const Gaussians& gradients) {
  write_floats(folder / "grad_center.f32", gradients.center);
  write_floats(folder / "grad_rotation.f32", gradients.rotation);
  write_floats(folder / "grad_scale.f32", gradients.scale);
  write_floats(folder / "grad_opacity.f32", gradients.opacity);
  write_floats(folder / "grad_features.f32", gradients.features);
}

}  // namespace effigy
