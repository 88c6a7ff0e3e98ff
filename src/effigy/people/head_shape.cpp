#include "effigy/people/head_shape.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

double ellipsoid(const Vec3d& p, const Vec3d& centre, const Vec3d& radii) {
  const Vec3d q = p - centre;
  const double k0 = q.cwiseQuotient(radii).norm();
  const double k1 = q.cwiseQuotient(radii.cwiseProduct(radii)).norm();
  return k1 > 1e-9 ? k0 * (k0 - 1.0) / k1 : -radii.minCoeff();
}

// A capsule whose radius goes from ra at a to rb at b.
double limb(const Vec3d& p, const Vec3d& a, const Vec3d& b, double ra, double rb) {
  const Vec3d ab = b - a;
  const double t = std::clamp((p - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0);
  return (p - a - t * ab).norm() - (ra + t * (rb - ra));
}

// Smooth union, blending over about k millimetres.
double join(double a, double b, double k) {
  const double h = std::max(k - std::abs(a - b), 0.0) / k;
  return std::min(a, b) - h * h * k * 0.25;
}
// Smooth difference a - b.
double carve(double a, double b, double k) {
  return -join(-a, b, k);
}

double skull(const Vec3d& p) {
  double d = ellipsoid(p, {0, 30, -16}, {74, 82, 86});
  d = join(d, ellipsoid(p, {0, 26, 14}, {63, 68, 77}), 20);
  return join(d, ellipsoid(p, {0, -8, -40}, {56, 52, 52}), 30);
}

double face(const Vec3d& p, double d) {
  d = join(d, ellipsoid(p, {0, -32, 32}, {55, 60, 50}), 24);
  d = join(d, ellipsoid(p, {0, -64, 56}, {33, 34, 34}), 18);        // maxilla
  d = join(d, limb(p, {39, -74, 14}, {13, -101, 74}, 13, 13), 18);  // mandible
  d = join(d, limb(p, {40, -70, 10}, {50, -14, 4}, 14, 16), 24);    // ramus
  d = join(d, ellipsoid(p, {0, -80, 44}, {36, 30, 40}), 20);        // floor of the mouth
  d = join(d, ellipsoid(p, {0, -102, 78}, {18, 14, 15}), 16);       // chin
  d = join(d, limb(p, {42, -22, 56}, {54, -16, 20}, 14, 12), 26);   // cheekbone
  return join(d, ellipsoid(p, {32, -52, 52}, {25, 32, 26}), 20);    // cheek
}

double neck(const Vec3d& p, double d) {
  d = join(d, limb(p, {0, -60, -28}, {0, -215, -28}, 47, 51), 26);
  d = join(d, limb(p, {47, -50, -22}, {14, -200, 20}, 8, 9), 20);     // sternomastoid
  d = join(d, limb(p, {18, -70, -56}, {40, -235, -52}, 16, 34), 34);  // trapezius
  return join(d, limb(p, {0, -132, 16}, {0, -150, 14}, 8, 9), 18);    // larynx
}

double eyes(const Vec3d& p, double d) {
  d = join(d, limb(p, {9, 15, 82}, {34, 19, 73}, 8, 8), 18);  // brow
  d = join(d, limb(p, {34, 19, 73}, {50, 4, 54}, 8, 9), 18);
  d = carve(d, ellipsoid(p, {30, 0, 88}, {18, 12, 16}), 14);          // socket
  return join(d, (p - Vec3d(kEyeX, kEyeY, kEyeZ)).norm() - 13.2, 6);  // lids on the eyeball
}

double nose(const Vec3d& p, double d) {
  d = join(d, limb(p, {0, 8, 80}, {0, -34, 98}, 8, 8.5), 14);
  d = join(d, ellipsoid(p, {0, -39, 102}, {9.5, 9, 11}), 10);
  d = join(d, ellipsoid(p, {11, -43, 91}, {6.5, 7, 10}), 8);
  d = join(d, limb(p, {0, -44, 102}, {0, -50, 90}, 4.5, 5), 6);
  return carve(d, ellipsoid(p, {6.5, -50.8, 98}, {3.2, 3, 5}), 3);  // nostril
}

// A lip: a tube that bends back from the middle to the corner and thins out.
double lip(const Vec3d& p, double y, double z, double radius, double corner_y) {
  const double side = p.x() / (kMouthHalfWidth + 2);
  const double s = std::min(side * side, 1.0);
  const Vec3d axis(std::min(p.x(), kMouthHalfWidth + 2), y + (corner_y - y) * s * side,
                   z - 13.5 * s);
  const Vec3d q = p - axis;
  const double r = radius * (1 - 0.62 * s);
  return (Vec3d(q.x(), q.y() * 1.05, q.z() * 0.9).norm() - r) * 0.8;
}

double mouth(const Vec3d& p, double d) {
  d = carve(d, limb(p, {0, -54, 101}, {0, -63, 102}, 2.5, 3.5), 6);  // philtrum
  const double upper = lip(p, -67.6, 91.0, 6.2, kMouthY + 1.2);
  const double lower = lip(p, -78.6, 89.5, 7.0, kMouthY - 1.0);
  return join(d, join(upper, lower, 1.5), 7);
}

// Height of the hairline over the angle from the front, degrees: forehead, temple, sideburn, over
// the ear, behind it, nape.
double hairline(double angle) {
  static constexpr std::array<std::pair<double, double>, 10> kLine = {{{0, 66},
                                                                       {28, 66},
                                                                       {46, 60},
                                                                       {60, 38},
                                                                       {70, 12},
                                                                       {76, -6},
                                                                       {92, 24},
                                                                       {112, 14},
                                                                       {122, -36},
                                                                       {180, -72}}};
  for (size_t i = 1; i < kLine.size(); ++i)
    if (angle <= kLine[i].first) {
      const double t = (angle - kLine[i - 1].first) / (kLine[i].first - kLine[i - 1].first);
      return mix(kLine[i - 1].second, kLine[i].second, smooth_step(0, 1, t));
    }
  return kLine.back().second;
}

}  // namespace

double hair_cover(const Vec3d& p, double soft) {
  const double angle = std::atan2(std::abs(p.x()), p.z() + 5) * 180 / std::numbers::pi;
  const double above = p.y() - hairline(angle);
  return smooth_step(-0.5 * soft, 0.5 * soft, above);
}

double head_distance(const Vec3d& point) {
  // Rounded at the mirror plane, so that the two halves meet without a crease.
  const Vec3d p(std::sqrt(point.x() * point.x() + 5.0), point.y(), point.z());
  double d = skull(p);
  d = face(p, d);
  d = neck(p, d);
  d = eyes(p, d);
  d = nose(p, d);
  d = mouth(p, d);
  // Short hair: a soft shell over the scalp.
  return p.y() > -80 && d < 40 ? d - 4.5 * hair_cover(p, 22) : d;
}

Vec3d head_normal(const Vec3d& p) {
  constexpr double kStep = 0.05;
  Vec3d g;
  for (int c = 0; c < 3; ++c) {
    Vec3d e = Vec3d::Zero();
    e[c] = kStep;
    g[c] = head_distance(p + e) - head_distance(p - e);
  }
  return g.normalized();
}

Vec3d march_head(const Vec3d& origin, const Vec3d& direction, double length) {
  double t = 0;
  for (int step = 0; step < 200 && t < length; ++step) {
    const double d = head_distance(origin + t * direction);
    if (std::abs(d) < 1e-4) break;
    t += 0.7 * d;
  }
  return origin + std::min(t, length) * direction;
}

}  // namespace effigy::people
