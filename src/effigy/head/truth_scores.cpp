#include "effigy/head/truth_scores.h"

#include <cmath>

#include "effigy/base/progress.h"
#include "effigy/head/evaluate.h"
#include "effigy/head/relight.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

// The avatar's G-buffer as a surface.
SurfaceImages surface_of(const Planes& gbuffer) {
  const int width = gbuffer.width, height = gbuffer.height;
  const auto channels = [&](int first, int count) {
    Image out(width, height, count);
    for (int c = 0; c < count; ++c)
      for (size_t i = 0; i < gbuffer.pixels(); ++i) {
        const float alpha = gbuffer.plane(kAlpha)[i];
        out.data[static_cast<size_t>(count) * i + static_cast<size_t>(c)] =
            alpha > 0 ? gbuffer.plane(first + c)[i] / alpha : 0.0f;
      }
    return out;
  };
  Image alpha(width, height, 1);
  std::copy_n(gbuffer.plane(kAlpha), gbuffer.pixels(), alpha.data.begin());
  return {channels(kAlbedo, 3),       channels(kRoughness, 1), channels(kSpecular, 1),
          channels(kMappedNormal, 3), channels(kDepth, 1),     std::move(alpha)};
}

}  // namespace

double light_error(const Cubemap& light, const Cubemap& truth) {
  EFFIGY_CHECK_EQ(light.size, truth.size);
  const Prefilter prefilter(light.size);
  const Cubemap a = prefilter.forward(light).diffuse, b = prefilter.forward(truth).diffuse;
  double cross = 0, square = 0, off = 0, all = 0;
  const auto visit = [&](auto&& each) {
    size_t i = 0;
    for (int face = 0; face < 6; ++face)
      for (int y = 0; y < a.size; ++y)
        for (int x = 0; x < a.size; ++x)
          for (int c = 0; c < 3; ++c, ++i)
            each(a.texels[i], b.texels[i], cubemap_solid_angle(x, y, a.size));
  };
  visit([&](double drawn, double known, double solid) {
    cross += solid * drawn * known;
    square += solid * drawn * drawn;
  });
  const double scale = square > 0 ? cross / square : 1.0;
  visit([&](double drawn, double known, double solid) {
    off += solid * std::abs(scale * drawn - known);
    all += solid * known;
  });
  return all > 0 ? off / all : 0.0;
}

Json TruthScores::to_json() const {
  Json json = surface.to_json();
  json["environment_error"] = environment_error;
  return json;
}

std::optional<TruthScores> score_truth(const HeadAvatar& avatar, const Capture& capture,
                                       const std::vector<int>& frames) {
  const std::optional<CaptureTruth> truth = read_truth(capture);
  if (!truth || truth->layers.empty()) return std::nullopt;
  HeadRenderer renderer(avatar);
  SurfaceErrors errors;
  for (const int frame : frames) {
    throw_if_interrupted();
    renderer.set_pose(tracked_pose(avatar, capture, frame));
    renderer.draw(capture.camera);
    const auto layer = [&](const char* name) { return load_layer(capture, *truth, name, frame); };
    errors.add(surface_of(renderer.gbuffer()),
               surface_from_layers(layer("albedo"), layer("material"), layer("normal"),
                                   layer("depth"), layer("radiance")));
  }
  TruthScores scores;
  scores.surface = errors.scores();
  const Path file = capture.folder / "capture.json";
  const Path light = file_inside(capture.extra, "light", file);
  scores.environment_error = light_error(
      avatar.environment, cubemap_from_equirectangular(read_environment(capture.folder / light),
                                                       avatar.environment.size));
  return scores;
}

}  // namespace effigy
