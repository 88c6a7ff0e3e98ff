// effigy bench: the numbers of BENCHMARKS.md, from the user's own machine.

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "bench/kernels.h"
#include "effigy/avatar/renderer.h"
#include "effigy/base/log.h"
#include "effigy/base/threads.h"
#include "effigy/cli/bench_figures.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/family.h"
#include "effigy/cli/program.h"
#include "effigy/head/trainer.h"
#include "effigy/image/metrics.h"
#include "effigy/light/builtin_lights.h"
#include "effigy/synth/head_capture.h"

namespace effigy {
namespace {

using Clock = std::chrono::steady_clock;
using Figures = std::vector<BenchResult>;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

// Drawing one avatar 512 pixels high, relit: fixed geometry, and the rig moving every frame.
void bench_playback(const HeadAvatar& avatar, int repeats, Figures& figures) {
  const Camera camera =
      avatar.camera.resized(512 * avatar.camera.width / avatar.camera.height, 512);
  HeadRenderer renderer(avatar);
  renderer.set_light(prefilter_environment(builtin_light("sunset")));
  const Track& track = avatar.tracks.begin()->second;
  const auto pose = [&](int i) -> const RigPose& {
    return track.poses[static_cast<size_t>(i) % track.poses.size()];
  };
  renderer.set_pose(pose(0));
  const Image exact = to_image(renderer.draw(camera));
  const auto pairs = static_cast<double>(renderer.pairs());
  renderer.set_exact(false);
  const Image deferred = to_image(renderer.draw(camera));
  figures.push_back(summarise("head.playback.avatar_deferred_psnr", {psnr(exact, deferred)}));
  figures.push_back(
      frames_per_second("head.playback.static_fps", repeats, [&](int) { renderer.draw(camera); }));
  figures.push_back(frames_per_second("head.playback.dynamic_fps", repeats, [&](int i) {
    renderer.set_pose(pose(i));
    renderer.draw(camera);
  }));
  figures.push_back(summarise("head.playback.avatar_pairs", {pairs}));
  figures.push_back(
      summarise("head.playback.avatar_surfels", {static_cast<double>(avatar.surfels.count())}));
}

// A capture and a freshly started avatar of it, for training figures and when no avatar is given.
class BenchCapture {
 public:
  BenchCapture()
      : folder_(std::filesystem::temp_directory_path() /
                ("effigy-bench-" + std::to_string(::getpid()))) {
    SynthHeadOptions options;
    options.frames = 8;
    options.size = 512;
    options.relight.clear();
    options.truth = HeadTruth::kSplitSum;  // the pictures do not matter, only their size
    options.samples = 4;
    options.layers = false;
    synth_head_capture(options, folder_);
    capture_ = read_capture(folder_);
  }
  ~BenchCapture() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  const Capture& capture() const { return capture_; }

 private:
  Path folder_;
  Capture capture_;
};

// 512^2, 10 k surfels, 1024^2 textures, all losses on. Returns the avatar as it stands then.
HeadAvatar bench_training(const Capture& capture, int repeats, Figures& figures) {
  constexpr int kSteps = 5;
  TrainSettings settings = TrainSettings::from_preset("quick");
  settings.uv_distortion_start = 0;
  HeadTrainer trainer(capture, settings);
  for (int i = 0; i < 30; ++i) trainer.step();
  std::vector<double> rates;
  for (int r = 0; r < repeats; ++r) {
    const auto begin = Clock::now();
    for (int i = 0; i < kSteps; ++i) trainer.step();
    rates.push_back(kSteps / seconds_since(begin));
  }
  figures.push_back(summarise("head.training.iterations_per_second", std::move(rates)));
  return trainer.avatar();
}

}  // namespace

int run_bench(int argc, char** argv) {
  CLI::App app(
      "Measures this machine: the surfel rasterizer's kernels (nanoseconds per blended "
      "surfel-pixel\n"
      "pair, and the ratio to the same kernel compiled without vectors), the Gaussian rasterizer\n"
      "(milliseconds a frame of 10 and 80 thousand), playback of an avatar at 512 pixels with "
      "fixed\n"
      "geometry and with the rig moving, and training. Medians with their spread.\n\n"
      "example: effigy bench --json\n"
      "         effigy bench --only gaussian\n"
      "         effigy bench --only networks\n"
      "         effigy bench --avatar anna",
      "bench");
  std::string avatar_path, only = "all";
  int repeats = 9;
  CommonOptions common;
  app.add_option("--avatar", avatar_path,
                 "Measure playback on this avatar, head or body (default: the demo head)");
  app.add_option("--repeats", repeats, "Timed runs of each figure (default 9)")
      ->check(CLI::Range(1, 1000));
  app.add_option("--only", only,
                 "all (the default: head and gaussian), head, gaussian, or networks: those of "
                 "bodies")
      ->check(CLI::IsMember({"all", "head", "gaussian", "networks"}));
  std::string size;
  app.add_option("--size", size, "networks: tiny, small or full (default small)");
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  if (only == "networks" || names_avatar(argc, argv, "body")) return hand_over(argc, argv);

  BenchOptions options;
  options.repeats = repeats;
  Figures figures;
  if (only != "head") {
    log_info("measuring the Gaussian rasterizer");
    figures = bench_gaussians(repeats);
  }
  if (only != "gaussian") {
    log_info("measuring kernels");
    for (const BenchResult& f : bench_kernels(options)) figures.push_back(f);
    const BenchCapture made;
    log_info("measuring training");
    const HeadAvatar started = bench_training(made.capture(), repeats, figures);
    log_info("measuring playback");
    bench_playback(avatar_path.empty() ? started : read_head_avatar(avatar_path), repeats, figures);
  }
  print_figures(figures, common.json);
  return 0;
}

}  // namespace effigy
