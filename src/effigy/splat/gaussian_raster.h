// The Gaussian rasterizer: 3D Gaussians with EWA projection (3DGS, Kerbl et al. 2023; Zwicker et
// al. 2001) and any number of feature channels in one pass, forward and backward.
//
// Gaussian i has covariance S = R diag(scale)^2 R^T, R the rotation of its quaternion divided by
// its length. On the screen: mean (fx x/z + cx, fy y/z + cy) of its centre in camera space,
// covariance C = J W S W^T J^T + blur I, W the camera's rotation, J the Jacobian of the projection
// at the centre (not clamped towards the image border). For a pixel, Gaussians with z > near in
// order of z (ties by index):
//   a = min(0.99, opacity exp(-d^T C^-1 d / 2)), d = pixel centre - mean; skipped when a < 1/255;
//   T (1 - a) < 1e-4: the pixel is finished before this Gaussian; else w = a T, T *= 1 - a;
//   alpha = sum of w, feature c = sum of w f_c + (1 - alpha) background_c.
// With `compensate` the opacity is multiplied by sqrt(det(C - blur I) / det C), so that the blur
// does not make small Gaussians heavier (Mip-Splatting, Yu et al. 2024).
//
// Gaussians that cannot be drawn are left out: any value that is not finite, a quaternion of length
// zero, no area on the screen.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/image/image.h"

namespace effigy {

// Arrays of n Gaussians.
struct GaussianView {
  std::span<const float> center;    // n * 3, world, metres
  std::span<const float> rotation;  // n * 4: w x y z, of any length but zero
  std::span<const float> scale;     // n * 3, standard deviations along the rotated axes, metres
  std::span<const float> opacity;   // n
  std::span<const float> features;  // n * channels
  int channels = 3;
  size_t count() const { return opacity.size(); }
};

struct Gaussians {
  std::vector<float> center, rotation, scale, opacity, features;  // as GaussianView
  int channels = 3;
  size_t count() const { return opacity.size(); }
  void resize(size_t count);
  GaussianView view() const;
};

// Derivatives of a loss; backward adds to them.
struct GaussianGradients {
  std::span<float> center, rotation, scale, opacity, features;  // as GaussianView
  std::span<float> background;                                  // channels, or empty: not wanted
};

struct GaussianRasterOptions {
  float near = 0.01f;
  float blur = 0.3f;  // squared pixels
  bool compensate = false;
  std::vector<float> background;  // channels; empty: zero
};

// What forward leaves for backward. Reusable between frames (keeps its memory).
class GaussianFrame {
 public:
  GaussianFrame();
  ~GaussianFrame();
  GaussianFrame(GaussianFrame&&) noexcept;
  GaussianFrame& operator=(GaussianFrame&&) noexcept;
  // Of the last forward pass: Gaussian-pixel pairs blended, and Gaussians in view.
  int64_t pairs() const;
  size_t visible() const;

  struct State;
  std::unique_ptr<State> state;
};

// Draws into `image`, resized to the camera: plane 0 is alpha, plane 1 + c feature c. Accuracy
// contract: within 1e-4 of the double-precision oracle (99.9th percentile, relative to the plane's
// largest value). The same bits for every thread count.
void render_gaussians(const Camera& camera, const GaussianView& gaussians,
                      const GaussianRasterOptions& options, Planes& image, GaussianFrame& frame);

// Backward of the last render_gaussians with the same arguments. `d_image`: derivative of the loss
// with respect to every plane. Accuracy contract: within 1e-4 relative L2 of the true gradient for
// each array. The same bits for every thread count.
void render_gaussians_backward(const Camera& camera, const GaussianView& gaussians,
                               const GaussianRasterOptions& options, const Planes& image,
                               const GaussianFrame& frame, const Planes& d_image,
                               const GaussianGradients& gradients);

}  // namespace effigy
