// Losses on the tuned mesh, its rig and the surfels' places on it (GTAvatar section 4.4). Each
// returns its unweighted value and adds weight times its gradient where a span is not empty.
#pragma once

#include <span>
#include <vector>

#include "effigy/geometry/laplacian.h"

namespace effigy {

// Mean over vertices of |L (tuned - original)|^2, both posed (3V, metres), L the uniform graph
// Laplacian: keeps the fine-tuned mesh's offsets smooth. `scratch` keeps its memory between calls.
double laplacian_loss(const UniformLaplacian& laplacian, std::span<const float> tuned,
                      std::span<const float> original, float weight, std::span<float> d_tuned,
                      std::vector<float>& scratch);

// Mean over surfels of |b - 1/3|^2 over the three barycentric coordinates, of which the last two
// are stored (2N, as BoundSurfels::barycentric; the first is 1 - b - c).
double barycentric_loss(std::span<const float> barycentric, float weight,
                        std::span<float> d_barycentric);

// How an array's distance from its tracked or original values is counted.
enum class Distance {
  kMeanSquared,  // mean over entries of (value - reference)^2
  kMeanRowNorm,  // mean over rows of `width` entries of |value - reference|_2 (the norm itself)
};

// Keeps a tuned array of the rig (template, bases, weights) near its original, and expressions near
// the tracker's (kMeanSquared: L_expr). kMeanRowNorm's gradient at distance 0 is 0.
double distance_loss(std::span<const float> value, std::span<const float> reference,
                     Distance distance, size_t width, float weight, std::span<float> d_value);

}  // namespace effigy
