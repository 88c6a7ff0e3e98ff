// The Gaussian rasterizer's figures.

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "kernels.h"

namespace effigy {

GaussianBenchScene make_gaussian_bench_scene(int count, int channels) {
  constexpr double kPi = std::numbers::pi;
  constexpr int kImage = 512;
  GaussianBenchScene scene;
  Camera& camera = scene.camera;
  camera.width = camera.height = kImage;
  camera.cx = camera.cy = 0.5 * kImage;
  camera.fx = camera.fy = std::sqrt(0.6 * kImage * kImage / kPi) / std::tan(std::asin(0.25));
  const double spacing = std::sqrt(4.0 * kPi / count), sigma = 0.5 * spacing;
  Gaussians& g = scene.gaussians;
  g.channels = channels;
  for (int i = 0; i < count; ++i) {
    const double y = 1.0 - 2.0 * (i + 0.5) / count, r = std::sqrt(1.0 - y * y);
    const double phi = std::fmod(i * kPi * (3.0 - std::sqrt(5.0)), 2.0 * kPi);
    const Vec3d normal(r * std::cos(phi), y, r * std::sin(phi));
    const auto q = Eigen::Quaterniond::FromTwoVectors(Vec3d::UnitZ(), normal);
    for (const double x : {normal.x(), normal.y(), normal.z() + 4.0})
      g.center.push_back(static_cast<float>(x));
    for (const double x : {q.w(), q.x(), q.y(), q.z()}) g.rotation.push_back(static_cast<float>(x));
    for (const double x : {sigma, sigma, 0.3 * sigma}) g.scale.push_back(static_cast<float>(x));
    g.opacity.push_back(0.9f);
    const double colour[] = {0.5 + 0.5 * normal.x(), 0.5 + 0.5 * y,
                             0.5 + 0.5 * std::sin(20.0 * normal.x()) * std::cos(20.0 * y)};
    for (int c = 0; c < channels; ++c) g.features.push_back(static_cast<float>(colour[c % 3]));
  }
  return scene;
}

namespace {

constexpr double kMilliseconds = 1e3;

// One scene with all that a frame of it needs.
class Case {
 public:
  Case(int thousands, int channels)
      : scene_(make_gaussian_bench_scene(1000 * thousands, channels)),
        view_(scene_.gaussians.view()),
        upstream_(scene_.camera.width, scene_.camera.height, 1 + channels) {
    d_.channels = channels;
    d_.resize(view_.count());
    Random random(1);
    for (float& x : upstream_.data) x = static_cast<float>(random.uniform(-1.0, 1.0));
  }
  Case(const Case&) = delete;
  Case& operator=(const Case&) = delete;

  void forward() { render_gaussians(scene_.camera, view_, {}, image_, frame_); }
  void forward_backward() {
    forward();
    render_gaussians_backward(scene_.camera, view_, {}, image_, frame_, upstream_,
                              {d_.center, d_.rotation, d_.scale, d_.opacity, d_.features, {}});
  }
  double pairs() const { return static_cast<double>(frame_.pairs()); }

 private:
  GaussianBenchScene scene_;
  GaussianView view_;
  Gaussians d_;
  Planes image_, upstream_;
  GaussianFrame frame_;
};

std::vector<double> ratios(const std::vector<double>& over, const std::vector<double>& under) {
  std::vector<double> result;
  for (size_t r = 0; r < over.size(); ++r) result.push_back(over[r] / under[r]);
  return result;
}

}  // namespace

std::vector<BenchResult> bench_gaussians(int repeats) {
  Case rgb10(10, 3), rgb80(80, 3), ten10(10, 10), ten80(80, 10);
  Case* const cases[] = {&rgb10, &rgb80, &ten10, &ten80};
  // All take turns; each is timed with what it needs in the caches.
  const auto time = [](const std::function<void()>& work, std::vector<double>& times) {
    work();
    times.push_back(kMilliseconds * seconds_of(work));
  };
  std::vector<double> forward[4], both[4], one_thread;
  const int threads = thread_count();
  for (int r = 0; r < repeats; ++r) {
    for (size_t c = 0; c < 4; ++c) time([&] { cases[c]->forward(); }, forward[c]);
    for (size_t c = 0; c < 4; ++c) {
      time([&] { cases[c]->forward_backward(); }, both[c]);
      if (c != 1) continue;
      set_thread_count(1);
      time([&] { cases[c]->forward_backward(); }, one_thread);
      set_thread_count(threads);
    }
  }
  const char* const names[] = {"10k", "80k", "10k", "80k"};
  std::vector<BenchResult> results;
  for (size_t c = 0; c < 4; ++c) {
    const std::string group = c < 2 ? "gaussian." : "gaussian.channels10.", size = names[c];
    results.push_back(summarise(group + "forward." + size + "_ms", forward[c]));
    results.push_back(summarise(group + "forward_backward." + size + "_ms", both[c]));
    if (c < 2) results.push_back(summarise("gaussian.pairs." + size, {cases[c]->pairs()}));
  }
  results.push_back(summarise("gaussian.80k_over_10k", ratios(forward[1], forward[0])));
  results.push_back(summarise("gaussian.channels10_over_rgb.10k", ratios(forward[2], forward[0])));
  results.push_back(summarise("gaussian.channels10_over_rgb.80k", ratios(forward[3], forward[1])));
  results.push_back(summarise("gaussian.threads", ratios(one_thread, both[1])));
  return results;
}

}  // namespace effigy
