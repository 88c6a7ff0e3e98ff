// effigy demo body (in effigy-learn): one command, end to end, on a capture of the built-in body.

#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/body/train_run.h"
#include "effigy/cli/body_evaluation.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/synth/body_capture.h"

namespace effigy {
namespace {

constexpr int kIterations = 6000;
constexpr size_t kViews = 24;  // scored of each group

SynthBodyOptions demo_stage(uint64_t subject, uint64_t seed) {
  SynthBodyOptions options;
  options.subject = subject;
  options.stage = stage_preset("tiny");
  options.stage.seed = seed;
  options.relight = {"studio", "sunset"};
  return options;
}

}  // namespace

int run_demo_body(int argc, char** argv) {
  CLI::App app(
      "Makes a light-stage capture of the built-in body, trains an avatar on it from scratch and\n"
      "scores it on cameras, lights, motion and environments that it has not seen: DIR/capture,\n"
      "DIR/avatar, DIR/eval. About eight minutes on two cores.\n\n"
      "example: effigy demo body -o body-demo",
      "demo");
  std::string what = "body", output = "effigy-body-demo";
  uint64_t subject = 1;
  CommonOptions common;
  app.add_option("WHAT", what, "body")->check(CLI::IsMember({"body"}));
  app.add_option("-o,--output", output, "Folder (default effigy-body-demo)");
  app.add_option("--subject", subject, "Who: 1 to 5 are the standard subjects (default 1)");
  add_common(app, common, true, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;

  const Path out = output;
  synth_body_capture(demo_stage(subject, common.seed), out / "capture");
  const StageCapture capture = read_stage_capture(out / "capture");
  BodyTrainSettings settings = BodyTrainSettings::from_preset("quick");
  settings.iterations = kIterations;
  settings.seed = common.seed;
  train_body(capture, settings, out / "avatar", {});
  BodyAvatar avatar = read_body_avatar(out / "avatar");
  BodyEvaluationOptions options;
  options.most_views = kViews;
  const BodyEvaluation evaluation = evaluate_body(avatar, capture, options);
  write_body_evaluation(evaluation, avatar, capture, out / "avatar", out / "eval");
  if (common.json) {
    print_json(evaluation.metrics());
    return 0;
  }
  for (const ViewGroup& group : evaluation.groups)
    std::printf("%s: PSNR %.2f dB, SSIM %.4f (left fully lit %.2f dB, one colour %.2f dB)\n",
                group.title.c_str(), group.mean().psnr, group.mean().ssim,
                group.mean(&ViewScores::unlit).psnr, group.mean(&ViewScores::flat).psnr);
  for (const auto& [light, scores] : evaluation.relight)
    std::printf("relit by %s: PSNR %.2f dB, after a scale of %.3f %.2f dB\n", light.c_str(),
                scores.psnr, scores.scale, scores.psnr_aligned);
  std::printf("%s\n", (out / "eval/report.html").c_str());
  return 0;
}

}  // namespace effigy
