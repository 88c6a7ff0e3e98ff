// report.html of an evaluation.

#include <algorithm>
#include <cmath>

#include "effigy/avatar/renderer.h"
#include "effigy/avatar/textures.h"
#include "effigy/base/log.h"
#include "effigy/cli/evaluation.h"
#include "effigy/cli/render_settings.h"
#include "effigy/cli/training_plots.h"
#include "effigy/image/files.h"
#include "effigy/report/overlay.h"
#include "effigy/report/report.h"

namespace effigy {
namespace {

constexpr int kFramesShown = 5, kRelitShown = 3;
constexpr const char* kUnitRange = "lpips_unit_range";

std::vector<size_t> spread_indices(size_t count, size_t most) {
  std::vector<size_t> picked;
  const size_t n = std::min(count, most);
  for (size_t i = 0; i < n; ++i) picked.push_back(i * count / n + count / (2 * n));
  return picked;
}

Image8 as_8bit(const Planes& planes) {
  return to_8bit(to_image(planes));
}

Image8 masked_input(const Capture& capture, int frame) {
  TargetFrame target;
  FrameStore(capture, 0).load(frame, target);
  return as_8bit(target.image);
}

class EvaluationReport {
 public:
  EvaluationReport(const Evaluation& evaluation, const HeadAvatar& avatar, const Capture& capture,
                   const EvaluationOptions& options, const Path& avatar_folder)
      : e_(evaluation),
        avatar_(avatar),
        capture_(capture),
        options_(options),
        folder_(avatar_folder),
        renderer_(avatar),
        report_("Avatar report", avatar_folder.filename().string() + ", " +
                                     std::to_string(evaluation.frames.size()) +
                                     " held-out frames") {}

  void write(const Path& path) {
    scores();
    reconstruction();
    relighting();
    editing();
    views();
    curves();
    settings();
    report_.write(path);
  }

 private:
  void scores() {
    const FrameScore m = e_.tracked.mean();
    std::vector<MetricTile> tiles = {
        {"PSNR", format("{:.2f}", m.psnr), "dB", "whole frame, higher is better"},
        {"SSIM", format("{:.4f}", m.ssim), "", "higher is better"},
        {"FLIP", format("{:.4f}", m.flip), "", "lower is better"}};
    for (const auto& [name, value] : m.distances)
      if (name != kUnitRange)
        tiles.push_back({distance_title(name), format("{:.4f}", value), "", "lower is better"});
    tiles.push_back({"Coverage", format("{:.4f}", m.coverage), "", "alpha inside the matte"});
    report_.add_metric_tiles(tiles);
    report_.add_heading("Scores");
    std::vector<std::vector<std::string>> rows = {row(e_.tracked_name, m),
                                                  row("tracker", e_.tracker.mean())};
    if (e_.refined) rows.push_back(row("refined", e_.refined->mean()));
    std::vector<std::string> columns = {"protocol", "PSNR dB", "PSNR head dB", "SSIM", "FLIP"};
    for (const auto& [name, value] : m.distances) columns.push_back(distance_title(name));
    columns.emplace_back("coverage");
    report_.add_table(columns, rows,
                      e_.tracked_name +
                          ": parameters from tracking, as the avatar's encoder corrects them; "
                          "tracker: from tracking alone; nothing is fitted to the test image. "
                          "refined: pose and expression fitted to the test image, the avatar "
                          "frozen.");
    report_.add_paragraph("Frames are 8-bit on black, scored over the whole frame. " +
                          distance_note(m));
    LinePlot plot{"PSNR by frame", "frame", "dB", {}, false, false};
    plot.series.push_back(series(e_.tracked_name, e_.tracked));
    plot.series.push_back(series("tracker", e_.tracker));
    if (e_.refined) plot.series.push_back(series("refined", *e_.refined));
    report_.add_line_plot(plot);
  }

  static std::vector<std::string> row(const std::string& name, const FrameScore& s) {
    std::vector<std::string> cells = {name, format("{:.2f}", s.psnr),
                                      format("{:.2f}", s.psnr_foreground), format("{:.4f}", s.ssim),
                                      format("{:.4f}", s.flip)};
    for (const auto& [distance, value] : s.distances) cells.push_back(format("{:.4f}", value));
    cells.push_back(format("{:.4f}", s.coverage));
    return cells;
  }

  std::string distance_title(const std::string& name) const {
    if (name == "lpips") return "LPIPS (" + e_.lpips_net + ")";
    if (name == kUnitRange) return "LPIPS, [0, 1] input";
    return name == "feature_squeezenet10" ? "SqueezeNet 1.0 features" : name;
  }

