// effigy study: the system with and without each of its parts, cell by cell.

#include <cstdio>
#include <optional>

#include "effigy/base/log.h"
#include "effigy/capture/capture.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/evaluation.h"
#include "effigy/cli/program.h"
#include "effigy/cli/study_cells.h"
#include "effigy/head/trainer.h"
#include "effigy/report/report.h"

namespace effigy {
namespace {

// Every loss and prior that GTAvatar or docs/decisions.md adds, taken away one at a time.
std::vector<Cell> relight_cells() {
  std::vector<Cell> cells = {{"all", Json::object()}};
  const auto without = [&cells](const std::string& name, const Json& changes) {
    cells.push_back({"without " + name, changes});
  };
  without("SSIM", {{"weight.dssim", 0.0}});
  without("mask loss", {{"weight.mask", 0.0}});
  without("roughness/F0 smoothness", {{"weight.smooth", 0.0}});
  without("normal-map regulariser", {{"weight.normal_map", 0.0}});
  without("normal consistency", {{"weight.normal_consistency", 0.0}});
  without("UV distortion", {{"uv_distortion", "off"}});
  without("texture boundary", {{"weight.boundary", 0.0}});
  without("barycentric loss", {{"weight.barycentric", 0.0}});
  without("Laplacian", {{"weight.laplacian", 0.0}});
  without("rig regulariser", {{"weight.rig", 0.0}});
  without("expression loss", {{"weight.expression", 0.0}});
  without("material prior", {{"weight.material_prior", 0.0}});
  without("albedo prior", {{"weight.albedo_prior", 0.0}});
  without("start light", {{"start_light", false}});
  without("start from frames", {{"start_from_frames", false}});
  without("rig refinement", {{"refine_rig", false}});
  without("pose refinement", {{"refine_pose", false}, {"refine_expression", false}});
  return cells;
}

struct StudyOptions {
  std::string preset = "quick";
  int iterations = 0, surfels = 0, texture_size = 0, frames = 0;
  std::vector<std::string> only;  // names of cells; empty: all
  uint64_t seed = 1;
};

TrainSettings cell_settings(const StudyOptions& options, const Cell& cell) {
  TrainSettings settings = TrainSettings::from_preset(options.preset);
  settings.seed = options.seed;
  Json overrides = cell.changes;
  overrides["evaluate_every"] = 0;
  if (options.iterations > 0) {
    overrides["iterations"] = options.iterations;
    // Parts that start later do so at the same share of a shorter study.
    overrides["uv_distortion_start"] = static_cast<int>(int64_t{settings.uv_distortion_start} *
                                                        options.iterations / settings.iterations);
  }
  if (options.surfels > 0) overrides["surfels"] = options.surfels;
  if (options.texture_size > 0) overrides["texture_size"] = options.texture_size;
  from_json_checked(overrides, "study cell '" + cell.name + "'", settings);
  return settings;
}

// The cell's metrics: from disk where the same settings were scored before on the same capture,
// else trained (going on from a checkpoint) and scored.
Json run_cell(const Cell& cell, const StudyOptions& options, const Capture& capture,
              const Path& folder) {
  const TrainSettings settings = cell_settings(options, cell);
  const Json key = {{"settings", to_json(settings)},
                    {"frames", options.frames},
                    {"capture", std::filesystem::absolute(capture.folder).string()}};
  return kept_cell(folder, key, [&] {
    TrainOptions train;
    train.resume = std::filesystem::exists(folder / "avatar" / "checkpoint.safetensors");
    train_head(capture, settings, folder / "avatar", train);
    EvaluationOptions evaluation;
    evaluation.refined = false;
    evaluation.most_frames = options.frames;
    return evaluate_avatar(read_head_avatar(folder / "avatar"), capture, evaluation).metrics();
  });
}

double mean_relit(const Json& metrics, const char* field) {
  double sum = 0;
  const Json& lights = metrics.at("relight");
  for (const auto& [name, scores] : lights.items()) sum += scores.at(field).get<double>();
  return sum / static_cast<double>(std::max<size_t>(1, lights.size()));
}

// A cell of the table, or a dash where the capture does not know the truth.
std::string number(const Json& metrics, const char* field, const char* form) {
  if (!metrics.contains(field) || !metrics[field].is_number()) return "-";
  char text[32];
  std::snprintf(text, sizeof text, form, metrics[field].get<double>());
  return text;
}

const std::vector<std::string> kColumns = {
    "cell",         "relit PSNR dB",   "change",         "held-out PSNR dB", "SSIM",
    "albedo error", "roughness error", "normal degrees", "light error"};

std::vector<std::string> table_row(const Cell& cell, const Json& metrics, const Json& all) {
  const double relit = mean_relit(metrics, "psnr_aligned");
  return {cell.name,
          format("{:.2f}", relit),
          format("{:+.2f}", relit - mean_relit(all, "psnr_aligned")),
          number(metrics, "psnr", "%.2f"),
          number(metrics, "ssim", "%.4f"),
          number(metrics, "albedo_error", "%.4f"),
          number(metrics, "roughness_error", "%.3f"),
          number(metrics, "normal_degrees", "%.1f"),
          number(metrics, "environment_error", "%.3f")};
}

void write_study_report(const std::vector<std::vector<std::string>>& rows, const Capture& capture,
                        const StudyOptions& options, const Json& all, const Path& path) {
  Report report("Relighting study", capture.folder.filename().string());
  report.add_metric_tiles(
      {{"Relit PSNR", format("{:.2f}", mean_relit(all, "psnr_aligned")), "dB", "all parts"},
       {"Left unlit", format("{:.2f}", mean_relit(all, "psnr_unlit")), "dB",
        "the same frames in the training light"}});
  report.add_heading("With and without each part");
  report.add_table(kColumns, rows,
                   "Relit: mean over the capture's lights, after the one global scale that albedo "
                   "and light leave free. Change: against all parts; positive means that the part "
                   "makes relighting worse.");
  report.add_heading("Settings");
  report.add_code(to_json(cell_settings(options, {"all", Json::object()})).dump(2));
  report.write(path);
}

}  // namespace

int run_study(int argc, char** argv) {
  if (argc > 1 && std::string(argv[1]) == "body") return hand_over(argc, argv);
  CLI::App app(
      "Runs a study: relight trains the head system with and without each of its losses and "
      "priors\n"
      "on a synthetic capture, scores each under the capture's other lights, and prints the "
      "table.\n"
      "Cells that are done are kept; an interrupted study goes on where it was. The same for "
      "bodies\n"
      "and the paper's baselines: effigy study body --help.\n\n"
      "example: effigy synth head -o truth && effigy study relight truth -o study",
      "study");
  std::string name, capture_path, output;
  bool list = false;
  StudyOptions options;
  CommonOptions common;
  app.add_option("NAME", name, "relight")->required()->check(CLI::IsMember({"relight"}));
  app.add_option("CAPTURE", capture_path, "A capture with relighting truth (effigy synth head)");
  app.add_option("-o,--output", output, "Folder for the cells, study.json and report.html");
  app.add_option("--preset", options.preset, "quick (default), standard or paper");
  app.add_option("--iterations", options.iterations, "Override the preset's iterations");
  app.add_option("--surfels", options.surfels, "Override the preset's number of surfels");
  app.add_option("--texture-size", options.texture_size, "Override the preset's texture size");
  app.add_option("--frames", options.frames, "Score at most this many held-out frames")
      ->check(at_least(1));
  app.add_option("--cell", options.only, "Only this cell (and 'all'); repeatable");
  app.add_flag("--list", list, "Only print the names of the cells");
  add_common(app, common, true, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  options.seed = common.seed;
  if (list) {
    for (const Cell& cell : relight_cells()) std::printf("%s\n", cell.name.c_str());
    return 0;
  }
  if (capture_path.empty() || output.empty())
    throw Error("study wants a CAPTURE and -o FOLDER; see 'effigy study --help'.");
  const Capture capture = read_capture(capture_path);
  if (relight_sets(capture).empty())
    throw Error(capture_path +
                ": holds no frames under other lights; make one with 'effigy synth "
                "head'.");

  const std::vector<Cell> cells =
      chosen_cells(relight_cells(), options.only, "effigy study relight --list");
  std::vector<std::vector<std::string>> rows;
  Json result = {{"cells", Json::array()}}, all;
  for (size_t i = 0; i < cells.size(); ++i) {
    log_info(format("cell {} of {}: {}", i + 1, cells.size(), cells[i].name));
    const Json metrics =
        run_cell(cells[i], options, capture, Path(output) / "cells" / folder_name(cells[i]));
    if (i == 0) all = metrics;
    rows.push_back(table_row(cells[i], metrics, all));
    result["cells"].push_back(
        {{"name", cells[i].name}, {"changes", cells[i].changes}, {"metrics", metrics}});
    if (common.json) continue;
    if (i == 0) std::printf("%-34s %9s %7s %9s\n", "cell", "relit dB", "change", "held-out");
    std::printf("%-34s %9s %7s %9s\n", rows[i][0].c_str(), rows[i][1].c_str(), rows[i][2].c_str(),
                rows[i][3].c_str());
    std::fflush(stdout);
  }
  write_json(Path(output) / "study.json", result);
  write_study_report(rows, capture, options, all, Path(output) / "report.html");
  if (common.json)
    print_json(result);
  else
    std::printf("%s\n", (Path(output) / "report.html").c_str());
  return 0;
}

}  // namespace effigy
