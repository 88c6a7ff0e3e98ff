// Losses of body avatars (Relightable Full-Body Gaussian Codec Avatars, Eq. 17-18 and appendix B,
// with docs/decisions.md), with their gradients.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "effigy/body/draw.h"
#include "effigy/body/train_settings.h"
#include "effigy/image/colour.h"

namespace effigy {

// Unweighted loss values of one view, by the names of BodyWeights.
using BodyLossValues = std::map<std::string, double>;

// What a camera saw.
struct BodyTarget {
  Planes image;             // 3 planes, display-encoded
  std::vector<float> mask;  // 1 a pixel, 1 = body
  Planes background;        // 3 planes, linear, behind the body; empty: black
  DisplayTransform display = DisplayTransform::kSrgb;
};

// A camera's colour: gain * radiance + offset * alpha, linear, r g b.
struct CameraColour {
  std::array<float, 3> gain{1, 1, 1}, offset{0, 0, 0};
};

struct BodyImageGradients {
  Planes radiance;           // 3 planes
  std::vector<float> alpha;  // 1 a pixel
  std::array<double, 3> gain{}, offset{};
};

// How different a network finds two pictures of 3 planes, display-encoded; adds `weight` times the
// derivative by `drawn` to d_drawn (PerceptualDistance::loss, which needs libtorch).
using PictureDistance =
    std::function<double(const Planes& drawn, const Planes& target, float weight, Planes& d_drawn)>;

// Losses on the picture: l1, dssim, pyramid, lpips or features (display-encoded, over the target's
// background), mask and alpha_sparsity (both without the border of the mask). Writes `gradients`.
// `perceptual`: the network that settings.perceptual names; empty for none.
BodyLossValues body_image_losses(const BodyTrainSettings& settings, const BodyTarget& target,
                                 const CameraColour& camera, const BodyPicture& picture,
                                 BodyImageGradients& gradients,
                                 const PictureDistance& perceptual = {});
// The picture as display-encoded image over the target's background: what the losses compare.
void body_display(const BodyPicture& picture, const CameraColour& camera, const BodyTarget& target,
                  Planes& encoded);

// Losses on the texels: scale, offset, normal, bound, transfer, albedo, neg_color. `normal_weight`:
// of |delta n|^2 at this moment. `diffuse`: BodyPicture::diffuse(). Adds to d_decoded, `gradients`
// and d_diffuse (3 planes).
BodyLossValues body_texel_losses(const BodyTrainSettings& settings, double normal_weight,
                                 std::span<const float> decoded, const BodySurface& surface,
                                 std::span<const float> diffuse, std::span<float> d_decoded,
                                 BodySurfaceGradients& gradients, std::span<float> d_diffuse);

// Zonal transfer of one far light from `direction` (unit) that is negative: light that would make
// the surface darker, which many lamps together hide. Mean square over texels and channels; adds
// `weight` times its gradient.
double dark_lobe_loss(const BodySurface& surface, const Vec3f& direction, float weight,
                      BodySurfaceGradients& gradients);

// Appendix B.2 and its relative form: cost and derivative of one value.
struct BoundCost {
  double cost = 0, slope = 0;
};
BoundCost bound_cost(double value, double low, double high, bool relative);

}  // namespace effigy
