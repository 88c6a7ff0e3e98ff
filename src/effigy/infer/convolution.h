// For infer/, learn/ and body/ only (it brings libtorch's headers along): how libtorch is used: one
// convolution on whichever of its backends is the fastest here, and its threads.
#pragma once

#include <ATen/core/Tensor.h>

#include <array>

namespace effigy {

// x [N, C, H, W], weight [O, C / groups, K, K], bias [O]; zeros around.
at::Tensor convolve(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                    const std::array<int64_t, 2>& stride, const std::array<int64_t, 2>& padding,
                    const std::array<int64_t, 2>& dilation, int64_t groups);

// The same for weights that are not trained: stride 1, odd kernels, their gradient by x alone,
// found by a convolution too (libtorch's own would go by its BLAS).
at::Tensor convolve_frozen(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                           int64_t padding);

// Threads that libtorch may use for work of the calling thread. It works on the same team as
// base/threads.h: one size throughout a piece of work, because changing it makes small layers slow.
void use_torch_threads(int count);

}  // namespace effigy
