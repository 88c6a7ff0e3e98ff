#include "effigy/track/track_report.h"

#include <algorithm>

#include "effigy/base/log.h"
#include "effigy/image/files.h"
#include "effigy/report/overlay.h"
#include "effigy/report/report.h"

namespace effigy {
namespace {

constexpr int kFramesShown = 10;

// Skin triangles seen from the front, the landmarks of the network (yellow) and of the rig (red).
Image8 overlay(const Capture& capture, const RigShape& shape, int frame, Image8 picture) {
  std::vector<float> vertices, projected;
  pose_vertices(shape, capture.poses[frame], vertices);
  for (size_t v = 0; v + 2 < vertices.size(); v += 3) {
    const Vec2d p = capture.camera.project(Vec3f(&vertices[v]).cast<double>());
    projected.push_back(static_cast<float>(p.x()));
    projected.push_back(static_cast<float>(p.y()));
  }
  std::vector<int32_t> triangles;
  const Mesh& mesh = capture.rig.mesh;
  for (int t = 0; t < mesh.triangle_count(); ++t) {
    const bool skin = mesh.triangle_part.empty() || mesh.parts[mesh.triangle_part[t]] == "skin";
    for (int k = 0; skin && k < 3; ++k) triangles.push_back(mesh.triangles[t][k]);
  }
  draw_triangle_wireframe(picture, projected, triangles, {{90, 220, 140}, 0.45f, 0.8f});
  for (int l = 0; l < capture.landmark_count; ++l) {
    const float* p =
        &capture.landmarks[2 * (static_cast<size_t>(frame) * capture.landmark_count + l)];
    draw_point(picture, p[0], p[1], 1.0, {{255, 220, 60}, 0.9f});
  }
  const auto fitted = landmark_positions(capture.rig.mediapipe, mesh.triangles, vertices);
  for (size_t l = 0; l < fitted.size(); l += 3) {
    const Vec2d p = capture.camera.project(Vec3f(&fitted[l]).cast<double>());
    draw_point(picture, p.x(), p.y(), 0.8, {{255, 70, 70}, 0.9f});
  }
  return picture;
}

Series error_series(const std::string& name, const std::vector<double>& errors, double scale) {
  Series series{name, {}, {}};
  for (size_t f = 0; f < errors.size(); ++f) {
    series.xs.push_back(static_cast<double>(f));
    series.ys.push_back(errors[f] < 0 ? NAN : errors[f] * scale);
  }
  return series;
}

}  // namespace

void write_track_report(const Capture& capture, const FitResult& fit, double to_512,
                        const Json& summary, const Path& folder) {
  Report report("Tracking", capture.source);
  report.add_metric_tiles(
      {{"Frames tracked",
        format("{} / {}", summary.value("tracked", 0), summary.value("frames", 0)), "", ""},
       {"Landmark error", format("{:.2f}", summary.value("landmark_error_median_px", 0.0)), "px",
        "median, of a 512-pixel frame"},
       {"Held-out landmarks",
        format("{:.2f}", summary.value("heldout_landmark_error_median_px", 0.0)), "px",
        "median, not used in the fit"},
       {"Time", format("{:.1f}", summary.value("milliseconds_per_frame", 0.0)), "ms a frame", ""}});
  report.add_heading("Overlays");
  report.add_paragraph(
      "The fitted rig in green, the network's landmarks in yellow, the rig's in red. If the mesh "
      "does "
      "not follow the face here, no training will help.");
  const RigShape shape = shape_rig(capture.rig, capture.identity);
  std::vector<ImageRow> rows;
  const size_t count = std::min<size_t>(kFramesShown, capture.frames.size());
  for (size_t k = 0; k < count; ++k) {
    const size_t f = k * capture.frames.size() / count;
    const Image8 picture = read_image8(folder / capture.frames[f].image);
    rows.push_back({format("frame {}", capture.frames[f].number),
                    {picture, overlay(capture, shape, static_cast<int>(f), picture),
                     read_image8(folder / capture.frames[f].mask)}});
  }
  report.add_image_grid({"frame", "fit", "matte"}, rows);
  report.add_heading("Landmark error by frame");
  report.add_line_plot({"Mean distance between network and rig",
                        "frame",
                        "pixels of a 512-pixel frame",
                        {error_series("inner landmarks", fit.error, to_512),
                         error_series("held out of the fit", fit.heldout_error, to_512)},
                        false,
                        true});
  report.add_heading("Timing");
  std::vector<Bar> bars;
  const Json stages = summary.value("seconds", Json::object());
  for (const auto& [name, seconds] : stages.items())
    bars.push_back({name, seconds.get<double>(), format("{:.1f} s", seconds.get<double>())});
  report.add_bars("Seconds by stage", bars);
  report.add_heading("Result");
  report.add_key_values(
      {{"rig", summary.value("rig", "")},
       {"networks", summary.value("networks", "")},
       {"focal length", format("{:.0f} px", summary.value("focal_px", 0.0))},
       {"capture size", format("{} x {}", capture.camera.width, capture.camera.height)},
       {"consent", capture.consent}});
  report.write(folder / "track.html");
}

}  // namespace effigy
