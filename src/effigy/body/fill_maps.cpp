#include "effigy/body/fill_maps.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr size_t kFrames = 16;
constexpr size_t kGrain = 256;
constexpr float kHidden = 0.1f;  // of the 90th percentile
constexpr int kFarthest = 32;    // texels

// Opacity times the two larger scales in texels, summed over some training frames.
std::vector<float> presences(StageMoments& moments, BodyModel& model) {
  const StageCapture& capture = moments.source().capture();
  const std::vector<int> frames = capture.frames_of(StageSplit::kTrain);
  const size_t count = std::min(kFrames, frames.size());
  std::vector<float> sum(model.texels().count(), 0.0f);
  for (size_t k = 0; k < count; ++k) {
    try {
      model.pose(moments.moment(moments.source().moment(frames[k * frames.size() / count])));
    } catch (const Error&) {
      continue;  // a damaged frame, which training has counted
    }
    const UvGaussians& g = model.surface().placed;
    for (size_t i = 0; i < sum.size(); ++i) {
      float scale[3] = {g.scale[3 * i], g.scale[3 * i + 1], g.scale[3 * i + 2]};
      std::sort(scale, scale + 3);
      const float spacing = model.texels().spacing[i];
      sum[i] += g.opacity[i] * scale[1] * scale[2] / (spacing * spacing);
    }
  }
  return sum;
}

float hidden_below(std::span<const float> presence) {
  std::vector<float> sorted(presence.begin(), presence.end());
  const auto high = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() * 9 / 10);
  std::nth_element(sorted.begin(), high, sorted.end());
  return kHidden * *high;
}

}  // namespace

void fill_hidden_texels(const UvTexels& texels, std::span<const float> presence, size_t channels,
                        std::span<float> map) {
  const size_t n = texels.count();
  EFFIGY_CHECK_EQ(presence.size(), n);
  EFFIGY_CHECK_EQ(map.size(), channels * n);
  if (n == 0) return;
  const float least = hidden_below(presence);
  const int size = texels.size;
  std::vector<int32_t> shown(static_cast<size_t>(size) * static_cast<size_t>(size), -1);
  for (size_t i = 0; i < n; ++i)
    if (presence[i] >= least) shown[static_cast<size_t>(texels.texel[i])] = static_cast<int32_t>(i);
  const std::vector<float> before(map.begin(), map.end());
  const auto fill = [&](size_t i) {
    const int x = texels.texel[i] % size, y = texels.texel[i] / size;
    // The smallest square around the texel that holds others which show.
    for (int radius = 1; radius <= kFarthest; ++radius) {
      std::vector<double> sum(channels, 0.0);
      double weights = 0;
      for (int v = std::max(0, y - radius); v <= std::min(size - 1, y + radius); ++v)
        for (int u = std::max(0, x - radius); u <= std::min(size - 1, x + radius); ++u) {
          const int32_t other =
              shown[static_cast<size_t>(v) * static_cast<size_t>(size) + static_cast<size_t>(u)];
          if (other < 0) continue;
          const auto k = static_cast<size_t>(other);
          const double far = (u - x) * (u - x) + (v - y) * (v - y);
          const double weight = static_cast<double>(presence[k]) / far;
          weights += weight;
          for (size_t c = 0; c < channels; ++c)
            sum[c] += weight * static_cast<double>(before[channels * k + c]);
        }
      if (weights <= 0) continue;
      for (size_t c = 0; c < channels; ++c)
        map[channels * i + c] = static_cast<float>(sum[c] / weights);
      return;
    }
  };
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i)
      if (presence[i] < least) fill(i);
  });
}

void fill_hidden_maps(StageMoments& moments, BodyModel& model) {
  const std::vector<float> presence = presences(moments, model);
  fill_hidden_texels(model.texels(), presence, 3, model.maps().albedo);
  fill_hidden_texels(model.texels(), presence, 1, model.maps().log_roughness);
}

}  // namespace effigy
