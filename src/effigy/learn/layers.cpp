#include "effigy/learn/layers.h"

#include <ATen/Context.h>
#include <ATen/TensorOperators.h>
#include <ATen/ops/conv2d.h>
#include <ATen/ops/empty.h>
#include <ATen/ops/from_blob.h>
#include <ATen/ops/leaky_relu.h>
#include <ATen/ops/linear.h>
#include <ATen/ops/mkldnn_convolution.h>
#include <ATen/ops/norm.h>
#include <ATen/ops/upsample_bilinear2d.h>
#include <ATen/ops/zeros.h>
#include <torch/csrc/autograd/custom_function.h>

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/learn/bias_activation.h"
#include "effigy/learn/up_convolution.h"

namespace effigy {
namespace {

using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

// Calls run(T{}) with T = float or double, the tensor's type.
template <typename Run>
void with_type(const at::Tensor& tensor, Run&& run) {
  if (tensor.scalar_type() == at::ScalarType::Double) {
    run(double{});
  } else {
    EFFIGY_CHECK(tensor.scalar_type() == at::ScalarType::Float);
    run(float{});
  }
}

UpConvolution up_shape(const at::Tensor& x, const at::Tensor& bias, double slope) {
  return {static_cast<size_t>(x.size(0)),
          static_cast<size_t>(x.size(1)),
          static_cast<size_t>(x.size(2)),
          static_cast<size_t>(bias.size(-1)),
          bias.dim() == 1,
          slope};
}

class UpConvolve : public Function<UpConvolve> {
 public:
  static at::Tensor forward(AutogradContext* context, const at::Tensor& picture,
                            const at::Tensor& kernel, const at::Tensor& bias, double slope) {
    const at::Tensor x = picture.contiguous(), weight = kernel.contiguous();
    const UpConvolution shape = up_shape(x, bias, slope);
    const int64_t out = bias.size(-1), height = 2 * x.size(0), width = 2 * x.size(1);
    EFFIGY_CHECK_EQ(weight.numel(), 16 * x.size(2) * out);
    EFFIGY_CHECK_EQ(bias.numel(), shape.tied ? out : height * width * out);
    at::Tensor y = at::empty({height, width, out}, x.options());
    with_type(x, [&](auto type) {
      using T = decltype(type);
      up_convolution(shape, x.data_ptr<T>(), weight.data_ptr<T>(), bias.data_ptr<T>(),
                     y.data_ptr<T>());
    });
    context->save_for_backward({x, weight, bias, y});
    context->saved_data["slope"] = slope;
    return y;
  }
  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const auto saved = context->get_saved_variables();
    const at::Tensor &x = saved[0], &weight = saved[1], &bias = saved[2], &y = saved[3];
    const at::Tensor d_y = gradients[0].contiguous();
    const UpConvolution shape = up_shape(x, bias, context->saved_data["slope"].toDouble());
    at::Tensor d_x = at::empty(x.sizes(), x.options());
    at::Tensor d_weight = at::empty(weight.sizes(), x.options());
    // Without an activation an untied bias has the gradient of y, and needs no copy of it.
    const bool same = !shape.tied && shape.slope == 1.0;
    at::Tensor d_bias = same ? d_y : at::empty(bias.sizes(), x.options());
    with_type(x, [&](auto type) {
      using T = decltype(type);
      up_convolution_backward(shape, x.data_ptr<T>(), weight.data_ptr<T>(), y.data_ptr<T>(),
                              d_y.data_ptr<T>(), d_x.data_ptr<T>(), d_weight.data_ptr<T>(),
                              same ? nullptr : d_bias.data_ptr<T>());
    });
    return {d_x, d_weight, d_bias, at::Tensor()};
  }
};

class AddBias : public Function<AddBias> {
 public:
  static at::Tensor forward(AutogradContext* context, const at::Tensor& input,
                            const at::Tensor& bias, double slope) {
    const at::Tensor x = input.contiguous();
    at::Tensor y = at::empty(x.sizes(), x.options());
    const bool tied = bias.dim() == 1;
    EFFIGY_CHECK_EQ(bias.numel(), tied ? x.size(2) : x.numel());
    with_type(x, [&](auto type) {
      using T = decltype(type);
      add_bias(static_cast<size_t>(x.size(0) * x.size(1)), static_cast<size_t>(x.size(2)), tied,
               slope, x.data_ptr<T>(), bias.data_ptr<T>(), y.data_ptr<T>());
    });
    context->save_for_backward({y, bias});
    context->saved_data["slope"] = slope;
    return y;
  }
  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const auto saved = context->get_saved_variables();
    const at::Tensor &y = saved[0], &bias = saved[1], d_y = gradients[0].contiguous();
    at::Tensor d_x = at::empty(y.sizes(), y.options());
    at::Tensor d_bias = at::empty(bias.sizes(), bias.options());
    with_type(y, [&](auto type) {
      using T = decltype(type);
      add_bias_backward(static_cast<size_t>(y.size(0) * y.size(1)), static_cast<size_t>(y.size(2)),
                        bias.dim() == 1, context->saved_data["slope"].toDouble(), y.data_ptr<T>(),
                        d_y.data_ptr<T>(), d_x.data_ptr<T>(), d_bias.data_ptr<T>());
    });
    return {d_x, d_bias, at::Tensor()};
  }
};

