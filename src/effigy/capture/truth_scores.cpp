#include "effigy/capture/truth_scores.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/geometry/types.h"
#include "effigy/image/colour.h"

namespace effigy {
namespace {

constexpr float kCovered = 0.99f;  // alpha of truth and avatar from which a pixel counts

Image channel_of(const Image& image, int channel) {
  Image out(image.width, image.height, 1);
  for (size_t i = 0; i < out.data.size(); ++i)
    out.data[i] =
        image.data[static_cast<size_t>(image.channels) * i + static_cast<size_t>(channel)];
  return out;
}

void check_size(const SurfaceImages& surface, const SurfaceImages& like) {
  for (const Image* image :
       {&surface.albedo, &surface.roughness, &surface.normal, &surface.depth, &surface.alpha})
    if (image->width != like.alpha.width || image->height != like.alpha.height)
      throw Error("A capture's layers and the avatar's picture have different sizes.");
}

}  // namespace

SurfaceImages surface_from_layers(Image albedo, const Image& material, Image normal, Image depth,
                                  const Image& radiance) {
  return {std::move(albedo), channel_of(material, 0), channel_of(material, 1),
          std::move(normal), std::move(depth),        channel_of(radiance, 3)};
}

double albedo_difference(const Image& drawn, const Image& truth,
                         const std::vector<size_t>& pixels) {
  double cross = 0, square = 0, sum = 0;
  for (const size_t i : pixels)
    for (size_t c = 0; c < 3; ++c) {
      const auto d = static_cast<double>(drawn.data[3 * i + c]);
      cross += d * static_cast<double>(truth.data[3 * i + c]);
      square += d * d;
    }
  const auto scale = static_cast<float>(square > 0 ? cross / square : 1.0);
  for (const size_t i : pixels)
    for (size_t c = 0; c < 3; ++c)
      sum += static_cast<double>(std::abs(srgb_from_linear(scale * drawn.data[3 * i + c]) -
                                          srgb_from_linear(truth.data[3 * i + c])));
  return pixels.empty() ? 0.0 : sum / (3 * static_cast<double>(pixels.size()));
}

Json SurfaceScores::to_json() const {
  Json json = {{"albedo_error", albedo_error},
               {"roughness_error", roughness_error},
               {"normal_degrees", normal_degrees},
               {"depth_error_mm", depth_error_mm}};
  if (specular_error) json["specular_error"] = *specular_error;
  return json;
}

void SurfaceErrors::add(const SurfaceImages& drawn, const SurfaceImages& truth) {
  check_size(drawn, truth);
  check_size(truth, truth);
  std::vector<size_t> pixels;
  for (size_t i = 0; i < truth.alpha.data.size(); ++i)
    if (truth.alpha.data[i] > kCovered && drawn.alpha.data[i] > kCovered && truth.depth.data[i] > 0)
      pixels.push_back(i);
  albedo_.add(albedo_difference(drawn.albedo, truth.albedo, pixels),
              static_cast<double>(pixels.size()));
  const bool specular = !drawn.specular.data.empty() && !truth.specular.data.empty();
  for (const size_t i : pixels) {
    roughness_.add(std::abs(drawn.roughness.data[i] - truth.roughness.data[i]));
    if (specular) specular_.add(std::abs(drawn.specular.data[i] - truth.specular.data[i]));
    const Vec3d a = Eigen::Map<const Vec3f>(&drawn.normal.data[3 * i]).cast<double>();
    const Vec3d b = Eigen::Map<const Vec3f>(&truth.normal.data[3 * i]).cast<double>();
    if (a.norm() > 0 && b.norm() > 0)
      normal_.add(std::acos(std::clamp(a.normalized().dot(b.normalized()), -1.0, 1.0)) * 180 /
                  std::numbers::pi);
    depth_.add(1000 * std::abs(static_cast<double>(drawn.depth.data[i]) -
                               static_cast<double>(truth.depth.data[i])));
  }
}

SurfaceScores SurfaceErrors::scores() const {
  SurfaceScores scores;
  scores.albedo_error = albedo_.mean();
  scores.roughness_error = roughness_.mean();
  if (specular_.weight > 0) scores.specular_error = specular_.mean();
  scores.normal_degrees = normal_.mean();
  scores.depth_error_mm = depth_.mean();
  return scores;
}

void ScaleFit::add(const Image& drawn, const Image& truth) {
  EFFIGY_CHECK_EQ(drawn.data.size(), truth.data.size());
  const auto linear = [](float encoded) {
    return static_cast<double>(linear_from_srgb(std::clamp(encoded, 0.0f, 1.0f)));
  };
  for (size_t i = 0; i < truth.data.size(); ++i) {
    const double d = linear(drawn.data[i]);
    cross += d * linear(truth.data[i]);
    square += d * d;
  }
}

void ScaleFit::add(const ScaleFit& other) {
  cross += other.cross;
  square += other.square;
}

Json RelightScores::to_json() const {
  return {{"psnr", psnr},
          {"ssim", ssim},
          {"psnr_aligned", psnr_aligned},
          {"ssim_aligned", ssim_aligned},
          {"scale", scale},
          {"psnr_unlit", psnr_unlit}};
}

}  // namespace effigy