  std::string distance_note(const FrameScore& mean) const {
    std::string note = e_.lpips_net.empty() ? "LPIPS is " + e_.lpips_note +
                                                  " (docs/evaluation.md says which files it needs)."
                                            : "LPIPS, [0, 1] input: without the step to [-1, 1], a "
                                              "slip of much of the literature, only for "
                                              "comparison with it.";
    if (mean.distances.count("feature_squeezenet10") != 0)
      note += " SqueezeNet 1.0 features: unweighted; not to be compared with LPIPS.";
    return note;
  }

  Series series(const std::string& name, const ProtocolScores& scores) const {
    Series s{name, {}, {}};
    for (const FrameScore& f : scores.frames) {
      s.xs.push_back(static_cast<double>(capture_.frames[f.frame].number));
      s.ys.push_back(f.psnr);
    }
    return s;
  }

  void reconstruction() {
    report_.add_heading("Reconstruction");
    std::vector<ImageRow> rows;
    for (size_t i : spread_indices(e_.frames.size(), kFramesShown)) {
      const int frame = e_.frames[i];
      renderer_.set_pose(e_.tracked.poses[i]);
      const Image8 input = masked_input(capture_, frame);
      const Image8 render = as_8bit(renderer_.draw(capture_.camera));
      ImageRow shown{
          format("frame {}, {:.1f} dB", capture_.frames[frame].number, e_.tracked.frames[i].psnr),
          {input, render, colour_difference(input, render)}};
      for (const char* buffer : {"albedo", "mapped_normal", "roughness", "uv"})
        shown.images.push_back(view_buffer(renderer_.gbuffer(), buffer));
      rows.push_back(std::move(shown));
    }
    report_.add_image_grid(
        {"input", "avatar", "difference (x5)", "albedo", "normals", "roughness", "UV"}, rows);
  }

  void relighting() {
    report_.add_heading("Relighting");
    if (!e_.relight.empty()) {
      std::vector<std::vector<std::string>> rows;
      for (const auto& [name, s] : e_.relight)
        rows.push_back({name, format("{:.2f}", s.psnr), format("{:.4f}", s.ssim),
                        format("{:.2f}", s.psnr_aligned), format("{:.4f}", s.ssim_aligned),
                        format("{:.3f}", s.scale), format("{:.2f}", s.psnr_unlit)});
      report_.add_table(
          {"light", "PSNR dB", "SSIM", "PSNR aligned dB", "SSIM aligned", "scale",
           "PSNR left unlit dB"},
          rows,
          "Against the synthetic truth. Aligned: after the one global scale that the "
          "albedo/light ambiguity leaves free. Left unlit: the same frames in the training "
          "light, aligned: what doing nothing scores.");
      truth_grid();
    }
    if (e_.truth) {
      const TruthScores& t = *e_.truth;
      report_.add_table(
          {"against the truth", "error"},
          {{"albedo, sRGB, one scale per frame", format("{:.4f}", t.surface.albedo_error)},
           {"roughness", format("{:.3f}", t.surface.roughness_error)},
           {"F0", format("{:.3f}", t.surface.specular_error.value_or(0))},
           {"normals, degrees", format("{:.1f}", t.surface.normal_degrees)},
           {"depth, mm", format("{:.2f}", t.surface.depth_error_mm)},
           {"light, share of its irradiance, one scale", format("{:.3f}", t.environment_error)}},
          "Mean absolute differences where truth and avatar cover the whole pixel.");
    } else if (e_.albedo_error) {
      report_.add_paragraph(format(
          "Albedo error (mean absolute, sRGB, one scale per image): {:.4f}.", *e_.albedo_error));
    }
    std::vector<std::string> columns;
    std::vector<ImageRow> rows(std::min<size_t>(kRelitShown, e_.frames.size()));
    const auto picked = spread_indices(e_.frames.size(), kRelitShown);
    for (const std::string& name : options_.lights) {
      columns.push_back(Path(name).stem().string());
      renderer_.set_light(load_light(name, 0, "auto", avatar_.environment));
      for (size_t k = 0; k < picked.size(); ++k) {
        renderer_.set_pose(e_.tracked.poses[picked[k]]);
        rows[k].caption = format("frame {}", capture_.frames[e_.frames[picked[k]]].number);
        rows[k].images.push_back(as_8bit(renderer_.draw(capture_.camera)));
      }
    }
    report_.add_image_grid(columns, rows);
    renderer_.set_light(own_light());
  }

