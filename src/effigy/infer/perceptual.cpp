#include "effigy/infer/perceptual.h"

#include <ATen/ops/empty.h>
#include <c10/core/InferenceMode.h>
#include <c10/util/Exception.h>

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

// mean over pixels of sum_c w_c (n(a)_c - n(b)_c)^2; no weights: all are 1.
double tap_distance(const at::Tensor& a, const at::Tensor& b, const std::vector<float>& weights) {
  const auto channels = static_cast<size_t>(a.size(1));
  const auto pixels = static_cast<size_t>(a.size(2) * a.size(3));
  const float* pa = a.data_ptr<float>();
  const float* pb = b.data_ptr<float>();
  std::vector<double> scale_a(pixels, 0.0), scale_b(pixels, 0.0), sum(pixels, 0.0);
  for (size_t c = 0; c < channels; ++c)
    for (size_t i = 0; i < pixels; ++i) {
      const double va = pa[c * pixels + i], vb = pb[c * pixels + i];
      scale_a[i] += va * va;
      scale_b[i] += vb * vb;
    }
  for (size_t i = 0; i < pixels; ++i) {
    scale_a[i] = 1 / (std::sqrt(scale_a[i]) + kNormGuard);
    scale_b[i] = 1 / (std::sqrt(scale_b[i]) + kNormGuard);
  }
  for (size_t c = 0; c < channels; ++c) {
    const double weight = weights.empty() ? 1.0 : static_cast<double>(weights[c]);
    for (size_t i = 0; i < pixels; ++i) {
      const double difference = pa[c * pixels + i] * scale_a[i] - pb[c * pixels + i] * scale_b[i];
      sum[i] += weight * difference * difference;
    }
  }
  double total = 0;
  for (const double value : sum) total += value;
  return total / static_cast<double>(pixels);
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

  double between(const Image& a, const Image& b, const InputMap& map) const {
    EFFIGY_CHECK(a.channels == 3 && b.channels == 3);
    EFFIGY_CHECK_EQ(a.width, b.width);
    EFFIGY_CHECK_EQ(a.height, b.height);
    try {
      // The two pictures at once: with two threads libtorch needs none of its own.
      const Image* images[2] = {&a, &b};
      std::vector<at::Tensor> taps[2];
      parallel_for(2, 1, [&](size_t begin, size_t end, int) {
        const c10::InferenceMode guard;
        use_torch_threads(std::max(1, thread_count() / 2));
        for (size_t i = begin; i < end; ++i)
          taps[i] = backbone.features(network_input(*images[i], map));
      });
      double sum = 0;
      for (size_t tap = 0; tap < taps[0].size(); ++tap)
        sum += tap_distance(taps[0][tap], taps[1][tap],
                            heads.empty() ? std::vector<float>() : heads[tap]);
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
  const c10::InferenceMode guard;
  auto state = std::make_unique<State>();
  state->backbone = read_backbone(net, TorchFile(backbone));
  state->heads = read_heads(TorchFile(heads), net, state->backbone.tap_channels());
  state->input = lpips_input(2, -1);
  state->unit_input = lpips_input(1, 0);
  return PerceptualDistance(std::move(state));
}

PerceptualDistance PerceptualDistance::squeezenet10(const Path& file) {
  const c10::InferenceMode guard;
  auto state = std::make_unique<State>();
  state->backbone = read_squeezenet10(file);
  state->input = state->unit_input = caffe_input();
  return PerceptualDistance(std::move(state));
}

double PerceptualDistance::between(const Image& a, const Image& b) const {
  return state_->between(a, b, state_->input);
}
double PerceptualDistance::between_unit_range(const Image& a, const Image& b) const {
  EFFIGY_CHECK(!state_->heads.empty());
  return state_->between(a, b, state_->unit_input);
}

}  // namespace effigy
