// report.html of a body's evaluation.

#include <algorithm>
#include <cmath>

#include "effigy/base/log.h"
#include "effigy/cli/body_evaluation.h"
#include "effigy/cli/training_plots.h"
#include "effigy/image/colour.h"
#include "effigy/report/overlay.h"
#include "effigy/report/report.h"

namespace effigy {
namespace {

constexpr size_t kShown = 4;  // views of each group

// A channel divided by alpha, for looking at.
Planes channel(const BodyPicture& picture, int first, int count) {
  const Planes& channels = picture.channels();
  Planes out(channels.width, channels.height, count);
  const float* alpha = channels.plane(0);
  for (int c = 0; c < count; ++c)
    for (size_t p = 0; p < out.pixels(); ++p)
      out.plane(c)[p] = channels.plane(1 + first + c)[p] / std::max(alpha[p], 1e-3f);
  return out;
}

std::string of(double value, int digits) {
  return digits == 2 ? format("{:.2f}", value) : format("{:.4f}", value);
}

class BodyReport {
 public:
  BodyReport(const BodyEvaluation& evaluation, BodyAvatar& avatar, const StageCapture& capture,
             const Path& avatar_folder)
      : e_(evaluation),
        avatar_(avatar),
        capture_(capture),
        folder_(avatar_folder),
        source_(capture),
        moments_(source_, avatar.model.shadow_texels(), avatar.settings),
        viewer_(avatar.settings, avatar.model, moments_),
        report_("Body avatar report", avatar_folder.filename().string() + ", " + capture.source) {}

  void write(const Path& path) {
    scores();
    for (const ViewGroup& group : e_.groups) views(group);
    surface();
    textures();
    curves();
    settings();
    report_.write(path);
  }

 private:
  void scores() {
    std::vector<MetricTile> tiles;
    for (const ViewGroup& group : e_.groups)
      tiles.push_back({group.title, format("{:.2f}", group.mean().psnr), "dB PSNR",
                       format("{} views", group.views.size())});
    report_.add_metric_tiles(tiles);
    report_.add_heading("Scores");
    std::vector<std::string> columns = {"held out", "views", "PSNR dB", "SSIM", "FLIP"};
    std::vector<std::string> names;
    for (const auto& [name, value] : e_.groups.front().mean_distances()) names.push_back(name);
    columns.insert(columns.end(), names.begin(), names.end());
    columns.emplace_back("inside the mask dB");
    if (e_.left_lit) columns.emplace_back("left fully lit dB");
    columns.emplace_back("one colour dB");
    std::vector<std::vector<std::string>> rows;
    for (const ViewGroup& group : e_.groups) {
      const BodyScore m = group.mean();
      std::vector<std::string> row = {group.title, std::to_string(group.views.size()),
                                      of(m.psnr, 2), of(m.ssim, 4), of(m.flip, 4)};
      for (const std::string& name : names) row.push_back(of(group.mean_distances().at(name), 4));
      row.push_back(of(m.psnr_inside, 2));
      if (e_.left_lit) row.push_back(of(group.mean(&ViewScores::unlit).psnr, 2));
      row.push_back(of(group.mean(&ViewScores::flat).psnr, 2));
      rows.push_back(std::move(row));
    }
    report_.add_table(columns, rows,
                      "On the bounding box of the body, 8-bit sRGB, on black. Left fully lit: the "
                      "same views drawn in the light of all lamps, what not relighting scores. "
                      "One colour: the mean of the fully lit training views in the true outline.");
    if (e_.lpips_net.empty()) report_.add_paragraph("LPIPS is " + e_.lpips_note + ".");
    relighting();
    surfaces();
  }

  void relighting() {
    if (e_.relight.empty()) return;
    std::vector<std::vector<std::string>> rows;
    for (const auto& [light, s] : e_.relight)
      rows.push_back({light, of(s.psnr, 2), of(s.ssim, 4), of(s.psnr_aligned, 2),
                      of(s.ssim_aligned, 4), format("{:.3f}", s.scale),
                      e_.left_lit ? of(s.psnr_unlit, 2) : "-"});
    report_.add_subheading("Relit by environments");
    report_.add_table({"light", "PSNR dB", "SSIM", "PSNR aligned dB", "SSIM aligned", "scale",
                       "left fully lit, aligned dB"},
                      rows,
                      "Unseen motion on held-out cameras, trained on lamps alone. Aligned: after "
                      "one scale for all views of a light.");
  }

