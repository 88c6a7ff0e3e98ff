#include "effigy/avatar/frame_encoder.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/safetensors.h"

namespace effigy {
namespace {

constexpr int64_t kMostCodes = 4096;
constexpr float kMostLimit = 100;

// Where the networks saw the landmarks, beside where the tracked rig has them: metres in the
// picture's plane at the landmark's depth, turned back by the head's roll.
void landmark_offsets(const FrameEncoder& encoder, const Capture& capture, const RigShape& shape,
                      int frame, std::span<float> out) {
  const RigPose& pose = capture.poses[frame];
  std::vector<float> vertices;
  pose_vertices(shape, pose, vertices);
  const LandmarkEmbedding& embedding = capture.rig.mediapipe;
  const std::vector<float> positions =
      landmark_positions(embedding, capture.rig.mesh.triangles, vertices);
  const std::vector<float> transforms = joint_transforms(shape, pose);
  // The head hangs on the joint below the root.
  const float* head = &transforms[encoder.joint_count > 1 ? 12 : 0];
  const double roll = std::atan2(head[4], head[0]);
  const double c = std::cos(roll), s = std::sin(roll);
  for (size_t l = 0; l < encoder.landmarks.size(); ++l) {
    const auto entry = static_cast<size_t>(encoder.landmarks[l]);
    const Vec3d world = Vec3f(&positions[3 * entry]).cast<double>();
    const double depth = std::max(capture.camera.to_camera(world).z(), 1e-3);
    const Vec2d rig = capture.camera.project(world);
    const float* seen =
        &capture.landmarks[2 * (static_cast<size_t>(frame) * capture.landmark_count +
                                static_cast<size_t>(embedding.index[entry]))];
    const double right = (seen[0] - rig.x()) * depth / capture.camera.fx;
    const double up = -(seen[1] - rig.y()) * depth / capture.camera.fy;
    out[2 * l] = static_cast<float>(c * right + s * up);
    out[2 * l + 1] = static_cast<float>(-s * right + c * up);
  }
}

bool has_landmarks(const FrameEncoder& encoder, const Capture& capture) {
  if (encoder.landmarks.empty() || capture.landmark_count == 0) return false;
  return std::all_of(encoder.landmarks.begin(), encoder.landmarks.end(), [&](int32_t entry) {
    return entry >= 0 && static_cast<size_t>(entry) < capture.rig.mediapipe.size() &&
           capture.rig.mediapipe.index[static_cast<size_t>(entry)] < capture.landmark_count;
  });
}

void fill_inputs(const FrameEncoder& encoder, const Capture& capture, const RigShape& shape,
                 int frame, std::span<float> x) {
  const RigPose& pose = capture.poses[frame];
  auto at = std::copy(pose.expression.begin(), pose.expression.end(), x.begin());
  at = std::copy(pose.joint_rotation.begin(), pose.joint_rotation.end(), at);
  at = std::copy(pose.translation.begin(), pose.translation.end(), at);
  const auto scores = static_cast<size_t>(encoder.score_count);
  if (capture.score_count == encoder.score_count)
    std::copy_n(capture.scores.begin() + static_cast<std::ptrdiff_t>(frame * scores), scores, at);
  if (has_landmarks(encoder, capture))
    landmark_offsets(encoder, capture, shape, frame, x.subspan(encoder.pose_size() + scores));
}

}  // namespace

std::vector<uint8_t> encoded_entries(const Rig& rig, bool head_pose) {
  std::vector<uint8_t> entries(
      static_cast<size_t>(rig.expression_count + 3 * rig.joint_count() + 3), head_pose ? 1 : 0);
  std::fill_n(entries.begin(), rig.expression_count, uint8_t{1});
  if (const int jaw = rig.joint("jaw"); jaw >= 0)
    std::fill_n(entries.begin() + rig.expression_count + 3 * jaw, 3, uint8_t{1});
  return entries;
}

size_t FrameEncoder::pose_size() const {
  return static_cast<size_t>(expression_count) + 3 * static_cast<size_t>(joint_count) + 3;
}

size_t FrameEncoder::input_size() const {
  return pose_size() + static_cast<size_t>(score_count) + 2 * landmarks.size();
}

bool FrameEncoder::corrects_head_pose(const Rig& rig) const {
  const std::vector<uint8_t> own = encoded_entries(rig, false);
  EFFIGY_CHECK_EQ(own.size(), pose_size());
  for (size_t i = 0; i < weights.size(); ++i)
    if (weights[i] != 0 && own[i / code_size()] == 0) return true;
  return false;
}

std::vector<float> FrameEncoder::inputs(const Capture& capture, int frame) const {
  EFFIGY_CHECK_EQ(capture.rig.expression_count, expression_count);
  EFFIGY_CHECK_EQ(capture.rig.joint_count(), joint_count);
  std::vector<float> x = mean;
  x.resize(input_size(), 0.0f);
  fill_inputs(*this, capture, shape_rig(capture.rig, capture.identity), frame, x);
  return x;
}

std::vector<float> FrameEncoder::code(std::span<const float> inputs) const {
  const size_t width = input_size();
  EFFIGY_CHECK_EQ(inputs.size(), width);
  std::vector<float> result(code_size());
  for (size_t k = 0; k < result.size(); ++k) {
    double sum = 0;
    for (size_t d = 0; d < width; ++d)
      sum += static_cast<double>(projection[k * width + d]) * (inputs[d] - mean[d]);
    result[k] = static_cast<float>(std::clamp<double>(sum, -limit[k], limit[k]));
  }
  return result;
}

RigPose FrameEncoder::corrected(const RigPose& pose, std::span<const float> code) const {
  RigPose result = pose;
  const size_t expressions = result.expression.size(), rotations = result.joint_rotation.size();
  for (size_t p = 0; p < pose_size(); ++p) {
    float sum = 0;
    for (size_t k = 0; k < code.size(); ++k) sum += weights[p * code.size() + k] * code[k];
    if (p < expressions)
      result.expression[p] += sum;
    else if (p < expressions + rotations)
      result.joint_rotation[p - expressions] += sum;
    else
      result.translation[p - expressions - rotations] += sum;
  }
  return result;
}

void FrameEncoder::backward(std::span<const float> code, std::span<const float> d_pose,
                            std::span<float> d_weights) const {
  for (size_t p = 0; p < d_pose.size(); ++p)
    for (size_t k = 0; k < code.size(); ++k) d_weights[p * code.size() + k] += d_pose[p] * code[k];
}

std::vector<RigPose> encoded_poses(const FrameEncoder& encoder, const Capture& capture,
                                   const std::vector<int>& frames) {
  EFFIGY_CHECK_EQ(capture.rig.expression_count, encoder.expression_count);
  EFFIGY_CHECK_EQ(capture.rig.joint_count(), encoder.joint_count);
  const RigShape shape = shape_rig(capture.rig, capture.identity);
  std::vector<RigPose> poses;
  for (const int frame : frames) {
    std::vector<float> x = encoder.mean;
    fill_inputs(encoder, capture, shape, frame, x);
    poses.push_back(encoder.corrected(capture.poses[frame], encoder.code(x)));
  }
  return poses;
}

void write_frame_encoder(const Path& path, const FrameEncoder& encoder) {
  const auto count = [](size_t n) { return static_cast<int64_t>(n); };
  const int64_t inputs = count(encoder.input_size()), codes = count(encoder.code_size());
  TensorFile file;
  file.metadata = {{"format", "effigy-encoder"}};
  const auto put = [&](const char* name, const std::vector<float>& values,
                       std::vector<int64_t> shape) {
    file.tensors[name] = Tensor::from(std::span<const float>(values), std::move(shape));
  };
  put("mean", encoder.mean, {inputs});
  put("projection", encoder.projection, {codes, inputs});
  put("weights", encoder.weights, {count(encoder.pose_size()), codes});
  put("limit", encoder.limit, {codes});
  file.tensors["landmarks"] =
      Tensor::from(std::span<const int32_t>(encoder.landmarks), {count(encoder.landmarks.size())});
  const std::vector<int32_t> scores = {encoder.score_count};
  file.tensors["scores"] = Tensor::from(std::span<const int32_t>(scores), {1});
  write_safetensors(path, file);
}

FrameEncoder read_frame_encoder(const Path& path, const Rig& rig) {
  const TensorFile file = read_safetensors(path);
  const auto require = [&](bool good, const char* tensor) {
    if (!good)
      throw Error(path.string() + ": tensor '" + tensor +
                  "' is not that of an encoder for this rig; train the avatar again.");
  };
  FrameEncoder encoder;
  encoder.expression_count = rig.expression_count;
  encoder.joint_count = rig.joint_count();
  encoder.score_count = file.ints("scores", {1})[0];
  require(encoder.score_count >= 0 && encoder.score_count <= kMostCodes, "scores");
  encoder.landmarks = file.ints("landmarks", {-1});
  for (const int32_t entry : encoder.landmarks)
    require(entry >= 0 && static_cast<size_t>(entry) < rig.mediapipe.size(), "landmarks");
  const auto inputs = static_cast<int64_t>(encoder.input_size());
  encoder.mean = file.floats("mean", {inputs});
  encoder.projection = file.floats("projection", {-1, inputs});
  const int64_t codes = file.shape("projection")[0];
  require(codes >= 1 && codes <= kMostCodes, "projection");
  encoder.limit = file.floats("limit", {codes});
  for (const float limit : encoder.limit) require(limit > 0 && limit <= kMostLimit, "limit");
  encoder.weights = file.floats("weights", {static_cast<int64_t>(encoder.pose_size()), codes});
  return encoder;
}

}  // namespace effigy
