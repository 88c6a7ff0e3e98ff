#include "effigy/capture/stage_capture.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <set>

#include "effigy/base/log.h"
#include "effigy/capture/capture_parts.h"
#include "effigy/image/files.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

constexpr StageSplit kSplits[] = {StageSplit::kTrain, StageSplit::kLights, StageSplit::kMotion,
                                  StageSplit::kEnvironment};

Json three_json(const Vec3f& v) {
  return {v.x(), v.y(), v.z()};
}

Vec3f three_from(const Json& object, const std::string& field, const Path& file) {
  const auto values = json_field<std::vector<float>>(object, field, file);
  if (values.size() != 3 || !std::isfinite(values[0] + values[1] + values[2]))
    throw Error(file.string() + ": field '" + field +
                "' must be three finite numbers; correct it.");
  return Vec3f(values.data());
}

StageCamera stage_camera_from(const Json& json, const Path& file) {
  StageCamera camera;
  camera.name = json_field<std::string>(json, "name", file);
  const bool plain = !camera.name.empty() &&
                     std::all_of(camera.name.begin(), camera.name.end(), [](unsigned char c) {
                       return std::isalnum(c) || c == '_' || c == '-';
                     });
  if (!plain)
    throw Error(file.string() + ": the camera name '" + camera.name +
                "' must be letters, digits, - and _; correct it.");
  camera.camera = camera_from_json(json, file);
  const auto split = json_field_or<std::string>(json, "split", file, "train");
  if (split != "train" && split != "test")
    throw Error(file.string() + ": field 'split' of a camera must be train or test, not '" + split +
                "'; correct it.");
  camera.test = split == "test";
  camera.background = json_field_or<bool>(json, "background", file, false);
  return camera;
}

StageLight light_from(const Json& json, const Path& file) {
  StageLight light{three_from(json, "position", file), three_from(json, "intensity", file)};
  if (light.intensity.minCoeff() < 0)
    throw Error(file.string() + ": field 'intensity' of a light is negative; correct it.");
  return light;
}

StageFrame frame_from(const Json& json, size_t cameras, size_t lights, const Path& file) {
  StageFrame frame;
  frame.number = json_field<int64_t>(json, "number", file);
  frame.seconds = json_field_or<double>(json, "seconds", file, 0.0);
  const auto split = json_field<std::string>(json, "split", file);
  const auto found = std::find_if(std::begin(kSplits), std::end(kSplits),
                                  [&](StageSplit s) { return to_string(s) == split; });
  if (found == std::end(kSplits))
    throw Error(file.string() + ": field 'split' of a frame is '" + split +
                "', which is not known; correct it.");
  frame.split = *found;
  frame.fully_lit = json_field_or<bool>(json, "fully_lit", file, false);
  frame.environment = path_inside(json, "environment", file, false);
  for (const auto& [light, amount] : json_field_or<std::vector<std::pair<int, float>>>(
           json, "lights", file, std::vector<std::pair<int, float>>{})) {
    if (light < 0 || static_cast<size_t>(light) >= lights || !(amount >= 0) ||
        !std::isfinite(amount))
      throw Error(file.string() + ": frame " + std::to_string(frame.number) +
                  " names a light that does not exist, or a negative amount; correct it.");
    frame.lights.emplace_back(light, amount);
  }
  frame.cameras = json_field_or<std::vector<int>>(json, "cameras", file, {});
  for (size_t k = 0; k < frame.cameras.size(); ++k)
    if (frame.cameras[k] < (k > 0 ? frame.cameras[k - 1] + 1 : 0) ||
        static_cast<size_t>(frame.cameras[k]) >= cameras)
      throw Error(file.string() + ": field 'cameras' of frame " + std::to_string(frame.number) +
                  " must be ascending numbers of cameras; correct it.");
  const int ways =
      (frame.fully_lit ? 1 : 0) + (frame.lights.empty() ? 0 : 1) + !frame.environment.empty();
  if (ways != 1 || frame.number < 0)
    throw Error(file.string() + ": frame " + std::to_string(frame.number) +
                " must be lit in one way: 'fully_lit', 'lights' or 'environment'; correct it.");
  return frame;
}

