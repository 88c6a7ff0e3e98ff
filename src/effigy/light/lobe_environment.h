// An environment filtered by spherical Gaussians of all widths (light/spherical_gaussian.h), for
// lookups by direction and width.
#pragma once

#include <vector>

#include "effigy/light/environment.h"
#include "effigy/light/spherical_gaussian.h"

namespace effigy {

// Level k holds, for every direction q, the mean of the radiance under exp(-theta^2 / 2 sigma_k^2),
// so that constant light gives exactly its value; a lookup interpolates linearly in 1 / sigma^2
// between levels, which is exact for constant light and at the centre of a small lamp (whose means
// go with 1 / sigma^2), and multiplies by N(sigma) times the lobe's integral. sigma_k = 0.01
// 2^(k/2). Against a lamp of one texel a lookup is off by at most 4 % of the lobe's peak where
// sigma is at least three texels of the light (6 / size); levels narrower than a texel are the
// light itself.
class LobeEnvironment {
 public:
  LobeEnvironment() = default;
  // `radiance`: a side of a power of two from 8 to 1024, read at 256 at most. Takes some three
  // seconds of processor time for 128. Throws Error for other sizes.
  explicit LobeEnvironment(const Cubemap& radiance);

  // Integral of L(w) G(w; q, sigma) dw, for `count` unit directions q (3 planes) and widths, added
  // to `colour` (3 planes). Widths are held to [0.01, 0.64] where the light is looked up, not in
  // N(sigma).
  void add(SgNorm norm, size_t count, const float* q, const float* sigma, size_t stride,
           float* colour) const;
  // Adds the derivatives by q (of the bilinear lookup, along the sphere) and sigma.
  void add_backward(SgNorm norm, size_t count, const float* q, const float* sigma, size_t stride,
                    const float* d_colour, float* d_q, float* d_sigma) const;

  static constexpr int kLevels = 13;
  static float level_sigma(int level);
  const Cubemap& level(int k) const { return levels_[static_cast<size_t>(k)]; }

 private:
  std::vector<Cubemap> levels_;
};

}  // namespace effigy
