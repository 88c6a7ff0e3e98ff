#include "effigy/body/fill_maps.h"

#include <algorithm>

#include "effigy/base/error.h"
#include "effigy/geometry/gutter.h"

namespace effigy {
namespace {

constexpr size_t kFrames = 16;
constexpr float kHidden = 0.1f;  // of the 90th percentile

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

}  // namespace

std::vector<size_t> standing_in(const UvTexels& texels, std::span<const float> presence) {
  const size_t n = texels.count();
  EFFIGY_CHECK_EQ(presence.size(), n);
  std::vector<float> sorted(presence.begin(), presence.end());
  const auto high = sorted.begin() + static_cast<std::ptrdiff_t>(n * 9 / 10);
  std::nth_element(sorted.begin(), high, sorted.end());
  std::vector<int32_t> shown(static_cast<size_t>(texels.size) * static_cast<size_t>(texels.size),
                             -1);
  for (size_t i = 0; i < n; ++i)
    if (presence[i] >= kHidden * *high)
      shown[static_cast<size_t>(texels.texel[i])] = static_cast<int32_t>(i);
  const std::vector<int> nearest = nearest_shown(texels.size, shown);
  std::vector<size_t> from(n);
  for (size_t i = 0; i < n; ++i)
    from[i] = static_cast<size_t>(
        shown[static_cast<size_t>(nearest[static_cast<size_t>(texels.texel[i])])]);
  return from;
}

void fill_hidden_maps(StageMoments& moments, BodyModel& model) {
  const std::vector<size_t> from = standing_in(model.texels(), presences(moments, model));
  const BodyMaps before = model.maps();
  for (size_t i = 0; i < from.size(); ++i) {
    std::copy_n(&before.albedo[3 * from[i]], 3, &model.maps().albedo[3 * i]);
    model.maps().log_roughness[i] = before.log_roughness[from[i]];
  }
}

}  // namespace effigy
