// Separable filtering shared by the blur and the metrics.
#pragma once

#include <span>
#include <vector>

namespace effigy {

// Filters `channels` interleaved channels of width x height floats with kernel_x along rows and
// kernel_y along columns (correlation, odd lengths, centre in the middle), repeating the edge.
// `out` may be `in`.
void filter_separable(const float* in, int width, int height, int channels,
                      std::span<const float> kernel_x, std::span<const float> kernel_y, float* out);

// exp(-x^2 / (2 sigma^2)) at x = -radius..radius, divided by its sum.
std::vector<float> gaussian_kernel(double sigma, int radius);

}  // namespace effigy
