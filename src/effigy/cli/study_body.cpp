// effigy study body (in effigy-learn): the method beside the paper's baselines and ablations.

#include <algorithm>
#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/body/renderer.h"
#include "effigy/body/train_run.h"
#include "effigy/cli/body_evaluation.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/eval.h"
#include "effigy/cli/study_cells.h"
#include "effigy/cli/study_crops.h"
#include "effigy/cli/training_distance.h"
#include "effigy/image/metrics.h"
#include "effigy/image/resample.h"
#include "effigy/report/overlay.h"
#include "effigy/report/report.h"

namespace effigy {
namespace {

// Rows of the paper's tables, and of our own where docs/decisions.md differs.
std::vector<Cell> body_cells() {
  return {{"full", Json::object()},
          {"PBR appearance", {{"appearance", "pbr"}, {"roughness_high", 1.0}}},
          {"SH, not rotated", {{"appearance", "sh"}}},
          {"SH, rotated", {{"appearance", "sh_turned"}}},
          {"without shadow network", {{"shadow", false}}},
          {"mesh normals", {{"normals", "mesh"}}},
          {"without deferred shading", {{"deferred", false}}},
          {"1 shadow ray", {{"shadow_samples", 1}}},
          {"256 shadow rays", {{"shadow_samples", 256}}},
          {"4 shadow groups", {{"shadow_groups", 4}}},
          {"SqueezeNet features", {{"perceptual", "squeezenet10"}}},
          {"alpha products of the paper", {{"divide_by_alpha", false}}},
          {"without opacity compensation", {{"compensate", false}}},
          {"free transfer", {{"weight.transfer", 0.0}}},
          {"without pyramid loss", {{"weight.pyramid", 0.0}}}};
}

struct BodyStudyOptions {
  std::string preset = "quick";
  int iterations = 0;
  size_t views = 24;
  std::vector<std::string> only;
  uint64_t seed = 1;
};

BodyTrainSettings cell_settings(const BodyStudyOptions& options, const Cell& cell) {
  BodyTrainSettings settings = BodyTrainSettings::from_preset(options.preset);
  settings.seed = options.seed;
  Json overrides = cell.changes;
  overrides["evaluate_every"] = 0;
  if (options.iterations > 0) overrides["iterations"] = options.iterations;
  from_json_checked(overrides, "study cell '" + cell.name + "'", settings);
  return settings;
}

Json run_cell(const Cell& cell, const BodyStudyOptions& options, const StageCapture& capture,
              const PerceptualDistances& distances, const Path& folder) {
  const BodyTrainSettings settings = cell_settings(options, cell);
  const Json key = {{"settings", to_json(settings)},
                    {"views", options.views},
                    {"capture", std::filesystem::absolute(capture.folder).string()}};
  return kept_cell(folder, key, [&] {
    BodyTrainOptions train;
    train.perceptual = training_distance(settings.perceptual, "");
    train.resume = std::filesystem::exists(folder / "avatar" / "checkpoint.safetensors");
    train_body(capture, settings, folder / "avatar", train);
    BodyAvatar avatar = read_body_avatar(folder / "avatar");
    BodyEvaluationOptions evaluation;
    evaluation.most_views = options.views;
    evaluation.perceptual = distances;
    return evaluate_body(avatar, capture, evaluation).metrics();
  });
}

std::string number(const Json& metrics, const char* group, const char* field, const char* form) {
  if (!metrics.contains(group) || !metrics[group].contains(field)) return "-";
  char text[32];
  std::snprintf(text, sizeof text, form, metrics[group][field].get<double>());
  return text;
}

const std::vector<std::string> kColumns = {
    "cell",        "view PSNR dB", "light PSNR dB",   "motion PSNR dB",
    "motion SSIM", "motion FLIP",  "motion features", "environment PSNR dB"};

std::vector<std::string> table_row(const Cell& cell, const Json& metrics) {
  return {cell.name,
          number(metrics, "view", "psnr", "%.2f"),
          number(metrics, "light", "psnr", "%.2f"),
          number(metrics, "motion", "psnr", "%.2f"),
          number(metrics, "motion", "ssim", "%.4f"),
          number(metrics, "motion", "flip", "%.4f"),
          number(metrics, "motion", "feature_squeezenet10", "%.4f"),
          number(metrics, "environment", "psnr", "%.2f")};
}

// Views of held-out motion and of environments, one column a cell.
void add_pictures(Report& report, const std::vector<Cell>& cells, const StageCapture& capture,
                  const Path& output) {
  std::vector<int> frames = capture.frames_of(StageSplit::kMotion);
  const std::vector<int> relit = capture.frames_of(StageSplit::kEnvironment);
  if (frames.size() > 2) frames = {frames.front(), frames.back()};
  for (size_t k = 0; k < relit.size(); k += std::max<size_t>(1, relit.size() / 2))
    frames.push_back(relit[k]);
  std::vector<int> cameras = capture.test_cameras();
  if (cameras.empty()) cameras = capture.train_cameras();
  std::vector<std::string> columns = {"truth"};
  std::vector<ImageRow> rows;
  rows.reserve(frames.size());
  for (const int frame : frames)
    rows.push_back({format("frame {}", capture.frames[static_cast<size_t>(frame)].number), {}});
  const StageSource source(capture);
  for (const Cell& cell : cells) {
    BodyAvatar avatar = read_body_avatar(output / folder_name(cell) / "avatar");
    StageMoments moments(source, avatar.model.shadow_texels(), avatar.settings);
    BodyViewer viewer(avatar.settings, avatar.model, moments);
    columns.push_back(cell.name);
    for (size_t k = 0; k < frames.size(); ++k) {
      const DrawnView view = viewer.draw({frames[k], cameras[k % cameras.size()]});
      if (rows[k].images.empty()) rows[k].images.push_back(to_8bit(view.truth));
      rows[k].images.push_back(to_8bit(view.drawn));
    }
  }
  report.add_heading("Side by side");
  report.add_image_grid(columns, rows);
}

// Whole pixels, so that nothing is smoothed over.
Image8 enlarged(const Image8& image) {
  constexpr int kShown = 208;
  const int times = std::max(1, kShown / std::max(1, std::min(image.width, image.height)));
  Image8 out(times * image.width, times * image.height, image.channels);
  for (int y = 0; y < out.height; ++y)
    for (int x = 0; x < out.width; ++x)
      std::copy_n(image.at(x / times, y / times), image.channels, out.at(x, y));
  return out;
}

template <class Picture>
Picture part_of(const Picture& image, const PixelBox& box) {
  return cropped(image, box.x0, box.y0, box.x1 - box.x0, box.y1 - box.y0);
}

// The crop's part of a drawn view.
PixelBox box_in(const StudyCrop& crop, const StageView& view) {
  const PixelBox all{0, 0, view.image.width, view.image.height};
  if (crop.box.empty()) return all;
  PixelBox box{crop.box.x0 - view.left, crop.box.y0 - view.top, crop.box.x1 - view.left,
               crop.box.y1 - view.top};
  box.x0 = std::clamp(box.x0, 0, all.x1 - 1);
  box.y0 = std::clamp(box.y0, 0, all.y1 - 1);
  box.x1 = std::clamp(box.x1, box.x0 + 1, all.x1);
  box.y1 = std::clamp(box.y1, box.y0 + 1, all.y1);
  return box;
}

Image8 true_normals(const StageCapture& capture, const StageView& view) {
  const Image layer = capture.load_layer("normal", view.camera, view.frame);
  const Planes normals =
      to_planes(cropped(layer, view.left, view.top, view.image.width, view.image.height));
  return colour_normals(normals, 0, {view.mask.data()});
}

// Truth, the full model and the row that a crop is about, each cell's avatar read once.
void add_crops(Report& report, const std::vector<Cell>& cells, const StageCapture& capture,
               const Path& output) {
  const StageSource source(capture);
  const std::vector<StudyCrop> crops = study_crops(source);
  const bool normals =
      std::find(capture.layers.begin(), capture.layers.end(), "normal") != capture.layers.end();
  std::vector<ImageRow> rows(crops.size());
  for (const Cell& cell : cells) {
    const bool full = &cell == cells.data();
    const auto about = [&](const StudyCrop& crop) { return full || crop.other == cell.name; };
    if (std::none_of(crops.begin(), crops.end(), about)) continue;
    BodyAvatar avatar = read_body_avatar(output / folder_name(cell) / "avatar");
    StageMoments moments(source, avatar.model.shadow_texels(), avatar.settings);
    BodyViewer viewer(avatar.settings, avatar.model, moments);
    for (size_t k = 0; k < crops.size(); ++k) {
      const StudyCrop& crop = crops[k];
      if (!about(crop)) continue;
      const DrawnView drawn = viewer.draw(crop.view);
      const PixelBox box = box_in(crop, viewer.view());
      const auto show = [&](const Image8& image) {
        rows[k].images.push_back(enlarged(part_of(image, box)));
      };
      if (full) {
        rows[k].caption = format("{}, frame {}, camera {}", crop.name,
                                 capture.frames[static_cast<size_t>(crop.view.frame)].number,
                                 capture.cameras[static_cast<size_t>(crop.view.camera)].name);
        if (!crop.normals)
          show(to_8bit(drawn.truth));
        else if (normals)
          show(true_normals(capture, viewer.view()));
        else
          rows[k].images.emplace_back();
      }
      show(crop.normals ? view_body_buffer(viewer.picture(), "normal") : to_8bit(drawn.drawn));
      rows[k].caption += format("; {}", full ? "full" : cell.name);
      if (!crop.normals)
        rows[k].caption +=
            format(" {:.1f} dB", psnr(part_of(drawn.drawn, box), part_of(drawn.truth, box)));
    }
  }
  if (rows.empty()) return;
  report.add_heading("Close up");
  report.add_paragraph(
      "On held-out cameras in unseen motion: of the views there are, the one that shows each part "
      "large, from the front and lit. Pixels are not smoothed.");
  report.add_image_grid({"truth", "full", "the other row"}, rows);
}

}  // namespace

int run_study_body(int argc, char** argv, const PerceptualDistances& distances) {
  CLI::App app(
      "Trains a body avatar in full, with the paper's baselines (PBR, spherical harmonics) and "
      "with\n"
      "each of its parts changed, scores each, and prints the table. Cells that are done are "
      "kept;\n"
      "an interrupted study goes on where it was.\n\n"
      "example: effigy synth body --stage tiny --relight studio sunset -o stage && effigy study "
      "body "
      "stage -o study",
      "study");
  std::string name, capture_path, output;
  bool list = false;
  BodyStudyOptions options;
  CommonOptions common;
  app.add_option("NAME", name, "body")->required()->check(CLI::IsMember({"body"}));
  app.add_option("CAPTURE", capture_path, "A light-stage capture (effigy synth body)");
  app.add_option("-o,--output", output, "Folder for the cells, study.json and report.html");
  app.add_option("--preset", options.preset, "quick (default), standard or paper");
  app.add_option("--iterations", options.iterations, "Override the preset's iterations");
  app.add_option("--views", options.views, "Views scored of each group (default 24; 0: all)");
  app.add_option("--cell", options.only, "Only this cell (and 'full'); repeatable");
  app.add_flag("--list", list, "Only print the names of the cells");
  add_common(app, common, true, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  options.seed = common.seed;
  if (list) {
    for (const Cell& cell : body_cells()) std::printf("%s\n", cell.name.c_str());
    return 0;
  }
  if (capture_path.empty() || output.empty())
    throw Error("study wants a CAPTURE and -o FOLDER; see 'effigy study body --help'.");
  const StageCapture capture = read_stage_capture(capture_path);
  std::vector<Cell> cells = chosen_cells(body_cells(), options.only, "effigy study body --list");
  // Without the user's weights that row is left out, unless it was asked for.
  if (options.only.empty() && find_perceptual({}).squeezenet10.empty())
    std::erase_if(cells, [](const Cell& cell) { return cell.changes.contains("perceptual"); });
  const Path out = output;
  make_folder(out);
  Json study = Json::object();
  std::vector<std::vector<std::string>> rows;
  for (const Cell& cell : cells) {
    log_info("cell: " + cell.name);
    study[cell.name] = run_cell(cell, options, capture, distances, out / folder_name(cell));
    rows.push_back(table_row(cell, study[cell.name]));
    write_json(out / "study.json", study);
  }
  Report report("Body study", capture.source);
  report.add_table(kColumns, rows,
                   "On cameras that were held out; on the bounding box of the body. Features: "
                   "feature_squeezenet10, where its weights are found.");
  add_crops(report, cells, capture, out);
  add_pictures(report, cells, capture, out);
  report.add_heading("Settings");
  report.add_code(to_json(cell_settings(options, cells.front())).dump(2));
  report.write(out / "report.html");
  if (common.json) {
    print_json(study);
    return 0;
  }
  std::string line = "|";
  for (const std::string& column : kColumns) line += " " + column + " |";
  std::printf("%s\n|%s\n", line.c_str(),
              [&] {
                std::string rule;
                for (size_t k = 0; k < kColumns.size(); ++k) rule += "---|";
                return rule;
              }()
                  .c_str());
  for (const std::vector<std::string>& row : rows) {
    line = "|";
    for (const std::string& cell : row) line += " " + cell + " |";
    std::printf("%s\n", line.c_str());
  }
  std::printf("%s\n", (out / "report.html").c_str());
  return 0;
}

}  // namespace effigy