template <typename T>
void copy_pixels(const at::Tensor& pixels, int64_t channels, const T* from, T* to, bool gather) {
  const int64_t* index = pixels.data_ptr<int64_t>();
  const auto c = static_cast<size_t>(channels);
  parallel_for(static_cast<size_t>(pixels.numel()), 1024, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const auto pixel = static_cast<size_t>(index[i]);
      std::copy_n(from + (gather ? pixel : i) * c, c, to + (gather ? i : pixel) * c);
    }
  });
}

class GatherPixels : public Function<GatherPixels> {
 public:
  static at::Tensor forward(AutogradContext* context, const at::Tensor& picture,
                            const at::Tensor& pixels) {
    const at::Tensor x = picture.contiguous();
    at::Tensor y = at::empty({pixels.numel(), x.size(2)}, x.options());
    with_type(x, [&](auto type) {
      using T = decltype(type);
      copy_pixels(pixels, x.size(2), x.data_ptr<T>(), y.data_ptr<T>(), true);
    });
    context->save_for_backward({pixels});
    context->saved_data["sides"] = std::vector<int64_t>{x.size(0), x.size(1), x.size(2)};
    return y;
  }
  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const at::Tensor pixels = context->get_saved_variables()[0];
    const at::Tensor d_y = gradients[0].contiguous();
    at::Tensor d_x = at::zeros(context->saved_data["sides"].toIntVector(), d_y.options());
    with_type(d_y, [&](auto type) {
      using T = decltype(type);
      copy_pixels(pixels, d_y.size(1), d_y.data_ptr<T>(), d_x.data_ptr<T>(), false);
    });
    return {d_x, at::Tensor()};
  }
};

// [h, w, c] <-> the [1, c, h, w] that libtorch's operators see, channels last: nothing moves. The
// batch comes first: its stride is one of the signs by which they tell that channels are last.
at::Tensor as_batch(const at::Tensor& picture) {
  return picture.unsqueeze(0).permute({0, 3, 1, 2});
}
at::Tensor as_picture(const at::Tensor& batch) {
  return batch.squeeze(0).permute({1, 2, 0});
}

double glorot_bound(int64_t in, int64_t out, double area, double slope) {
  const double gain = std::sqrt(2.0 / (1.0 + slope * slope));
  return std::sqrt(3.0) * gain * std::sqrt(2.0 / (static_cast<double>(in + out) * area));
}

// The gains of a weight-normed V, starting at gain |V|.
at::Tensor make_gain(ParameterMaker& make, const std::string& name, int64_t out,
                     const at::Tensor& v, double gain) {
  const double norm =
      make.only_counts() ? 0.0 : v.detach().to(at::ScalarType::Double).norm().item<double>();
  return make.constant(name + ".gain", {out}, gain * norm);
}

at::Tensor make_bias(ParameterMaker& make, const std::string& name, int64_t side, int64_t out,
                     bool tied) {
  return make.constant(name + ".bias",
                       tied ? std::vector<int64_t>{out} : std::vector<int64_t>{side, side, out},
                       0.0);
}

}  // namespace

int64_t Parameter::count() const {
  int64_t n = 1;
  for (int64_t side : shape) n *= side;
  return n;
}

ParameterMaker ParameterMaker::counting() {
  return {};
}

ParameterMaker ParameterMaker::initial(uint64_t seed, at::ScalarType type) {
  ParameterMaker maker;
  maker.mode_ = Mode::kInitial;
  maker.seed_ = seed;
  maker.type_ = type;
  return maker;
}

ParameterMaker ParameterMaker::from_file(const TensorFile& file, const std::string& prefix) {
  ParameterMaker maker;
  maker.mode_ = Mode::kFile;
  maker.file_ = &file;
  maker.prefix_ = prefix;
  return maker;
}

at::Tensor ParameterMaker::make(const std::string& name, std::vector<int64_t> shape,
                                const std::function<void(std::vector<double>&)>& fill) {
  Parameter parameter{name, std::move(shape), {}};
  if (mode_ == Mode::kFile) {
    std::vector<float> values = file_->floats(prefix_ + name, parameter.shape);
    parameter.value = at::from_blob(values.data(), parameter.shape, at::ScalarType::Float).clone();
  } else if (mode_ == Mode::kInitial) {
    std::vector<double> values(static_cast<size_t>(parameter.count()));
    fill(values);
    parameter.value =
        at::from_blob(values.data(), parameter.shape, at::ScalarType::Double).to(type_).clone();
  }
  if (parameter.value.defined()) parameter.value.set_requires_grad(true);
  parameters_.push_back(parameter);
  return parameter.value;
}

