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

// Threads that libtorch may use for work of the calling thread. Few: they would fight with ours.
void use_torch_threads(int count);

}  // namespace effigy
