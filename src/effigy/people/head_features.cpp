#include "effigy/people/head_features.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

double square(double x) {
  return x * x;
}

// How much of a furrow along the polyline is at p: 1 on it, fading over `width`, and towards its
// two ends.
double furrow(const Vec3d& p, std::span<const Vec3d> line, double width) {
  double best = 1e30, along = 0;
  for (size_t i = 1; i < line.size(); ++i) {
    const Vec3d ab = line[i] - line[i - 1];
    const double t = std::clamp((p - line[i - 1]).dot(ab) / ab.squaredNorm(), 0.0, 1.0);
    const double squared = (p - line[i - 1] - t * ab).squaredNorm();
    if (squared < best) {
      best = squared;
      along = (static_cast<double>(i - 1) + t) / static_cast<double>(line.size() - 1);
    }
  }
  const double ends = smooth_step(0, 0.25, along) * (1 - smooth_step(0.75, 1, along));
  return ends * std::exp(-best / square(width));
}

// 1 at the middle of the mouth, 0 at the corner.
double lip_height(double x, double power) {
  return std::pow(std::max(0.0, 1 - square(x / 27.0)), power);
}

}  // namespace

double lip_line(double x) {
  const double s = std::min(std::abs(x) / kMouthHalfWidth, 1.0);
  // Dips in the middle below the tubercle and falls a little towards the corners.
  return kMouthY - 0.7 * std::exp(-square(x / 4.5)) + 0.9 * std::exp(-square((s - 0.42) / 0.25)) -
         0.6 * s * s;
}

double lip_top(double x) {
  const double bow = 1.7 * std::exp(-square(x / 3.2));
  return lip_line(x) + (8.6 - bow) * lip_height(x, 0.72) * (1 - 0.10 * std::abs(x) / 27);
}

double lip_bottom(double x) {
  return lip_line(x) - 9.8 * lip_height(x, 0.62);
}

double add_eye_sockets(const Vec3d& p, double d) {
  if (p.z() < 15 || std::abs(p.y()) > 75) return d;
  d = join(d, limb(p, {8, 15, 82}, {32, 20, 73}, 7.5, 7.5), 16);  // brow
  d = join(d, limb(p, {32, 20, 73}, {49, 9, 55}, 7.5, 7), 24);
  d = carve(d, ellipsoid(p, {29, -1, 90}, {18, 12, 18}), 14);
  d += 0.7 * bump(p, {18, 5, 84}, {7, 8, 14});                     // beside the bridge
  d = join(d, (p - Vec3d(kEyeX, kEyeY, kEyeZ)).norm() - 13.0, 8);  // lids on the eyeball
  d -= 2.6 * bump(p, {35, 10.5, 78}, {17, 6, 14});                 // fat below the brow
  static const std::array<Vec3d, 4> kTear = {
      {{16, -5, 82}, {21, -13.5, 81}, {29, -19, 79}, {38, -21, 74}}};
  return d + 0.5 * furrow(p, kTear, 3.5);
}

double add_nose(const Vec3d& p, double d) {
  if (p.z() < 50 || p.y() > 40 || p.y() < -80 || p.x() > 45) return d;
  d = join(d, limb(p, {0, 8, 81}, {0, -28, 101.5}, 6.4, 6.6), 12);    // bridge
  d = join(d, limb(p, {6, -4, 78}, {8.5, -36, 92}, 6, 9), 12);        // side walls
  d = join(d, ellipsoid(p, {3.2, -40, 107}, {7.4, 7.4, 9.0}), 7);     // tip
  d = join(d, ellipsoid(p, {11.8, -45, 94.5}, {5.6, 6.6, 10.5}), 5);  // wing
  d = join(d, limb(p, {0, -46, 108}, {0, -52, 96}, 3.4, 4.2), 5);     // columella
  static const std::array<Vec3d, 5> kWing = {
      {{8.5, -37.5, 107}, {12.5, -37, 100}, {17, -38.5, 93}, {19.5, -43.5, 88}, {18.5, -50, 87}}};
  d += 1.3 * furrow(p, kWing, 2.2);
  return carve(d, ellipsoid(p, {7.2, -53.5, 100.5}, {2.4, 4.0, 4.4}), 2.5);  // nostril
}

double add_mouth(const Vec3d& p, double d) {
  if (p.z() < 55 || std::abs(p.y() - kMouthY) > 40 || p.x() > 50) return d;
  const double x = p.x(), y = p.y();
  d -= 4.5 * bump(p, {0, -69, 92}, {26, 17, 28});  // teeth behind
  // Philtrum: two columns from the columella to the peaks of Cupid's bow, a groove between.
  const double column_x = mix(3.2, 5.6, smooth_step(-53, -65, y));
  const double between = smooth_step(-49, -55, y) * (1 - smooth_step(-63, -68, y));
  d -= between * (0.9 * std::exp(-square((x - column_x) / 2.1)) - 0.7 * std::exp(-square(x / 2.4)));
  // Lips: relief over the front view, in shares of the way from the line to the border.
  const double line = lip_line(x), height = lip_height(x, 0.8);
  double relief = 0;
  if (y > line) {
    const double t = (y - line) / std::max(lip_top(x) - line, 0.8);
    relief = t < 1 ? -2.6 * square(1 - std::min(t / 0.38, 1.0)) +
                         2.4 * (1 - square((std::min(t, 1.0) - 0.38) / 0.85))
                   : 2.4 * (1 - square(0.62 / 0.85)) * std::exp(-square((y - lip_top(x)) / 6.5));
    relief += 0.5 * std::exp(-square((t - 1.04) / 0.16)) +
              0.8 * std::exp(-square(x / 4.2)) * std::exp(-square((t - 0.3) / 0.4));
  } else {
    const double t = (line - y) / std::max(line - lip_bottom(x), 0.8);
    relief = t < 1 ? -2.6 * square(1 - std::min(t / 0.42, 1.0)) +
                         3.6 * (1 - square((std::min(t, 1.0) - 0.42) / 0.75))
                   : 3.6 * (1 - square(0.58 / 0.75)) * std::exp(-square((lip_bottom(x) - y) / 5.0));
    relief -= 0.5 * std::exp(-square(x / 3.0)) * std::exp(-square((t - 0.4) / 0.4));
  }
  d -= height * relief * smooth_step(60, 76, p.z());
  d += 2.0 * bump(p, {0, -90.5, 90}, {17, 4.5, 16});      // fold above the chin
  d += 1.6 * bump(p, {27.5, -73.5, 78}, {4.0, 4.0, 14});  // corner
  d -= 1.2 * bump(p, {33, -76, 72}, {6, 8, 16});          // muscle knot beside it
  static const std::array<Vec3d, 4> kFold = {
      {{19, -42, 86}, {25, -52, 84}, {31, -63, 79}, {35, -74, 72}}};
  return d + 0.9 * furrow(p, kFold, 4.0);
}

}  // namespace effigy::people
