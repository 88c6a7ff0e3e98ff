#include "effigy/head/start_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/light/cubemap_layout.h"

namespace effigy {
namespace {

constexpr int kRounds = 30;       // of light and albedo in turns
constexpr int kSteps = 4;         // of the light, each round
constexpr double kFree = 0.35;    // log albedo off the median that counts half as albedo
constexpr double kOutlier = 0.3;  // log residual that halves a sample's weight
constexpr double kHold = 0.001;   // weight of "as bright as the mean" against all samples
constexpr float kDark = 0.004f;   // radiance relative to the median below which nothing is told

using Rgb = std::array<double, 3>;

struct Fit {
  explicit Fit(int size) : prefilter(size), light(size, 1.0f), response(diffuse_response(light)) {}
  // The response's texel, three values on, that a normal falls into.
  size_t bin_of(const Vec3f& normal) const {
    const CubePoint at = cube_point(normal.cast<double>());
    const int n = response.size;
    const auto cell = [n](double t) {
      return std::clamp(static_cast<int>((t + 1) * 0.5 * n), 0, n - 1);
    };
    return 3 * ((static_cast<size_t>(at.face) * n + cell(at.t)) * n + cell(at.s));
  }

  Prefilter prefilter;
  Cubemap light;                // radiance
  Cubemap response;             // irradiance / pi by normal
  std::vector<size_t> bin;      // of each sample
  std::vector<Rgb> log_albedo;  // of each patch
};

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Log albedo of each patch given the light: the mean over its samples, drawn towards the median of
// all patches the more, the nearer it is to it (Student's t).
void fit_albedo(const std::vector<SurfaceSample>& samples, Fit& fit) {
  const size_t patches = fit.log_albedo.size();
  std::vector<double> count(patches, 0.0);
  std::fill(fit.log_albedo.begin(), fit.log_albedo.end(), Rgb{0, 0, 0});
  for (size_t s = 0; s < samples.size(); ++s) {
    const auto patch = static_cast<size_t>(samples[s].patch);
    ++count[patch];
    for (size_t c = 0; c < 3; ++c)
      fit.log_albedo[patch][c] +=
          std::log(samples[s].radiance[c]) - std::log(fit.response.texels[fit.bin[s] + c]);
  }
  Rgb middle;
  for (size_t c = 0; c < 3; ++c) {
    std::vector<double> values;
    for (size_t p = 0; p < patches; ++p)
      if (count[p] > 0) values.push_back(fit.log_albedo[p][c] /= count[p]);
    middle[c] = median(values);
  }
  for (size_t p = 0; p < patches; ++p) {
    double off = 0;
    for (size_t c = 0; c < 3; ++c) off += std::pow(fit.log_albedo[p][c] - middle[c], 2) / 3;
    const double share = off / (off + kFree * kFree);
    for (size_t c = 0; c < 3; ++c)
      fit.log_albedo[p][c] = middle[c] + share * (fit.log_albedo[p][c] - middle[c]);
  }
}

// Multiplicative least squares of radiance = albedo * response (Lee and Seung 2001): stays positive
// and moves only what the samples see.
void fit_light(const std::vector<SurfaceSample>& samples, Fit& fit) {
  PrefilteredEnvironment told = fit.prefilter.zero_like(), expected = fit.prefilter.zero_like();
  std::vector<float> seen(fit.response.texels.size(), 0.0f);
  for (size_t s = 0; s < samples.size(); ++s) {
    const Rgb& log_albedo = fit.log_albedo[static_cast<size_t>(samples[s].patch)];
    for (size_t c = 0; c < 3; ++c) {
      const size_t at = fit.bin[s] + c;
      const double told_here = samples[s].radiance[c] / std::exp(log_albedo[c]);
      const double off = std::log(told_here / fit.response.texels[at]) / kOutlier;
      const double weight = 1 / (1 + off * off);
      seen[at] += static_cast<float>(weight);
      told.diffuse.texels[at] += static_cast<float>(weight * told_here);
    }
  }
  std::vector<float>& light = fit.light.texels;
  const auto hold =
      static_cast<float>(3 * kHold * static_cast<double>(samples.size()) / light.size());
  Cubemap up(fit.light.size, hold);
  fit.prefilter.backward(told, up);
  for (int step = 0; step < kSteps; ++step) {
    for (size_t i = 0; i < seen.size(); ++i)
      expected.diffuse.texels[i] = seen[i] * fit.response.texels[i];
    Cubemap down = fit.light;
    for (float& value : down.texels) value *= hold;
    fit.prefilter.backward(expected, down);
    for (size_t i = 0; i < light.size(); ++i) light[i] *= up.texels[i] / down.texels[i];
    fit.response = fit.prefilter.forward(fit.light).diffuse;
  }
}

void make_mean_one(Fit& fit) {
  Rgb mean{0, 0, 0};
  const int n = fit.light.size;
  for (int face = 0, i = 0; face < 6; ++face)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x, i += 3)
        for (int c = 0; c < 3; ++c)
          mean[c] += cubemap_solid_angle(x, y, n) / (4 * std::numbers::pi) *
                     fit.light.texels[static_cast<size_t>(i + c)];
  for (Cubemap* map : {&fit.light, &fit.response})
    for (size_t i = 0; i < map->texels.size(); ++i)
      map->texels[i] /= static_cast<float>(mean[i % 3]);
}

// Without those that are too dark to tell of the light in every channel.
std::vector<SurfaceSample> bright_enough(const std::vector<SurfaceSample>& samples) {
  std::vector<double> levels;
  for (const SurfaceSample& s : samples) levels.push_back(s.radiance[1]);
  const auto least = static_cast<float>(kDark * median(levels));
  std::vector<SurfaceSample> kept;
  for (const SurfaceSample& s : samples)
    if (std::min({s.radiance[0], s.radiance[1], s.radiance[2]}) > std::max(least, 1e-5f))
      kept.push_back(s);
  return kept;
}

}  // namespace

Cubemap start_light(const std::vector<SurfaceSample>& all_samples, int patches, int size) {
  if (all_samples.empty()) return Cubemap(size, 1.0f);
  const std::vector<SurfaceSample> samples = bright_enough(all_samples);
  if (samples.empty()) return Cubemap(size, 1.0f);
  Fit fit(size);
  fit.log_albedo.resize(static_cast<size_t>(patches));
  fit.bin.reserve(samples.size());
  for (const SurfaceSample& s : samples) {
    EFFIGY_CHECK(s.patch >= 0 && s.patch < patches);
    fit.bin.push_back(fit.bin_of(s.normal));
  }
  for (int round = 0; round < kRounds; ++round) {
    fit_albedo(samples, fit);
    fit_light(samples, fit);
    make_mean_one(fit);
  }
  return fit.light;
}

Cubemap diffuse_response(const Cubemap& light) {
  return Prefilter(light.size).forward(light).diffuse;
}

}  // namespace effigy
