#include "effigy/body/networks.h"

#include <ATen/TensorOperators.h>
#include <ATen/core/grad_mode.h>
#include <ATen/ops/cat.h>
#include <ATen/ops/empty.h>
#include <ATen/ops/from_blob.h>
#include <ATen/ops/tensor.h>
#include <ATen/ops/zeros.h>
#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/body/gaussian_channels.h"
#include "effigy/body/network_modules.h"
#include "effigy/infer/convolution.h"

namespace effigy {
namespace {

constexpr const char* kPrefix = "networks.";
constexpr float kSmallestDeviation = 1e-4f;

at::Tensor copy_of(std::span<const float> values, const std::vector<int64_t>& shape) {
  at::Tensor tensor = at::empty(shape, at::ScalarType::Float);
  EFFIGY_CHECK_EQ(tensor.numel(), values.size());
  parallel_for(values.size(), 1 << 16, [&](size_t begin, size_t end, int) {
    std::copy_n(&values[begin], end - begin, tensor.data_ptr<float>() + begin);
  });
  return tensor;
}

std::span<float> values_of(const at::Tensor& tensor) {
  return {tensor.data_ptr<float>(), static_cast<size_t>(tensor.numel())};
}

void check_texels(const std::vector<int32_t>& texels, int texture, const std::string& name) {
  const int64_t end = int64_t{texture} * texture;
  if (texels.empty()) throw Error(name + ": there are no valid texels; the mesh needs UVs.");
  for (size_t i = 0; i < texels.size(); ++i)
    if (texels[i] < 0 || texels[i] >= end || (i > 0 && texels[i] <= texels[i - 1]))
      throw Error(name + ": valid texel " + std::to_string(i) + " is " + std::to_string(texels[i]) +
                  ", expected ascending numbers below " + std::to_string(end) + ".");
}

void check_scale(const KeypointScale& scale, int keypoints, const std::string& name) {
  if (scale.mean.size() != 3 * static_cast<size_t>(keypoints) || !(scale.deviation > 0.0f) ||
      !std::isfinite(scale.deviation))
    throw Error(name + ": the keypoints' scale needs " + std::to_string(3 * keypoints) +
                " means and a positive deviation.");
}

}  // namespace

KeypointScale keypoint_scale(std::span<const float> frames, int keypoints) {
  const size_t width = 3 * static_cast<size_t>(keypoints);
  EFFIGY_CHECK(width > 0 && !frames.empty() && frames.size() % width == 0);
  const size_t count = frames.size() / width;
  std::vector<double> mean(width);
  for (size_t i = 0; i < frames.size(); ++i) mean[i % width] += frames[i];
  for (double& value : mean) value /= static_cast<double>(count);
  double square = 0;
  for (size_t i = 0; i < frames.size(); ++i) {
    const double off = frames[i] - mean[i % width];
    square += off * off;
  }
  KeypointScale scale;
  scale.mean.assign(mean.begin(), mean.end());
  scale.deviation =
      std::max(kSmallestDeviation,
               static_cast<float>(std::sqrt(square / static_cast<double>(frames.size()))));
  return scale;
}

struct BodyNetworks::State {
  BodyNetworkSettings settings;
  std::vector<int32_t> texels;
  KeypointScale body_scale, face_scale;
  std::vector<float> mean_irradiance;
  ParameterMaker maker;
  BodyModules modules;
  at::Tensor pixels;          // texels as int64
  std::vector<int> cell;      // of each texel, in the 8 x 8 picture
  std::vector<float> weight;  // of each texel in its cell's mean
  bool training = false;
  at::Tensor seed, gaussians, visibility, shadow;  // of the last calls

  State(const BodyNetworkSettings& s, std::vector<int32_t> valid, ParameterMaker&& make,
        const std::string& name)
      : settings((s.check(name), s)),
        texels(std::move(valid)),
        maker(std::move(make)),
        modules(settings, maker) {
    check_texels(texels, settings.texture(), name);
    body_scale.mean.resize(3 * static_cast<size_t>(settings.body_keypoints));
    face_scale.mean.resize(3 * static_cast<size_t>(settings.face_keypoints));
    mean_irradiance.resize(static_cast<size_t>(settings.shadow_side) *
                           static_cast<size_t>(settings.shadow_side));
    pixels = at::empty({static_cast<int64_t>(texels.size())}, at::ScalarType::Long);
    std::copy(texels.begin(), texels.end(), pixels.data_ptr<int64_t>());
    const int side = settings.texture(), texels_per_cell = side / kSeedSide;
    std::vector<int> members(kSeedSide * kSeedSide);
    for (int32_t texel : texels) {
      cell.push_back(texel / side / texels_per_cell * kSeedSide + texel % side / texels_per_cell);
      ++members[static_cast<size_t>(cell.back())];
    }
    for (int c : cell) weight.push_back(1.0f / static_cast<float>(members[static_cast<size_t>(c)]));
  }

