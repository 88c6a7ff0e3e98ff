#include "effigy/infer/convolution.h"

#include <ATen/Context.h>
#include <ATen/Parallel.h>
#include <ATen/ops/conv2d.h>
#include <ATen/ops/mkldnn_convolution.h>
#include <dlfcn.h>

namespace effigy {

// libtorch gives single-threaded 1x1 convolutions to its BLAS, which is two to three times slower
// than oneDNN on large pictures and starts threads of its own; on tiny ones it is the faster.
at::Tensor convolve(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                    const std::array<int64_t, 2>& stride, const std::array<int64_t, 2>& padding,
                    const std::array<int64_t, 2>& dilation, int64_t groups) {
  constexpr int64_t kTiny = 64;
  static const bool has_onednn = at::globalContext().hasMKLDNN();
  if (has_onednn && x.size(2) * x.size(3) > kTiny)
    return at::mkldnn_convolution(x, weight, bias, padding, stride, dilation, groups);
  return at::conv2d(x, weight, bias, stride, padding, dilation, groups);
}

// OpenBLAS has threads of its own, which spin while they wait; libtorch does not know of them.
void use_torch_threads(int count) {
  static const bool once = [] {
    using SetThreads = void (*)(int);
    const auto set = reinterpret_cast<SetThreads>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"));
    if (set != nullptr) set(1);
    return true;
  }();
  static_cast<void>(once);
  if (at::get_num_threads() != count) at::set_num_threads(count);
}

}  // namespace effigy
