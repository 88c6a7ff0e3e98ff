#include "effigy/people/head_domain.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kRadians = std::numbers::pi / 180.0;
constexpr double kNeckLevel = -55;

struct Ray {
  double y, z;       // origin on the mirror plane
  double elevation;  // radians
};

// Below kNeckLevel the origin slides down the neck while the ray turns level again; the rates are
// chosen so that rays do not cross where the skin is.
Ray ray_at(double level) {
  if (level >= kNeckLevel) return {0, -5, level * kRadians};
  const double w = (kNeckLevel - level) / (kNeckLevel - kLevelBottom);
  return {kNeckBottom * w, -5 - 18 * w, (kNeckLevel * (1 - w * w)) * kRadians};
}

// A monotone function given by its slope, tabulated: value(x) for x in [low, high] -> [0, 1].
template <typename Slope>
class Ramp {
 public:
  Ramp(double low, double high, Slope slope) : low_(low), high_(high) {
    double sum = 0;
    for (int i = 0; i <= kSteps; ++i) {
      value_[i] = sum;
      sum += slope(low + (high - low) * (i + 0.5) / kSteps);
    }
    for (double& v : value_) v /= value_[kSteps];
  }
  double operator()(double x) const {
    const double s = std::clamp((x - low_) / (high_ - low_), 0.0, 1.0) * kSteps;
    const int i = std::min(static_cast<int>(s), kSteps - 1);
    return value_[i] + (s - i) * (value_[i + 1] - value_[i]);
  }

 private:
  static constexpr int kSteps = 400;
  double low_, high_;
  std::array<double, kSteps + 1> value_{};
};

// Most texels on the face: UV per degree is largest in front and at face height.
double across(double azimuth) {
  static const Ramp ramp(0, 180,
                         [](double a) { return 0.40 + 0.80 * (1 - smooth_step(55, 125, a)); });
  return ramp(azimuth);
}
double along(double level) {
  static const Ramp ramp(kLevelBottom, kLevelTop, [](double t) {
    return 0.42 + 0.80 * smooth_step(-72, -52, t) * (1 - smooth_step(28, 55, t));
  });
  return ramp(level);
}

// Width of the atlas at a level: the crown runs to a point, the neck is narrowed, which leaves the
// corners free for eyes, teeth and tongue.
double width(double level) {
  const double crown = level > 5 ? std::cos((level - 5) / (kLevelTop - 5) * 90 * kRadians) : 1.0;
  return 0.485 * crown * (1 - 0.24 * (1 - smooth_step(-85, -50, level)));
}

}  // namespace

Vec3d point_at(double azimuth, double level) {
  const Ray ray = ray_at(level);
  const double a = azimuth * kRadians;
  const Vec3d direction(std::sin(a) * std::cos(ray.elevation), std::sin(ray.elevation),
                        std::cos(a) * std::cos(ray.elevation));
  const Vec3d origin(0, ray.y, ray.z);
  constexpr double kOutside = 200;
  Vec3d p = march_head(origin + kOutside * direction, -direction, kOutside);
  if (azimuth <= 0 || azimuth >= 180 || level >= kLevelTop) p.x() = 0;
  return p;
}

Vec2d domain_of(const Vec3d& p) {
  double low = kLevelBottom, high = kLevelTop;
  for (int i = 0; i < 40; ++i) {
    const double level = 0.5 * (low + high);
    const Ray ray = ray_at(level);
    const double reach = std::hypot(p.x(), p.z() - ray.z);
    const bool above = (p.y() - ray.y) * std::cos(ray.elevation) > reach * std::sin(ray.elevation);
    (above ? low : high) = level;
  }
  const double level = 0.5 * (low + high);
  return {std::atan2(std::max(p.x(), 0.0), p.z() - ray_at(level).z) / kRadians, level};
}

Vec2d uv_at(double azimuth, double level) {
  return {0.5 + across(azimuth) * width(level), 0.015 + 0.97 * along(level)};
}

}  // namespace effigy::people
