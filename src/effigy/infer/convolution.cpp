#include "effigy/infer/convolution.h"

#include <ATen/Context.h>
#include <ATen/Parallel.h>
#include <ATen/ops/conv2d.h>
#include <ATen/ops/mkldnn_convolution.h>
#include <ATen/ops/zeros.h>
#include <dlfcn.h>
#include <torch/csrc/autograd/custom_function.h>

namespace effigy {
namespace {

using torch::autograd::AutogradContext;
using torch::autograd::Variable;
using torch::autograd::variable_list;

struct FrozenConvolution : torch::autograd::Function<FrozenConvolution> {
  static Variable forward(AutogradContext* context, const Variable& x, const at::Tensor& weight,
                          const at::Tensor& bias, int64_t padding) {
    context->save_for_backward({weight});
    context->saved_data["padding"] = padding;
    return convolve(x, weight, bias, {1, 1}, {padding, padding}, {1, 1}, 1);
  }
  // Of a correlation: the correlation with the kernel turned round, from outputs to inputs.
  static variable_list backward(AutogradContext* context, const variable_list& d_out) {
    const at::Tensor weight = context->get_saved_variables()[0];
    const int64_t padding = weight.size(2) - 1 - context->saved_data["padding"].toInt();
    const at::Tensor turned = weight.transpose(0, 1).flip({2, 3}).contiguous();
    const at::Tensor none = at::zeros({turned.size(0)}, turned.scalar_type());
    return {convolve(d_out[0].contiguous(), turned, none, {1, 1}, {padding, padding}, {1, 1}, 1),
            Variable(), Variable(), Variable()};
  }
};

}  // namespace

at::Tensor convolve_frozen(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                           int64_t padding) {
  return FrozenConvolution::apply(x, weight, bias, padding);
}

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
