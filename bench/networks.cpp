#include "bench/networks.h"

#include <ATen/TensorOperators.h>
#include <ATen/core/grad_mode.h>
#include <ATen/ops/convolution_backward.h>
#include <ATen/ops/mkldnn_convolution.h>
#include <ATen/ops/randn.h>

#include <time.h>

#include <algorithm>
#include <chrono>
#include <numeric>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/body/gaussian_channels.h"
#include "effigy/body/networks.h"
#include "effigy/infer/convolution.h"

namespace effigy {
namespace {

using Clock = std::chrono::steady_clock;

// Processor time of all threads, milliseconds.
double processor_time() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

// Milliseconds of every run, by the clock and of processor time.
struct Times {
  std::vector<double> wall, processor;
  template <typename Run>
  void measure(Run&& run) {
    const auto begin = Clock::now();
    const double processor_begin = processor_time();
    run();
    processor.push_back(processor_time() - processor_begin);
    wall.push_back(1e3 * std::chrono::duration<double>(Clock::now() - begin).count());
  }
};

std::vector<float> random_floats(size_t count, uint64_t stream) {
  Random random(1, stream);
  std::vector<float> values(count);
  for (float& value : values) value = static_cast<float>(random.normal());
  return values;
}

// The convolutions of the view-independent decoder alone, on pictures of the right sizes.
class BareLoop {
 public:
  explicit BareLoop(const BodyNetworkSettings& settings) {
    std::vector<int> widths = settings.decoder;
    widths.push_back(static_cast<int>(GaussianChannels::kCount));
    int64_t in = settings.seed_channels, side = kSeedSide;
    for (int width : widths) {
      layers_.push_back({at::randn({side, side, in}).permute({2, 0, 1}).unsqueeze(0),
                         at::randn({4 * width, in, 2, 2}),
                         {},
                         {}});
      in = width;
      side *= 2;
    }
    forward();
    for (Layer& layer : layers_) layer.d_y = at::randn_like(layer.y);
  }
  void forward() {
    const at::NoGradGuard none;
    use_torch_threads(thread_count());
    for (Layer& layer : layers_)
      layer.y = at::mkldnn_convolution(layer.x, layer.weight, {}, {1, 1}, {1, 1}, {1, 1}, 1);
  }
  void backward() {
    const at::NoGradGuard none;
    use_torch_threads(thread_count());
    for (Layer& layer : layers_)
      at::convolution_backward(layer.d_y, layer.x, layer.weight, c10::nullopt, {1, 1}, {1, 1},
                               {1, 1}, false, {0, 0}, 1, {true, true, false});
  }

 private:
  struct Layer {
    at::Tensor x, weight, y, d_y;
  };
  std::vector<Layer> layers_;
};

}  // namespace

std::vector<BenchResult> bench_networks(const std::string& size, int repeats) {
  constexpr int kKeypoints = 70;
  const auto settings = BodyNetworkSettings::from_size(size, kKeypoints, kKeypoints);
  std::vector<int32_t> texels(static_cast<size_t>(settings.texture()) *
                              static_cast<size_t>(settings.texture()));
  std::iota(texels.begin(), texels.end(), 0);
  BodyNetworks networks(settings, texels, 1);
  const auto body = random_floats(3 * kKeypoints, 1), face = random_floats(3 * kKeypoints, 2),
             directions = random_floats(3 * texels.size(), 3),
             irradiance =
                 random_floats(static_cast<size_t>(settings.shadow_side * settings.shadow_side), 4),
             d_gaussians = random_floats(GaussianChannels::kCount * texels.size(), 5);
  BareLoop bare(settings);
  const auto forward = [&](bool training) {
    networks.set_training(training);
    networks.decode(body, face);
  };
  const auto forward_backward = [&] {
    forward(true);
    networks.backward(d_gaussians, {}, {});
    networks.clear_gradients();
  };
  const auto bare_forward_backward = [&] {
    bare.forward();
    bare.backward();
  };
  forward_backward();
  bare_forward_backward();
  Times times[4], views, shadows;
  std::vector<double> shares[2];
  for (int r = 0; r < repeats; ++r) {
    times[0].measure([&] { forward(false); });
    times[1].measure([&] { bare.forward(); });
    times[2].measure(forward_backward);
    times[3].measure(bare_forward_backward);
    for (size_t i = 0; i < 2; ++i)
      shares[i].push_back(times[2 * i + 1].wall.back() / times[2 * i].wall.back());
    forward(false);
    views.measure([&] { networks.visibility(directions); });
    shadows.measure([&] { networks.shadow(irradiance); });
  }
  return {summarise("body.decoder.forward_ms", times[0].wall),
          summarise("body.decoder.forward_processor_ms", times[0].processor),
          summarise("body.decoder.bare_forward_ms", times[1].wall),
          summarise("body.decoder.bare_forward_processor_ms", times[1].processor),
          summarise("body.decoder.forward_share", shares[0]),
          summarise("body.decoder.forward_backward_ms", times[2].wall),
          summarise("body.decoder.forward_backward_processor_ms", times[2].processor),
          summarise("body.decoder.bare_forward_backward_ms", times[3].wall),
          summarise("body.decoder.bare_forward_backward_processor_ms", times[3].processor),
          summarise("body.decoder.forward_backward_share", shares[1]),
          summarise("body.visibility.forward_ms", views.wall),
          summarise("body.shadow.forward_ms", shadows.wall)};
}

}  // namespace effigy
