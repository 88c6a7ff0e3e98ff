#include "effigy/body/truth_scores.h"

#include <algorithm>
#include <cmath>

#include "effigy/body/draw.h"
#include "effigy/body/renderer.h"
#include "effigy/image/resample.h"

namespace effigy {
namespace {

constexpr const char* kLayers[] = {"albedo", "material", "normal", "depth", "radiance"};

}  // namespace

SurfaceImages drawn_surface(const BodyViewer& viewer) {
  const BodyPicture& picture = viewer.picture();
  const bool microfacets =
      body_appearance_named(viewer.settings().appearance) == BodyAppearance::kPbr;
  SurfaceImages out;
  out.albedo = to_image(
      body_albedo(viewer.view().view, viewer.surface(), draw_options(viewer.settings()).raster));
  out.roughness = body_buffer_values(picture, "roughness");
  if (!microfacets)
    for (float& width : out.roughness.data) width = std::sqrt(std::max(width, 0.0f));
  out.normal = body_buffer_values(picture, "normal");
  out.depth = body_buffer_values(picture, "depth");
  out.alpha = body_buffer_values(picture, "alpha");
  return out;
}

std::optional<SurfaceImages> true_surface(const StageCapture& capture, const StageView& view) {
  for (const char* layer : kLayers)
    if (std::find(capture.layers.begin(), capture.layers.end(), layer) == capture.layers.end())
      return std::nullopt;
  const auto layer = [&](const char* name) {
    return cropped(capture.load_layer(name, view.camera, view.frame), view.left, view.top,
                   view.view.width, view.view.height);
  };
  return surface_from_layers(layer("albedo"), layer("material"), layer("normal"), layer("depth"),
                             layer("radiance"));
}

std::optional<SurfaceScores> score_surface(const BodyViewer& viewer, const StageCapture& capture) {
  const std::optional<SurfaceImages> truth = true_surface(capture, viewer.view());
  if (!truth) return std::nullopt;
  SurfaceErrors errors;
  errors.add(drawn_surface(viewer), *truth);
  if (errors.empty()) return std::nullopt;
  return errors.scores();
}

}  // namespace effigy
