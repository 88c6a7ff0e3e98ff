// A stride-2 transposed convolution with a 4x4 kernel and padding 1, its bias and its activation,
// forward and backward in one pass each, on plain arrays.
//
// It is one 2x2 convolution to four phases and a shuffle of pixels: exact, without the zeros that a
// 3x3 form would multiply. In one dimension y[2i - 1 + k] += x[i] w[k], k = 0..3. Cell j = 0..n
// sees x[j - 1] (tap t = 0) and x[j] (t = 1) and makes y[2j - 1 + p], p = 0, 1, with the weight
//   v[t][p] = w[2 - 2t + p];
// y[-1] and y[2n] fall outside and are dropped. In two dimensions the weight is
//   V[ty][tx][in][py][px][out] = W[in][out][2 - 2 ty + py][2 - 2 tx + px]
// with W as torch's ConvTranspose2d has it. Two taps of a row lie side by side in memory, so a row
// of cells is a matrix product that reads the picture in place. The phases never leave the cache.
#pragma once

#include <cstddef>

namespace effigy {

struct UpConvolution {
  size_t height = 0, width = 0;  // of x
  size_t in = 0, out = 0;        // channels
  bool tied = false;             // one bias per channel instead of one per channel and pixel
  double slope = 1.0;            // of negative values; positive, 1 for none
};

// y [2 height, 2 width, out] = leaky(transposed convolution of x [height, width, in] + bias), bias
// [2 height, 2 width, out] or, tied, [out]. The result does not depend on the thread count.
void up_convolution(const UpConvolution& shape, const float* x, const float* weight,
                    const float* bias, float* y);
void up_convolution(const UpConvolution& shape, const double* x, const double* weight,
                    const double* bias, double* y);

// From y (its sign is that of the activation's argument) and its gradient. Writes d_x, d_weight and
// d_bias. Null d_x or d_bias: not wanted (an untied bias without activation has the gradient d_y).
// The same thread count gives the same bits.
void up_convolution_backward(const UpConvolution& shape, const float* x, const float* weight,
                             const float* y, const float* d_y, float* d_x, float* d_weight,
                             float* d_bias);
void up_convolution_backward(const UpConvolution& shape, const double* x, const double* weight,
                             const double* y, const double* d_y, double* d_x, double* d_weight,
                             double* d_bias);

}  // namespace effigy