  at::Tensor keypoints(std::span<const float> values, const KeypointScale& scale,
                       const char* name) const {
    EFFIGY_CHECK_EQ(values.size(), scale.mean.size());
    at::Tensor x = at::empty({1, static_cast<int64_t>(values.size())}, at::ScalarType::Float);
    for (size_t i = 0; i < values.size(); ++i) {
      if (!std::isfinite(values[i]))
        throw Error(std::string("The ") + name + " keypoint " + std::to_string(i / 3) +
                    " is not finite; leave the frame out or repair its keypoints.");
      x.data_ptr<float>()[i] = (values[i] - scale.mean[i]) / scale.deviation;
    }
    return x;
  }
};

BodyNetworks::BodyNetworks(const BodyNetworkSettings& settings, std::vector<int32_t> texels,
                           uint64_t seed)
    : state_(std::make_unique<State>(settings, std::move(texels),
                                     ParameterMaker::initial(seed, at::ScalarType::Float),
                                     "The body networks")) {}
BodyNetworks::BodyNetworks(std::unique_ptr<State> state) : state_(std::move(state)) {}
BodyNetworks::BodyNetworks(BodyNetworks&&) noexcept = default;
BodyNetworks& BodyNetworks::operator=(BodyNetworks&&) noexcept = default;
BodyNetworks::~BodyNetworks() = default;

const BodyNetworkSettings& BodyNetworks::settings() const {
  return state_->settings;
}
const std::vector<int32_t>& BodyNetworks::texels() const {
  return state_->texels;
}

void BodyNetworks::set_keypoint_scale(KeypointScale body, KeypointScale face) {
  check_scale(body, state_->settings.body_keypoints, "The body networks");
  check_scale(face, state_->settings.face_keypoints, "The body networks");
  state_->body_scale = std::move(body);
  state_->face_scale = std::move(face);
}

void BodyNetworks::set_mean_irradiance(std::vector<float> mean) {
  EFFIGY_CHECK_EQ(mean.size(), state_->mean_irradiance.size());
  state_->mean_irradiance = std::move(mean);
}

void BodyNetworks::set_training(bool training) {
  state_->training = training;
}

std::span<const float> BodyNetworks::decode(std::span<const float> body,
                                            std::span<const float> face) {
  State& s = *state_;
  use_torch_threads(thread_count());
  const at::AutoGradMode mode(s.training);
  s.visibility = at::Tensor();
  s.seed = s.modules.seed(s.modules.encode(s.keypoints(body, s.body_scale, "body"),
                                           s.keypoints(face, s.face_scale, "face")));
  s.gaussians = gather_pixels(s.modules.decode(s.seed), s.pixels);
  return values_of(s.gaussians);
}

std::span<const float> BodyNetworks::visibility(std::span<const float> directions) {
  State& s = *state_;
  EFFIGY_CHECK(s.seed.defined());
  EFFIGY_CHECK_EQ(directions.size(), 3 * s.texels.size());
  use_torch_threads(thread_count());
  const at::AutoGradMode mode(s.training);
  at::Tensor view = at::zeros({kSeedSide, kSeedSide, 3}, at::ScalarType::Float);
  float* mean = view.data_ptr<float>();
  for (size_t i = 0; i < s.texels.size(); ++i)
    for (size_t c = 0; c < 3; ++c)
      mean[3 * static_cast<size_t>(s.cell[i]) + c] += s.weight[i] * directions[3 * i + c];
  s.visibility = gather_pixels(s.modules.visibility(s.seed, view), s.pixels);
  return values_of(s.visibility);
}

std::span<const float> BodyNetworks::shadow(std::span<const float> irradiance) {
  State& s = *state_;
  const size_t size = s.mean_irradiance.size(), pictures = irradiance.size() / size;
  EFFIGY_CHECK(pictures >= 1 && irradiance.size() == pictures * size);
  use_torch_threads(thread_count());
  const at::AutoGradMode mode(s.training);
  std::vector<at::Tensor> shadows;
  for (size_t k = 0; k < pictures; ++k) {
    at::Tensor x =
        at::empty({s.settings.shadow_side, s.settings.shadow_side, 1}, at::ScalarType::Float);
    for (size_t i = 0; i < size; ++i)
      x.data_ptr<float>()[i] = irradiance[k * size + i] - s.mean_irradiance[i];
    shadows.push_back(gather_pixels(s.modules.shadow(x), s.pixels));
  }
  s.shadow = pictures == 1 ? shadows.front() : at::cat(shadows, 0);
  return values_of(s.shadow);
}

void BodyNetworks::backward(std::span<const float> d_gaussians, std::span<const float> d_visibility,
                            std::span<const float> d_shadow) {
  State& s = *state_;
  use_torch_threads(thread_count());
  std::vector<at::Tensor> results, gradients;
  const auto add = [&](const at::Tensor& result, std::span<const float> gradient) {
    if (gradient.empty()) return;
    EFFIGY_CHECK(result.defined() && result.requires_grad());
    results.push_back(result);
    gradients.push_back(copy_of(gradient, result.sizes().vec()));
  };
  add(s.gaussians, d_gaussians);
  add(s.visibility, d_visibility);
  add(s.shadow, d_shadow);
  if (!results.empty()) torch::autograd::backward(results, gradients);
  s.seed = s.gaussians = s.visibility = s.shadow = at::Tensor();
}

void BodyNetworks::clear_gradients() {
  for (Parameter& parameter : state_->maker.parameters())
    parameter.value.mutable_grad() = at::Tensor();
}

std::vector<BodyParameter> BodyNetworks::parameters() {
  std::vector<BodyParameter> list;
  for (const Parameter& parameter : state_->maker.parameters()) {
    const auto count = static_cast<size_t>(parameter.value.numel());
    at::Tensor& gradient = parameter.value.mutable_grad();
    if (gradient.defined() && !gradient.is_contiguous()) gradient = gradient.contiguous();
    list.push_back({parameter.name,
                    {parameter.value.data_ptr<float>(), count},
                    gradient.defined() ? values_of(gradient) : std::span<float>()});
  }
  return list;
}

void BodyNetworks::save(TensorFile& file) const {
  const State& s = *state_;
  const std::string prefix = kPrefix;
  file.metadata["networks"] = to_json(s.settings).dump();
  file.tensors[prefix + "texels"] =
      Tensor::from(std::span<const int32_t>(s.texels), {static_cast<int64_t>(s.texels.size())});
  const auto store = [&](const std::string& name, std::span<const float> values,
                         std::vector<int64_t> shape) {
    file.tensors[prefix + name] = Tensor::from(values, std::move(shape));
  };
  const auto store_scale = [&](const std::string& name, const KeypointScale& scale) {
    store(name + ".mean", scale.mean, {static_cast<int64_t>(scale.mean.size())});
    store(name + ".deviation", {&scale.deviation, 1}, {1});
  };
  store_scale("keypoints.body", s.body_scale);
  store_scale("keypoints.face", s.face_scale);
  store("mean_irradiance", s.mean_irradiance, {s.settings.shadow_side, s.settings.shadow_side});
  for (const Parameter& parameter : state_->maker.parameters())
    store(parameter.name, values_of(parameter.value), parameter.shape);
}

BodyNetworks BodyNetworks::load(const TensorFile& file) {
  const std::string prefix = kPrefix, name = file.path.string();
  const auto found = file.metadata.find("networks");
  const Json json = found == file.metadata.end() ? Json(Json::value_t::discarded)
                                                 : Json::parse(found->second, nullptr, false);
  if (!json.is_object())
    throw Error(name + ": its metadata do not describe body networks; write the file again.");
  const BodyNetworkSettings settings = body_network_settings(json, file.path);
  auto state = std::make_unique<State>(settings, file.ints(prefix + "texels", {-1}),
                                       ParameterMaker::from_file(file, prefix), name);
  const auto load_scale = [&](const std::string& field, int keypoints) {
    KeypointScale scale{file.floats(prefix + field + ".mean", {3 * keypoints}),
                        file.floats(prefix + field + ".deviation", {1}).front()};
    check_scale(scale, keypoints, name);
    return scale;
  };
  state->body_scale = load_scale("keypoints.body", settings.body_keypoints);
  state->face_scale = load_scale("keypoints.face", settings.face_keypoints);
  state->mean_irradiance =
      file.floats(prefix + "mean_irradiance", {settings.shadow_side, settings.shadow_side});
  return BodyNetworks(std::move(state));
}

}  // namespace effigy
