#include "effigy/capture/truth.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/capture/capture_parts.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

constexpr const char* kFile = "truth.safetensors";

}  // namespace

void write_truth(const CaptureTruth& truth, Capture& capture, const Path& folder) {
  EFFIGY_CHECK_EQ(truth.poses.size(), capture.frames.size());
  const auto frames = static_cast<int64_t>(truth.poses.size());
  const int64_t vertices = capture.rig.mesh.vertex_count();
  TensorFile file;
  file.metadata = {{"format", "effigy-truth"}, {"rig", capture.rig.kind}};
  const auto put = [&](const std::string& name, const std::vector<float>& values,
                       std::vector<int64_t> shape) {
    file.tensors[name] = Tensor::from(std::span<const float>(values), std::move(shape));
  };
  put_poses(truth.poses, capture.rig, file);
  put("identity", truth.identity, {static_cast<int64_t>(truth.identity.size())});
  put("vertices", truth.vertices, {frames, vertices, 3});
  if (!truth.irradiance.empty()) put("irradiance", truth.irradiance, {frames, vertices, 3});
  put("keypoints", truth.keypoints,
      {frames, static_cast<int64_t>(truth.keypoints.size()) / (3 * std::max<int64_t>(frames, 1)),
       3});
  write_safetensors(folder / kFile, file);
  Json layers = Json::object();
  for (const auto& [name, place] : truth.layers) layers[name] = place.string();
  capture.extra["truth"] = {
      {"file", kFile}, {"transport", truth.transport}, {"parts", truth.parts}, {"layers", layers}};
}

std::optional<CaptureTruth> read_truth(const Capture& capture) {
  if (!capture.extra.is_object() || !capture.extra.contains("truth")) return std::nullopt;
  const Path json_file = capture.folder / "capture.json";
  const Json json = capture.extra["truth"];
  CaptureTruth truth;
  truth.transport = json_field<std::string>(json, "transport", json_file);
  truth.parts = json_field<std::vector<std::string>>(json, "parts", json_file);
  for (const auto& [name, place] :
       json_field<std::map<std::string, std::string>>(json, "layers", json_file)) {
    const Path path = place;
    const bool escapes = path.is_absolute() || std::any_of(path.begin(), path.end(),
                                                           [](const Path& p) { return p == ".."; });
    if (escapes || !layer_channels().count(name))
      throw Error(json_file.string() + ": field 'layers' has '" + name + "': '" + place +
                  "', which is not a known layer inside the capture; correct it.");
    truth.layers[name] = path;
  }
  const TensorFile file = read_safetensors(capture.folder / kFile);
  const auto frames = static_cast<int64_t>(capture.frames.size());
  const int64_t vertices = capture.rig.mesh.vertex_count();
  truth.identity = file.floats("identity", {-1});
  truth.vertices = file.floats("vertices", {frames, vertices, 3});
  if (file.has("irradiance")) truth.irradiance = file.floats("irradiance", {frames, vertices, 3});
  truth.keypoints = file.floats("keypoints", {frames, -1, 3});
  truth.poses = poses_from(file, capture.rig, capture.frames.size());
  return truth;
}

Image load_layer(const Capture& capture, const CaptureTruth& truth, const std::string& layer,
                 int frame) {
  const auto place = truth.layers.find(layer);
  if (place == truth.layers.end())
    throw Error(capture.folder.string() + ": the capture has no layer '" + layer +
                "'; make it again with layers.");
  Path name = capture.frames.at(frame).image.filename();
  const Path path =
      capture.folder / place->second / name.replace_extension(layer == "part" ? ".png" : ".exr");
  return read_layer(path, layer, capture.camera, truth.parts.size());
}

}  // namespace effigy
