// Learnable material textures: raw parameters, their activations, the losses in texture space
// (GTAvatar section 4.2 smoothness and normal regulariser, 4.3 UV mask loss and statistical
// albedo), and the fused optimiser step over all of it.
//
// Layout everywhere: MaterialTexture's (splat/surfel_raster.h), 8 floats a texel, row 0 is v = 0:
// albedo r g b, roughness, F0, normal x, normal y, spare (always 0).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "effigy/learn/adam.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {

inline constexpr size_t kTexelFloats = 8;

// albedo = sigmoid(raw); roughness and F0 = low + (high - low) sigmoid(raw); normal xy = tanh(raw),
// shortened to `normal_limit` where it is longer (so that z = sqrt(1 - x^2 - y^2) stays > 0).
struct TextureActivation {
  float roughness_low = 0.04f, roughness_high = 1.0f;
  float specular_low = 0.02f, specular_high = 1.0f;
  float normal_limit = 0.99f;
};

// Values of one texel. The normal is flat.
struct TexelValue {
  std::array<float, 3> albedo{0.5f, 0.5f, 0.5f};  // linear
  float roughness = 0.5f, specular = 0.05f;
};

// Which texels belong to UV islands (M_uv = 0 in the paper), and which neighbouring pairs do.
class UvMask {
 public:
  // `inside`: width * height, not zero inside an island. Row 0 is v = 0 unless `top_row_first`
  // (as geometry's uv_coverage returns it).
  UvMask(std::span<const uint8_t> inside, int width, int height, bool top_row_first = false);
  int width() const { return width_; }
  int height() const { return height_; }
  size_t inside() const { return inside_; }
  size_t outside() const { return flags_.size() - inside_; }
  // Bits of a texel: 1 inside; 2, 4, 8, 16: its neighbour at x + 1, x - 1, y + 1, y - 1 is inside
  // too (never set for texels outside).
  const std::vector<uint8_t>& flags() const { return flags_; }
  // Kinds of the runs of texels that the kernels walk in (texture_kernel.h).
  const std::vector<uint8_t>& runs() const { return runs_; }

 private:
  int width_, height_;
  size_t inside_ = 0;
  std::vector<uint8_t> flags_, runs_;
};

// What the optimiser moves, with its moments.
struct TextureParameters {
  int width = 0, height = 0;
  std::vector<float> raw;  // height * width * 8
  AdamState adam;
  // Kept by texture_step: runs of texels outside the islands that have nothing to do until an image
  // gradient reaches them (skipping them changes no bit), and the boundary loss they rest under.
  // Clear `resting` after changing raw or adam.
  std::vector<uint8_t> resting;
  std::array<float, 7> resting_under{};
};
// All texels inside at `inside`, all outside at `outside` (the boundary loss's target).
TextureParameters make_texture_parameters(const UvMask& mask, const TextureActivation& activation,
                                          const TexelValue& inside, const TexelValue& outside);
// Parameters whose activation is `texture`, as near as the ranges allow (values are kept 1e-4 of
// the range away from its ends); moments zero.
TextureParameters texture_parameters_of(const MaterialTexture& texture,
                                        const TextureActivation& activation);
// `texture` is resized.
void activate_texture(const TextureParameters& parameters, const TextureActivation& activation,
                      MaterialTexture& texture);

// Arrays "<name>.raw" and Adam's of a checkpoint; load throws Error naming the file.
void save_texture(const TextureParameters& parameters, const std::string& name, TensorFile& file);
TextureParameters load_texture(const TensorFile& file, const std::string& name);

// Weights and targets. All are means: over texels inside, or (boundary) over texels outside.
struct TextureLossSettings {
  // TV(T) = mean over texels inside of |T - T_right| + |T - T_above| over pairs with both inside
  // (squared differences with `tv_squared`); albedo: mean of its three channels.
  float roughness_tv = 0.01f, specular_tv = 0.01f, albedo_tv = 0.0f;
  bool tv_squared = false;
  float normal = 0.01f;   // |x| + |y| + |1 - z| of the normal map, inside
  float boundary = 1.0f;  // sum of |T - outside| over albedo, roughness, F0 and normal, outside
  TexelValue outside{{0, 0, 0}, 0.5f, 0.05f};  // T_init; its normal is flat
  // Differences under this count as zero in the boundary loss (the sigmoid never reaches 0).
  float boundary_tolerance = 1e-3f;
  // Squared distance to a constant, inside (the soft prior of decisions that keep full ranges).
  float roughness_prior = 0.0f, specular_prior = 0.0f;
  float roughness_target = 0.5f, specular_target = 0.05f;
  // |albedo - prior| summed over channels, inside (the paper's statistical albedo); not owned.
  float albedo_prior = 0.0f;
  const MaterialTexture* albedo_target = nullptr;
};

// Unweighted values; a loss whose weight is 0 may be left at 0.
struct TextureLosses {
  double roughness_tv = 0, specular_tv = 0, albedo_tv = 0, normal = 0, boundary = 0;
  double roughness_prior = 0, specular_prior = 0, albedo_prior = 0;
  double total(const TextureLossSettings& settings) const;
};

struct TextureRates {
  float albedo = 5e-3f, roughness = 5e-3f, specular = 5e-3f, normal = 1e-3f;
};

struct TextureStep {
  TextureLosses losses;   // of the texture before the step
  size_t not_finite = 0;  // entries of d_texels that were not finite (taken as zero)
};

// One optimiser step in one pass over memory: gradients of the losses above + `d_texels` (of the
// image losses, with respect to the activated texels) -> chain rule -> Adam -> new activation.
// `texture` must be activate_texture(parameters) on entry and is so again on return; `d_texels` is
// zero on return, ready for the next frame. Does not depend on the thread count.
TextureStep texture_step(TextureParameters& parameters, const TextureActivation& activation,
                         const UvMask& mask, const TextureLossSettings& settings,
                         const TextureRates& rates, const AdamSettings& adam,
                         MaterialTexture& texture, std::span<float> d_texels);

// The same without a step: writes the gradient with respect to raw into `d_raw` (8 a texel).
TextureStep texture_gradient(const TextureParameters& parameters,
                             const TextureActivation& activation, const UvMask& mask,
                             const TextureLossSettings& settings, const MaterialTexture& texture,
                             std::span<const float> d_texels, std::span<float> d_raw);

}  // namespace effigy
