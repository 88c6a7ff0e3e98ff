#include "effigy/body/losses.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/body/stretches.h"
#include "effigy/learn/image_losses.h"
#include "effigy/learn/pyramid_loss.h"

namespace effigy {
namespace {

constexpr int kPyramidLevels = 4;
constexpr size_t kGrain = 8192;

// Display encoding that goes on beyond 1, so that a pixel that is too bright still has a gradient.
float encode(float linear, DisplayTransform display, float& slope) {
  const float size = std::abs(linear);
  float x = size, inner = 1;
  if (display == DisplayTransform::kReinhardSrgb) {
    inner = 1.0f / ((1 + size) * (1 + size));
    x = size / (1 + size);
  }
  if (x <= 0.0031308f) {
    slope = 12.92f * inner;
    return 12.92f * std::copysign(x, linear);
  }
  const float root = std::pow(x, 1.0f / 2.4f);
  slope = 1.055f / 2.4f * root / x * inner;
  return std::copysign(1.055f * root - 0.055f, linear);
}

float behind(const BodyTarget& target, int c, size_t p) {
  return target.background.data.empty() ? 0.0f : target.background.plane(c)[p];
}

// Pixels within `border` of the mask's edge (row or column wise, then both).
std::vector<uint8_t> mask_edge(const std::vector<float>& mask, int width, int height, int border) {
  const auto span = [&](bool rows, const std::vector<float>& in, bool highest) {
    std::vector<float> out(in.size());
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        float value = in[static_cast<size_t>(y) * width + x];
        for (int d = -border; d <= border; ++d) {
          const int xx = rows ? std::clamp(x + d, 0, width - 1) : x;
          const int yy = rows ? y : std::clamp(y + d, 0, height - 1);
          const float other = in[static_cast<size_t>(yy) * width + xx];
          value = highest ? std::max(value, other) : std::min(value, other);
        }
        out[static_cast<size_t>(y) * width + x] = value;
      }
    return out;
  };
  const std::vector<float> low = span(false, span(true, mask, false), false);
  const std::vector<float> high = span(false, span(true, mask, true), true);
  std::vector<uint8_t> edge(mask.size());
  for (size_t p = 0; p < mask.size(); ++p) edge[p] = high[p] - low[p] > 0.5f;
  return edge;
}

double sparsity(float alpha, bool log_prior, float& slope) {
  const double a = std::clamp(static_cast<double>(alpha), 0.0, 1.0);
  if (log_prior) {                                // 0 at both ends
    constexpr double kAtEnds = 2.20727491318972;  // -log(0.1) - log(1.1)
    slope = static_cast<float>(1 / (0.1 + a) - 1 / (1.1 - a));
    return std::log(0.1 + a) + std::log(1.1 - a) + kAtEnds;
  }
  slope = a < 0.5 ? 1.0f : -1.0f;
  return std::min(a, 1 - a);
}

void mask_losses(const BodyTrainSettings& settings, const BodyTarget& target,
                 std::span<const float> alpha, int width, int height, std::span<float> d_alpha,
                 BodyLossValues& values) {
  const std::vector<uint8_t> edge = mask_edge(target.mask, width, height, settings.mask_border);
  const double pixels = static_cast<double>(alpha.size());
  const auto mask_step = static_cast<float>(settings.weights.mask / pixels);
  const auto sparse_step = static_cast<float>(settings.weights.alpha_sparsity / pixels);
  const bool log_prior = settings.alpha_sparsity == "log";
  double mask_sum = 0, sparse_sum = 0;
  for (size_t p = 0; p < alpha.size(); ++p) {
    if (edge[p]) continue;
    const float miss = alpha[p] - target.mask[p];
    mask_sum += static_cast<double>(std::abs(miss));
    d_alpha[p] += miss > 0 ? mask_step : (miss < 0 ? -mask_step : 0.0f);
    float slope;
    sparse_sum += sparsity(alpha[p], log_prior, slope);
    d_alpha[p] += sparse_step * slope;
  }
  values["mask"] = mask_sum / pixels;
  values["alpha_sparsity"] = sparse_sum / pixels;
}

}  // namespace

