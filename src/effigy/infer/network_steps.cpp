#include "effigy/infer/network_steps.h"

#include <ATen/ops/avg_pool2d.h>
#include <ATen/ops/cat.h>
#include <ATen/ops/constant_pad_nd.h>
#include <ATen/ops/empty.h>
#include <ATen/ops/relu.h>
#include <ATen/ops/upsample_bilinear2d.h>

#include <algorithm>
#include <array>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/infer/convolution.h"
#include "effigy/infer/elementwise.h"

namespace effigy {
namespace {

using Values = std::vector<at::Tensor>;
using Run = std::function<at::Tensor(const Values&)>;

constexpr double kMostMultiplications = 2e10;  // of one convolution; the largest known has 2e7

// An operand: a constant held here, or the number of a computed tensor.
struct Operand {
  int index = -1;
  at::Tensor constant;
  const at::Tensor& get(const Values& values) const {
    return constant.defined() ? constant : values[index];
  }
};

struct Fused {
  Activation activation = Activation::kNone;
  PreluSlopes slopes;
  int channels = 1;
};

void apply(const Fused& fused, at::Tensor& y) {
  if (fused.activation == Activation::kNone) return;
  activate(y.data_ptr<float>(), static_cast<size_t>(y.numel()), fused.activation, fused.slopes);
}

at::Tensor nchw(const at::Tensor& x) {
  return x.permute({0, 3, 1, 2});
}
at::Tensor nhwc(const at::Tensor& x) {
  return x.permute({0, 2, 3, 1}).contiguous();
}

// Zero (or other) rows and columns around an NHWC picture.
at::Tensor pad_picture(const at::Tensor& x, int64_t top, int64_t bottom, int64_t left,
                       int64_t right, float value) {
  const int64_t height = x.size(1), width = x.size(2), channels = x.size(3);
  const int64_t out_h = height + top + bottom, out_w = width + left + right;
  at::Tensor y = at::empty({1, out_h, out_w, channels}, x.options());
  float* out = y.data_ptr<float>();
  const float* in = x.data_ptr<float>();
  for (int64_t row = 0; row < out_h; ++row, out += out_w * channels) {
    if (row < top || row >= top + height) {
      std::fill_n(out, out_w * channels, value);
      continue;
    }
    std::fill_n(out, left * channels, value);
    std::memcpy(out + left * channels, in + (row - top) * width * channels,
                static_cast<size_t>(width * channels) * sizeof(float));
    std::fill_n(out + (left + width) * channels, right * channels, value);
  }
  return y;
}

struct Window {
  int64_t before = 0, after = 0;  // padding
};

// TFLite's SAME and VALID.
Window padding(bool same, int64_t in, int64_t filter, int64_t stride, int64_t dilation) {
  if (!same) return {};
  const int64_t out = (in + stride - 1) / stride;
  const int64_t total = std::max<int64_t>((out - 1) * stride + (filter - 1) * dilation + 1 - in, 0);
  return {total / 2, total - total / 2};
}

class Builder {
 public:
  Builder(const TfliteModel& model, const std::string& name) : model_(model), name_(name) {}

  std::vector<NetworkStep> build();

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw Error(name_ + ": not a sound TFLite network (" + what +
                "); replace it by the published file.");
  }
  const TfliteTensor& tensor(int index) const { return model_.tensors[index]; }
  const std::vector<int64_t>& shape(int index) const { return model_.tensors[index].shape; }

  void require(bool condition, const char* what) const {
    if (!condition) fail(what);
  }
  // Input `i` as an operand; its absence is an error.
  Operand operand(const TfliteNode& node, size_t i) const {
    require(i < node.inputs.size() && node.inputs[i] >= 0, "an operator lacks an input");
    const int index = node.inputs[i];
    require(!tensor(index).integer, "an operator computes with integers");
    Operand result;
    result.index = index;
    if (tensor(index).constant)
      result.constant = tensor_from(tensor(index).floats.data(), shape(index));
    return result;
  }
  const std::vector<int32_t>& integers(const TfliteNode& node, size_t i) const {
    require(i < node.inputs.size() && node.inputs[i] >= 0, "an operator lacks an input");
    const TfliteTensor& source = tensor(node.inputs[i]);
    require(source.constant && source.integer, "an operator's parameter is not a constant");
    return source.ints;
  }
  void picture(int index) const {
    require(shape(index).size() == 4 && shape(index)[0] == 1, "a picture has not batch size 1");
  }

