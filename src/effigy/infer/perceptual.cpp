#include "effigy/infer/perceptual.h"

#include <ATen/ops/empty.h>
#include <c10/core/InferenceMode.h>
#include <c10/util/Exception.h>
#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/infer/backbone.h"
#include "effigy/infer/convolution.h"

namespace effigy {
namespace {

constexpr double kNormGuard = 1e-10;
// LPIPS' scaling layer, for red, green and blue in [-1, 1].
constexpr double kShift[3] = {-0.030, -0.088, -0.188}, kScale[3] = {0.458, 0.448, 0.450};
constexpr int kLeastSide = 32;  // of pictures in a loss; every network takes it
// Caffe's mean picture, for blue, green and red in [0, 255].
constexpr double kCaffeMean[3] = {104, 117, 123};

// Channel c of the network's input is gain[c] * image channel source[c] + offset[c].
struct InputMap {
  int source[3];
  double gain[3], offset[3];
};

// `gain`, `offset`: what brings [0, 1] to the range that the scaling layer is given.
InputMap lpips_input(double gain, double offset) {
  InputMap map{{0, 1, 2}, {}, {}};
  for (int c = 0; c < 3; ++c) {
    map.gain[c] = gain / kScale[c];
    map.offset[c] = (offset - kShift[c]) / kScale[c];
  }
  return map;
}

InputMap caffe_input() {
  return {{2, 1, 0}, {255, 255, 255}, {-kCaffeMean[0], -kCaffeMean[1], -kCaffeMean[2]}};
}

at::Tensor network_input(const Image& image, const InputMap& map) {
  at::Tensor x = at::empty({1, 3, image.height, image.width}, at::kFloat);
  float* out = x.data_ptr<float>();
  const size_t pixels = static_cast<size_t>(image.width) * image.height;
  for (int c = 0; c < 3; ++c)
    for (size_t i = 0; i < pixels; ++i)
      *out++ = static_cast<float>(
          map.gain[c] * static_cast<double>(image.data[3 * i + map.source[c]]) + map.offset[c]);
  return x;
}

// 1 / (|f| + guard) of pixels [begin, end).
void inverse_norms(const float* f, size_t channels, size_t pixels, size_t begin, size_t end,
                   std::vector<double>& inverse) {
  inverse.assign(end - begin, 0.0);
  for (size_t c = 0; c < channels; ++c)
    for (size_t i = begin; i < end; ++i) {
      const double v = static_cast<double>(f[c * pixels + i]);
      inverse[i - begin] += v * v;
    }
  for (double& value : inverse) value = 1 / (std::sqrt(value) + kNormGuard);
}

// mean over pixels of sum_c w_c (n(a)_c - n(b)_c)^2; no weights: all are 1. `d_a`, when not null,
// becomes `share` times the derivative by a; 0 where a is 0, as that of the ReLU before it.
double tap_distance(const at::Tensor& a, const at::Tensor& b, const std::vector<float>& weights,
                    double share, at::Tensor* d_a) {
  const auto channels = static_cast<size_t>(a.size(1));
  const auto pixels = static_cast<size_t>(a.size(2) * a.size(3));
  const float* pa = a.data_ptr<float>();
  const float* pb = b.data_ptr<float>();
  std::vector<double> sum(pixels, 0.0);
  const double each = 2 * share / static_cast<double>(pixels);
  const auto weight_of = [&](size_t c) {
    return weights.empty() ? 1.0 : static_cast<double>(weights[c]);
  };
  float* out = nullptr;
  if (d_a != nullptr) {
    *d_a = at::empty(a.sizes(), at::kFloat);
    out = d_a->data_ptr<float>();
  }
  parallel_for(pixels, 64, [&](size_t begin, size_t end, int) {
    std::vector<double> scale_a, scale_b;
    inverse_norms(pa, channels, pixels, begin, end, scale_a);
    inverse_norms(pb, channels, pixels, begin, end, scale_b);
    // sum_c of the derivative by n(a)_c times n(a)_c: what a's length takes away again.
    std::vector<double> along(end - begin, 0.0);
    for (size_t c = 0; c < channels; ++c) {
      const double weight = weight_of(c);
      for (size_t i = begin; i < end; ++i) {
        const double unit = static_cast<double>(pa[c * pixels + i]) * scale_a[i - begin];
        const double difference =
            unit - static_cast<double>(pb[c * pixels + i]) * scale_b[i - begin];
        sum[i] += weight * difference * difference;
        along[i - begin] += each * weight * difference * unit;
      }
    }
    if (out == nullptr) return;
    for (size_t i = begin; i < end; ++i) {  // over |a|
      const double length = 1 / scale_a[i - begin] - kNormGuard;
      along[i - begin] = length > 0 ? along[i - begin] / length : 0.0;
      if (!(length > 0)) scale_a[i - begin] = 0;
    }
    for (size_t c = 0; c < channels; ++c) {
      const double weight = each * weight_of(c);
      for (size_t i = begin; i < end; ++i) {
        const double value = static_cast<double>(pa[c * pixels + i]), scale = scale_a[i - begin];
        const double difference =
            value * scale - static_cast<double>(pb[c * pixels + i]) * scale_b[i - begin];
        out[c * pixels + i] =
            static_cast<float>(scale * (weight * difference - along[i - begin] * value));
      }
    }
  });
  double total = 0;
  for (const double value : sum) total += value;
  return total / static_cast<double>(pixels);
}

// Black to the right and below, up to the least side.
Image continued(const Planes& planes) {
  const Image image = to_image(planes);
  const int width = std::max(image.width, kLeastSide), height = std::max(image.height, kLeastSide);
  if (width == image.width && height == image.height) return image;
  Image out(width, height, image.channels);
  for (int y = 0; y < image.height; ++y)
    std::copy_n(image.at(0, y), static_cast<size_t>(image.width) * image.channels, out.at(0, y));
  return out;
}

// One row of non-negative weights for each tap.
std::vector<std::vector<float>> read_heads(const TorchFile& file, const std::string& net,
                                           const std::vector<int>& channels) {
  const auto fail = [&](const std::string& why) {
    throw Error(file.path().string() + ": not the LPIPS heads for '" + net + "' (" + why +
                "); take lpips/weights/v0.1/" + net + ".pth of richzhang/PerceptualSimilarity.");
  };
  std::vector<std::vector<float>> heads;
  for (size_t tap = 0; tap < channels.size(); ++tap) {
    const std::string name = "lin" + std::to_string(tap) + ".model.1.weight";
    if (!file.has(name)) {
      const bool backbone = file.has("features.0.weight");
      fail("there is no '" + name + "'" + (backbone ? "; this is a backbone" : ""));
    }
    const std::vector<int64_t> shape = {1, channels[tap], 1, 1};
    if (file.shape(name) != shape)
      fail("'" + name + "' is " + TorchFile::sides(file.shape(name)) + " instead of " +
           TorchFile::sides(shape));
    heads.push_back(file.read(name));
    for (const float weight : heads.back())
      if (weight < 0) fail("'" + name + "' holds a negative weight");
  }
  const std::string more = "lin" + std::to_string(channels.size()) + ".model.1.weight";
  if (file.has(more)) fail("there is a '" + more + "' too many");
  return heads;
}

}  // namespace

struct PerceptualDistance::State {
  Backbone backbone;
  std::vector<std::vector<float>> heads;  // empty: no learned weights
  InputMap input, unit_input;