  void surfaces() {
    std::vector<std::vector<std::string>> rows;
    for (const ViewGroup& group : e_.groups)
      if (const std::optional<SurfaceScores> s = group.mean_surface())
        rows.push_back({group.title, of(s->albedo_error, 4), format("{:.3f}", s->roughness_error),
                        format("{:.1f}", s->normal_degrees), format("{:.2f}", s->depth_error_mm)});
    if (rows.empty()) return;
    report_.add_subheading("Against the true surface");
    report_.add_table({"held out", "albedo, sRGB, one scale a view", "roughness",
                       "normals, degrees", "depth, mm"},
                      rows,
                      "Mean absolute differences where truth and avatar cover the whole pixel. The "
                      "width of the avatar's lobe counts as the square of a roughness.");
  }

  void views(const ViewGroup& group) {
    report_.add_heading("Views: " + group.title);
    std::vector<ImageRow> rows;
    const size_t count = std::min(kShown, group.views.size());
    for (size_t k = 0; k < count; ++k) {
      const ViewScores& scored = group.views[(2 * k + 1) * group.views.size() / (2 * count)];
      const DrawnView drawn = viewer_.draw(scored.view);
      const BodyPicture& picture = viewer_.picture();
      const PlaneView view{picture.channels().plane(0), {24, 24, 28}};
      const Image8 truth = to_8bit(drawn.truth), made = to_8bit(drawn.drawn);
      rows.push_back(
          {format("frame {}, camera {}, {:.1f} dB",
                  capture_.frames[static_cast<size_t>(scored.view.frame)].number,
                  capture_.cameras[static_cast<size_t>(scored.view.camera)].name,
                  scored.score.psnr),
           {truth, made, colour_difference(truth, made),
            colour_normals(channel(picture, kBodyNormal, 3), 0, view),
            colour_scalar(channel(picture, kBodyShadow, 1), 0, ColourMap::kGrey, 0, 1, false, view),
            colour_scalar(channel(picture, kBodyVisibility, 1), 0, ColourMap::kGrey, 0, 1, false,
                          view)}});
    }
    report_.add_image_grid(
        {"truth", "avatar", "difference (x5)", "normals", "shadow", "specular visibility"}, rows);
  }

  // One view of what was held out most, beside the truth.
  void surface() {
    const ViewGroup* group = e_.group("motion");
    if (group == nullptr) group = &e_.groups.front();
    viewer_.draw(group->views[group->views.size() / 2].view);
    const std::optional<SurfaceImages> truth = true_surface(capture_, viewer_.view());
    if (!truth) return;
    const SurfaceImages drawn = drawn_surface(viewer_);
    const auto row = [](const char* caption, const SurfaceImages& s) {
      const PlaneView covered{s.alpha.data.data(), {24, 24, 28}};
      Planes albedo = to_planes(s.albedo);
      for (float& value : albedo.data) value = srgb_from_linear(std::clamp(value, 0.0f, 1.0f));
      return ImageRow{
          caption,
          {colour_rgb(albedo, 0, covered),
           colour_scalar(to_planes(s.roughness), 0, ColourMap::kGrey, 0, 1, false, covered),
           colour_normals(to_planes(s.normal), 0, covered)}};
    };
    report_.add_heading("Surface: " + group->title);
    report_.add_image_grid({"albedo", "roughness", "normals"},
                           {row("truth", *truth), row("avatar", drawn)});
  }

  void textures() {
    report_.add_heading("Textures");
    const BodyMapImages maps = to_images(avatar_.model.texels(), avatar_.model.maps());
    Image roughness = maps.roughness;
    for (float& value : roughness.data) value = std::min(value / 0.4f, 1.0f);
    report_.add_image_grid({"albedo", "roughness (white: 0.4)"},
                           {{"", {to_8bit(maps.albedo), to_8bit(roughness)}}});
  }

  void curves() {
    const Path file = folder_ / "training.json";
    if (!std::filesystem::exists(file)) return;
    report_.add_heading("Training");
    add_training_plots(report_, read_json(file),
                       {"l1", "dssim", "pyramid", "mask", "normal_orient"}, "unseen motion");
  }

  void settings() {
    report_.add_heading("Settings and provenance");
    add_provenance(report_, avatar_.info,
                   {{"Gaussians", std::to_string(avatar_.model.texels().count())}});
  }

  const BodyEvaluation& e_;
  BodyAvatar& avatar_;
  const StageCapture& capture_;
  Path folder_;
  StageSource source_;
  StageMoments moments_;
  BodyViewer viewer_;
  Report report_;
};

}  // namespace

void write_body_evaluation(const BodyEvaluation& evaluation, BodyAvatar& avatar,
                           const StageCapture& capture, const Path& avatar_folder,
                           const Path& out) {
  make_folder(out);
  BodyReport(evaluation, avatar, capture, avatar_folder).write(out / "report.html");
  write_json(out / "metrics.json", evaluation.metrics());
}

}  // namespace effigy
