#include "effigy/synth/prior_image.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"
#include "effigy/image/filter.h"

namespace effigy {
namespace {

constexpr std::array<float, 3> kTint = {1.1f, 1.0f, 0.85f};
constexpr float kDarker = 0.75f, kTowardsMean = 1.0f / 3;
constexpr double kBlur = 1.0 / 48;  // of the width

void blur(Image& image, double sigma) {
  const auto kernel = gaussian_kernel(sigma, static_cast<int>(std::ceil(3 * sigma)));
  filter_separable(image.data.data(), image.width, image.height, image.channels, kernel, kernel,
                   image.data.data());
}

Image degraded(const Image& albedo, const Image& alpha) {
  Image result = albedo, weight = alpha;
  for (size_t i = 0; i < alpha.data.size(); ++i)
    for (size_t c = 0; c < 3; ++c) result.data[3 * i + c] *= alpha.data[i];
  std::array<double, 4> sum = {};
  for (size_t i = 0; i < alpha.data.size(); ++i) {
    for (size_t c = 0; c < 3; ++c) sum[c] += result.data[3 * i + c];
    sum[3] += alpha.data[i];
  }
  const double sigma = kBlur * albedo.width;
  blur(result, sigma);
  blur(weight, sigma);
  for (size_t i = 0; i < alpha.data.size(); ++i)
    for (size_t c = 0; c < 3; ++c) {
      float& value = result.data[3 * i + c];
      if (alpha.data[i] <= 0) {
        value = 0;
        continue;
      }
      const auto mean = static_cast<float>(sum[c] / sum[3]);
      value /= std::max(weight.data[i], 1e-6f);
      value = kDarker * kTint[c] * (value + kTowardsMean * (mean - value));
    }
  return result;
}

}  // namespace

Image8 albedo_prior_image(const Image& albedo, const Image& alpha, const std::string& kind) {
  if (kind != "truth" && kind != "degraded")
    throw Error("--albedo-prior must be none, truth or degraded, not '" + kind + "'.");
  EFFIGY_CHECK(albedo.channels == 3 && alpha.channels == 1);
  Image image = kind == "truth" ? albedo : degraded(albedo, alpha);
  for (float& value : image.data) value = srgb_from_linear(value);
  return to_8bit(image);
}

}  // namespace effigy
