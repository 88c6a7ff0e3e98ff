#include "effigy/body/network_modules.h"

#include <ATen/TensorOperators.h>
#include <ATen/ops/cat.h>
#include <ATen/ops/sigmoid.h>

#include "effigy/body/gaussian_channels.h"

namespace effigy {
namespace {

// Last layers start small, so that an untrained avatar is near what the activations' fixed offsets
// describe, yet every layer has a gradient from the first step on.
constexpr double kLastGain = 0.1;
// Added before the sigmoid of specular visibility: an untrained avatar is dull, because highlights
// in the wrong places would drive it to nothing, from where it does not come back.
constexpr float kVisibilityOffset = -2.2f;
// Added before the shadow's sigmoid: an untrained avatar is lit.
constexpr double kShadowOffset = 1.0;

std::vector<DenseLayer> make_encoder(ParameterMaker& make, const std::string& name, int64_t in,
                                     const std::vector<int>& hidden, int64_t latent) {
  std::vector<DenseLayer> layers;
  for (int width : hidden) {
    layers.emplace_back(make, name + std::to_string(layers.size()), in, width);
    in = width;
  }
  layers.emplace_back(make, name + std::to_string(layers.size()), in, latent, LayerOptions{1.0});
  return layers;
}

std::vector<UpLayer> make_decoder(ParameterMaker& make, const std::string& name, int64_t in,
                                  const std::vector<int>& widths, int64_t out, bool tied_last) {
  std::vector<UpLayer> layers;
  int64_t side = kSeedSide;
  for (int width : widths) {
    layers.emplace_back(make, name + std::to_string(layers.size()), in, width, side);
    in = width;
    side *= 2;
  }
  layers.emplace_back(make, name + std::to_string(layers.size()), in, out, side,
                      LayerOptions{1.0, tied_last, kLastGain});
  return layers;
}

template <typename Layer>
at::Tensor run(const std::vector<Layer>& layers, at::Tensor x) {
  for (const Layer& layer : layers) x = layer(x);
  return x;
}

}  // namespace

BodyModules::BodyModules(const BodyNetworkSettings& s, ParameterMaker& make)
    : texture_(s.texture()), seed_channels_(s.seed_channels) {
  body_encoder_ =
      make_encoder(make, "encoder.body.", 3 * s.body_keypoints, s.body_hidden, s.body_latent);
  face_encoder_ =
      make_encoder(make, "encoder.face.", 3 * s.face_keypoints, s.face_hidden, s.face_latent);
  seed_.emplace_back(make, "seed.0", s.body_latent + s.face_latent,
                     s.seed_channels * kSeedSide * kSeedSide);
  view_independent_ = make_decoder(make, "view_independent.", s.seed_channels, s.decoder,
                                   s.channels(), s.tied_last);
  view_.emplace_back(make, "view_dependent.view", 3, kViewChannels);
  view_dependent_ = make_decoder(make, "view_dependent.", s.seed_channels + kViewChannels,
                                 s.decoder, 1, s.tied_last);
  int64_t side = s.shadow_side;
  const int64_t width = s.shadow_width;
  for (int level = 0; level < kShadowLevels; ++level, side /= 2)
    shadow_down_.emplace_back(make, "shadow.down" + std::to_string(level), level == 0 ? 1 : width,
                              width, side);
  for (int level = kShadowLevels - 1; level >= 0; --level) {
    side *= 2;
    shadow_up_.emplace_back(make, "shadow.up" + std::to_string(level),
                            level == kShadowLevels - 1 ? width : 2 * width, width, side);
  }
  shadow_out_.emplace_back(make, "shadow.out", width, 1, side, LayerOptions{1.0, true});
}

at::Tensor BodyModules::encode(const at::Tensor& body, const at::Tensor& face) const {
  return at::cat({run(body_encoder_, body), run(face_encoder_, face)}, 1);
}

at::Tensor BodyModules::seed(const at::Tensor& latents) const {
  return run(seed_, latents).view({kSeedSide, kSeedSide, seed_channels_});
}

at::Tensor BodyModules::decode(const at::Tensor& seed) const {
  return run(view_independent_, seed);
}

at::Tensor BodyModules::visibility(const at::Tensor& seed, const at::Tensor& view) const {
  const at::Tensor features = run(view_, view.view({kSeedSide * kSeedSide, 3}));
  const at::Tensor start = at::cat({seed, features.view({kSeedSide, kSeedSide, kViewChannels})}, 2);
  return at::sigmoid(run(view_dependent_, start) + kVisibilityOffset);
}

at::Tensor BodyModules::shadow(const at::Tensor& irradiance) const {
  std::vector<at::Tensor> levels;
  at::Tensor x = irradiance;
  for (const ConvLayer& layer : shadow_down_) {
    if (!levels.empty()) x = resize_picture(x, x.size(0) / 2);
    x = layer(x);
    levels.push_back(x);
  }
  for (size_t i = 0; i < shadow_up_.size(); ++i) {
    if (i > 0) {
      const at::Tensor& skip = levels[levels.size() - 1 - i];
      x = at::cat({resize_picture(x, skip.size(0)), skip}, 2);
    }
    x = shadow_up_[i](x);
  }
  return resize_picture(at::sigmoid(run(shadow_out_, x) + kShadowOffset), texture_);
}

std::vector<BodyModuleCount> count_body_parameters(const BodyNetworkSettings& settings) {
  ParameterMaker counting = ParameterMaker::counting();
  const BodyModules modules(settings, counting);
  std::vector<BodyModuleCount> counts;
  for (const Parameter& parameter : counting.parameters()) {
    const std::string module = parameter.name.substr(0, parameter.name.find('.'));
    if (counts.empty() || counts.back().module != module) counts.push_back({module});
    (parameter.name.ends_with(".bias") ? counts.back().biases : counts.back().weights) +=
        parameter.count();
  }
  return counts;
}

}  // namespace effigy