  Fused fused_after(size_t node, int* output);
  Run convolution(const TfliteNode& node, bool depthwise, Fused fused) const;
  Run transposed_convolution(const TfliteNode& node, Fused fused) const;
  Run max_pool(const TfliteNode& node) const;
  Run average_pool(const TfliteNode& node) const;
  Run pad(const TfliteNode& node) const;
  Run add(const TfliteNode& node, Fused fused) const;
  Run multiply(const TfliteNode& node) const;
  Run reduce(const TfliteNode& node) const;
  Run strided_slice(const TfliteNode& node) const;
  Run simple(const TfliteNode& node) const;
  Run rearrange(const TfliteNode& node) const;
  Run make(const TfliteNode& node, const Fused& fused) const;
  Activation activation_of(const TfliteNode& node) const;

  const TfliteModel& model_;
  const std::string& name_;
  std::vector<int> uses_, user_;  // how often, and by which node last
  std::vector<bool> skipped_;
};

Activation Builder::activation_of(const TfliteNode& node) const {
  switch (node.op) {
    case TfliteOp::kRelu:
      return Activation::kRelu;
    case TfliteOp::kRelu6:
      return Activation::kRelu6;
    case TfliteOp::kPrelu:
      return Activation::kPrelu;
    case TfliteOp::kHardSwish:
      return Activation::kHardSwish;
    case TfliteOp::kLogistic:
      return Activation::kLogistic;
    default:
      return Activation::kNone;
  }
}

// The activation to run in place on the result of `node`: its own, or that of its only reader.
Fused Builder::fused_after(size_t index, int* output) {
  const TfliteNode& node = model_.nodes[index];
  Fused fused;
  *output = node.outputs[0];
  if (node.activation != TfliteActivation::kNone) {
    fused.activation =
        node.activation == TfliteActivation::kRelu ? Activation::kRelu : Activation::kRelu6;
    return fused;
  }
  if (uses_[*output] != 1 || user_[*output] < 0) return fused;
  const TfliteNode& reader = model_.nodes[user_[*output]];
  fused.activation = activation_of(reader);
  if (fused.activation == Activation::kNone || reader.inputs[0] != *output) {
    fused.activation = Activation::kNone;
    return fused;
  }
  if (fused.activation == Activation::kPrelu) {
    const Operand slope = operand(reader, 1);
    require(slope.constant.defined() && slope.constant.numel() == shape(*output).back() &&
                tensor(reader.inputs[1]).shape.back() == shape(*output).back(),
            "a PReLU has not one slope per channel");
    fused.slopes = PreluSlopes(tensor(reader.inputs[1]).floats);
  }
  skipped_[user_[*output]] = true;
  *output = reader.outputs[0];
  return fused;
}

Run Builder::convolution(const TfliteNode& node, bool depthwise, Fused fused) const {
  const Operand x = operand(node, 0), weight = operand(node, 1);
  picture(x.index);
  require(weight.constant.defined() && weight.constant.dim() == 4, "weights are not a constant");
  const int64_t channels = shape(x.index)[3];
  const int64_t kernel_h = weight.constant.size(1), kernel_w = weight.constant.size(2);
  // TFLite stores [O, kh, kw, I] and, depthwise, [1, kh, kw, C]; libtorch wants [O, I, kh, kw].
  at::Tensor w = depthwise ? weight.constant.permute({3, 0, 1, 2}).contiguous()
                           : weight.constant.permute({0, 3, 1, 2});
  if (depthwise)
    require(w.size(1) == 1 && w.size(0) % channels == 0, "depthwise weights have another shape");
  else
    require(w.size(1) == channels, "weights have another number of channels than the input");
  at::Tensor bias;
  if (node.inputs.size() > 2 && node.inputs[2] >= 0) {
    bias = operand(node, 2).constant;
    require(bias.defined() && bias.dim() == 1 && bias.size(0) == w.size(0),
            "a bias has another size than its layer");
  }
  const int64_t stride_h = node.stride_h, stride_w = node.stride_w;
  const int64_t dilation_h = node.dilation_h, dilation_w = node.dilation_w;
  const int64_t groups = depthwise ? channels : 1;
  const Window rows = padding(node.same_padding, shape(x.index)[1], kernel_h, stride_h, dilation_h);
  const Window columns =
      padding(node.same_padding, shape(x.index)[2], kernel_w, stride_w, dilation_w);
  const double cost = static_cast<double>(tensor(node.outputs[0]).count()) *
                      static_cast<double>(w.numel()) / static_cast<double>(w.size(0));
  require(cost < kMostMultiplications, "a convolution is too large");
  // libtorch pads both sides alike; what differs is padded beforehand.
  const bool uneven = rows.before != rows.after || columns.before != columns.after;
  const int64_t pad_h = uneven ? 0 : rows.before, pad_w = uneven ? 0 : columns.before;
  return [=](const Values& values) {
    at::Tensor in = x.get(values);
    if (uneven) in = pad_picture(in, rows.before, rows.after, columns.before, columns.after, 0.0f);
    at::Tensor y = nhwc(convolve(nchw(in), w, bias, {stride_h, stride_w}, {pad_h, pad_w},
                                 {dilation_h, dilation_w}, groups));
    apply(fused, y);
    return y;
  };
}

// MediaPipe's Convolution2DTransposeBias: weights [O, k, k, I], stride = kernel, so that output
// blocks do not overlap: a 1x1 convolution to O k k channels, then a shuffle of blocks.
Run Builder::transposed_convolution(const TfliteNode& node, Fused fused) const {
  require(node.custom == "Convolution2DTransposeBias" && node.custom_bytes.size() >= 12,
          "a custom operator is not supported");
  int32_t parameters[3];
  std::memcpy(parameters, node.custom_bytes.data(), sizeof(parameters));
  const Operand x = operand(node, 0), weight = operand(node, 1), bias = operand(node, 2);
  picture(x.index);
  require(weight.constant.defined() && weight.constant.dim() == 4 && bias.constant.defined(),
          "weights are not a constant");
  const int64_t outputs = weight.constant.size(0), kernel_h = weight.constant.size(1);
  const int64_t kernel_w = weight.constant.size(2), channels = weight.constant.size(3);
  require(channels == shape(x.index)[3] && bias.constant.numel() == outputs &&
              parameters[1] == kernel_w && parameters[2] == kernel_h,
          "a transposed convolution's stride is not its kernel size");
  // Row (i, j, o) of the matrix gives pixel (i, j) of the block.
  const at::Tensor w = weight.constant.permute({1, 2, 0, 3})
                           .contiguous()
                           .view({kernel_h * kernel_w * outputs, channels, 1, 1});
  const at::Tensor b = bias.constant.view({outputs}).repeat({kernel_h * kernel_w});
  return [=](const Values& values) {
    const at::Tensor& in = x.get(values);
    const int64_t height = in.size(1), width = in.size(2);
    at::Tensor y = nhwc(convolve(nchw(in), w, b, {1, 1}, {0, 0}, {1, 1}, 1))
                       .view({height, width, kernel_h, kernel_w, outputs})
                       .permute({0, 2, 1, 3, 4})
                       .contiguous()
                       .view({1, height * kernel_h, width * kernel_w, outputs});
    apply(fused, y);
    return y;
  };
}

Run Builder::max_pool(const TfliteNode& node) const {
  const Operand x = operand(node, 0);
  picture(x.index);
  const int filter_h = node.filter_h, filter_w = node.filter_w;
  const int stride_h = node.stride_h, stride_w = node.stride_w;
  const int64_t height = shape(x.index)[1], width = shape(x.index)[2];
  const Window rows = padding(node.same_padding, height, filter_h, stride_h, 1);
  const Window columns = padding(node.same_padding, width, filter_w, stride_w, 1);
  const int64_t padded_h = height + rows.before + rows.after;
  const int64_t padded_w = width + columns.before + columns.after;
  require(filter_h <= padded_h && filter_w <= padded_w, "a pool is larger than its picture");
  const int64_t out_h = (padded_h - filter_h) / stride_h + 1;
  const int64_t out_w = (padded_w - filter_w) / stride_w + 1;
  const bool outside = rows.before + rows.after + columns.before + columns.after > 0;
  require(node.activation == TfliteActivation::kNone, "a pool has a fused activation");
  return [=](const Values& values) {
    at::Tensor in = x.get(values);
    if (outside)
      in = pad_picture(in, rows.before, rows.after, columns.before, columns.after, -3.0e38f);
    const int64_t channels = in.size(3);
    at::Tensor y = at::empty({1, out_h, out_w, channels}, in.options());
    std::vector<const float*> window(filter_h);
    for (int64_t row = 0; row < out_h; ++row) {
      for (int v = 0; v < filter_h; ++v)
        window[v] = in.data_ptr<float>() + (row * stride_h + v) * in.size(2) * channels;
      max_pool_row(y.data_ptr<float>() + row * out_w * channels, window.data(), filter_h, filter_w,
                   stride_w, static_cast<int>(out_w), static_cast<size_t>(channels));
    }
    return y;
  };
}

Run Builder::average_pool(const TfliteNode& node) const {
  const Operand x = operand(node, 0);
  picture(x.index);
  require(node.activation == TfliteActivation::kNone, "a pool has a fused activation");
  const int64_t height = shape(x.index)[1], width = shape(x.index)[2];
  const Window rows = padding(node.same_padding, height, node.filter_h, node.stride_h, 1);
  const Window columns = padding(node.same_padding, width, node.filter_w, node.stride_w, 1);
  require(rows.before + rows.after + columns.before + columns.after == 0,
          "an average pool that leaves its picture is not supported");
  if (node.filter_h == height && node.filter_w == width) {
    return [=](const Values& values) {
      const at::Tensor& in = x.get(values);
      at::Tensor y = at::empty({1, 1, 1, in.size(3)}, in.options());
      mean_channels(y.data_ptr<float>(), in.data_ptr<float>(), static_cast<size_t>(height * width),
                    static_cast<size_t>(in.size(3)));
      return y;
    };
  }
  const std::vector<int64_t> filter = {node.filter_h, node.filter_w};
  const std::vector<int64_t> stride = {node.stride_h, node.stride_w};
  return [=](const Values& values) {
    return nhwc(at::avg_pool2d(nchw(x.get(values)), filter, stride));
  };
}

Run Builder::pad(const TfliteNode& node) const {
  const Operand x = operand(node, 0);
  const std::vector<int32_t>& amounts = integers(node, 1);
  const size_t axes = shape(x.index).size();
  require(amounts.size() == 2 * axes, "a PAD has not two amounts per axis");
  std::vector<int64_t> reversed;  // libtorch starts at the last axis
  for (size_t axis = axes; axis-- > 0;)
    for (const int32_t amount : {amounts[2 * axis], amounts[2 * axis + 1]}) {
      require(amount >= 0 && amount <= 65536, "a PAD has an impossible amount");
      reversed.push_back(amount);
    }
  return [=](const Values& values) {
    return at::constant_pad_nd(x.get(values), reversed, 0).contiguous();
  };
}

Run Builder::add(const TfliteNode& node, Fused fused) const {
  const Operand a = operand(node, 0), b = operand(node, 1);
  if (shape(a.index) != shape(b.index)) {
    return [=](const Values& values) {
      at::Tensor y = a.get(values).add(b.get(values)).contiguous();
      apply(fused, y);
      return y;
    };
  }
  return [=](const Values& values) {
    const at::Tensor& first = a.get(values);
    at::Tensor y = at::empty(first.sizes(), first.options());
    add_activate(y.data_ptr<float>(), first.data_ptr<float>(), b.get(values).data_ptr<float>(),
                 static_cast<size_t>(y.numel()), fused.activation, fused.slopes);
    return y;
  };
}

Run Builder::multiply(const TfliteNode& node) const {
  const Operand a = operand(node, 0), b = operand(node, 1);
  require(node.activation == TfliteActivation::kNone, "a MUL has a fused activation");
  const std::vector<int64_t>&picture_shape = shape(a.index), &gain = shape(b.index);
  const bool gate = picture_shape.size() == 4 && gain.size() == 4 && picture_shape[0] == 1 &&
                    tensor(b.index).count() == picture_shape[3] && gain[3] == picture_shape[3];
  if (!gate)
    return [=](const Values& values) { return a.get(values).mul(b.get(values)).contiguous(); };
  return [=](const Values& values) {
    const at::Tensor& x = a.get(values);
    at::Tensor y = at::empty(x.sizes(), x.options());
    scale_channels(y.data_ptr<float>(), x.data_ptr<float>(), b.get(values).data_ptr<float>(),
                   static_cast<size_t>(x.size(1) * x.size(2)), static_cast<size_t>(x.size(3)));
    return y;
  };
}

Run Builder::reduce(const TfliteNode& node) const {
  const Operand x = operand(node, 0);
  const auto axes = static_cast<int64_t>(shape(x.index).size());
  std::vector<int64_t> over;
  for (const int32_t axis : integers(node, 1)) {
    require(axis >= -axes && axis < axes, "a reduction names an axis that does not exist");
    over.push_back(axis < 0 ? axis + axes : axis);
  }
  const bool keep = node.keep_dims, mean = node.op == TfliteOp::kMean;
  return [=](const Values& values) {
    const at::Tensor& in = x.get(values);
    return (mean ? in.mean(over, keep) : in.sum(over, keep)).contiguous();
  };
}

Run Builder::strided_slice(const TfliteNode& node) const {
  const Operand x = operand(node, 0);
  const auto &begin = integers(node, 1), &end = integers(node, 2), &stride = integers(node, 3);
  const std::vector<int64_t>& sides = shape(x.index);
  require(node.ellipsis_mask == 0 && node.new_axis_mask == 0 && begin.size() <= sides.size() &&
              end.size() == begin.size() && stride.size() == begin.size(),
          "a STRIDED_SLICE of this kind is not supported");
  struct Cut {
    int64_t begin, end, stride;
    bool shrink;
  };
  std::vector<Cut> cuts;
  for (size_t axis = 0; axis < begin.size(); ++axis) {
    const int bit = 1 << axis;
    Cut cut{begin[axis], end[axis], stride[axis], (node.shrink_mask & bit) != 0};
    if (cut.begin < 0) cut.begin += sides[axis];
    if (cut.end < 0) cut.end += sides[axis];
    if ((node.begin_mask & bit) != 0) cut.begin = 0;
    if (cut.shrink)
      cut.end = cut.begin + 1;
    else if ((node.end_mask & bit) != 0)
      cut.end = sides[axis];
    require(cut.stride >= 1 && cut.begin >= 0 && cut.begin < cut.end && cut.end <= sides[axis],
            "a STRIDED_SLICE leaves its tensor");
    cuts.push_back(cut);
  }
  return [=](const Values& values) {
    at::Tensor y = x.get(values);
    for (size_t axis = cuts.size(); axis-- > 0;) {
      const auto dimension = static_cast<int64_t>(axis);
      y = y.slice(dimension, cuts[axis].begin, cuts[axis].end, cuts[axis].stride);
      if (cuts[axis].shrink) y = y.squeeze(dimension);
    }
    return y.contiguous();
  };
}

// Element-wise operators on small tensors, with broadcasting.
Run Builder::simple(const TfliteNode& node) const {
  const Operand x = operand(node, 0);
  const TfliteOp op = node.op;
  if (op == TfliteOp::kSub || op == TfliteOp::kDiv || op == TfliteOp::kSquaredDifference) {
    require(node.activation == TfliteActivation::kNone, "a SUB or DIV has a fused activation");
    const Operand y = operand(node, 1);
    return [=](const Values& values) {
      const at::Tensor &a = x.get(values), &b = y.get(values);
      if (op == TfliteOp::kDiv) return a.div(b).contiguous();
      const at::Tensor difference = a.sub(b).contiguous();
      return op == TfliteOp::kSub ? difference : difference.mul(difference);
    };
  }
  if (op == TfliteOp::kNeg) return [=](const Values& values) { return x.get(values).neg(); };
  if (op == TfliteOp::kSqrt) return [=](const Values& values) { return x.get(values).sqrt(); };
  if (op == TfliteOp::kRsqrt) return [=](const Values& values) { return x.get(values).rsqrt(); };
  Fused fused;
  fused.activation = activation_of(node);
  if (fused.activation == Activation::kPrelu) {
    const Operand slope = operand(node, 1);
    require(slope.constant.defined() && slope.constant.numel() == shape(x.index).back() &&
                shape(slope.index).back() == shape(x.index).back(),
            "a PReLU has not one slope per channel");
    fused.slopes = PreluSlopes(tensor(slope.index).floats);
  }
  require(fused.activation != Activation::kNone, "an operator is not supported");
  return [=](const Values& values) {
    at::Tensor y = x.get(values).clone();
    apply(fused, y);
    return y;
  };
}

// Operators that move values without changing them, and the resize.
Run Builder::rearrange(const TfliteNode& node) const {
  const std::vector<int64_t>& result = shape(node.outputs[0]);
  if (node.op == TfliteOp::kConcat) {
    require(node.activation == TfliteActivation::kNone, "a CONCAT has a fused activation");
    std::vector<Operand> parts;
    for (size_t i = 0; i < node.inputs.size(); ++i) parts.push_back(operand(node, i));
    const auto axes = static_cast<int>(result.size());
    require(node.axis >= -axes && node.axis < axes, "a CONCAT names an axis that does not exist");
    const int64_t axis = node.axis;
    return [=](const Values& values) {
      std::vector<at::Tensor> tensors;
      for (const Operand& part : parts) tensors.push_back(part.get(values));
      return at::cat(tensors, axis).contiguous();
    };
  }
  const Operand x = operand(node, 0);
  if (node.op == TfliteOp::kReshape) {
    require(tensor(x.index).count() == tensor(node.outputs[0]).count(),
            "a RESHAPE changes the number of values");
    return [=](const Values& values) { return x.get(values).view(result); };
  }
  if (node.op == TfliteOp::kTranspose) {
    std::vector<int64_t> order;
    for (const int32_t axis : integers(node, 1)) order.push_back(axis);
    std::vector<int64_t> sorted = order;
    std::sort(sorted.begin(), sorted.end());
    for (size_t axis = 0; axis < sorted.size(); ++axis)
      require(sorted[axis] == static_cast<int64_t>(axis), "a TRANSPOSE is not a permutation");
    require(sorted.size() == shape(x.index).size(), "a TRANSPOSE is not a permutation");
    return [=](const Values& values) { return x.get(values).permute(order).contiguous(); };
  }
  picture(x.index);
  const std::vector<int32_t>& size = integers(node, 1);
  require(size.size() == 2 && size[0] > 0 && size[1] > 0 && size[0] <= 8192 && size[1] <= 8192,
          "a RESIZE_BILINEAR has an impossible size");
  require(node.half_pixel_centers || node.align_corners,
          "a RESIZE_BILINEAR without half-pixel centres is not supported");
  const std::vector<int64_t> target = {size[0], size[1]};
  const bool align = node.align_corners;
  return [=](const Values& values) {
    return nhwc(at::upsample_bilinear2d(nchw(x.get(values)), target, align));
  };
}

Run Builder::make(const TfliteNode& node, const Fused& fused) const {
  switch (node.op) {
    case TfliteOp::kConv:
      return convolution(node, false, fused);
    case TfliteOp::kDepthwiseConv:
      return convolution(node, true, fused);
    case TfliteOp::kCustom:
      return transposed_convolution(node, fused);
    case TfliteOp::kAdd:
      return add(node, fused);
    case TfliteOp::kMaxPool:
      return max_pool(node);
    case TfliteOp::kAveragePool:
      return average_pool(node);
    case TfliteOp::kPad:
      return pad(node);
    case TfliteOp::kMul:
      return multiply(node);
    case TfliteOp::kMean:
    case TfliteOp::kSum:
      return reduce(node);
    case TfliteOp::kStridedSlice:
      return strided_slice(node);
    case TfliteOp::kReshape:
    case TfliteOp::kTranspose:
    case TfliteOp::kConcat:
    case TfliteOp::kResizeBilinear:
      return rearrange(node);
    default:
      return simple(node);
  }
}

std::vector<NetworkStep> Builder::build() {
  uses_.assign(model_.tensors.size(), 0);
  user_.assign(model_.tensors.size(), -1);
  skipped_.assign(model_.nodes.size(), false);
  for (size_t n = 0; n < model_.nodes.size(); ++n)
    for (const int input : model_.nodes[n].inputs)
      if (input >= 0) {
        ++uses_[input];
        user_[input] = static_cast<int>(n);
      }
  for (const int output : model_.outputs) ++uses_[output];

  std::vector<NetworkStep> steps;
  for (size_t n = 0; n < model_.nodes.size(); ++n) {
    if (skipped_[n]) continue;
    const TfliteNode& node = model_.nodes[n];
    NetworkStep step;
    step.output = node.outputs[0];
    Fused fused;
    if (node.op == TfliteOp::kConv || node.op == TfliteOp::kDepthwiseConv ||
        node.op == TfliteOp::kCustom || node.op == TfliteOp::kAdd)
      fused = fused_after(n, &step.output);
    step.run = make(node, fused);
    for (const int input : node.inputs)
      if (input >= 0 && !tensor(input).constant) step.inputs.push_back(input);
    steps.push_back(std::move(step));
  }
  return steps;
}

}  // namespace

at::Tensor tensor_from(const float* data, const std::vector<int64_t>& shape) {
  at::Tensor tensor = at::empty(shape, at::TensorOptions().dtype(at::kFloat));
  std::memcpy(tensor.data_ptr<float>(), data, static_cast<size_t>(tensor.numel()) * sizeof(float));
  return tensor;
}

std::vector<NetworkStep> make_steps(const TfliteModel& model, const std::string& name) {
  return Builder(model, name).build();
}

}  // namespace effigy
