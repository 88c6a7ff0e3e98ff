// A bias and an activation in one pass, and its backward, on plain arrays.
#pragma once

#include <cstddef>

namespace effigy {

// y = leaky(x + bias), leaky(z) = z > 0 ? z : slope z, slope > 0, over `pixels` pixels; bias
// [pixels, channels] or, tied, [channels].
template <typename T>
void add_bias(size_t pixels, size_t channels, bool tied, double slope, const T* x, const T* bias,
              T* y);
// From y (its sign is that of the activation's argument) and its gradient.
template <typename T>
void add_bias_backward(size_t pixels, size_t channels, bool tied, double slope, const T* y,
                       const T* d_y, T* d_x, T* d_bias);

}  // namespace effigy