  void truth_grid() {
    std::vector<ImageRow> rows;
    for (const RelightSet& set : relight_sets(capture_)) {
      if (set.images.empty()) continue;
      const auto& [frame, path] =
          *std::next(set.images.begin(), static_cast<std::ptrdiff_t>(set.images.size() / 2));
      renderer_.set_light(prefilter_environment(read_environment(capture_.folder / set.light), 0,
                                                e_.relight.at(set.name).scale));
      renderer_.set_pose(tracked_pose(avatar_, capture_, frame));
      const Image8 truth = read_image8(capture_.folder / path);
      const Image8 render = as_8bit(renderer_.draw(capture_.camera));
      rows.push_back({set.name, {truth, render, colour_difference(truth, render)}});
    }
    report_.add_image_grid({"truth", "avatar, relit", "difference (x5)"}, rows);
    renderer_.set_light(own_light());
  }

  void editing() {
    report_.add_heading("Repainted");
    report_.add_paragraph(
        "A checker over the whole albedo atlas: straight, sharp squares that follow the face mean "
        "that "
        "textures can be painted on.");
    report_.add_paragraph(format(
        "Measured over {} corners in these and other views: corners lie {:.2f} px (median) and "
        "{:.2f} px (95 %) from where the rig's surface has their UV; edges rise from 10 to 90 % in "
        "{:.2f} px.",
        e_.edit.corners, e_.edit.corner_error_median, e_.edit.corner_error_p95,
        e_.edit.edge_width_median));
    HeadAvatar edited = avatar_;
    edited.material = paint_checker(avatar_.material, 24);
    HeadRenderer renderer(edited);
    ImageRow row{"checker", {}};
    for (size_t i : spread_indices(e_.frames.size(), 4)) {
      renderer.set_pose(e_.tracked.poses[i]);
      row.images.push_back(as_8bit(renderer.draw(capture_.camera)));
    }
    report_.add_image_grid({}, {row});
    const MaterialImages maps = to_images(avatar_.material);
    report_.add_image_grid({"albedo", "roughness", "specular F0", "normal"},
                           {{"textures",
                             {to_8bit(maps.albedo), to_8bit(maps.roughness), to_8bit(maps.specular),
                              to_8bit(maps.normal)}}});
  }

  void views() {
    report_.add_heading("New views");
    renderer_.set_pose(e_.tracked.poses[e_.frames.size() / 2]);
    const Vec3d center = head_center(renderer_.vertices());
    ImageRow row{"orbit", {}};
    std::vector<std::string> columns;
    for (int degrees : {-60, -30, 0, 30, 60}) {
      columns.push_back(format("{}°", degrees));
      row.images.push_back(
          as_8bit(renderer_.draw(orbit_camera(capture_.camera, center, degrees * 0.0174533, 0))));
    }
    report_.add_image_grid(columns, {row});
    report_.add_subheading("Learned light");
    Image light = equirectangular_from_cubemap(avatar_.environment, 256, 128);
    for (float& v : light.data) v = srgb_from_linear(v / (1 + v));
    report_.add_image(to_8bit(light), "environment.exr, Reinhard-compressed", {.width = 384});
  }

  void curves() {
    const Path file = folder_ / "training.json";
    if (!std::filesystem::exists(file)) return;
    report_.add_heading("Training");
    add_training_plots(report_, read_json(file),
                       {"l1", "dssim", "mask", "normal_consistency", "uv_distortion"}, "tracker",
                       {{"evaluation", format("{:.0f} s", e_.seconds)}});
  }

  void settings() {
    report_.add_heading("Settings and provenance");
    add_provenance(
        report_, avatar_.info,
        {{"surfels", std::to_string(avatar_.surfels.count())},
         {"texture", format("{} x {}", avatar_.material.width, avatar_.material.height)}});
  }

  PrefilteredEnvironment own_light() const {
    return Prefilter(avatar_.environment.size).forward(avatar_.environment);
  }

  const Evaluation& e_;
  const HeadAvatar& avatar_;
  const Capture& capture_;
  const EvaluationOptions& options_;
  Path folder_;
  HeadRenderer renderer_;
  Report report_;
};

}  // namespace

void write_evaluation(const Evaluation& evaluation, const HeadAvatar& avatar,
                      const Capture& capture, const Path& avatar_folder,
                      const EvaluationOptions& options, const Path& out) {
  EvaluationReport(evaluation, avatar, capture, options, avatar_folder).write(out / "report.html");
  write_json(out / "metrics.json", evaluation.metrics());
}

}  // namespace effigy
