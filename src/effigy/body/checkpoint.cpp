// Checkpoints: everything a run needs to go on bit for bit, in one safetensors file.

#include <algorithm>

#include "effigy/base/hash.h"
#include "effigy/base/safetensors.h"
#include "effigy/body/trainer_state.h"

namespace effigy {
namespace {

// A short text that changes when the capture's frames, cameras or rig do.
std::string fingerprint_of(const StageCapture& capture) {
  Hash hash;
  for (const StageFrame& frame : capture.frames) {
    hash.mix(&frame.number, sizeof frame.number);
    hash.mix(&frame.split, sizeof frame.split);
  }
  for (const StageCamera& camera : capture.cameras) {
    hash.mix(camera.name.data(), camera.name.size());
    hash.mix(&camera.test, sizeof camera.test);
  }
  hash.mix(capture.body_keypoints);
  hash.mix(capture.rig.mesh.vertices);
  return std::to_string(hash.value);
}

std::vector<float> pack(const std::vector<CameraColour>& colours) {
  std::vector<float> flat;
  for (const CameraColour& colour : colours) {
    flat.insert(flat.end(), colour.gain.begin(), colour.gain.end());
    flat.insert(flat.end(), colour.offset.begin(), colour.offset.end());
  }
  return flat;
}

}  // namespace

uint64_t BodyTrainer::fingerprint() const {
  State& s = *state_;
  Hash hash;
  const std::string made_on = fingerprint_of(s.capture) + to_json(s.settings).dump();
  hash.mix(made_on.data(), made_on.size());
  for (const BodyParameter& parameter : s.model.networks().parameters()) hash.mix(parameter.value);
  hash.mix(s.model.maps().albedo);
  hash.mix(s.model.maps().log_roughness);
  hash.mix(pack(s.colours));
  return hash.value;
}

void BodyTrainer::save_checkpoint(const Path& path) const {
  State& s = *state_;
  TensorFile file;
  file.metadata = {
      {"format", "effigy-checkpoint"},          {"capture", fingerprint_of(s.capture)},
      {"settings", to_json(s.settings).dump()}, {"iteration", std::to_string(s.iteration)},
      {"order", std::to_string(s.order)},       {"view", std::to_string(s.next_number())}};
  s.model.save(file);
  const std::vector<BodyParameter> parameters = s.model.networks().parameters();
  for (size_t p = 0; p < parameters.size(); ++p)
    save_adam(s.networks[p], "adam." + parameters[p].name, file);
  save_adam(s.albedo, "adam.albedo", file);
  save_adam(s.roughness, "adam.roughness", file);
  const auto cameras = static_cast<int64_t>(s.colours.size());
  file.tensors["cameras"] = Tensor::from(std::span<const float>(pack(s.colours)), {cameras, 6});
  for (size_t c = 0; c < s.colours.size(); ++c)
    save_adam(s.colour_states[c], "adam.camera." + std::to_string(c), file);
  const std::vector<float> recent(s.recent.begin(), s.recent.end());
  file.tensors["recent"] =
      Tensor::from(std::span<const float>(recent), {static_cast<int64_t>(recent.size())});
  write_safetensors(path, file);
}

void BodyTrainer::load_checkpoint(const Path& path) {
  State& s = *state_;
  const TensorFile file = read_safetensors(path);
  const auto meta = [&](const char* name) {
    const auto found = file.metadata.find(name);
    return found == file.metadata.end() ? std::string() : found->second;
  };
  if (meta("capture") != fingerprint_of(s.capture))
    throw Error(path.string() +
                ": the checkpoint belongs to another capture (or its tracking has changed); train "
                "without --resume.");
  if (meta("settings") != to_json(s.settings).dump())
    throw Error(path.string() +
                ": the checkpoint was made with other settings; give the same options, or train "
                "without --resume.");
  s.model = BodyModel(s.capture.rig.mesh, file);
  s.prepare_model();
  const std::vector<BodyParameter> parameters = s.model.networks().parameters();
  for (size_t p = 0; p < parameters.size(); ++p)
    s.networks[p] = load_adam(file, "adam." + parameters[p].name, parameters[p].value.size());
  s.albedo = load_adam(file, "adam.albedo", s.albedo.size());
  s.roughness = load_adam(file, "adam.roughness", s.roughness.size());
  const std::vector<float> colours =
      file.floats("cameras", {static_cast<int64_t>(s.colours.size()), 6});
  for (size_t c = 0; c < s.colours.size(); ++c) {
    std::copy_n(&colours[6 * c], 3, s.colours[c].gain.begin());
    std::copy_n(&colours[6 * c + 3], 3, s.colours[c].offset.begin());
    s.colour_states[c] = load_adam(file, "adam.camera." + std::to_string(c), 6);
  }
  const std::vector<float> recent = file.floats("recent", {-1});
  s.recent.assign(recent.begin(), recent.end());
  s.iteration = std::strtoll(meta("iteration").c_str(), nullptr, 10);
  s.order = std::strtoll(meta("order").c_str(), nullptr, 10);
  s.go_to(std::strtoull(meta("view").c_str(), nullptr, 10));
}

}  // namespace effigy
