#include "effigy/capture/truth.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/safetensors.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

constexpr const char* kFile = "truth.safetensors";

const std::map<std::string, int>& layer_channels() {
  static const std::map<std::string, int> channels = {
      {"radiance", 4}, {"albedo", 3}, {"material", 3}, {"normal", 3},
      {"depth", 1},    {"uv", 2},     {"part", 1}};
  return channels;
}

std::vector<float> flat(const std::vector<RigPose>& poses,
                        const std::function<std::span<const float>(const RigPose&)>& field) {
  std::vector<float> values;
  for (const RigPose& pose : poses) {
    const auto part = field(pose);
    values.insert(values.end(), part.begin(), part.end());
  }
  return values;
}

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
  put("expression", flat(truth.poses, [](const RigPose& p) { return std::span(p.expression); }),
      {frames, capture.rig.expression_count});
  put("joint_rotation",
      flat(truth.poses, [](const RigPose& p) { return std::span(p.joint_rotation); }),
      {frames, 3 * capture.rig.joint_count()});
  put("translation",
      flat(truth.poses, [](const RigPose& p) { return std::span<const float>(p.translation); }),
      {frames, 3});
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
  const int64_t expressions = capture.rig.expression_count,
                rotations = 3 * capture.rig.joint_count();
  const auto expression = file.floats("expression", {frames, expressions});
  const auto rotation = file.floats("joint_rotation", {frames, rotations});
  const auto translation = file.floats("translation", {frames, 3});
  truth.identity = file.floats("identity", {-1});
  truth.vertices = file.floats("vertices", {frames, vertices, 3});
  if (file.has("irradiance")) truth.irradiance = file.floats("irradiance", {frames, vertices, 3});
  truth.keypoints = file.floats("keypoints", {frames, -1, 3});
  for (int64_t f = 0; f < frames; ++f) {
    RigPose pose;
    pose.expression.assign(expression.begin() + f * expressions,
                           expression.begin() + (f + 1) * expressions);
    pose.joint_rotation.assign(rotation.begin() + f * rotations,
                               rotation.begin() + (f + 1) * rotations);
    std::copy_n(translation.begin() + f * 3, 3, pose.translation.begin());
    truth.poses.push_back(std::move(pose));
  }
  return truth;
}

Image load_layer(const Capture& capture, const CaptureTruth& truth, const std::string& layer,
                 int frame) {
  const auto place = truth.layers.find(layer);
  if (place == truth.layers.end())
    throw Error(capture.folder.string() + ": the capture has no layer '" + layer +
                "'; make it again with layers.");
  Path name = capture.frames.at(frame).image.filename();
  const bool label = layer == "part";
  const Path path =
      capture.folder / place->second / name.replace_extension(label ? ".png" : ".exr");
  Image image;
  if (label) {
    const Image8 labels = read_image8(path);
    image = Image(labels.width, labels.height, labels.channels);
    std::copy(labels.data.begin(), labels.data.end(), image.data.begin());
  } else {
    image = read_image(path);
  }
  const int channels = layer_channels().at(layer);
  if (image.width != capture.camera.width || image.height != capture.camera.height ||
      image.channels != channels)
    throw Error(path.string() + ": it is " + std::to_string(image.width) + "x" +
                std::to_string(image.height) + "x" + std::to_string(image.channels) +
                ", the layer has the camera's size and " + std::to_string(channels) +
                " channels; make the capture again.");
  for (const float value : image.data)
    if (!std::isfinite(value) || (label && value > static_cast<float>(truth.parts.size())))
      throw Error(path.string() +
                  ": it holds a value that is not finite or an unknown label; make "
                  "the capture again.");
  return image;
}

}  // namespace effigy