void body_display(const BodyPicture& picture, const CameraColour& camera, const BodyTarget& target,
                  Planes& encoded) {
  const Planes& radiance = picture.radiance();
  const std::span<const float> alpha = picture.alpha();
  if (encoded.width != radiance.width || encoded.height != radiance.height || encoded.count != 3)
    encoded = Planes(radiance.width, radiance.height, 3);
  const auto encode_stretch = [&](size_t begin, size_t end) {
    for (int c = 0; c < 3; ++c) {
      const auto k = static_cast<size_t>(c);
      for (size_t p = begin; p < end; ++p) {
        float slope;
        const float linear = camera.gain[k] * radiance.plane(c)[p] + camera.offset[k] * alpha[p] +
                             (1 - alpha[p]) * behind(target, c, p);
        encoded.plane(c)[p] = encode(linear, target.display, slope);
      }
    }
  };
  if (!target.background.data.empty())
    return parallel_for(radiance.pixels(), kGrain,
                        [&](size_t begin, size_t end, int) { encode_stretch(begin, end); });
  std::fill(encoded.data.begin(), encoded.data.end(), 0.0f);  // black stays black
  for_covered_stretches(alpha, encode_stretch);
}

BodyLossValues body_image_losses(const BodyTrainSettings& settings, const BodyTarget& target,
                                 const CameraColour& camera, const BodyPicture& picture,
                                 BodyImageGradients& gradients, const PictureDistance& perceptual) {
  const Planes& radiance = picture.radiance();
  const std::span<const float> alpha = picture.alpha();
  const int width = radiance.width, height = radiance.height;
  const size_t pixels = radiance.pixels();
  EFFIGY_CHECK(target.image.width == width && target.image.height == height);
  EFFIGY_CHECK_EQ(target.mask.size(), pixels);
  Planes encoded, d_encoded(width, height, 3);
  body_display(picture, camera, target, encoded);
  // What a camera cannot tell apart from white is white.
  for (int c = 0; c < 3; ++c)
    for (size_t p = 0; p < pixels; ++p)
      if (target.image.plane(c)[p] >= 1) encoded.plane(c)[p] = std::min(encoded.plane(c)[p], 1.0f);

  const BodyWeights& w = settings.weights;
  BodyLossValues values;
  const PhotometricLoss photo =
      photometric_loss(encoded, target.image, {}, {},
                       {static_cast<float>(w.l1), static_cast<float>(w.dssim), 0}, &d_encoded, {});
  values["l1"] = photo.l1;
  values["dssim"] = photo.dssim;
  if (w.pyramid > 0)
    values["pyramid"] = pyramid_loss(encoded, target.image, 3, kPyramidLevels,
                                     static_cast<float>(w.pyramid), &d_encoded);

  if (perceptual) {
    const bool features = settings.perceptual == "squeezenet10";
    values[features ? "features" : "lpips"] = perceptual(
        encoded, target.image, static_cast<float>(features ? w.features : w.lpips), d_encoded);
  }

  gradients.radiance = Planes(width, height, 3);
  gradients.alpha.assign(pixels, 0.0f);
  gradients.gain = gradients.offset = {};
  for (int c = 0; c < 3; ++c) {
    const auto k = static_cast<size_t>(c);
    for (size_t p = 0; p < pixels; ++p) {
      float slope;
      const float bare = radiance.plane(c)[p], back = behind(target, c, p);
      const float linear =
          camera.gain[k] * bare + camera.offset[k] * alpha[p] + (1 - alpha[p]) * back;
      const float bright = encode(linear, target.display, slope);
      if (bright > 1 && target.image.plane(c)[p] >= 1) continue;
      const float d = d_encoded.plane(c)[p] * slope;
      gradients.radiance.plane(c)[p] = d * camera.gain[k];
      gradients.alpha[p] += d * (camera.offset[k] - back);
      gradients.gain[k] += static_cast<double>(d) * static_cast<double>(bare);
      gradients.offset[k] += static_cast<double>(d) * static_cast<double>(alpha[p]);
    }
  }
  mask_losses(settings, target, alpha, width, height, gradients.alpha, values);
  return values;
}

BoundCost bound_cost(double value, double low, double high, bool relative) {
  constexpr double kLeast = 1e-7;
  if (value < low) {
    const double held = std::max(value, kLeast), scale = relative ? low : 1.0;
    return {scale / held, value > kLeast ? -scale / (held * held) : 0.0};
  }
  if (value > high) return {(value - high) * (value - high), 2 * (value - high)};
  return {};
}