Json frame_json(const StageFrame& frame) {
  Json json = {
      {"number", frame.number}, {"seconds", frame.seconds}, {"split", to_string(frame.split)}};
  if (frame.fully_lit) json["fully_lit"] = true;
  if (!frame.lights.empty()) json["lights"] = frame.lights;
  if (!frame.environment.empty()) json["environment"] = frame.environment.string();
  if (!frame.cameras.empty()) json["cameras"] = frame.cameras;
  return json;
}

std::vector<std::array<float, 12>> transforms_from(const TensorFile& file, const std::string& name,
                                                   int64_t frames) {
  const std::vector<float> values = file.floats(name, {frames, 12});
  std::vector<std::array<float, 12>> out(static_cast<size_t>(frames));
  for (size_t f = 0; f < out.size(); ++f) std::copy_n(values.data() + 12 * f, 12, out[f].begin());
  return out;
}

void read_tracking(StageCapture& capture) {
  const TensorFile file = read_safetensors(capture.folder / "tracking.safetensors");
  const auto frames = static_cast<int64_t>(capture.frames.size());
  capture.poses = poses_from(file, capture.rig, capture.frames.size());
  const auto keypoints = [&](const char* name, const std::vector<std::string>& names) {
    return file.floats(name, {frames, static_cast<int64_t>(names.size()), 3});
  };
  capture.body_keypoints = keypoints("body_keypoints", capture.body_keypoint_names);
  capture.face_keypoints = keypoints("face_keypoints", capture.face_keypoint_names);
  capture.body_from_rest = transforms_from(file, "body_from_rest", frames);
  capture.face_from_rest = transforms_from(file, "face_from_rest", frames);
}

void write_tracking(const StageCapture& capture, const Path& folder) {
  const auto frames = static_cast<int64_t>(capture.frames.size());
  TensorFile file;
  file.metadata = {{"format", "effigy-tracking"}, {"rig", capture.rig.kind}};
  put_poses(capture.poses, capture.rig, file);
  const auto put = [&](const char* name, const std::vector<float>& values, int64_t count) {
    file.tensors[name] = Tensor::from(std::span<const float>(values), {frames, count, 3});
  };
  put("body_keypoints", capture.body_keypoints,
      static_cast<int64_t>(capture.body_keypoint_names.size()));
  put("face_keypoints", capture.face_keypoints,
      static_cast<int64_t>(capture.face_keypoint_names.size()));
  const auto put_transforms = [&](const char* name,
                                  const std::vector<std::array<float, 12>>& transforms) {
    std::vector<float> values;
    for (const auto& m : transforms) values.insert(values.end(), m.begin(), m.end());
    file.tensors[name] = Tensor::from(std::span<const float>(values), {frames, 12});
  };
  put_transforms("body_from_rest", capture.body_from_rest);
  put_transforms("face_from_rest", capture.face_from_rest);
  write_safetensors(folder / "tracking.safetensors", file);
}

std::string number_name(int64_t frame) {
  return format("{:06}", frame);
}

}  // namespace

std::string to_string(StageSplit split) {
  switch (split) {
    case StageSplit::kTrain:
      return "train";
    case StageSplit::kLights:
      return "test-lights";
    case StageSplit::kMotion:
      return "test-motion";
    case StageSplit::kEnvironment:
      break;
  }
  return "test-environment";
}

std::vector<int> StageCapture::train_cameras() const {
  std::vector<int> out;
  for (size_t c = 0; c < cameras.size(); ++c)
    if (!cameras[c].test) out.push_back(static_cast<int>(c));
  return out;
}

std::vector<int> StageCapture::test_cameras() const {
  std::vector<int> out;
  for (size_t c = 0; c < cameras.size(); ++c)
    if (cameras[c].test) out.push_back(static_cast<int>(c));
  return out;
}

std::vector<int> StageCapture::frames_of(StageSplit split) const {
  std::vector<int> out;
  for (size_t f = 0; f < frames.size(); ++f)
    if (frames[f].split == split) out.push_back(static_cast<int>(f));
  return out;
}

