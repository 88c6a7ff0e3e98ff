// effigy demo: one command, end to end, on a capture of the built-in head.

#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/evaluation.h"
#include "effigy/cli/program.h"
#include "effigy/head/trainer.h"
#include "effigy/synth/head_capture.h"

namespace effigy {
namespace {

// Small enough for minutes on two cores, large enough to look at.
constexpr int kFrames = 64, kSize = 288, kIterations = 1500, kSurfels = 8000, kTexture = 512,
              kSamples = 64;
constexpr double kFramesPerSecond = 10;  // few frames, but of all that the head does

TrainSettings demo_settings(uint64_t seed) {
  TrainSettings settings = TrainSettings::from_preset("quick");
  settings.iterations = kIterations;
  settings.surfels = kSurfels;
  settings.texture_size = kTexture;
  settings.seed = seed;
  return settings;
}

}  // namespace

int run_demo(int argc, char** argv) {
  for (int k = 1; k < argc; ++k)
    if (std::string(argv[k]) == "body") return hand_over(argc, argv);
  CLI::App app(
      "Makes a capture of the built-in head, trains an avatar on it from scratch, scores, "
      "relights\n"
      "and repaints it: DIR/capture, DIR/avatar, DIR/eval. About five minutes on two cores. The "
      "same "
      "for a\n"
      "body in a light stage, in about eight minutes: effigy demo body.\n\n"
      "example: effigy demo -o demo\n"
      "         effigy demo body -o body-demo",
      "demo");
  std::string what = "head", output = "effigy-demo";
  uint64_t subject = 1;
  CommonOptions common;
  app.add_option("WHAT", what, "head (default) or body")->check(CLI::IsMember({"head", "body"}));
  app.add_option("-o,--output", output, "Folder (default effigy-demo)");
  app.add_option("--subject", subject, "Who: 1 to 5 are the standard subjects (default 1)");
  add_common(app, common, true, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;

  const Path out = output;
  SynthHeadOptions synth;
  synth.subject = subject;
  synth.frames = kFrames;
  synth.size = kSize;
  synth.seed = common.seed;
  synth.samples = kSamples;
  synth.frames_per_second = kFramesPerSecond;
  synth_head_capture(synth, out / "capture");
  const Capture capture = read_capture(out / "capture");
  train_head(capture, demo_settings(common.seed), out / "avatar", {});
  const HeadAvatar avatar = read_head_avatar(out / "avatar");
  EvaluationOptions options;
  options.refined = false;
  const Evaluation evaluation = evaluate_avatar(avatar, capture, options);
  write_evaluation(evaluation, avatar, capture, out / "avatar", options, out / "eval");
  if (common.json) {
    print_json(evaluation.metrics());
  } else {
    const FrameScore m = evaluation.tracked.mean();
    std::printf("held-out PSNR %.2f dB, SSIM %.4f\n", m.psnr, m.ssim);
    for (const auto& [name, scores] : evaluation.relight)
      std::printf("relit by %s: PSNR %.2f dB scale-aligned (left in the training light: %.2f dB)\n",
                  name.c_str(), scores.psnr_aligned, scores.psnr_unlit);
    std::printf("%s\n", (out / "eval/report.html").c_str());
  }
  return 0;
}

}  // namespace effigy
