// effigy eval of a body avatar.

#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/cli/body_evaluation.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/eval.h"

namespace effigy {
namespace {

void print_scores(const BodyEvaluation& evaluation) {
  for (const ViewGroup& group : evaluation.groups) {
    const BodyScore m = group.mean();
    std::printf("%-12s PSNR %.2f dB  SSIM %.4f  FLIP %.4f", group.name.c_str(), m.psnr, m.ssim,
                m.flip);
    for (const auto& [name, value] : group.mean_distances())
      std::printf("  %s %.4f", name.c_str(), value);
    if (evaluation.left_lit)
      std::printf("  left fully lit %.2f dB", group.mean(&ViewScores::unlit).psnr);
    std::printf("  one colour %.2f dB  (%zu views)\n", group.mean(&ViewScores::flat).psnr,
                group.views.size());
  }
  for (const auto& [light, s] : evaluation.relight)
    std::printf("  %-10s PSNR %.2f dB  SSIM %.4f  after a scale of %.3f: %.2f dB, %.4f\n",
                light.c_str(), s.psnr, s.ssim, s.scale, s.psnr_aligned, s.ssim_aligned);
}

}  // namespace

int evaluate_body_command(int argc, char** argv, const DistanceSource& source) {
  CLI::App app(
      "Scores a body avatar on what its capture holds out: cameras, lights, motion, environments;\n"
      "writes metrics.json and report.html. LPIPS and feature_squeezenet10 where their weights "
      "are\n"
      "found (--models, else $EFFIGY_DATA/perceptual; docs/evaluation.md).\n\n"
      "example: effigy eval body stage-capture -o body-eval\n"
      "         effigy eval body stage-capture -o body-eval --shard 0/8   (docs/scale.md)",
      "eval");
  std::string avatar_path, capture_path, output;
  ShardOptions shards;
  BodyEvaluationOptions options;
  PerceptualOptions perceptual;
  CommonOptions common;
  app.add_option("AVATAR", avatar_path, "Avatar folder")->required();
  app.add_option("CAPTURE", capture_path, "Capture folder")->required();
  app.add_option("-o,--output", output, "Folder for metrics.json and report.html")->required();
  app.add_option("--views", options.most_views,
                 "Views scored of each group, evenly spread (default 48; 0: all)");
  add_shard_options(app, shards);
  add_perceptual_options(app, perceptual);
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;

  options.shard = shards.parse();
  const PerceptualFiles files = find_perceptual(perceptual);
  options.perceptual.lpips_note = files.note;
  if (files.any() && !shards.merge) options.perceptual = source(files);
  BodyAvatar avatar = read_body_avatar(avatar_path);
  const StageCapture capture = read_stage_capture(capture_path);
  if (!options.shard.whole()) {
    write_body_shard(score_body_views(avatar, capture, options), options, capture, avatar_path,
                     output);
    return 0;
  }
  const BodyEvaluation evaluation = shards.merge
                                        ? merge_body_shards(avatar, capture, avatar_path, output)
                                        : evaluate_body(avatar, capture, options);
  write_body_evaluation(evaluation, avatar, capture, avatar_path, output);
  if (common.json) {
    print_json(evaluation.metrics());
    return 0;
  }
  print_scores(evaluation);
  std::printf("%s\n", (Path(output) / "report.html").c_str());
  return 0;
}

}  // namespace effigy
