#include "effigy/light/builtin_lights.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/geometry/types.h"
#include "effigy/image/colour.h"

// Lights are functions of direction, averaged over each pixel and scaled to mean radiance 1. People
// look along +z, so "front" is +z.

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kWidth = 256, kHeight = 128, kSub = 6;

using Light = std::function<Vec3d(const Vec3d&)>;

double smoothstep(double low, double high, double x) {
  const double t = std::clamp((x - low) / (high - low), 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

// Longitude in degrees from the front, positive towards +x, and elevation in degrees.
Vec3d from_angles(double longitude, double elevation) {
  const double a = longitude * kPi / 180.0, e = elevation * kPi / 180.0;
  return {std::cos(e) * std::sin(a), std::sin(e), std::cos(e) * std::cos(a)};
}

// A soft box: a rectangle of half sizes `w` x `h` (tangents) around `center`, upright, with edges
// `soft` wide and a brighter middle.
double soft_box(const Vec3d& d, const Vec3d& center, double w, double h, double soft) {
  const double depth = d.dot(center);
  if (depth <= 0.05) return 0.0;
  const Vec3d right = Vec3d(0, 1, 0).cross(center).normalized(), up = center.cross(right);
  const double x = std::abs(d.dot(right) / depth), y = std::abs(d.dot(up) / depth);
  const double inside = (1.0 - smoothstep(w - soft, w, x)) * (1.0 - smoothstep(h - soft, h, y));
  const double hot = std::exp(-2.0 * ((x * x) / (w * w) + (y * y) / (h * h)));
  return inside * (0.6 + 0.4 * hot);
}

Vec3d studio(const Vec3d& d) {
  static const Vec3d key = from_angles(-42, 38), fill = from_angles(62, 8),
                     rim = from_angles(150, 30), hair = from_angles(-160, 62);
  const double up = 0.5 + 0.5 * d.y();
  Vec3d light = Vec3d(0.11, 0.115, 0.125) * (0.45 + 0.75 * up);
  light += Vec3d(38.0, 35.5, 32.0) * soft_box(d, key, 0.34, 0.46, 0.06);
  light += Vec3d(4.2, 4.7, 5.6) * soft_box(d, fill, 0.42, 0.75, 0.12);
  light += Vec3d(22.0, 24.5, 29.0) * soft_box(d, rim, 0.10, 0.62, 0.03);
  light += Vec3d(15.0, 14.0, 12.5) * soft_box(d, hair, 0.30, 0.16, 0.05);
  return light;
}

Vec3d overcast(const Vec3d& d) {
  static const Vec3d bright = from_angles(-35, 55);
  // CIE overcast sky: zenith three times the horizon; clouds thinner around one direction.
  const double y = d.y();
  const Vec3d sky = Vec3d(0.93, 1.0, 1.10) * (1.0 + 2.0 * std::max(y, 0.0)) / 3.0 * 2.4 +
                    Vec3d(1.7, 1.62, 1.5) * std::exp(5.0 * (d.dot(bright) - 1.0));
  const Vec3d ground = Vec3d(0.30, 0.29, 0.25) * (1.0 + 0.5 * y);
  const double horizon = smoothstep(-0.03, 0.03, y);
  return ground + horizon * (sky - ground);
}

Vec3d sunset(const Vec3d& d) {
  static const Vec3d sun = from_angles(48, 9);
  constexpr double kSunRadius = 0.9 * kPi / 180.0;
  const double y = std::max(d.y(), 0.0), toward = d.dot(sun);
  // Blue above, orange along the horizon, more so towards the sun.
  const double low = std::exp(-5.5 * y), side = 0.5 + 0.5 * toward;
  Vec3d sky = Vec3d(0.16, 0.30, 0.62) * (0.55 + 0.45 * y);
  sky += Vec3d(1.5, 0.62, 0.20) * low * (0.25 + 1.35 * side * side * side);
  sky += Vec3d(3.2, 1.45, 0.48) * std::exp(22.0 * (toward - 1.0));
  const Vec3d ground = Vec3d(0.085, 0.066, 0.052) * (0.7 + 0.9 * side) * (1.0 + 0.4 * d.y());
  const double horizon = smoothstep(-0.012, 0.012, d.y());
  Vec3d light = ground + horizon * (sky - ground);
  const double angle = std::atan2(d.cross(sun).norm(), toward);
  light += Vec3d(3400.0, 1900.0, 820.0) * (1.0 - smoothstep(0.94 * kSunRadius, kSunRadius, angle));
  return light;
}

Vec3d window(const Vec3d& d) {
  static const Vec3d pane = from_angles(78, 24), lamp = from_angles(-115, 38);
  // A room: pale ceiling, darker walls, wooden floor, lit by one tall window and a lamp.
  const double up = smoothstep(0.55, 0.75, d.y()), down = smoothstep(0.5, 0.7, -d.y());
  Vec3d light = Vec3d(0.30, 0.28, 0.25) * (0.6 + 0.4 * d.x());
  light += up * (Vec3d(0.62, 0.60, 0.56) - light);
  light += down * (Vec3d(0.16, 0.11, 0.07) - light);
  light += Vec3d(13.0, 15.0, 18.0) * soft_box(d, pane, 0.42, 0.75, 0.03);
  light += Vec3d(60.0, 36.0, 16.0) * (1.0 - smoothstep(0.07, 0.09, (d - lamp).norm()));
  return light;
}

Image paint(const Light& light) {
  Image image(kWidth, kHeight, 3);
  double total = 0.0, weights = 0.0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      Vec3d sum = Vec3d::Zero();
      double weight = 0.0;
      for (int i = 0; i < kSub * kSub; ++i) {
        const double theta = kPi * (y + (i / kSub + 0.5) / kSub) / kHeight;
        const double phi = 2.0 * kPi * ((x + (i % kSub + 0.5) / kSub) / kWidth - 0.5);
        const double w = std::sin(theta);
        sum += w * light({w * std::sin(phi), std::cos(theta), -w * std::cos(phi)});
        weight += w;
      }
      const Vec3f mean = (sum / weight).cast<float>();
      Eigen::Map<Vec3f>(image.at(x, y)) = mean;
      total += weight * luminance(mean.x(), mean.y(), mean.z());
      weights += weight;
    }
  }
  for (float& value : image.data) value *= static_cast<float>(weights / total);
  return image;
}

}  // namespace

std::vector<std::string> builtin_light_names() {
  return {"studio", "overcast", "sunset", "window"};
}

Image builtin_light(const std::string& name) {
  if (name == "studio") return paint(studio);
  if (name == "overcast") return paint(overcast);
  if (name == "sunset") return paint(sunset);
  if (name == "window") return paint(window);
  throw Error("There is no built-in light named \"" + name +
              "\"; choose studio, overcast, sunset or window.");
}

}  // namespace effigy