at::Tensor ParameterMaker::uniform(const std::string& name, std::vector<int64_t> shape,
                                   double bound) {
  Random random(seed_, parameters_.size());
  return make(name, std::move(shape), [&](std::vector<double>& values) {
    for (double& value : values) value = random.uniform(-bound, bound);
  });
}

at::Tensor ParameterMaker::equal_phases(const std::string& name, int64_t in, int64_t out,
                                        double bound) {
  Random random(seed_, parameters_.size());
  return make(name, {2, 2, in, 2, 2, out}, [&](std::vector<double>& values) {
    const auto n = static_cast<size_t>(out);
    for (size_t row = 0; row < values.size(); row += 4 * n)
      for (size_t o = 0; o < n; ++o) {
        const double value = random.uniform(-bound, bound);
        for (size_t phase = 0; phase < 4; ++phase) values[row + phase * n + o] = value;
      }
  });
}

at::Tensor ParameterMaker::constant(const std::string& name, std::vector<int64_t> shape,
                                    double value) {
  return make(name, std::move(shape),
              [&](std::vector<double>& values) { std::fill(values.begin(), values.end(), value); });
}

DenseLayer::DenseLayer(ParameterMaker& make, const std::string& name, int64_t in, int64_t out,
                       const LayerOptions& options)
    : slope_(options.slope) {
  v_ = make.uniform(name + ".v", {out, in}, glorot_bound(in, out, 1.0, slope_));
  g_ = make_gain(make, name, out, v_, options.gain);
  bias_ = make.constant(name + ".bias", {out}, 0.0);
}

at::Tensor DenseLayer::operator()(const at::Tensor& x) const {
  // x W^T with W = g_o V / |V|: scaling the result moves less than scaling V.
  const at::Tensor y = at::linear(x, v_) * (g_ / v_.norm()) + bias_;
  return slope_ == 1.0 ? y : at::leaky_relu(y, slope_);
}

ConvLayer::ConvLayer(ParameterMaker& make, const std::string& name, int64_t in, int64_t out,
                     int64_t side, const LayerOptions& options)
    : slope_(options.slope) {
  v_ = make.uniform(name + ".v", {out, in, 3, 3}, glorot_bound(in, out, 9.0, slope_));
  g_ = make_gain(make, name, out, v_, options.gain);
  bias_ = make_bias(make, name, side, out, options.tied);
}

at::Tensor ConvLayer::operator()(const at::Tensor& x) const {
  return AddBias::apply(convolve_picture(x, weight_norm(v_, g_, 0), 1), bias_, slope_);
}

UpLayer::UpLayer(ParameterMaker& make, const std::string& name, int64_t in, int64_t out,
                 int64_t side, const LayerOptions& options)
    : slope_(options.slope) {
  v_ = make.equal_phases(name + ".v", in, out, glorot_bound(in, out, 4.0, slope_));
  g_ = make_gain(make, name, out, v_, options.gain);
  bias_ = make_bias(make, name, 2 * side, out, options.tied);
}

at::Tensor UpLayer::operator()(const at::Tensor& x) const {
  return up_convolve(x, weight_norm(v_, g_, 5), bias_, slope_);
}

at::Tensor weight_norm(const at::Tensor& v, const at::Tensor& g, int64_t out) {
  std::vector<int64_t> sides(static_cast<size_t>(v.dim()), 1);
  sides[static_cast<size_t>(out)] = g.numel();
  return v * (g / v.norm()).view(sides);
}

at::Tensor up_convolve(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                       double slope) {
  return UpConvolve::apply(x, weight, bias, slope);
}

at::Tensor convolve_picture(const at::Tensor& x, const at::Tensor& weight, int64_t padding) {
  static const bool has_onednn = at::globalContext().hasMKLDNN();
  if (has_onednn && x.scalar_type() == at::ScalarType::Float)
    return as_picture(
        at::mkldnn_convolution(as_batch(x), weight, {}, {padding, padding}, {1, 1}, {1, 1}, 1));
  return as_picture(at::conv2d(as_batch(x), weight, {}, {1, 1}, {padding, padding}));
}

at::Tensor resize_picture(const at::Tensor& x, int64_t side) {
  if (x.size(0) == side && x.size(1) == side) return x;
  return as_picture(at::upsample_bilinear2d(as_batch(x), {side, side}, true));
}

at::Tensor gather_pixels(const at::Tensor& picture, const at::Tensor& pixels) {
  // Ascending: all of them are the picture itself.
  if (pixels.numel() == picture.size(0) * picture.size(1))
    return picture.view({pixels.numel(), picture.size(2)});
  return GatherPixels::apply(picture, pixels);
}

}  // namespace effigy