std::vector<int> StageCapture::cameras_of(int frame, const std::vector<int>& wanted) const {
  const std::vector<int>& saw = frames.at(static_cast<size_t>(frame)).cameras;
  if (saw.empty()) return wanted;
  std::vector<int> out;
  std::set_intersection(wanted.begin(), wanted.end(), saw.begin(), saw.end(),
                        std::back_inserter(out));
  return out;
}

std::vector<StageLight> StageCapture::lights_of(int frame) const {
  const StageFrame& f = frames.at(static_cast<size_t>(frame));
  if (f.fully_lit) return lights;
  std::vector<StageLight> out;
  for (const auto& [light, amount] : f.lights) {
    out.push_back(lights.at(static_cast<size_t>(light)));
    out.back().intensity *= amount;
  }
  return out;
}

Path stage_image_path(const std::string& camera, int64_t frame) {
  return Path("images") / camera / (number_name(frame) + ".png");
}
Path stage_mask_path(const std::string& camera, int64_t frame) {
  return Path("masks") / camera / (number_name(frame) + ".png");
}
Path stage_background_path(const std::string& camera) {
  return Path("backgrounds") / (camera + ".png");
}
Path stage_layer_path(const std::string& layer, const std::string& camera, int64_t frame) {
  return Path("layers") / layer / camera /
         (number_name(frame) + (layer == "part" ? ".png" : ".exr"));
}

Image8 StageCapture::load_image(int camera, int frame) const {
  const StageCamera& c = cameras.at(static_cast<size_t>(camera));
  const int64_t number = frames.at(static_cast<size_t>(frame)).number;
  return read_view(folder / stage_image_path(c.name, number), c.camera, 3);
}

Image8 StageCapture::load_mask(int camera, int frame) const {
  const StageCamera& c = cameras.at(static_cast<size_t>(camera));
  const int64_t number = frames.at(static_cast<size_t>(frame)).number;
  return read_view(folder / stage_mask_path(c.name, number), c.camera, 1);
}

Image8 StageCapture::load_background(int camera) const {
  const StageCamera& c = cameras.at(static_cast<size_t>(camera));
  return read_view(folder / stage_background_path(c.name), c.camera, 3);
}

Image StageCapture::load_layer(const std::string& layer, int camera, int frame) const {
  if (std::find(layers.begin(), layers.end(), layer) == layers.end())
    throw Error(folder.string() + ": the capture has no layer '" + layer +
                "'; make it again with layers.");
  const StageCamera& c = cameras.at(static_cast<size_t>(camera));
  const int64_t number = frames.at(static_cast<size_t>(frame)).number;
  return read_layer(folder / stage_layer_path(layer, c.name, number), layer, c.camera,
                    parts.size());
}

StageFrameArrays load_frame_arrays(const StageCapture& capture, int frame) {
  const StageFrame& f = capture.frames.at(static_cast<size_t>(frame));
  const TensorFile file =
      read_safetensors(capture.folder / "frames" / (number_name(f.number) + ".safetensors"));
  const int64_t vertices = capture.rig.mesh.vertex_count();
  StageFrameArrays arrays;
  arrays.tracked = file.floats("tracked", {vertices, 3});
  if (file.has("irradiance")) arrays.irradiance = file.floats("irradiance", {vertices, 3});
  if (file.has("truth")) arrays.truth = file.floats("truth", {vertices, 3});
  return arrays;
}

void write_frame_arrays(const StageFrameArrays& arrays, const Path& folder, int64_t number) {
  const auto vertices = static_cast<int64_t>(arrays.tracked.size() / 3);
  TensorFile file;
  file.metadata = {{"format", "effigy-stage-frame"}};
  const auto put = [&](const char* name, const std::vector<float>& values) {
    if (!values.empty())
      file.tensors[name] = Tensor::from(std::span<const float>(values), {vertices, 3});
  };
  put("tracked", arrays.tracked);
  put("irradiance", arrays.irradiance);
  put("truth", arrays.truth);
  write_safetensors(folder / "frames" / (number_name(number) + ".safetensors"), file);
}

std::string capture_kind(const Path& folder) {
  const Path file = folder / "capture.json";
  if (!std::filesystem::exists(file))
    throw Error(folder.string() + ": not a capture (capture.json is missing); check the path.");
  return json_field<std::string>(read_json(file), "kind", file);
}

