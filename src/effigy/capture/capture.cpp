#include "effigy/capture/capture.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/log.h"
#include "effigy/base/safetensors.h"
#include "effigy/image/files.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

constexpr int kFormatVersion = 1;
constexpr int kMostPixels = 16384;  // a side

Json camera_json(const Camera& camera) {
  Json rotation = Json::array();
  for (int row = 0; row < 3; ++row)
    rotation.push_back({camera.camera_from_world_rotation(row, 0),
                        camera.camera_from_world_rotation(row, 1),
                        camera.camera_from_world_rotation(row, 2)});
  const Vec3d& t = camera.camera_from_world_translation;
  return {{"name", "cam0"},
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

// A path written in a capture must stay inside the capture.
Path inside(const Json& frame, const std::string& field, const Path& file, bool required) {
  if (!required && !frame.contains(field)) return {};
  const Path path = json_field<std::string>(frame, field, file);
  const bool escapes = path.is_absolute() || std::any_of(path.begin(), path.end(),
                                                         [](const Path& p) { return p == ".."; });
  if (path.empty() || escapes)
    throw Error(file.string() + ": field '" + field +
                "' must name a file inside the capture, not '" + path.string() + "'; correct it.");
  return path;
}

CaptureFrame frame_from_json(const Json& json, const Path& file) {
  CaptureFrame frame;
  frame.number = json_field<int64_t>(json, "number", file);
  frame.seconds = json_field_or<double>(json, "seconds", file, 0.0);
  frame.image = inside(json, "image", file, true);
  frame.mask = inside(json, "mask", file, true);
  frame.albedo = inside(json, "albedo", file, false);
  const auto split = json_field_or<std::string>(json, "split", file, "train");
  if (split != "train" && split != "test")
    throw Error(file.string() + ": field 'split' must be train or test, not '" + split +
                "'; correct it.");
  frame.test = split == "test";
  frame.tracked = json_field_or<bool>(json, "tracked", file, true);
  return frame;
}

Json frame_json(const CaptureFrame& frame) {
  Json json = {{"number", frame.number},
               {"seconds", frame.seconds},
               {"image", frame.image.string()},
               {"mask", frame.mask.string()},
               {"split", frame.test ? "test" : "train"},
               {"tracked", frame.tracked}};
  if (!frame.albedo.empty()) json["albedo"] = frame.albedo.string();
  return json;
}

void read_tracking(Capture& capture) {
  const TensorFile file = read_safetensors(capture.folder / "tracking.safetensors");
  const auto frames = static_cast<int64_t>(capture.frames.size());
  const int64_t expressions = capture.rig.expression_count;
  const int64_t rotations = 3 * capture.rig.joint_count();
  const auto expression = file.floats("expression", {frames, expressions});
  const auto rotation = file.floats("joint_rotation", {frames, rotations});
  const auto translation = file.floats("translation", {frames, 3});
  capture.identity = file.floats("identity", {-1});
  if (capture.identity.size() > static_cast<size_t>(capture.rig.identity_count))
    throw Error(file.path.string() +
                ": tensor 'identity' has more coefficients than the rig; track "
                "the video again.");
  capture.poses.resize(capture.frames.size());
  for (int64_t f = 0; f < frames; ++f) {
    RigPose& pose = capture.poses[f];
    pose.expression.assign(expression.begin() + f * expressions,
                           expression.begin() + (f + 1) * expressions);
    pose.joint_rotation.assign(rotation.begin() + f * rotations,
                               rotation.begin() + (f + 1) * rotations);
    std::copy_n(translation.begin() + f * 3, 3, pose.translation.begin());
  }
  if (file.has("landmarks")) {
    capture.landmarks = file.floats("landmarks", {frames, -1, 2});
    capture.landmark_count = static_cast<int>(file.shape("landmarks")[1]);
  }
}

void write_tracking(const Capture& capture, const Path& folder) {
  std::vector<float> expression, rotation, translation;
  for (const RigPose& pose : capture.poses) {
    expression.insert(expression.end(), pose.expression.begin(), pose.expression.end());
    rotation.insert(rotation.end(), pose.joint_rotation.begin(), pose.joint_rotation.end());
    translation.insert(translation.end(), pose.translation.begin(), pose.translation.end());
  }
  const auto frames = static_cast<int64_t>(capture.frames.size());
  TensorFile file;
  file.metadata = {{"format", "effigy-tracking"}, {"rig", capture.rig.kind}};
  auto put = [&](const std::string& name, const std::vector<float>& values,
                 std::vector<int64_t> shape) {
    file.tensors[name] = Tensor::from(std::span<const float>(values), std::move(shape));
  };
  put("expression", expression, {frames, capture.rig.expression_count});
  put("joint_rotation", rotation, {frames, 3 * capture.rig.joint_count()});
  put("translation", translation, {frames, 3});
  put("identity", capture.identity, {static_cast<int64_t>(capture.identity.size())});
  if (capture.landmark_count > 0)
    put("landmarks", capture.landmarks, {frames, capture.landmark_count, 2});
  write_safetensors(folder / "tracking.safetensors", file);
}

}  // namespace

std::vector<int> Capture::train_frames() const {
  std::vector<int> indices;
  for (size_t i = 0; i < frames.size(); ++i)
    if (!frames[i].test && frames[i].tracked) indices.push_back(static_cast<int>(i));
  return indices;
}

std::vector<int> Capture::test_frames() const {
  std::vector<int> indices;
  for (size_t i = 0; i < frames.size(); ++i)
    if (frames[i].test && frames[i].tracked) indices.push_back(static_cast<int>(i));
  return indices;
}

namespace {

void check_size(const Image8& image, const Camera& camera, const Path& path) {
  if (image.width != camera.width || image.height != camera.height)
    throw Error(path.string() + ": it is " + std::to_string(image.width) + "x" +
                std::to_string(image.height) + " pixels, the capture's camera has " +
                std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                "; resize it or track again.");
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

}  // namespace

Image8 Capture::load_image(int frame) const {
  const Path path = folder / frames.at(frame).image;
  const Image8 image = read_image8(path);
  check_size(image, camera, path);
  return to_channels(image, 3);
}

Image8 Capture::load_mask(int frame) const {
  const Path path = folder / frames.at(frame).mask;
  const Image8 image = read_image8(path);
  check_size(image, camera, path);
  return to_channels(image, 1);
}

Capture read_capture(const Path& folder) {
  const Path file = folder / "capture.json";
  if (!std::filesystem::is_directory(folder))
    throw Error("Cannot read the capture " + folder.string() +
                ": there is no such folder; make one with 'effigy track VIDEO -o CAPTURE'.");
  if (!std::filesystem::exists(file))
    throw Error(folder.string() +
                ": not a capture (capture.json is missing); make one with 'effigy track VIDEO -o "
                "CAPTURE'.");
  const Json json = read_json(file);
  const int version = json_field<int>(json, "version", file);
  if (version != kFormatVersion)
    throw Error(file.string() + ": field 'version' is " + std::to_string(version) +
                ", this program reads version 1; update Effigy or make the capture again.");
  Capture capture;
  capture.folder = folder;
  capture.kind = json_field<std::string>(json, "kind", file);
  if (capture.kind != "head")
    throw Error(file.string() + ": field 'kind' is '" + capture.kind +
                "', only 'head' captures are known here.");
  capture.source = json_field_or<std::string>(json, "source", file, "not stated");
  capture.licence = json_field_or<std::string>(json, "licence", file, "not stated");
  capture.consent = json_field_or<std::string>(json, "consent", file, "not stated");
  capture.display =
      display_transform_from_name(json_field_or<std::string>(json, "display", file, "srgb"));
  capture.frames_per_second = json_field_or<double>(json, "frames_per_second", file, 25.0);
  const auto cameras = json_field<std::vector<Json>>(json, "cameras", file);
  if (cameras.size() != 1)
    throw Error(file.string() + ": field 'cameras' has " + std::to_string(cameras.size()) +
                " entries, a head capture has one.");
  capture.camera = camera_from_json(cameras[0], file);
  for (const Json& frame : json_field<std::vector<Json>>(json, "frames", file))
    capture.frames.push_back(frame_from_json(frame, file));
  if (capture.frames.empty())
    throw Error(file.string() + ": field 'frames' is empty; track the video again.");
  capture.extra = json_field_or<Json>(json, "extra", file, Json::object());
  capture.rig = read_rig(folder / "rig.safetensors");
  read_tracking(capture);
  return capture;
}

void write_capture(const Capture& capture, const Path& folder) {
  EFFIGY_CHECK_EQ(capture.frames.size(), capture.poses.size());
  Json frames = Json::array();
  for (const CaptureFrame& frame : capture.frames) frames.push_back(frame_json(frame));
  write_rig(folder / "rig.safetensors", capture.rig);
  write_tracking(capture, folder);
  write_json(folder / "capture.json",
             {{"format", "effigy-capture"},
              {"version", kFormatVersion},
              {"kind", capture.kind},
              {"unit", "metre"},
              {"colour", "srgb"},
              {"display", to_string(capture.display)},
              {"source", capture.source},
              {"licence", capture.licence},
              {"consent", capture.consent},
              {"rig", capture.rig.kind},
              {"frames_per_second", capture.frames_per_second},
              {"cameras", Json::array({camera_json(capture.camera)})},
              {"extra", capture.extra.is_null() ? Json::object() : capture.extra},
              {"frames", frames}});
}

void split_test_frames(Capture& capture, int count) {
  const int total = static_cast<int>(capture.frames.size());
  const int test = count < 0 ? std::min(total / 4, 350) : count;
  if (test >= total)
    throw Error("--test " + std::to_string(test) + " leaves no training frame: the capture has " +
                std::to_string(total) + " frames.");
  for (int i = 0; i < total; ++i) capture.frames[i].test = i >= total - test;
}

}  // namespace effigy
