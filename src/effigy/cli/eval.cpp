// effigy eval: metrics and a report of an avatar on a capture.

#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/evaluation.h"

namespace effigy {

int run_eval(int argc, char** argv) {
  CLI::App app(
      "Scores an avatar on a capture's held-out frames and writes metrics.json and report.html.\n"
      "Protocols: tracker (nothing fitted to the test image) and refined (pose and expression "
      "fitted,\n"
      "avatar frozen). LPIPS is left out: it needs backbone weights that cannot be shipped.\n\n"
      "example: effigy eval anna anna-capture -o anna-eval",
      "eval");
  std::string avatar_path, capture_path, output, protocol = "all";
  EvaluationOptions options;
  CommonOptions common;
  app.add_option("AVATAR", avatar_path, "Avatar folder")->required();
  app.add_option("CAPTURE", capture_path, "Capture folder")->required();
  app.add_option("-o,--output", output, "Folder for metrics.json and report.html")->required();
  app.add_option("--protocol", protocol, "tracker, refined or all (default)")
      ->check(CLI::IsMember({"tracker", "tracked", "refined", "all"}));
  app.add_option("--refine-steps", options.refine_steps,
                 "Steps of the protocol refined (default 60)")
      ->check(CLI::Range(1, 1000));
  app.add_option("--frames", options.most_frames, "Score at most this many frames, evenly spread")
      ->check(CLI::PositiveNumber);
  app.add_option("--light", options.lights,
                 "Lights of the report's relit rows (names or HDR/EXR files)")
      ->delimiter(',');
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  options.refined = protocol == "all" || protocol == "refined";

  const HeadAvatar avatar = read_head_avatar(avatar_path);
  const Capture capture = read_capture(capture_path);
  const Evaluation evaluation = evaluate_avatar(avatar, capture, options);
  write_evaluation(evaluation, avatar, capture, avatar_path, options, output);
  if (common.json) {
    print_json(evaluation.metrics());
  } else {
    const FrameScore m = evaluation.tracker.mean();
    std::printf("tracker  PSNR %.2f dB  SSIM %.4f  FLIP %.4f  coverage %.4f  (%zu frames)\n",
                m.psnr, m.ssim, m.flip, m.coverage, evaluation.tracker.frames.size());
    if (evaluation.refined) {
      const FrameScore r = evaluation.refined->mean();
      std::printf("refined  PSNR %.2f dB  SSIM %.4f  FLIP %.4f  coverage %.4f\n", r.psnr, r.ssim,
                  r.flip, r.coverage);
    }
    std::printf("%s\n", (Path(output) / "report.html").c_str());
  }
  return 0;
}

}  // namespace effigy