StageCapture read_stage_capture(const Path& folder) {
  const Path file = folder / "capture.json";
  if (!std::filesystem::exists(file))
    throw Error(folder.string() + ": not a capture (capture.json is missing); check the path.");
  const Json json = read_json(file);
  StageCapture capture;
  read_description(json, "body", file, capture);
  std::set<std::string> names;
  for (const Json& camera : json_field<std::vector<Json>>(json, "cameras", file)) {
    capture.cameras.push_back(stage_camera_from(camera, file));
    if (!names.insert(capture.cameras.back().name).second)
      throw Error(file.string() + ": two cameras are called '" + capture.cameras.back().name +
                  "'; rename one.");
  }
  if (capture.cameras.empty())
    throw Error(file.string() + ": it has no cameras; make the capture again.");
  for (const Json& light : json_field<std::vector<Json>>(json, "lights", file))
    capture.lights.push_back(light_from(light, file));
  std::set<int64_t> numbers;
  for (const Json& frame : json_field<std::vector<Json>>(json, "frames", file)) {
    if (capture.lights.empty() && !frame.contains("environment"))
      throw Error(
          file.string() +
          ": it has no lights, but its frames are lit by lights; put back field 'lights' or "
          "make the capture again.");
    capture.frames.push_back(
        frame_from(frame, capture.cameras.size(), capture.lights.size(), file));
    if (!numbers.insert(capture.frames.back().number).second)
      throw Error(file.string() + ": frame " + std::to_string(capture.frames.back().number) +
                  " is listed twice; remove one.");
  }
  if (capture.frames.empty())
    throw Error(file.string() + ": it has no frames; make the capture again.");
  capture.body_keypoint_names = json_field<std::vector<std::string>>(json, "body_keypoints", file);
  capture.face_keypoint_names = json_field<std::vector<std::string>>(json, "face_keypoints", file);
  capture.rig = read_rig(folder / "rig.safetensors");
  read_tracking(capture);
  if (!json.contains("truth")) return capture;
  const Json truth = json_field<Json>(json, "truth", file);
  capture.parts = json_field<std::vector<std::string>>(truth, "parts", file);
  capture.layers = json_field<std::vector<std::string>>(truth, "layers", file);
  for (const std::string& layer : capture.layers)
    if (!layer_channels().count(layer))
      throw Error(file.string() + ": field 'layers' has '" + layer +
                  "', which is not a known layer; correct it.");
  capture.true_poses = poses_from(read_safetensors(folder / "truth.safetensors"), capture.rig,
                                  capture.frames.size());
  return capture;
}

void write_stage_capture(const StageCapture& capture, const Path& folder) {
  EFFIGY_CHECK_EQ(capture.frames.size(), capture.poses.size());
  Json cameras = Json::array(), lights = Json::array(), frames = Json::array();
  for (const StageCamera& c : capture.cameras) {
    cameras.push_back(camera_json(c.name, c.camera));
    cameras.back()["split"] = c.test ? "test" : "train";
    if (c.background) cameras.back()["background"] = true;
  }
  for (const StageLight& l : capture.lights)
    lights.push_back(
        {{"position", three_json(l.position)}, {"intensity", three_json(l.intensity)}});
  for (const StageFrame& f : capture.frames) frames.push_back(frame_json(f));
  Json json = description_json(capture, "body");
  json["cameras"] = cameras;
  json["lights"] = lights;
  json["body_keypoints"] = capture.body_keypoint_names;
  json["face_keypoints"] = capture.face_keypoint_names;
  json["frames"] = frames;
  write_rig(folder / "rig.safetensors", capture.rig);
  write_tracking(capture, folder);
  if (!capture.true_poses.empty()) {
    TensorFile truth;
    truth.metadata = {{"format", "effigy-truth"}, {"rig", capture.rig.kind}};
    put_poses(capture.true_poses, capture.rig, truth);
    write_safetensors(folder / "truth.safetensors", truth);
    json["truth"] = {{"parts", capture.parts}, {"layers", capture.layers}};
  }
  write_json(folder / "capture.json", json);
}

}  // namespace effigy
