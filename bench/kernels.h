// Benchmarks of the rasterizers' kernels, used by `effigy bench`.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "bench/result.h"
#include "effigy/geometry/types.h"
#include "effigy/splat/gaussian_raster.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {

struct BenchOptions {
  int repeats = 15;  // timed runs of each kernel, after one to warm up
  int surfels = 10000;
  int image = 512;     // pixels a side
  int texture = 1024;  // texels a side
};

// The scene that all kernel figures are about: surfels on a Fibonacci sphere of radius 1 at
// distance 4 that covers 60 % of a square image, standard deviation 0.6 times their spacing,
// opacity 0.9, UV = longitude and latitude, a texture with detail at every scale. Both sides of the
// sphere are blended.
struct BenchScene {
  Camera camera;
  PosedSurfels surfels;
  MaterialTexture texture;
};
BenchScene make_bench_scene(const BenchOptions& options);

// head.forward.ns_per_pair, head.forward_backward.ns_per_pair (with the paper's UV distortion),
// head.playback.ns_per_pair: wall-clock nanoseconds per blended surfel-pixel pair, everything
// included; head.playback.deferred_psnr: material and normals of playback against the full
// rasterizer, decibels, peak 1; head.scalar.ratio: time of forward with one lane over time with the
// best instruction set, one thread each.
std::vector<BenchResult> bench_kernels(const BenchOptions& options);

// Times `work` after one run to warm up; results are seconds * scale.
BenchResult measure(const std::string& name, int repeats, double scale,
                    const std::function<void()>& work);

// The scene that OpenSplat was measured on: 3D Gaussians on the same sphere, standard deviation
// half their spacing along it and 0.3 of that across, colours by position, further channels
// likewise.
struct GaussianBenchScene {
  Camera camera;
  Gaussians gaussians;
};
GaussianBenchScene make_gaussian_bench_scene(int count, int channels);

// gaussian.forward.{10k,80k}_ms, gaussian.forward_backward.{10k,80k}_ms (RGB, projection included)
// and gaussian.channels10.* (ten channels): milliseconds a frame; gaussian.pairs.{10k,80k}: what is
// blended in it; gaussian.threads: time of one thread over time of all, forward with backward, 80k;
// gaussian.{80k_over_10k,channels10_over_rgb.{10k,80k}}: ratios of forward. All take turns, and
// ratios are of neighbours.
std::vector<BenchResult> bench_gaussians(int repeats);

}  // namespace effigy
