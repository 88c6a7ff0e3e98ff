// Captures of a light stage: many cameras, lights that are known, a tracked mesh for every frame
// (docs/formats.md). What body avatars are trained from.
//   capture.json (kind "body")  rig.safetensors  tracking.safetensors
//   images/<camera>/<frame>.png  masks/<camera>/<frame>.png  frames/<frame>.safetensors
//   [backgrounds/<camera>.png  layers/<layer>/<camera>/<frame>.exr|png  truth.safetensors
//   lights/...]
#pragma once

#include <array>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "effigy/capture/capture.h"

namespace effigy {

struct StageCamera {
  std::string name;
  Camera camera;
  bool test = false;  // held out
  // There is a photograph of what is behind the body when all lights are on: pictures of fully lit
  // frames show it; else they are on black, as those of all other frames.
  bool background = false;
};

// Irradiance at distance d facing the light: amount * intensity / d^2.
struct StageLight {
  Vec3f position = Vec3f::Zero();   // metres, world
  Vec3f intensity = Vec3f::Ones();  // at amount 1
};

// Why a frame is not trained on. The names in capture.json: "train", "test-lights",
// "test-motion", "test-environment".
enum class StageSplit {
  kTrain,
  kLights,       // held-out partially lit frame of the training motion
  kMotion,       // unseen motion
  kEnvironment,  // a moment of the unseen motion again, under an environment
};
std::string to_string(StageSplit split);

struct StageFrame {
  int64_t number = 0;  // in the files' names
  double seconds = 0;
  StageSplit split = StageSplit::kTrain;
  bool fully_lit = false;                     // all lights at amount 1
  std::vector<std::pair<int, float>> lights;  // of a partially lit frame: light and its amount
  Path environment;  // equirectangular EXR relative to the capture, instead of lights; else empty
  std::vector<int> cameras;  // that saw it, ascending; empty: all
};

struct StageCapture {
  Path folder;
  std::string source;
  std::string licence = "not stated", consent = "not stated";
  DisplayTransform display = DisplayTransform::kSrgb;
  double frames_per_second = 30;
  std::vector<StageCamera> cameras;
  std::vector<StageLight> lights;
  std::vector<StageFrame> frames;
  Rig rig;                     // of the tracked mesh
  std::vector<RigPose> poses;  // one per frame, as tracked
  // Keypoints of every frame, metres, world: [F][names][3].
  std::vector<std::string> body_keypoint_names, face_keypoint_names;
  std::vector<float> body_keypoints, face_keypoints;
  // Root frames, world from rest pose: 3 x 4, row-major, per frame. Keypoints are given to
  // networks moved by their inverse.
  std::vector<std::array<float, 12>> body_from_rest, face_from_rest;

  // Synthetic captures: poses as they were, labels of layer "part" (label k is parts[k - 1]), and
  // the image layers there are, by name (capture/truth.h).
  std::vector<RigPose> true_poses;
  std::vector<std::string> parts;
  std::vector<std::string> layers;
  Json extra;  // further fields of capture.json, kept

  std::vector<int> train_cameras() const;
  std::vector<int> test_cameras() const;
  std::vector<int> frames_of(StageSplit split) const;
  // Those of `cameras` (ascending) that saw the frame.
  std::vector<int> cameras_of(int frame, const std::vector<int>& cameras) const;
  // Lights of a frame at their amounts; empty when an environment lights it.
  std::vector<StageLight> lights_of(int frame) const;

  // 3-channel image, 1-channel mask (255 = body), an image layer. Throw Error naming the file.
  Image8 load_image(int camera, int frame) const;
  Image8 load_mask(int camera, int frame) const;
  Image8 load_background(int camera) const;  // 3 channels, encoded as images are
  Image load_layer(const std::string& layer, int camera, int frame) const;
};

// The large arrays of one frame.
struct StageFrameArrays {
  std::vector<float> tracked;     // 3V, metres, world: the mesh that training knows
  std::vector<float> irradiance;  // 3V in [0, 1] on it: Relightable Full-Body Gaussian Codec
                                  // Avatars, Eq. 15; empty when it was not computed
  std::vector<float> truth;       // 3V, the true surface; empty in real captures
};
StageFrameArrays load_frame_arrays(const StageCapture& capture, int frame);
void write_frame_arrays(const StageFrameArrays& arrays, const Path& folder, int64_t number);

// Names of a view's files, relative to the capture.
Path stage_image_path(const std::string& camera, int64_t frame);
Path stage_mask_path(const std::string& camera, int64_t frame);
Path stage_background_path(const std::string& camera);
Path stage_layer_path(const std::string& layer, const std::string& camera, int64_t frame);

// Reads and checks everything but pixels and the frames' arrays.
StageCapture read_stage_capture(const Path& folder);
// Writes capture.json, rig, tracking and (when there are true poses) truth.safetensors into an
// existing folder that already holds images and frames.
void write_stage_capture(const StageCapture& capture, const Path& folder);
// "head" or "body": the kind of the capture in a folder. Throws Error when it is none.
std::string capture_kind(const Path& folder);

}  // namespace effigy
