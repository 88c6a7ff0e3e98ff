#include "effigy/synth/tracking_error.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/random.h"

namespace effigy {
namespace {

constexpr double kTranslation = 1e-3, kRotation = 0.5 * std::numbers::pi / 180, kExpression = 0.03;

// One parameter's error over time, of variance about 1.
class Wander {
 public:
  Wander(uint64_t seed, uint64_t parameter) {
    Random random(seed ^ 0x747261636bULL, parameter);
    constant_ = random.normal() / std::sqrt(3.0);
    for (Wave& wave : waves_) {
      wave.rate = 2 * std::numbers::pi / random.uniform(0.4, 2.5);
      wave.phase = random.uniform(0, 2 * std::numbers::pi);
    }
  }
  double at(double seconds) const {
    double sum = constant_;
    // Four sines of variance 1/2 each make up the remaining two thirds.
    for (const Wave& wave : waves_)
      sum += std::sqrt(1.0 / 3.0) * std::sin(wave.rate * seconds + wave.phase);
    return sum;
  }

 private:
  struct Wave {
    double rate = 0, phase = 0;
  };
  double constant_ = 0;
  Wave waves_[4];
};

}  // namespace

std::vector<RigPose> with_tracking_error(const Rig& rig, const std::vector<RigPose>& poses,
                                         double frames_per_second, double amount, uint64_t seed) {
  if (amount <= 0) return poses;
  std::vector<RigPose> tracked = poses;
  uint64_t parameter = 0;
  const auto disturb = [&](double deviation, auto&& value_of) {
    const Wander wander(seed, parameter++);
    for (size_t f = 0; f < tracked.size(); ++f)
      value_of(tracked[f]) += static_cast<float>(
          amount * deviation * wander.at(static_cast<double>(f) / frames_per_second));
  };
  for (size_t c = 0; c < 3; ++c)
    disturb(kTranslation, [&](RigPose& p) -> float& { return p.translation[c]; });
  for (int j = 0; j < rig.joint_count(); ++j) {
    if (rig.joint_names[j].rfind("eye", 0) == 0) continue;
    for (int c = 0; c < 3; ++c)
      disturb(kRotation, [&](RigPose& p) -> float& { return p.joint_rotation[3 * j + c]; });
  }
  for (int e = 0; e < rig.expression_count; ++e) {
    disturb(kExpression, [&](RigPose& p) -> float& { return p.expression[e]; });
    for (RigPose& pose : tracked)
      pose.expression[e] =
          std::clamp(pose.expression[e], rig.expression_low[e], rig.expression_high[e]);
  }
  return tracked;
}

}  // namespace effigy
