// Normal consistency (2DGS, Huang et al. 2024, section 4.2; GTAvatar section 4.4): surfels' normals
// agree with the surface that the rendered depth describes.
//
// At a pixel p with expected depth z = D / alpha and ray r = ((x + .5 - cx)/fx, (y + .5 - cy)/fy,
// 1) the surface point is X = z r, and the surface's normal, towards the camera,
//   N = normalize((X(x, y+1) - X(x, y-1)) x (X(x+1, y) - X(x-1, y))).
// The loss of a pixel is sum_i w_i (1 - n_i . N) = alpha - n . N with the accumulated normal n =
// sum_i w_i n_i; the value is the mean over the pixels that count: those with alpha > min_alpha
// whose four neighbours have it too (so the image's one-pixel border never counts).
//
// Gradients go to the normal planes, and through N to depth and alpha (of z). The alpha that stands
// alone in "alpha - n . N" is held constant (`detach_alpha`), as 2DGS does with its alpha factor:
// otherwise misaligned surfels would fade instead of turning.
#pragma once

#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/image/image.h"

namespace effigy {

struct NormalConsistencyOptions {
  float min_alpha = 1e-5f;
  bool detach_alpha = true;
};

// `gbuffer` as render_surfels leaves it (splat/surfel_raster.h: alpha, depth, normal). Returns the
// unweighted value; adds weight times the gradient to `d_gbuffer` unless null. `scratch` keeps its
// memory between frames. Does not depend on the thread count.
double normal_consistency_loss(const Planes& gbuffer, const Camera& camera,
                               const NormalConsistencyOptions& options, float weight,
                               Planes* d_gbuffer, std::vector<float>& scratch);

}  // namespace effigy
