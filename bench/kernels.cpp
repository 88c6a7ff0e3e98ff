#include "kernels.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/splat/kernel_choice.h"
#include "effigy/splat/surfel_kernels.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;

void append(std::vector<float>& to, const Vec3d& v) {
  for (int k = 0; k < 3; ++k) to.push_back(static_cast<float>(v[k]));
}

// Value noise, smooth between lattice points, four octaves.
double noise(double x, double y, uint64_t channel) {
  double sum = 0.0, weight = 0.5;
  for (double frequency = 16.0; frequency < 200.0; frequency *= 2.0, weight *= 0.5) {
    const double u = x * frequency, v = y * frequency;
    const auto cell_x = static_cast<int64_t>(std::floor(u));
    const auto cell_y = static_cast<int64_t>(std::floor(v));
    const auto at = [&](int64_t i, int64_t j) {
      Random random(static_cast<uint64_t>(i + 1000 * j), channel);
      return random.uniform();
    };
    const auto ease = [](double t) { return t * t * (3.0 - 2.0 * t); };
    const double fx = ease(u - static_cast<double>(cell_x));
    const double fy = ease(v - static_cast<double>(cell_y));
    sum +=
        weight * std::lerp(std::lerp(at(cell_x, cell_y), at(cell_x + 1, cell_y), fx),
                           std::lerp(at(cell_x, cell_y + 1), at(cell_x + 1, cell_y + 1), fx), fy);
  }
  return sum;
}

MaterialTexture make_texture(int size) {
  MaterialTexture texture(size, size);
  parallel_for(static_cast<size_t>(size), 8, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y) {
      for (size_t x = 0; x < static_cast<size_t>(size); ++x) {
        float* texel = texture.texels.data() + 8 * (y * static_cast<size_t>(size) + x);
        const double u = (static_cast<double>(x) + 0.5) / size;
        const double v = (static_cast<double>(y) + 0.5) / size;
        for (uint64_t c = 0; c < 5; ++c) texel[c] = static_cast<float>(noise(u, v, c));
        for (uint64_t c = 5; c < 7; ++c) texel[c] = static_cast<float>(noise(u, v, c) - 0.5);
      }
    }
  });
  return texture;
}

BenchResult constant(const std::string& name, double value) {
  return {name, value, value, value, thread_count()};
}

}  // namespace

BenchResult measure(const std::string& name, int repeats, double scale,
                    const std::function<void()>& work) {
  work();
  std::vector<double> times;
  for (int k = 0; k < std::max(1, repeats); ++k) times.push_back(scale * seconds_of(work));
  return summarise(name, std::move(times));
}

BenchScene make_bench_scene(const BenchOptions& options) {
  BenchScene scene;
  const int n = options.surfels;
  scene.camera.width = scene.camera.height = options.image;
  scene.camera.cx = scene.camera.cy = 0.5 * options.image;
  const double disc = std::sqrt(0.6 * options.image * options.image / kPi);
  scene.camera.fx = scene.camera.fy = disc / std::tan(std::asin(0.25));
  const double sigma = 0.6 * std::sqrt(4.0 * kPi / n);
  PosedSurfels& p = scene.surfels;
  for (int i = 0; i < n; ++i) {
    const double y = 1.0 - 2.0 * (i + 0.5) / n, r = std::sqrt(1.0 - y * y);
    const double phi = std::fmod(i * kPi * (3.0 - std::sqrt(5.0)), 2.0 * kPi);
    const Vec3d normal(r * std::cos(phi), y, r * std::sin(phi));
    const Vec3d tangent(-std::sin(phi), 0.0, std::cos(phi));  // along increasing phi
    const Vec3d bitangent = normal.cross(tangent);
    append(p.center, normal + Vec3d(0, 0, 4));
    append(p.s, sigma * tangent);
    append(p.t, sigma * bitangent);
    p.opacity.push_back(0.9f);
    // u = phi / 2 pi, v = latitude / pi + 1/2; d(v)/d(bitangent) from the bitangent's y.
    p.uv.push_back(static_cast<float>(phi / (2.0 * kPi)));
    p.uv.push_back(static_cast<float>(std::asin(y) / kPi + 0.5));
    const double du = sigma / (2.0 * kPi * std::max(r, 0.05));
    const double dv = sigma / kPi * bitangent.y() / std::max(r, 1e-6);
    for (const double d : {du, 0.0, 0.0, dv}) p.uv_per_st.push_back(static_cast<float>(d));
    append(p.frame, tangent);
    append(p.frame, -bitangent);  // to increasing v
    append(p.frame, normal);
  }
  scene.texture = make_texture(options.texture);
  return scene;
}

std::vector<BenchResult> bench_kernels(const BenchOptions& options) {
  const BenchScene scene = make_bench_scene(options);
  SurfelFrame frame;
  Planes gbuffer, deferred;
  const SurfelRasterOptions plain;
  SurfelRasterOptions training;
  training.uv_distortion = UvDistortion::kNorm;
  const auto forward = [&](const SurfelRasterOptions& with) {
    render_surfels(scene.camera, scene.surfels, scene.texture, with, gbuffer, frame);
  };
  forward(plain);
  const double per_pair = 1e9 / static_cast<double>(std::max<int64_t>(1, frame.pairs()));
  std::vector<BenchResult> results;
  results.push_back(
      measure("head.forward.ns_per_pair", options.repeats, per_pair, [&] { forward(plain); }));

  Planes upstream(options.image, options.image, kGBufferPlanes);
  Random random(1);
  for (float& x : upstream.data) x = static_cast<float>(random.uniform(-1.0, 1.0));
  PosedSurfels d_surfels;
  d_surfels.resize(scene.surfels.count());
  std::vector<float> d_texels(scene.texture.texels.size());
  results.push_back(measure("head.forward_backward.ns_per_pair", options.repeats, per_pair, [&] {
    forward(training);
    render_surfels_backward(scene.camera, scene.surfels, scene.texture, training, gbuffer, frame,
                            upstream, d_surfels, d_texels);
  }));

  const PlaybackTexture playback_texture(scene.texture);
  results.push_back(measure("head.playback.ns_per_pair", options.repeats, per_pair, [&] {
    render_surfels_playback(scene.camera, scene.surfels, playback_texture, {}, deferred, frame);
  }));
  forward(plain);
  double error = 0.0;
  size_t count = 0;
  for (int c = kAlbedo; c < kUv; ++c) {
    for (size_t i = 0; i < gbuffer.pixels(); ++i, ++count) {
      const double e = static_cast<double>(gbuffer.plane(c)[i] - deferred.plane(c)[i]);
      error += e * e;
    }
  }
  results.push_back(
      constant("head.playback.deferred_psnr",
               -10.0 * std::log10(std::max(1e-12, error / static_cast<double>(count)))));

  const int threads = thread_count();
  set_thread_count(1);
  const int repeats = std::max(1, options.repeats / 3);
  const BenchResult best = measure("", repeats, 1.0, [&] { forward(plain); });
  choose_splat_kernels(KernelChoice::kScalar);
  const BenchResult scalar = measure("", repeats, 1.0, [&] { forward(plain); });
  choose_splat_kernels(KernelChoice::kBest);
  results.push_back({"head.scalar.ratio", scalar.median / best.median, scalar.min / best.max,
                     scalar.max / best.min, 1});
  set_thread_count(threads);
  return results;
}

}  // namespace effigy
