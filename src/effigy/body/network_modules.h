// The networks of a body avatar as libtorch functions with gradients. For body/ and its tests only:
// it brings libtorch's headers along; body/networks.h is what others use.
#pragma once

#include <string>
#include <vector>

#include "effigy/body/network_settings.h"
#include "effigy/learn/layers.h"

namespace effigy {

class BodyModules {
 public:
  // Makes (counts, loads) the parameters in a fixed order; names begin with "encoder.", "seed.",
  // "view_independent.", "view_dependent.", "shadow.".
  BodyModules(const BodyNetworkSettings& settings, ParameterMaker& make);

  // Eq. 3: keypoints [1, 3 K] in the root's and the head's frame, normalised -> latents
  // [1, body_latent + face_latent].
  at::Tensor encode(const at::Tensor& body, const at::Tensor& face) const;
  // Latents -> the picture [8, 8, seed_channels] that both decoders start from.
  at::Tensor seed(const at::Tensor& latents) const;
  // Eq. 4, D_ci: -> [texture, texture, 65] before activations (gaussian_channels.h).
  at::Tensor decode(const at::Tensor& seed) const;
  // D_cv: with viewing directions [8, 8, 3], the mean over each eighth's texels in their local
  // frames -> specular visibility [texture, texture, 1] in (0, 1).
  at::Tensor visibility(const at::Tensor& seed, const at::Tensor& view) const;
  // Normalised irradiance (Eq. 15) less its mean [shadow_side, shadow_side, 1] -> shadow
  // [texture, texture, 1] in (0, 1), 1 = lit: a U-Net of constant width (Bagautdinov et al. 2021).
  at::Tensor shadow(const at::Tensor& irradiance) const;

 private:
  int64_t texture_ = 0, seed_channels_ = 0;
  std::vector<DenseLayer> body_encoder_, face_encoder_, seed_, view_;
  std::vector<UpLayer> view_independent_, view_dependent_;
  std::vector<ConvLayer> shadow_down_, shadow_up_, shadow_out_;
};

// Parameters per module, in the order they are made: weights (with gains) and biases.
struct BodyModuleCount {
  std::string module;
  int64_t weights = 0, biases = 0;
};
std::vector<BodyModuleCount> count_body_parameters(const BodyNetworkSettings& settings);

}  // namespace effigy
