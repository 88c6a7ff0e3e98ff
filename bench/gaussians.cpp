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

std::vector<BenchResult> bench_gaussians(int repeats) {
  constexpr double kMilliseconds = 1e3;
  std::vector<BenchResult> results;
  for (const int channels : {3, 10}) {
    for (const int thousands : {10, 80}) {
      const GaussianBenchScene scene = make_gaussian_bench_scene(1000 * thousands, channels);
      const GaussianView view = scene.gaussians.view();
      const GaussianRasterOptions options;
      Gaussians d;
      d.channels = channels;
      d.resize(view.count());
      Planes image, upstream(scene.camera.width, scene.camera.height, 1 + channels);
      Random random(1);
      for (float& x : upstream.data) x = static_cast<float>(random.uniform(-1.0, 1.0));
      GaussianFrame frame;
      const auto forward = [&] { render_gaussians(scene.camera, view, options, image, frame); };
      const auto both = [&] {
        forward();
        render_gaussians_backward(scene.camera, view, options, image, frame, upstream,
                                  {d.center, d.rotation, d.scale, d.opacity, d.features, {}});
      };
      const std::string group = channels == 3 ? "gaussian." : "gaussian.channels10.";
      const std::string size = std::to_string(thousands) + "k";
      results.push_back(
          measure(group + "forward." + size + "_ms", repeats, kMilliseconds, forward));
      const BenchResult all =
          measure(group + "forward_backward." + size + "_ms", repeats, kMilliseconds, both);
      results.push_back(all);
      if (channels != 3) continue;
      const auto pairs = static_cast<double>(frame.pairs());
      results.push_back({group + "pairs." + size, pairs, pairs, pairs, thread_count()});
      if (thousands != 80) continue;
      const int threads = thread_count();
      set_thread_count(1);
      const BenchResult one = measure("", repeats, kMilliseconds, both);
      set_thread_count(threads);
      results.push_back({"gaussian.threads", one.median / all.median, one.min / all.max,
                         one.max / all.min, threads});
    }
  }
  return results;
}

}  // namespace effigy