  const std::vector<float>& head(size_t tap) const {
    static const std::vector<float> kNone;
    return heads.empty() ? kNone : heads[tap];
  }

  // The distance and, when `d_a` is not null, `weight` times its derivative by the network's input
  // for a.
  double between(const Image& a, const Image& b, const InputMap& map, double weight,
                 at::Tensor* d_a) const {
    EFFIGY_CHECK(a.channels == 3 && b.channels == 3);
    EFFIGY_CHECK_EQ(a.width, b.width);
    EFFIGY_CHECK_EQ(a.height, b.height);
    try {
      // The two pictures at once: with two threads libtorch needs none of its own.
      at::Tensor x_of_a;
      std::vector<at::Tensor> of_a, of_b;
      parallel_for(2, 1, [&](size_t begin, size_t end, int) {
        use_torch_threads(std::max(1, thread_count() / 2));
        for (size_t i = begin; i < end; ++i) {
          const bool differentiate = i == 0 && d_a != nullptr;
          const c10::InferenceMode guard(!differentiate);
          const at::Tensor x = network_input(i == 0 ? a : b, map);
          if (differentiate) x_of_a = x.requires_grad_(true);
          (i == 0 ? of_a : of_b) = backbone.features(x);
        }
      });
      double sum = 0;
      std::vector<at::Tensor> d_taps(of_a.size());
      for (size_t tap = 0; tap < of_a.size(); ++tap)
        sum += tap_distance(of_a[tap], of_b[tap], head(tap), weight,
                            d_a != nullptr ? &d_taps[tap] : nullptr);
      if (d_a != nullptr) {
        // Threads of libtorch wait by spinning; where cores are shared they cost more than they
        // give.
        use_torch_threads(1);
        torch::autograd::backward(of_a, d_taps);
        *d_a = x_of_a.grad().contiguous();
      }
      return sum;
    } catch (const c10::Error& problem) {
      throw Error(backbone.name + " failed (" + problem.what_without_backtrace() + ").",
                  Blame::kInternal);
    }
  }
};

PerceptualDistance::PerceptualDistance(std::unique_ptr<State> state) : state_(std::move(state)) {}
PerceptualDistance::PerceptualDistance(PerceptualDistance&&) noexcept = default;
PerceptualDistance::~PerceptualDistance() = default;

PerceptualDistance PerceptualDistance::lpips(const std::string& net, const Path& backbone,
                                             const Path& heads) {
  auto state = std::make_unique<State>();
  state->backbone = read_backbone(net, TorchFile(backbone));
  state->heads = read_heads(TorchFile(heads), net, state->backbone.tap_channels());
  state->input = lpips_input(2, -1);
  state->unit_input = lpips_input(1, 0);
  return PerceptualDistance(std::move(state));
}

PerceptualDistance PerceptualDistance::squeezenet10(const Path& file) {
  auto state = std::make_unique<State>();
  state->backbone = read_squeezenet10(file);
  state->input = state->unit_input = caffe_input();
  return PerceptualDistance(std::move(state));
}

double PerceptualDistance::between(const Image& a, const Image& b) const {
  return state_->between(a, b, state_->input, 0, nullptr);
}
double PerceptualDistance::between_unit_range(const Image& a, const Image& b) const {
  EFFIGY_CHECK(!state_->heads.empty());
  return state_->between(a, b, state_->unit_input, 0, nullptr);
}

double PerceptualDistance::loss(const Planes& drawn, const Planes& target, float weight,
                                Planes& d_drawn) const {
  EFFIGY_CHECK(d_drawn.width == drawn.width && d_drawn.height == drawn.height);
  EFFIGY_CHECK(drawn.count == 3 && target.count == 3 && d_drawn.count >= 3);
  const Image a = continued(drawn);
  at::Tensor d_input;
  const double value =
      state_->between(a, continued(target), state_->input, static_cast<double>(weight), &d_input);
  const float* d = d_input.data_ptr<float>();
  for (int c = 0; c < 3; ++c) {
    const auto gain = static_cast<float>(state_->input.gain[c]);
    float* out = d_drawn.plane(state_->input.source[c]);
    for (int y = 0; y < drawn.height; ++y)
      for (int x = 0; x < drawn.width; ++x)
        out[y * drawn.width + x] += gain * d[(c * a.height + y) * a.width + x];
  }
  return value;
}

}  // namespace effigy
