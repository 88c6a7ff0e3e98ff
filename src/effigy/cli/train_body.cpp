// effigy train for bodies: a light-stage capture becomes an avatar (in effigy-learn).

#include "effigy/base/log.h"
#include "effigy/body/train_run.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/perceptual_files.h"
#include "effigy/cli/program.h"
#include "effigy/cli/training_distance.h"
#include "effigy/learn/mpi_ranks.h"

namespace effigy {
namespace {

struct BodyTrainCommand {
  std::string capture, output;
  bool json = false;
  BodyTrainSettings settings;
  BodyTrainOptions options;
};

// False when --help was asked for.
bool parse(int argc, char** argv, BodyTrainCommand& command) {
  CLI::App app(
      "Trains a body avatar on a light-stage capture. Presets: quick (networks tiny, minutes),\n"
      "standard (small, under two hours), paper (full, as long as the paper). A run that was\n"
      "interrupted goes on with --resume, bit for bit. Under mpirun or srun many processes train\n"
      "together (docs/scale.md): the batch is then that of each.\n\n"
      "example: effigy train stage-capture -o body --preset quick\n"
      "         mpirun -np 4 effigy train stage-capture -o body --preset paper --batch 1",
      "train");
  std::string preset = "standard", settings_file, size;
  std::string perceptual, models;
  std::vector<std::string> assignments;
  bool paper_literal = false;
  int iterations = 0, batch = 0, crop = 0;
  CommonOptions common;
  app.add_option("CAPTURE", command.capture, "Capture folder")->required();
  app.add_option("-o,--output", command.output, "Avatar folder to write")->required();
  app.add_option("--preset", preset, "quick, standard (default) or paper");
  app.add_flag("--paper-literal", paper_literal,
               "Every setting of docs/decisions.md on the paper's side");
  app.add_option("--size", size, "Of the networks: tiny, small or full (default: the preset's)");
  app.add_option("--iterations", iterations, "Override the preset's number of iterations");
  app.add_option("--batch", batch, "Override the preset's views a step (of each process)");
  app.add_option("--crop", crop, "Train on random squares of so many pixels");
  app.add_option("--settings", settings_file, "JSON file of settings (docs/body-training.md)");
  app.add_option("--set", assignments, "name=value of one setting; repeatable");
  app.add_option("--perceptual", perceptual,
                 "Network of a perceptual loss: vgg, alex or squeeze (LPIPS), squeezenet10, none "
                 "(default), or auto: the first that has its files (docs/body-training.md)");
  app.add_option("--models", models,
                 "Folder with the weights of --perceptual (default: $EFFIGY_DATA/perceptual)");
  app.add_flag("--resume", command.options.resume, "Go on from AVATAR's checkpoint");
  app.add_option("--consent", command.options.consent,
                 "What the person agreed to; recorded in avatar.json (default: the capture's)");
  add_common(app, common, true, true);
  if (!parse_command_line(app, argc, argv, common)) return false;
  command.json = common.json;

  BodyTrainSettings& settings = command.settings;
  settings = BodyTrainSettings::from_preset(preset);
  if (paper_literal) settings.make_paper_literal();
  settings.seed = common.seed;
  if (!settings_file.empty()) from_json_checked(read_json(settings_file), settings_file, settings);
  Json overrides = parse_assignments(assignments);
  if (perceptual.empty() && paper_literal) perceptual = "auto";
  if (!perceptual.empty()) overrides["perceptual"] = training_network(perceptual, models);
  // The paper has LPIPS where we have SSIM; the small network's features are no LPIPS.
  const bool lpips = overrides.contains("perceptual") && overrides["perceptual"] != "none" &&
                     overrides["perceptual"] != "squeezenet10";
  if (paper_literal && lpips && !overrides.contains("weight.dssim"))
    overrides["weight.dssim"] = 0.0;
  if (!size.empty()) overrides["size"] = size;
  if (iterations != 0) overrides["iterations"] = iterations;
  if (batch != 0) overrides["batch"] = batch;
  if (crop != 0) overrides["crop"] = crop;
  from_json_checked(overrides, "command line", settings);
  command.options.perceptual = training_distance(settings.perceptual, models);
  return true;
}

void train(int argc, char** argv, Ranks& ranks) {
  BodyTrainCommand command;
  StageCapture capture;
  bool wanted = false;
  if (ranks.rank() != 0) set_log_level(LogLevel::kWarning);
  together(ranks, [&] {
    wanted = parse(argc, argv, command);
    if (!wanted) return;
    from_json_checked({{"batch", command.settings.batch * ranks.size()}},
                      "the batches of all processes together", command.settings);
    capture = read_stage_capture(command.capture);
  });
  if (!wanted) return;
  const Json result = train_body(capture, command.settings, command.output, command.options, ranks);
  if (ranks.rank() != 0) return;
  if (command.json) print_json(result);
  log_info("wrote " + command.output);
}

}  // namespace

int run_train_body(int argc, char** argv) {
  const std::unique_ptr<Ranks> ranks = start_ranks();
  try {
    train(argc, argv, *ranks);
    return 0;
  } catch (const RankFailed& elsewhere) {
    return elsewhere.code();
  } catch (const std::exception&) {
    // Said once, by the process it went wrong in; the others know, or have to be ended.
    const bool known = ranks->failed() >= 0;
    const int code = complain_of_exception(!known || ranks->failed() == ranks->rank());
    if (ranks->size() > 1 && !known) ranks->abort(code);
    return code;
  }
}

}  // namespace effigy
