#include "effigy/head/truth_scores.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/base/progress.h"
#include "effigy/head/relight.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

constexpr float kCovered = 0.99f;  // alpha of truth and avatar from which a pixel counts

struct Mean {
  double sum = 0, weight = 0;
  void add(double value, double by = 1) {
    sum += by * value;
    weight += by;
  }
  double mean() const { return weight > 0 ? sum / weight : 0.0; }
};

// One frame's true layers and the avatar's G-buffer values, for the pixels that both cover.
class FrameTruth {
 public:
  FrameTruth(const Capture& capture, const CaptureTruth& truth, int frame, const Planes& gbuffer)
      : albedo_(load_layer(capture, truth, "albedo", frame)),
        material_(load_layer(capture, truth, "material", frame)),
        normal_(load_layer(capture, truth, "normal", frame)),
        depth_(load_layer(capture, truth, "depth", frame)),
        gbuffer_(gbuffer) {
    const Image radiance = load_layer(capture, truth, "radiance", frame);
    for (size_t i = 0; i < gbuffer.pixels(); ++i)
      if (radiance.data[4 * i + 3] > kCovered && gbuffer.plane(kAlpha)[i] > kCovered &&
          depth_.data[i] > 0)
        pixels_.push_back(i);
  }

  // Albedo, roughness, F0, degrees, millimetres.
  void add(std::array<Mean, 5>& sums) const {
    const double scale = albedo_scale();
    for (const size_t i : pixels_) {
      for (size_t c = 0; c < 3; ++c) {
        const auto drawn = static_cast<float>(scale * value(kAlbedo + static_cast<int>(c), i));
        sums[0].add(std::abs(srgb_from_linear(drawn) - srgb_from_linear(albedo_.data[3 * i + c])));
      }
      sums[1].add(std::abs(value(kRoughness, i) - material_.data[3 * i]));
      sums[2].add(std::abs(value(kSpecular, i) - material_.data[3 * i + 1]));
      const Vec3d drawn(value(kMappedNormal, i), value(kMappedNormal + 1, i),
                        value(kMappedNormal + 2, i));
      const Vec3d truth = Eigen::Map<const Vec3f>(&normal_.data[3 * i]).cast<double>();
      if (drawn.norm() > 0 && truth.norm() > 0)
        sums[3].add(std::acos(std::clamp(drawn.normalized().dot(truth.normalized()), -1.0, 1.0)) *
                    180 / std::numbers::pi);
      sums[4].add(1000 * std::abs(value(kDepth, i) - depth_.data[i]));
    }
  }

 private:
  double value(int plane, size_t i) const {
    return gbuffer_.plane(plane)[i] / gbuffer_.plane(kAlpha)[i];
  }
  // Least squares over linear values.
  double albedo_scale() const {
    double cross = 0, square = 0;
    for (const size_t i : pixels_)
      for (size_t c = 0; c < 3; ++c) {
        const double drawn = value(kAlbedo + static_cast<int>(c), i);
        cross += drawn * albedo_.data[3 * i + c];
        square += drawn * drawn;
      }
    return square > 0 ? cross / square : 1.0;
  }

  Image albedo_, material_, normal_, depth_;
  const Planes& gbuffer_;
  std::vector<size_t> pixels_;
};

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
  return {{"albedo_error", albedo_error},     {"roughness_error", roughness_error},
          {"specular_error", specular_error}, {"normal_degrees", normal_degrees},
          {"depth_error_mm", depth_error_mm}, {"environment_error", environment_error}};
}

std::optional<TruthScores> score_truth(const HeadAvatar& avatar, const Capture& capture,
                                       const std::vector<int>& frames) {
  const std::optional<CaptureTruth> truth = read_truth(capture);
  if (!truth || truth->layers.empty()) return std::nullopt;
  HeadRenderer renderer(avatar);
  std::array<Mean, 5> sums;
  for (const int frame : frames) {
    throw_if_interrupted();
    renderer.set_pose(capture.poses[frame]);
    renderer.draw(capture.camera);
    FrameTruth(capture, *truth, frame, renderer.gbuffer()).add(sums);
  }
  TruthScores scores;
  scores.albedo_error = sums[0].mean();
  scores.roughness_error = sums[1].mean();
  scores.specular_error = sums[2].mean();
  scores.normal_degrees = sums[3].mean();
  scores.depth_error_mm = sums[4].mean();
  const Path file = capture.folder / "capture.json";
  const Path light = file_inside(capture.extra, "light", file);
  scores.environment_error = light_error(
      avatar.environment, cubemap_from_equirectangular(read_environment(capture.folder / light),
                                                       avatar.environment.size));
  return scores;
}

}  // namespace effigy
