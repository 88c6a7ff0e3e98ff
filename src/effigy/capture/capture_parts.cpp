#include "effigy/capture/capture_parts.h"

#include <algorithm>
#include <cmath>

#include "effigy/image/files.h"

namespace effigy {
namespace {

constexpr int kMostPixels = 16384;  // a side

}  // namespace

void check_description(const Json& json, const std::string& kind, const Path& file) {
  const int version = json_field<int>(json, "version", file);
  if (version != kCaptureVersion)
    throw Error(file.string() + ": field 'version' is " + std::to_string(version) +
                ", this program reads version " + std::to_string(kCaptureVersion) +
                "; update Effigy or make the capture again.");
  const auto found = json_field<std::string>(json, "kind", file);
  if (found != kind)
    throw Error(file.string() + ": field 'kind' is '" + found + "', a '" + kind +
                "' capture is needed here.");
}

Json camera_json(const std::string& name, const Camera& camera) {
  Json rotation = Json::array();
  for (int row = 0; row < 3; ++row)
    rotation.push_back({camera.camera_from_world_rotation(row, 0),
                        camera.camera_from_world_rotation(row, 1),
                        camera.camera_from_world_rotation(row, 2)});
  const Vec3d& t = camera.camera_from_world_translation;
  return {{"name", name},
          {"width", camera.width},
          {"height", camera.height},
          {"fx", camera.fx},
          {"fy", camera.fy},
          {"cx", camera.cx},
          {"cy", camera.cy},
          {"camera_from_world", {{"rotation", rotation}, {"translation", {t.x(), t.y(), t.z()}}}}};
}

Camera camera_from_json(const Json& json, const Path& file) {
  Camera camera;
  camera.width = json_field<int>(json, "width", file);
  camera.height = json_field<int>(json, "height", file);
  camera.fx = json_field<double>(json, "fx", file);
  camera.fy = json_field<double>(json, "fy", file);
  camera.cx = json_field<double>(json, "cx", file);
  camera.cy = json_field<double>(json, "cy", file);
  const Json pose = json_field<Json>(json, "camera_from_world", file);
  const auto rotation = json_field<std::vector<std::vector<double>>>(pose, "rotation", file);
  const auto translation = json_field<std::vector<double>>(pose, "translation", file);
  bool good = camera.width > 0 && camera.height > 0 && camera.width <= kMostPixels &&
              camera.height <= kMostPixels && camera.fx > 0 && camera.fy > 0 &&
              std::isfinite(camera.fx + camera.fy + camera.cx + camera.cy) &&
              rotation.size() == 3 && translation.size() == 3;
  for (int row = 0; good && row < 3; ++row) {
    good = rotation[row].size() == 3 && std::isfinite(translation[row]);
    for (int column = 0; good && column < 3; ++column)
      camera.camera_from_world_rotation(row, column) = rotation[row][column];
    if (good) camera.camera_from_world_translation[row] = translation[row];
  }
  const Mat3d& r = camera.camera_from_world_rotation;
  if (good) good = (r * r.transpose() - Mat3d::Identity()).norm() < 1e-4 && r.determinant() > 0;
  if (!good)
    throw Error(file.string() +
                ": field 'cameras' has an impossible camera (size 1..16384, positive focal length, "
                "a rotation matrix, finite numbers); correct it.");
  return camera;
}

Path path_inside(const Json& frame, const std::string& field, const Path& file, bool required) {
  if (!required && !frame.contains(field)) return {};
  Path path = json_field<std::string>(frame, field, file);
  const bool escapes = path.is_absolute() || std::any_of(path.begin(), path.end(),
                                                         [](const Path& p) { return p == ".."; });
  if (path.empty() || escapes)
    throw Error(file.string() + ": field '" + field +
                "' must name a file inside the capture, not '" + path.string() + "'; correct it.");
  return path;
}

std::vector<RigPose> poses_from(const TensorFile& file, const Rig& rig, size_t count) {
  const auto frames = static_cast<int64_t>(count);
  const int64_t expressions = rig.expression_count, rotations = 3 * rig.joint_count();
  const auto expression = file.floats("expression", {frames, expressions});
  const auto rotation = file.floats("joint_rotation", {frames, rotations});
  const auto translation = file.floats("translation", {frames, 3});
  std::vector<RigPose> poses(count);
  for (int64_t f = 0; f < frames; ++f) {
    RigPose& pose = poses[f];
    pose.expression.assign(expression.begin() + f * expressions,
                           expression.begin() + (f + 1) * expressions);
    pose.joint_rotation.assign(rotation.begin() + f * rotations,
                               rotation.begin() + (f + 1) * rotations);
    std::copy_n(translation.begin() + f * 3, 3, pose.translation.begin());
  }
  return poses;
}

void put_poses(const std::vector<RigPose>& poses, const Rig& rig, TensorFile& file) {
  std::vector<float> expression, rotation, translation;
  for (const RigPose& pose : poses) {
    expression.insert(expression.end(), pose.expression.begin(), pose.expression.end());
    rotation.insert(rotation.end(), pose.joint_rotation.begin(), pose.joint_rotation.end());
    translation.insert(translation.end(), pose.translation.begin(), pose.translation.end());
  }
  const auto frames = static_cast<int64_t>(poses.size());
  const auto put = [&](const std::string& name, const std::vector<float>& values, int64_t width) {
    file.tensors[name] = Tensor::from(std::span<const float>(values), {frames, width});
  };
  put("expression", expression, rig.expression_count);
  put("joint_rotation", rotation, 3 * rig.joint_count());
  put("translation", translation, 3);
}

Image8 to_channels(const Image8& image, int channels) {
  if (image.channels == channels) return image;
  Image8 out(image.width, image.height, channels);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      for (int c = 0; c < channels; ++c)
        out.at(x, y)[c] = image.at(x, y)[image.channels >= 3 ? std::min(c, 2) : 0];
  return out;
}

Image8 read_view(const Path& path, const Camera& camera, int channels) {
  const Image8 image = read_image8(path);
  if (image.width != camera.width || image.height != camera.height)
    throw Error(path.string() + ": it is " + std::to_string(image.width) + "x" +
                std::to_string(image.height) + " pixels, the capture's camera has " +
                std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                "; resize it or make the capture again.");
  return to_channels(image, channels);
}

const std::map<std::string, int>& layer_channels() {
  static const std::map<std::string, int> channels = {
      {"radiance", 4}, {"albedo", 3}, {"material", 3}, {"normal", 3},
      {"depth", 1},    {"uv", 2},     {"part", 1}};
  return channels;
}

Image read_layer(const Path& path, const std::string& layer, const Camera& camera, size_t parts) {
  const bool label = layer == "part";
  Image image;
  if (label) {
    const Image8 labels = read_image8(path);
    image = Image(labels.width, labels.height, labels.channels);
    std::copy(labels.data.begin(), labels.data.end(), image.data.begin());
  } else {
    image = read_image(path);
  }
  const int channels = layer_channels().at(layer);
  if (image.width != camera.width || image.height != camera.height || image.channels != channels)
    throw Error(path.string() + ": it is " + std::to_string(image.width) + "x" +
                std::to_string(image.height) + "x" + std::to_string(image.channels) +
                ", the layer has the camera's size and " + std::to_string(channels) +
                " channels; make the capture again.");
  for (const float value : image.data)
    if (!std::isfinite(value) || (label && value > static_cast<float>(parts)))
      throw Error(path.string() +
                  ": it holds a value that is not finite or an unknown label; make "
                  "the capture again.");
  return image;
}

}  // namespace effigy
