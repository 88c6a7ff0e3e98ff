#include "effigy/learn/layers.h"

#include <ATen/TensorOperators.h>
#include <ATen/ops/conv2d.h>
#include <ATen/ops/conv_transpose2d.h>
#include <ATen/ops/from_blob.h>
#include <ATen/ops/leaky_relu.h>
#include <ATen/ops/matmul.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>

#include "effigy/base/random.h"
#include "support.h"

namespace effigy {
namespace {

at::Tensor random_tensor(std::vector<int64_t> shape, uint64_t stream,
                         at::ScalarType type = at::ScalarType::Double) {
  Random random(7, stream);
  int64_t count = 1;
  for (int64_t side : shape) count *= side;
  std::vector<double> values(static_cast<size_t>(count));
  for (double& value : values) value = random.normal();
  return at::from_blob(values.data(), shape, at::ScalarType::Double).to(type).clone();
}

at::Tensor leaf(const at::Tensor& values) {
  return values.detach().clone().set_requires_grad(true);
}

double distance(const at::Tensor& a, const at::Tensor& b) {
  EXPECT_EQ(a.sizes(), b.sizes());
  return (a - b).abs().max().item<double>();
}

at::Tensor to_batch(const at::Tensor& picture) {
  return picture.permute({2, 0, 1}).unsqueeze(0).contiguous();
}
at::Tensor to_picture(const at::Tensor& batch) {
  return batch.squeeze(0).permute({1, 2, 0}).contiguous();
}

std::vector<at::Tensor> gradients_of(const at::Tensor& y, const at::Tensor& d_y,
                                     const std::vector<at::Tensor>& inputs) {
  return torch::autograd::grad({y}, inputs, {d_y});
}

struct Case {
  int64_t in, out, height, width;
  bool tied;
  double slope;
};
constexpr Case kCases[] = {{1, 1, 1, 1, false, 1.0},
                           {3, 5, 4, 4, false, kLeakySlope},
                           {4, 2, 3, 5, true, 1.0},
                           {8, 65, 6, 2, false, 1.0},
                           {2, 7, 1, 9, true, kLeakySlope}};

// W[in][out][2 - 2 ty + py][2 - 2 tx + px] = V[ty][tx][in][py][px][out]: as ConvTranspose2d has it.
at::Tensor transposed_weight(const at::Tensor& v) {
  return v.permute({2, 5, 0, 3, 1, 4}).flip({2, 4}).reshape({v.size(2), v.size(5), 4, 4});
}

TEST(Layers, LayoutOfTheKernel) {
  const at::Tensor v = random_tensor({2, 2, 3, 2, 2, 5}, 1), w = transposed_weight(v);
  for (int64_t t = 0; t < 2; ++t)
    for (int64_t p = 0; p < 2; ++p)
      EXPECT_EQ(w[1][4][2 - 2 * t + p][2 - 2 * (1 - t) + p].item<double>(),
                v[t][1 - t][1][p][p][4].item<double>());
}

// The four-phase form against libtorch's transposed convolution: values and the gradients of
// picture, weight and bias.
TEST(Layers, FourPhasesAreTheTransposedConvolution) {
  for (const Case& c : kCases) {
    const at::Tensor x = leaf(random_tensor({c.height, c.width, c.in}, 1));
    const at::Tensor v = leaf(random_tensor({2, 2, c.in, 2, 2, c.out}, 2));
    const std::vector<int64_t> untied = {2 * c.height, 2 * c.width, c.out};
    const at::Tensor b = leaf(random_tensor(c.tied ? std::vector<int64_t>{c.out} : untied, 3));
    const at::Tensor ours = up_convolve(x, v, b, c.slope);
    at::Tensor theirs =
        to_picture(at::conv_transpose2d(to_batch(x), transposed_weight(v), {}, {2, 2}, {1, 1})) + b;
    theirs = at::leaky_relu(theirs, c.slope);
    EXPECT_LT(distance(ours, theirs), 1e-12);
    const at::Tensor d_y = random_tensor(untied, 4);
    const auto our_gradients = gradients_of(ours, d_y, {x, v, b});
    const auto their_gradients = gradients_of(theirs, d_y, {x, v, b});
    for (size_t i = 0; i < 3; ++i)
      EXPECT_LT(distance(our_gradients[i], their_gradients[i]), 1e-11) << i;
  }
}

TEST(Layers, FloatAgreesWithDouble) {
  for (const Case& c : kCases) {
    std::vector<at::Tensor> results[2];
    for (const auto type : {at::ScalarType::Double, at::ScalarType::Float}) {
      const at::Tensor x = leaf(random_tensor({c.height, c.width, c.in}, 1, type));
      const at::Tensor w = leaf(random_tensor({2, 2, c.in, 2, 2, c.out}, 2, type));
      const std::vector<int64_t> untied = {2 * c.height, 2 * c.width, c.out};
      const at::Tensor b =
          leaf(random_tensor(c.tied ? std::vector<int64_t>{c.out} : untied, 3, type));
      const at::Tensor y = up_convolve(x, w, b, c.slope);
      auto& list = results[type == at::ScalarType::Float];
      list = gradients_of(y, random_tensor(untied, 4, type), {x, w, b});
      list.push_back(y);
    }
    for (size_t i = 0; i < results[0].size(); ++i)
      EXPECT_LT(distance(results[0][i], results[1][i].to(at::ScalarType::Double)), 2e-4) << i;
  }
}

TEST(Layers, WeightNormByItsDefinition) {
  const at::Tensor v = leaf(random_tensor({3, 4, 2, 2}, 1)), g = leaf(random_tensor({4}, 2));
  const at::Tensor w = weight_norm(v, g, 1);
  double square = 0;
  for (int64_t i = 0; i < v.numel(); ++i) {
    const double value = v.data_ptr<double>()[i];
    square += value * value;
  }
  for (int64_t i = 0; i < v.numel(); ++i)
    EXPECT_NEAR(w.data_ptr<double>()[i],
                g.data_ptr<double>()[i / 4 % 4] * v.data_ptr<double>()[i] / std::sqrt(square),
                1e-14);
  // d/dV sum(d W) = g_o (d - V sum over all of (g d V) / (g_o |V|^2) ...) / |V|.
  const at::Tensor d = random_tensor({3, 4, 2, 2}, 3);
  const auto gradients = gradients_of(w, d, {v, g});
  const double norm = std::sqrt(square);
  double along = 0;
  std::vector<double> d_gain(4);
  for (int64_t i = 0; i < v.numel(); ++i) {
    const double product = d.data_ptr<double>()[i] * v.data_ptr<double>()[i];
    along += g.data_ptr<double>()[i / 4 % 4] * product;
    d_gain[static_cast<size_t>(i / 4 % 4)] += product / norm;
  }
  for (int64_t i = 0; i < v.numel(); ++i)
    EXPECT_NEAR(gradients[0].data_ptr<double>()[i],
                g.data_ptr<double>()[i / 4 % 4] * d.data_ptr<double>()[i] / norm -
                    v.data_ptr<double>()[i] * along / (norm * norm * norm),
                1e-13);
  for (size_t o = 0; o < 4; ++o) EXPECT_NEAR(gradients[1].data_ptr<double>()[o], d_gain[o], 1e-13);
}

TEST(Layers, ConvolutionWithUntiedAndTiedBias) {
  for (const bool tied : {false, true}) {
    ParameterMaker make = ParameterMaker::initial(3, at::ScalarType::Double);
    const ConvLayer layer(make, "layer", 3, 5, 6, {kLeakySlope, tied});
    auto& parameters = make.parameters();
    ASSERT_EQ(parameters.size(), 3u);
    at::Tensor bias = parameters[2].value;
    bias.detach().copy_(random_tensor(parameters[2].shape, 1));
    const at::Tensor x = leaf(random_tensor({6, 6, 3}, 2));
    const at::Tensor w = weight_norm(parameters[0].value, parameters[1].value, 0);
    const at::Tensor ours = layer(x);
    const at::Tensor theirs = at::leaky_relu(
        to_picture(at::conv2d(to_batch(x), w, {}, {1, 1}, {1, 1})) + bias, kLeakySlope);
    EXPECT_LT(distance(ours, theirs), 1e-12);
    const at::Tensor d_y = random_tensor({6, 6, 5}, 4);
    const auto a = gradients_of(ours, d_y, {x, bias, parameters[0].value});
    const auto b = gradients_of(theirs, d_y, {x, bias, parameters[0].value});
    for (size_t i = 0; i < a.size(); ++i) EXPECT_LT(distance(a[i], b[i]), 1e-11) << i;
  }
}

TEST(Layers, DenseByItsDefinition) {
  ParameterMaker make = ParameterMaker::initial(3, at::ScalarType::Double);
  const DenseLayer layer(make, "layer", 4, 6);
  const auto& p = make.parameters();
  p[1].value.detach().copy_(random_tensor({6}, 1));
  p[2].value.detach().copy_(random_tensor({6}, 2));
  const at::Tensor x = leaf(random_tensor({3, 4}, 3));
  const at::Tensor ours = layer(x);
  const at::Tensor theirs = at::leaky_relu(
      at::matmul(x, weight_norm(p[0].value, p[1].value, 0).t()) + p[2].value, kLeakySlope);
  EXPECT_LT(distance(ours, theirs), 1e-13);
  const at::Tensor d_y = random_tensor({3, 6}, 4);
  const std::vector<at::Tensor> inputs = {x, p[0].value, p[1].value, p[2].value};
  const auto a = gradients_of(ours, d_y, inputs), b = gradients_of(theirs, d_y, inputs);
  for (size_t i = 0; i < a.size(); ++i) EXPECT_LT(distance(a[i], b[i]), 1e-12) << i;
}

TEST(Layers, InitialisationByTheReference) {
  ParameterMaker make = ParameterMaker::initial(5, at::ScalarType::Double);
  const UpLayer up(make, "up", 32, 16, 4);
  const UpLayer last(make, "last", 32, 16, 4, {1.0, true, 0.25});
  const DenseLayer dense(make, "dense", 100, 50);
  const auto& p = make.parameters();
  ASSERT_EQ(p.size(), 9u);
  EXPECT_EQ(p[0].name, "up.v");
  EXPECT_EQ(p[1].name, "up.gain");
  EXPECT_EQ(p[2].name, "up.bias");
  EXPECT_EQ(p[2].shape, (std::vector<int64_t>{8, 8, 16}));
  EXPECT_EQ(p[5].shape, (std::vector<int64_t>{16}));
  // s = sqrt(2 / (1 + a^2)) sqrt(2 / ((in + out) area)), uniform within sqrt(3) s.
  const auto spread = [](double slope, double in_out_area) {
    return std::sqrt(2 / (1 + slope * slope)) * std::sqrt(2 / in_out_area);
  };
  const double expected[] = {spread(0.2, 48 * 4), spread(1.0, 48 * 4), spread(0.2, 150)};
  for (size_t i = 0; i < 3; ++i) {
    const at::Tensor& v = p[3 * i].value;
    const double s = std::sqrt(v.detach().square().mean().item<double>());
    EXPECT_NEAR(s / expected[i], 1.0, 0.03) << i;
    EXPECT_LE(v.abs().max().item<double>(), std::sqrt(3.0) * expected[i]);
    EXPECT_GT(v.abs().max().item<double>(), 0.98 * std::sqrt(3.0) * expected[i]);
    const double norm = std::sqrt(v.detach().square().sum().item<double>());
    EXPECT_NEAR(p[3 * i + 1].value[0].item<double>(), (i == 1 ? 0.25 : 1.0) * norm, 1e-9);
    EXPECT_EQ(p[3 * i + 2].value.abs().max().item<double>(), 0.0);
  }
  // The four phases of a kernel are equal.
  const double* kernel = p[0].value.data_ptr<double>();
  for (int64_t row = 0; row < 4 * 32; ++row, kernel += 4 * 16)
    for (int64_t i = 16; i < 4 * 16; ++i) ASSERT_EQ(kernel[i], kernel[i % 16]);
  // Another type, the same numbers; another seed, others.
  ParameterMaker same = ParameterMaker::initial(5, at::ScalarType::Float);
  const UpLayer again(same, "up", 32, 16, 4);
  EXPECT_LT(distance(same.parameters()[0].value.to(at::ScalarType::Double), p[0].value), 1e-7);
  ParameterMaker other = ParameterMaker::initial(6, at::ScalarType::Double);
  const UpLayer third(other, "up", 32, 16, 4);
  EXPECT_GT(distance(other.parameters()[0].value, p[0].value), 0.01);
}

TEST(Layers, CountingAllocatesNothing) {
  ParameterMaker make = ParameterMaker::counting();
  const UpLayer layer(make, "huge", 1 << 12, 1 << 12, 1 << 14);
  ASSERT_EQ(make.parameters().size(), 3u);
  EXPECT_EQ(make.parameters()[2].count(), int64_t{1} << 42);
  EXPECT_FALSE(make.parameters()[2].value.defined());
}

TEST(Layers, GatherTakesPixelsAndGivesTheirGradientsBack) {
  const at::Tensor x = leaf(random_tensor({3, 4, 5}, 1));
  std::vector<int64_t> index = {1, 4, 11};
  const at::Tensor pixels = at::from_blob(index.data(), {3}, at::ScalarType::Long).clone();
  const at::Tensor y = gather_pixels(x, pixels);
  EXPECT_EQ(distance(y, x.view({12, 5}).index_select(0, pixels)), 0.0);
  const at::Tensor d_y = random_tensor({3, 5}, 2);
  const at::Tensor d_x = gradients_of(y, d_y, {x})[0].view({12, 5});
  for (int64_t pixel = 0; pixel < 12; ++pixel) {
    const auto at = std::find(index.begin(), index.end(), pixel);
    const at::Tensor expected = at == index.end() ? d_x[pixel] * 0 : d_y[at - index.begin()];
    EXPECT_EQ(distance(d_x[pixel], expected), 0.0) << pixel;
  }
}

TEST(Layers, ResizeKeepsCornersAndPlanes) {
  // a + b x + c y stays itself when corners meet corners.
  at::Tensor x = random_tensor({5, 5, 2}, 1);
  for (int64_t i = 0; i < 5; ++i)
    for (int64_t j = 0; j < 5; ++j) {
      x[i][j][0] = 1.0 + 0.25 * static_cast<double>(i) - 0.5 * static_cast<double>(j);
      x[i][j][1] = 2.0;
    }
  const at::Tensor y = resize_picture(x, 9);
  for (int64_t i = 0; i < 9; ++i)
    for (int64_t j = 0; j < 9; ++j) {
      EXPECT_NEAR(y[i][j][0].item<double>(),
                  1.0 + 0.125 * static_cast<double>(i) - 0.25 * static_cast<double>(j), 1e-12);
      EXPECT_NEAR(y[i][j][1].item<double>(), 2.0, 1e-12);
    }
}

}  // namespace
}  // namespace effigy
