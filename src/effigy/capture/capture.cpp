#include "effigy/capture/capture.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/log.h"
#include "effigy/base/safetensors.h"
#include "effigy/capture/capture_parts.h"
#include "effigy/image/files.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

CaptureFrame frame_from_json(const Json& json, const Path& file) {
  CaptureFrame frame;
  frame.number = json_field<int64_t>(json, "number", file);
  frame.seconds = json_field_or<double>(json, "seconds", file, 0.0);
  frame.image = path_inside(json, "image", file, true);
  frame.mask = path_inside(json, "mask", file, true);
  frame.albedo = path_inside(json, "albedo", file, false);
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
  capture.identity = file.floats("identity", {-1});
  if (capture.identity.size() > static_cast<size_t>(capture.rig.identity_count))
    throw Error(file.path.string() +
                ": tensor 'identity' has more coefficients than the rig; track "
                "the video again.");
  capture.poses = poses_from(file, capture.rig, capture.frames.size());
  if (file.has("landmarks")) {
    capture.landmarks = file.floats("landmarks", {frames, -1, 2});
    capture.landmark_count = static_cast<int>(file.shape("landmarks")[1]);
  }
  if (file.has("scores")) {
    capture.scores = file.floats("scores", {frames, -1});
    capture.score_count = static_cast<int>(file.shape("scores")[1]);
  }
}

void write_tracking(const Capture& capture, const Path& folder) {
  const auto frames = static_cast<int64_t>(capture.frames.size());
  TensorFile file;
  file.metadata = {{"format", "effigy-tracking"}, {"rig", capture.rig.kind}};
  auto put = [&](const std::string& name, const std::vector<float>& values,
                 std::vector<int64_t> shape) {
    file.tensors[name] = Tensor::from(std::span<const float>(values), std::move(shape));
  };
  put_poses(capture.poses, capture.rig, file);
  put("identity", capture.identity, {static_cast<int64_t>(capture.identity.size())});
  if (capture.landmark_count > 0)
    put("landmarks", capture.landmarks, {frames, capture.landmark_count, 2});
  if (capture.score_count > 0) put("scores", capture.scores, {frames, capture.score_count});
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

Image8 Capture::load_image(int frame) const {
  const Path path = folder / frames.at(frame).image;
  return read_view(path, camera, 3);
}

Image8 Capture::load_mask(int frame) const {
  const Path path = folder / frames.at(frame).mask;
  return read_view(path, camera, 1);
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
  Capture capture;
  read_description(json, "head", file, capture);
  const auto cameras = json_field<std::vector<Json>>(json, "cameras", file);
  if (cameras.size() != 1)
    throw Error(file.string() + ": field 'cameras' has " + std::to_string(cameras.size()) +
                " entries, a head capture has one.");
  capture.camera = camera_from_json(cameras[0], file);
  for (const Json& frame : json_field<std::vector<Json>>(json, "frames", file))
    capture.frames.push_back(frame_from_json(frame, file));
  if (capture.frames.empty())
    throw Error(file.string() + ": field 'frames' is empty; track the video again.");
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
  Json json = description_json(capture, "head");
  json["cameras"] = Json::array({camera_json("cam0", capture.camera)});
  json["frames"] = frames;
  write_json(folder / "capture.json", json);
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
