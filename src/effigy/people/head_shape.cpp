#include "effigy/people/head_shape.h"

#include <algorithm>
#include <cmath>

#include "effigy/people/head_features.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

double skull(const Vec3d& p) {
  double d = ellipsoid(p, {0, 33, -14}, {75, 80.5, 85});
  d = join(d, ellipsoid(p, {0, 29, 18}, {64, 63, 71.5}), 24);
  d = join(d, ellipsoid(p, {0, 0, -42}, {54, 48, 51}), 30);
  return d + 1.2 * bump(p, {68, 10, 44}, {14, 22, 22});  // temple
}

double face(const Vec3d& p, double d) {
  d = join(d, ellipsoid(p, {0, -28, 33}, {57, 58, 49}), 24);
  d = join(d, ellipsoid(p, {0, -64, 56}, {33, 33, 37}), 18);       // maxilla
  d = join(d, limb(p, {44, -74, 6}, {15, -101, 72}, 13, 13), 20);  // mandible
  d = join(d, limb(p, {44, -72, 4}, {54, -14, 2}, 14, 15), 24);    // ramus
  d = join(d, ellipsoid(p, {0, -84, 43}, {37, 29, 40}), 20);       // floor of the mouth
  d = join(d, ellipsoid(p, {0, -102, 78}, {17, 14, 16}), 16);      // chin
  d = join(d, limb(p, {41, -24, 60}, {59, -14, 20}, 12, 11), 26);  // cheekbone
  d = join(d, ellipsoid(p, {33, -52, 51}, {26, 35, 28}), 20);      // cheek
  d -= 1.2 * bump(p, {38, -27, 74}, {17, 11, 22});                 // malar fat
  d += 0.8 * bump(p, {50, -50, 46}, {14, 20, 26});                 // hollow below the cheekbone
  return d - 1.5 * bump(p, {56, -64, 10}, {12, 22, 20});           // masseter
}

double neck(const Vec3d& p, double d) {
  d = join(d, limb(p, {0, -50, -22}, {0, -215, -40}, 44, 54), 26);
  d = join(d, limb(p, {0, -100, 16}, {0, -200, -4}, 22, 26), 24);     // throat
  d = join(d, limb(p, {53, -40, -26}, {13, -196, 18}, 8, 8), 16);     // sternomastoid
  d = join(d, limb(p, {14, -40, -54}, {54, -205, -58}, 15, 25), 36);  // trapezius
  d = join(d, limb(p, {20, -206, 0}, {70, -214, -30}, 9, 15), 30);    // collar bone
  return join(d, limb(p, {0, -130, 27}, {0, -148, 22}, 7, 8), 16);    // larynx
}

}  // namespace

double head_distance(const Vec3d& point) {
  // Rounded at the mirror plane, so that the two halves meet without a crease.
  const Vec3d p(std::sqrt(point.x() * point.x() + 5.0), point.y(), point.z());
  double d = skull(p);
  d = face(p, d);
  d = neck(p, d);
  d = add_eye_sockets(p, d);
  d = add_nose(p, d);
  d = add_mouth(p, d);
  return d;
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
