// Checkpoints: everything a run needs to go on bit for bit, in one safetensors file.

#include <algorithm>

#include "effigy/base/hash.h"
#include "effigy/base/safetensors.h"
#include "effigy/head/trainer_state.h"

namespace effigy {
namespace {

// The whole-run parameter arrays by name.
template <typename Model, typename Visit>
void visit_parameters(Model& model, Visit&& visit) {
  visit("model.barycentric", model.surfels.barycentric);
  visit("model.displacement", model.surfels.displacement);
  visit("model.rotation", model.surfels.rotation);
  visit("model.log_scale", model.surfels.log_scale);
  visit("model.opacity_logit", model.surfels.opacity_logit);
  visit("model.rest", model.shape.rest);
  visit("model.weights", model.shape.weights);
  visit("model.expression_basis", model.shape.expression_basis);
  visit("model.pose_basis", model.shape.pose_basis);
  visit("model.environment", model.environment);
  if (model.encoder) visit("model.encoder", model.encoder->weights);
}

Tensor flat(const std::vector<float>& values) {
  return Tensor::from(std::span<const float>(values), {static_cast<int64_t>(values.size())});
}

// A short text that changes when the capture's frames or rig do.
std::string fingerprint(const Capture& capture) {
  Hash hash;
  for (const CaptureFrame& frame : capture.frames) {
    hash.mix(&frame.number, sizeof frame.number);
    hash.mix(&frame.test, sizeof frame.test);
  }
  for (const RigPose& pose : capture.poses) hash.mix(pose.translation);
  hash.mix(capture.rig.mesh.vertices);
  return std::to_string(hash.value);
}

}  // namespace

void HeadTrainer::save_checkpoint(const Path& path) const {
  const State& s = *state_;
  TensorFile file;
  file.metadata = {
      {"format", "effigy-checkpoint"},          {"capture", fingerprint(s.capture)},
      {"settings", to_json(s.settings).dump()}, {"iteration", std::to_string(s.iteration)},
      {"epoch", std::to_string(s.epoch)},       {"next", std::to_string(s.next)}};
  visit_parameters(s.model, [&](const char* name, const std::vector<float>& values) {
    file.tensors[name] = flat(values);
  });
  file.tensors["model.triangle"] = Tensor::from(std::span<const int32_t>(s.model.surfels.triangle),
                                                {static_cast<int64_t>(s.model.surfels.count())});
  HeadOptimiser& optimiser = state_->optimiser;
  optimiser.visit([&](const char* name, const AdamState& state) {
    save_adam(state, std::string("adam.") + name, file);
  });
  save_texture(s.model.material, "material", file);
  const size_t size = pose_size(s.capture.rig);
  std::vector<float> poses(size * s.model.poses.size()), m(poses.size()), v(poses.size());
  std::vector<int64_t> steps(s.model.poses.size());
  for (size_t f = 0; f < s.model.poses.size(); ++f) {
    pack_pose(s.model.poses[f], {&poses[f * size], size});
    const AdamState& state = optimiser.poses[f];
    std::copy(state.m.begin(), state.m.end(), m.begin() + static_cast<int64_t>(f * size));
    std::copy(state.v.begin(), state.v.end(), v.begin() + static_cast<int64_t>(f * size));
    steps[f] = state.step;
  }
  file.tensors["poses"] = flat(poses);
  file.tensors["adam.poses.m"] = flat(m);
  file.tensors["adam.poses.v"] = flat(v);
  file.tensors["adam.poses.step"] =
      Tensor::from(std::span<const int64_t>(steps), {static_cast<int64_t>(steps.size())});
  write_safetensors(path, file);
}

void HeadTrainer::load_checkpoint(const Path& path) {
  State& s = *state_;
  const TensorFile file = read_safetensors(path);
  const auto meta = [&](const char* name) {
    const auto found = file.metadata.find(name);
    return found == file.metadata.end() ? std::string() : found->second;
  };
  if (meta("capture") != fingerprint(s.capture))
    throw Error(path.string() +
                ": the checkpoint belongs to another capture (or its tracking has changed); train "
                "without --resume.");
  if (meta("settings") != to_json(s.settings).dump())
    throw Error(path.string() +
                ": the checkpoint was made with other settings; give the same options, or train "
                "without --resume.");
  visit_parameters(s.model, [&](const char* name, std::vector<float>& values) {
    values = file.floats(name, {static_cast<int64_t>(values.size())});
  });
  s.model.surfels.triangle =
      file.ints("model.triangle", {static_cast<int64_t>(s.model.surfels.count())});
  for (int32_t triangle : s.model.surfels.triangle)
    if (triangle < 0 || triangle >= s.capture.rig.mesh.triangle_count())
      throw Error(path.string() + ": tensor 'model.triangle' is out of range; train again.");
  s.optimiser.visit([&](const char* name, AdamState& state) {
    state = load_adam(file, std::string("adam.") + name, state.size());
  });
  TextureParameters material = load_texture(file, "material");
  if (material.width != s.model.material.width || material.height != s.model.material.height)
    throw Error(path.string() +
                ": the textures have another size than --texture-size; train again.");
  s.model.material = std::move(material);
  activate_texture(s.model.material, s.activation, s.texture);
  const size_t size = pose_size(s.capture.rig);
  const auto count = static_cast<int64_t>(size * s.model.poses.size());
  const auto poses = file.floats("poses", {count}), m = file.floats("adam.poses.m", {count}),
             v = file.floats("adam.poses.v", {count});
  const auto steps = file.longs("adam.poses.step", {static_cast<int64_t>(s.model.poses.size())});
  for (size_t f = 0; f < s.model.poses.size(); ++f) {
    unpack_pose({&poses[f * size], size}, s.model.poses[f]);
    AdamState& state = s.optimiser.poses[f];
    state = AdamState(steps[f] > 0 ? size : 0);
    if (steps[f] > 0) {
      std::copy_n(m.begin() + static_cast<int64_t>(f * size), size, state.m.begin());
      std::copy_n(v.begin() + static_cast<int64_t>(f * size), size, state.v.begin());
      state.step = steps[f];
    }
  }
  s.iteration = std::strtoll(meta("iteration").c_str(), nullptr, 10);
  s.epoch = std::strtoll(meta("epoch").c_str(), nullptr, 10);
  s.shuffle_frames();
  s.next = std::min<size_t>(std::strtoull(meta("next").c_str(), nullptr, 10), s.frames.size());
}

}  // namespace effigy
