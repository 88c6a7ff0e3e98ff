// A stride-2 transposed convolution with a 4x4 kernel and padding 1 is one 2x2 convolution to four
// phases followed by a shuffle of pixels: exact, without the zeros that a 3x3 form would multiply,
// and several times faster than libtorch's transposed convolution on a CPU.
//
// In one dimension y[2i - 1 + k] += x[i] w[k], k = 0..3. Cell j = 0..n of the phase picture sees
// x[j - 1] (tap t = 0) and x[j] (t = 1) and makes y[2j - 1 + p], p = 0, 1, with
//   w_phase[p][t] = w[2 - 2t + p];
// y[-1] and y[2n] fall outside and are dropped. Here are the passes around the convolution, on
// plain arrays; pictures are [height, width, channels].
#pragma once

#include <cstddef>

namespace effigy {

struct PhaseShuffle {
  size_t height = 0, width = 0;  // of the picture before it is doubled
  size_t channels = 0;           // after
  bool tied = false;             // one bias per channel instead of one per channel and pixel
  double slope = 1.0;            // y = x > 0 ? x : slope x; positive, 1 for none
  size_t phase_count() const { return (height + 1) * (width + 1) * 4 * channels; }
  size_t output_count() const { return height * width * 4 * channels; }
  size_t bias_count() const { return tied ? channels : output_count(); }
};

// output [2 height, 2 width, channels] = leaky(phases [height + 1, width + 1, (py, px, channel)],
// shuffled, + bias).
template <typename T>
void phase_shuffle(const PhaseShuffle& shape, const T* phases, const T* bias, T* output);

// From the output itself (its sign is that of the activation's argument) and the gradient of the
// output. Writes d_phases (zero at the dropped places) and d_bias.
template <typename T>
void phase_shuffle_backward(const PhaseShuffle& shape, const T* output, const T* d_output,
                            T* d_phases, T* d_bias);

// y = leaky(x + bias) over `pixels` pixels, and its backward; bias [pixels, channels] or, tied,
// [channels]. d_x may be d_bias when the bias is not tied.
template <typename T>
void add_bias(size_t pixels, size_t channels, bool tied, double slope, const T* x, const T* bias,
              T* y);
template <typename T>
void add_bias_backward(size_t pixels, size_t channels, bool tied, double slope, const T* y,
                       const T* d_y, T* d_x, T* d_bias);

}  // namespace effigy
