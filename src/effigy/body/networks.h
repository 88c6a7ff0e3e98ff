// The networks of a body avatar on plain arrays: keypoints to Gaussians, viewing directions to
// specular visibility, irradiance to shadow; forward and backward. No libtorch type leaves.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "effigy/base/safetensors.h"
#include "effigy/body/network_settings.h"

namespace effigy {

// What is subtracted from and divided out of keypoints before the encoder sees them.
struct KeypointScale {
  std::vector<float> mean;  // 3 K, metres
  float deviation = 1.0f;   // metres, > 0
};
// Mean and root mean square deviation over frames; `frames` holds 3 K numbers a frame. The
// deviation is at least a tenth of a millimetre.
KeypointScale keypoint_scale(std::span<const float> frames, int keypoints);

// One array of parameters, to be handed to an optimiser. Valid as long as the networks live.
struct BodyParameter {
  std::string name;
  std::span<float> value;
  std::span<float> gradient;  // empty when nothing was passed back since clear_gradients()
};

class BodyNetworks {
 public:
  // texels: the valid texels of the UV picture, ascending row-major indices (row 0 = top) below
  // texture()^2; only they are returned. The same seed gives the same bits.
  BodyNetworks(const BodyNetworkSettings& settings, std::vector<int32_t> texels, uint64_t seed);
  // From the arrays "networks.*" and the metadata "networks" of a file that save() has filled.
  // Throws Error naming the file and what is wrong in it.
  static BodyNetworks load(const TensorFile& file);
  void save(TensorFile& file) const;

  BodyNetworks(BodyNetworks&&) noexcept;
  BodyNetworks& operator=(BodyNetworks&&) noexcept;
  ~BodyNetworks();

  const BodyNetworkSettings& settings() const;
  const std::vector<int32_t>& texels() const;
  // Default: nothing subtracted, metres.
  void set_keypoint_scale(KeypointScale body, KeypointScale face);
  // Subtracted from irradiance, shadow_side^2 numbers (the mean over training frames); default 0.
  void set_mean_irradiance(std::vector<float> mean);

  // Off (the default): nothing is kept for backward().
  void set_training(bool training);

  // Encoder, seed and view-independent decoder for one frame: keypoints [K][3] in metres, the
  // body's in the root's frame, the face's in the head's. Returns [texels][65] before activations
  // (gaussian_channels.h), valid until the next call. Throws Error when a keypoint is not finite.
  std::span<const float> decode(std::span<const float> body, std::span<const float> face);
  // View-dependent decoder after decode(): unit directions texel -> camera in the texels' tangent
  // frames, [texels][3] -> specular visibility in (0, 1), [texels]. Directions get no gradient.
  std::span<const float> visibility(std::span<const float> directions);
  // Shadow network: normalised irradiance in [0, 1], [shadow_side][shadow_side], row 0 = top
  // -> shadow in (0, 1), 1 = lit, [texels]; several pictures one after the other give as many
  // shadows.
  std::span<const float> shadow(std::span<const float> irradiance);

  // Adds the gradients of all parameters from those of the last results (an empty span: no
  // gradient); afterwards the results must be computed again before the next backward().
  void backward(std::span<const float> d_gaussians, std::span<const float> d_visibility,
                std::span<const float> d_shadow);
  void clear_gradients();
  std::vector<BodyParameter> parameters();

 private:
  struct State;
  explicit BodyNetworks(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace effigy
