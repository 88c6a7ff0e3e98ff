#include "effigy/head/start_light.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr int kBins = 16;         // of normals and of light: texels a side of a cubemap's face
constexpr int kRounds = 30;       // of light and albedo in turns
constexpr int kSteps = 4;         // of the light, each round
constexpr double kFree = 0.35;    // log albedo off the median that counts half as albedo
constexpr double kOutlier = 0.3;  // log residual that halves a sample's weight
constexpr double kHold = 0.001;   // weight of "as bright as the mean" against all samples
constexpr float kDark = 0.004f;   // radiance relative to the median below which nothing is told

using Rgb = std::array<double, 3>;
constexpr size_t kTexels = size_t{6} * kBins * kBins;

// Cosine lobes: the share of direction j's radiance in normal i's irradiance / pi. Rows sum to 1.
std::vector<float> lobes() {
  std::vector<Vec3f> direction(kTexels);
  std::vector<double> solid(kTexels);
  for (size_t i = 0; i < kTexels; ++i) {
    const int face = static_cast<int>(i / (kBins * kBins)), y = static_cast<int>(i / kBins % kBins),
              x = static_cast<int>(i % kBins);
    direction[i] = cubemap_direction(face, x, y, kBins);
    solid[i] = cubemap_solid_angle(x, y, kBins);
  }
  std::vector<float> rows(kTexels * kTexels);
  for (size_t i = 0; i < kTexels; ++i) {
    float* row = &rows[i * kTexels];
    double sum = 0;
    for (size_t j = 0; j < kTexels; ++j) {
      row[j] = static_cast<float>(solid[j] * std::max(0.0f, direction[i].dot(direction[j])));
      sum += row[j];
    }
    for (size_t j = 0; j < kTexels; ++j) row[j] = static_cast<float>(row[j] / sum);
  }
  return rows;
}

// The texel of a kBins cubemap that a direction falls into.
size_t bin_of(const Vec3f& d) {
  const Vec3f a = d.cwiseAbs();
  int face;
  float u, v, most;
  if (a.x() >= a.y() && a.x() >= a.z()) {
    face = d.x() > 0 ? 0 : 1, most = a.x(), u = d.x() > 0 ? -d.z() : d.z(), v = -d.y();
  } else if (a.y() >= a.z()) {
    face = d.y() > 0 ? 2 : 3, most = a.y(), u = d.x(), v = d.y() > 0 ? d.z() : -d.z();
  } else {
    face = d.z() > 0 ? 4 : 5, most = a.z(), u = d.z() > 0 ? d.x() : -d.x(), v = -d.y();
  }
  const auto cell = [most](float t) {
    return static_cast<size_t>(
        std::clamp(static_cast<int>((t / most + 1) * (0.5f * kBins)), 0, kBins - 1));
  };
  return static_cast<size_t>(face) * kBins * kBins + cell(v) * kBins + cell(u);
}

struct Fit {
  std::vector<float> rows = lobes();
  std::vector<size_t> bin;                              // of each sample
  std::vector<Rgb> light = {kTexels, Rgb{1, 1, 1}};     // radiance
  std::vector<Rgb> response = {kTexels, Rgb{1, 1, 1}};  // irradiance / pi by normal
  std::vector<Rgb> log_albedo;                          // of each patch

  void respond() {
    for (size_t i = 0; i < kTexels; ++i) {
      Rgb sum{0, 0, 0};
      const float* row = &rows[i * kTexels];
      for (size_t j = 0; j < kTexels; ++j)
        for (size_t c = 0; c < 3; ++c) sum[c] += row[j] * light[j][c];
      response[i] = sum;
    }
  }
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
          std::log(samples[s].radiance[c]) - std::log(fit.response[fit.bin[s]][c]);
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
  std::vector<Rgb> seen(kTexels, Rgb{0, 0, 0}), told(kTexels, Rgb{0, 0, 0});
  for (size_t s = 0; s < samples.size(); ++s) {
    const size_t bin = fit.bin[s];
    const Rgb& log_albedo = fit.log_albedo[static_cast<size_t>(samples[s].patch)];
    for (size_t c = 0; c < 3; ++c) {
      const double told_here = samples[s].radiance[c] / std::exp(log_albedo[c]);
      const double off = std::log(told_here / fit.response[bin][c]) / kOutlier;
      const double weight = 1 / (1 + off * off);
      seen[bin][c] += weight;
      told[bin][c] += weight * told_here;
    }
  }
  const double hold = kHold * static_cast<double>(samples.size()) / kTexels;
  for (int step = 0; step < kSteps; ++step) {
    std::vector<Rgb> up(kTexels, Rgb{hold, hold, hold}), down(kTexels);
    for (size_t j = 0; j < kTexels; ++j)
      for (size_t c = 0; c < 3; ++c) down[j][c] = hold * fit.light[j][c];
    for (size_t i = 0; i < kTexels; ++i) {
      if (seen[i][0] + seen[i][1] + seen[i][2] <= 0) continue;
      const float* row = &fit.rows[i * kTexels];
      Rgb expected;
      for (size_t c = 0; c < 3; ++c) expected[c] = seen[i][c] * fit.response[i][c];
      for (size_t j = 0; j < kTexels; ++j)
        for (size_t c = 0; c < 3; ++c) {
          up[j][c] += row[j] * told[i][c];
          down[j][c] += row[j] * expected[c];
        }
    }
    for (size_t j = 0; j < kTexels; ++j)
      for (size_t c = 0; c < 3; ++c) fit.light[j][c] *= up[j][c] / down[j][c];
    fit.respond();
  }
}

void make_mean_one(Fit& fit) {
  Rgb mean{0, 0, 0};
  double all = 0;
  for (size_t j = 0; j < kTexels; ++j) {
    const double solid = cubemap_solid_angle(static_cast<int>(j % kBins),
                                             static_cast<int>(j / kBins % kBins), kBins);
    for (size_t c = 0; c < 3; ++c) mean[c] += solid * fit.light[j][c];
    all += solid;
  }
  for (auto* values : {&fit.light, &fit.response})
    for (Rgb& value : *values)
      for (size_t c = 0; c < 3; ++c) value[c] *= all / mean[c];
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
  Fit fit;
  fit.log_albedo.resize(static_cast<size_t>(patches));
  fit.bin.reserve(samples.size());
  for (const SurfaceSample& s : samples) {
    EFFIGY_CHECK(s.patch >= 0 && s.patch < patches);
    fit.bin.push_back(bin_of(s.normal));
  }
  for (int round = 0; round < kRounds; ++round) {
    fit_albedo(samples, fit);
    fit_light(samples, fit);
    make_mean_one(fit);
  }
  Cubemap coarse(kBins), light(size);
  for (size_t j = 0; j < kTexels; ++j)
    for (size_t c = 0; c < 3; ++c) coarse.texels[3 * j + c] = static_cast<float>(fit.light[j][c]);
  for (int face = 0, i = 0; face < 6; ++face)
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x, i += 3) {
        const Vec3f value = sample_cubemap(coarse, cubemap_direction(face, x, y, size));
        std::copy_n(value.data(), 3, &light.texels[static_cast<size_t>(i)]);
      }
  return light;
}

Cubemap diffuse_response(const Cubemap& light) {
  return Prefilter(light.size).forward(light).diffuse;
}

}  // namespace effigy
