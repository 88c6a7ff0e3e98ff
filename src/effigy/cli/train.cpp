// effigy train: a capture becomes an avatar.

#include "effigy/base/log.h"
#include "effigy/capture/capture.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/family.h"
#include "effigy/cli/program.h"
#include "effigy/head/trainer.h"
#include "effigy/learn/ranks.h"

namespace effigy {

int run_train(int argc, char** argv) {
  if (names_capture(argc, argv, "body")) return hand_over(argc, argv);
  CLI::App app(
      "Trains an avatar on a capture. Presets: quick (minutes), standard (about an hour), paper "
      "(the\n"
      "paper's length). A run that was interrupted goes on with --resume, bit for bit. Options of\n"
      "light-stage captures of bodies: effigy train CAPTURE --help.\n\n"
      "example: effigy train anna-capture -o anna --preset quick",
      "train");
  std::string capture_path, output, preset = "standard", settings_file;
  std::vector<std::string> assignments;
  bool paper_literal = false;
  int iterations = 0, surfels = 0, texture_size = 0;
  TrainOptions options;
  CommonOptions common;
  app.add_option("CAPTURE", capture_path, "Capture folder")->required();
  app.add_option("-o,--output", output, "Avatar folder to write")->required();
  app.add_option("--preset", preset, "quick, standard (default) or paper");
  app.add_flag("--paper-literal", paper_literal,
               "Every setting of docs/decisions.md on the paper's side");
  app.add_option("--iterations", iterations, "Override the preset's number of iterations");
  app.add_option("--surfels", surfels, "Override the preset's number of surfels");
  app.add_option("--texture-size", texture_size, "Override the preset's texture size");
  app.add_option("--settings", settings_file, "JSON file of settings (docs/training.md)");
  app.add_option("--set", assignments, "name=value of one setting; repeatable");
  app.add_flag("--resume", options.resume, "Go on from AVATAR's checkpoint");
  app.add_option("--consent", options.consent,
                 "What the person agreed to; recorded in avatar.json (default: the capture's)");
  add_common(app, common, true, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;

  if (job_size() > 1)
    throw Error("Heads are trained by one process; start it without mpirun or srun.");
  TrainSettings settings = TrainSettings::from_preset(preset);
  if (paper_literal) settings.make_paper_literal();
  settings.seed = common.seed;
  if (!settings_file.empty()) from_json_checked(read_json(settings_file), settings_file, settings);
  Json overrides = parse_assignments(assignments);
  if (iterations != 0) overrides["iterations"] = iterations;
  if (surfels != 0) overrides["surfels"] = surfels;
  if (texture_size != 0) overrides["texture_size"] = texture_size;
  from_json_checked(overrides, "command line", settings);

  const Capture capture = read_capture(capture_path);
  const Json result = train_head(capture, settings, output, options);
  if (common.json) print_json(result);
  log_info("wrote " + output);
  return 0;
}

}  // namespace effigy
