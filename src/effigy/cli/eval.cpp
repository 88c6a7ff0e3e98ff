// effigy eval: metrics and a report of an avatar on a capture.

#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/eval.h"
#include "effigy/cli/family.h"
#include "effigy/cli/program.h"

namespace effigy {

namespace {

// "  LPIPS (vgg) 0.1234  feature_squeezenet10 0.0456": what was measured of the two.
std::string distances_line(const FrameScore& mean, const std::string& net) {
  std::string line;
  for (const auto& [name, value] : mean.distances) {
    if (name == "lpips") line += format("  LPIPS ({}) {:.4f}", net, value);
    if (name == "feature_squeezenet10") line += format("  {} {:.4f}", name, value);
  }
  return line;
}

}  // namespace

void add_perceptual_options(CLI::App& app, PerceptualOptions& perceptual) {
  app.add_option("--models", perceptual.models,
                 "Folder with perceptual weights (default: $EFFIGY_DATA/perceptual)");
  app.add_option("--lpips", perceptual.lpips,
                 "Network of LPIPS: vgg, alex, squeeze or none (default: the first whose files are "
                 "there)")
      ->check(CLI::IsMember({"auto", "vgg", "alex", "squeeze", "none"}));
  app.add_option("--lpips-backbone", perceptual.backbone,
                 "torchvision's weights for --lpips, a .pth file");
  app.add_option("--lpips-heads", perceptual.heads,
                 "The lpips package's heads for --lpips, a .pth file");
}

void add_shard_options(CLI::App& app, ShardOptions& options) {
  app.add_option("--shard", options.shard,
                 "i/n: score only every n-th frame, starting with the i-th (0-based), into "
                 "OUTPUT/shards");
  app.add_flag("--merge", options.merge,
               "Score nothing: put the shards in OUTPUT/shards together, as if not split");
}

Shard ShardOptions::parse() const {
  if (merge && !shard.empty())
    throw Error("--merge puts all shards together; give it without --shard.");
  return parse_shard(shard);
}

int evaluate_command(int argc, char** argv, const DistanceSource& source) {
  CLI::App app(
      "Scores an avatar on a capture's held-out frames and writes metrics.json and report.html.\n"
      "Protocols: tracker (tracking alone), tracked (as the avatar's encoder corrects it; nothing "
      "fitted\n"
      "to the test image) and refined (pose and expression fitted, avatar frozen). LPIPS and "
      "feature_squeezenet10 where their weights are found (--models, "
      "else "
      "$EFFIGY_DATA/perceptual;\n"
      "docs/evaluation.md says which files); LPIPS is left out, and said to be, without them.\n\n"
      "example: effigy eval anna anna-capture -o anna-eval\n"
      "         effigy eval anna anna-capture -o anna-eval --shard 0/8   (docs/scale.md)",
      "eval");
  std::string avatar_path, capture_path, output, protocol = "all";
  EvaluationOptions options;
  PerceptualOptions perceptual;
  ShardOptions shards;
  CommonOptions common;
  app.add_option("AVATAR", avatar_path, "Avatar folder")->required();
  app.add_option("CAPTURE", capture_path, "Capture folder")->required();
  app.add_option("-o,--output", output, "Folder for metrics.json and report.html")->required();
  app.add_option("--protocol", protocol,
                 "tracker or tracked (both are scored), refined or all (default)")
      ->check(CLI::IsMember({"tracker", "tracked", "refined", "all"}));
  app.add_option("--refine-steps", options.refine_steps,
                 "Steps of the protocol refined (default 60)")
      ->check(CLI::Range(1, 1000));
  app.add_option("--frames", options.most_frames, "Score at most this many frames, evenly spread")
      ->check(at_least(1));
  app.add_option("--light", options.lights,
                 "Lights of the report's relit rows (names or HDR/EXR files)")
      ->delimiter(',');
  add_shard_options(app, shards);
  add_perceptual_options(app, perceptual);
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  options.refined = protocol == "all" || protocol == "refined";

  options.shard = shards.parse();
  PerceptualFiles files;
  if (!shards.merge) files = find_perceptual(perceptual);
  if (files.any() && !source) {
    if (can_hand_over()) return hand_over(argc, argv);
    files = {};
    files.note = "left out: effigy-learn, which runs the network, is not built";
  }
  options.perceptual.lpips_note = files.note;
  if (files.any()) options.perceptual = source(files);

  const HeadAvatar avatar = read_head_avatar(avatar_path);
  const Capture capture = read_capture(capture_path);
  Evaluation evaluation = shards.merge ? merge_shards(avatar, capture, avatar_path, output)
                                       : score_frames(avatar, capture, options);
  if (!options.shard.whole()) {
    write_evaluation_shard(evaluation, options, capture, avatar_path, output);
    return 0;
  }
  score_as_a_whole(avatar, capture, evaluation);
  write_evaluation(evaluation, avatar, capture, avatar_path, options, output);
  if (common.json) {
    print_json(evaluation.metrics());
  } else {
    const std::string& net = evaluation.lpips_net;
    const auto print = [&](const char* name, const FrameScore& m) {
      std::printf("%s  PSNR %.2f dB  SSIM %.4f  FLIP %.4f%s  coverage %.4f\n", name, m.psnr, m.ssim,
                  m.flip, distances_line(m, net).c_str(), m.coverage);
    };
    std::printf("%zu frames\n", evaluation.frames.size());
    print(evaluation.tracked_name.c_str(), evaluation.tracked.mean());
    print("tracker", evaluation.tracker.mean());
    if (evaluation.refined) print("refined", evaluation.refined->mean());
    if (net.empty()) std::printf("LPIPS %s\n", evaluation.lpips_note.c_str());
    std::printf("%s\n", (Path(output) / "report.html").c_str());
  }
  return 0;
}

int run_eval(int argc, char** argv) {
  if (names_avatar(argc, argv, "body")) return hand_over(argc, argv);
  return evaluate_command(argc, argv, {});
}

}  // namespace effigy