BodyLossValues body_texel_losses(const BodyTrainSettings& settings, double normal_weight,
                                 std::span<const float> decoded, const BodySurface& surface,
                                 std::span<const float> diffuse, std::span<float> d_decoded,
                                 BodySurfaceGradients& gradients, std::span<float> d_diffuse) {
  const BodyWeights& w = settings.weights;
  const size_t n = surface.count(), channels = decoded.size() / n;
  const double each = 1.0 / static_cast<double>(n);
  const bool relative = settings.bound == "relative";
  const size_t transfers = GaussianChannels::transfer_of(channels);
  double scale = 0, offset = 0, normal = 0, bound = 0, albedo = 0, negative = 0, transfer = 0;
  for (size_t i = 0; i < n; ++i) {
    const float* channel = &decoded[i * channels];
    float* d = &d_decoded[i * channels];
    for (size_t c = 0; c < 3; ++c) {
      const double s = static_cast<double>(surface.placed.scale[3 * i + c]);
      scale += s / 3;
      const BoundCost cost = bound_cost(s, settings.scale_low, settings.scale_high, relative);
      bound += cost.cost / 3;
      gradients.scale[3 * i + c] += static_cast<float>(each / 3 * (w.scale + w.bound * cost.slope));
      const double t = static_cast<double>(channel[GaussianChannels::kOffset + c]);
      offset += t * t;
      d[GaussianChannels::kOffset + c] += static_cast<float>(each * w.offset * 2 * t);
      const double dn = static_cast<double>(channel[GaussianChannels::normal_of(channels) + c]);
      normal += dn * dn;
      d[GaussianChannels::normal_of(channels) + c] +=
          static_cast<float>(each * normal_weight * 2 * dn);
      const double rho = static_cast<double>(surface.albedo[3 * i + c]);
      const double dark_rho = std::min(rho, 0.0);
      const double dark = static_cast<double>(std::min(diffuse[c * n + i], 0.0f));
      albedo += std::abs(rho) / 3;
      negative += (dark_rho * dark_rho + dark * dark) / 3;
      gradients.albedo[3 * i + c] += static_cast<float>(
          each / 3 * (w.albedo * (rho > 0 ? 1 : (rho < 0 ? -1 : 0)) + w.neg_color * 2 * dark_rho));
      d_diffuse[c * n + i] += static_cast<float>(each / 3 * w.neg_color * 2 * dark);
    }
    for (size_t k = 0; k < transfers; ++k) {
      const double z = static_cast<double>(channel[GaussianChannels::kColoured + k]);
      transfer += z * z / static_cast<double>(transfers);
      d[GaussianChannels::kColoured + k] +=
          static_cast<float>(each * w.transfer * 2 * z / static_cast<double>(transfers));
    }
    const BoundCost rough = bound_cost(static_cast<double>(surface.roughness[i]),
                                       settings.roughness_low, settings.roughness_high, relative);
    bound += rough.cost;
    gradients.roughness[i] += static_cast<float>(each * w.bound * rough.slope);
  }
  return {{"scale", scale * each},       {"offset", offset * each},     {"normal", normal * each},
          {"bound", bound * each},       {"transfer", transfer * each}, {"albedo", albedo * each},
          {"neg_color", negative * each}};
}

double dark_lobe_loss(const BodySurface& surface, const Vec3f& direction, float weight,
                      BodySurfaceGradients& gradients) {
  const size_t n = surface.count();
  DiffuseLight light;
  light.points.lights = {{direction, Vec3f::Ones(), true}};
  const TransferView view{n, surface.placed.axes, {}, surface.placed.zonal};
  std::vector<float> value(3 * n);
  shade_diffuse(light, view, value);
  const double each = 1.0 / static_cast<double>(3 * n);
  double sum = 0;
  for (float& v : value) {
    const double dark = static_cast<double>(std::min(v, 0.0f));
    sum += dark * dark * each;
    v = static_cast<float>(2 * dark * each * static_cast<double>(weight));
  }
  shade_diffuse_backward(light, view, value, {gradients.axes, {}, gradients.zonal, {}});
  return sum;
}

}  // namespace effigy
