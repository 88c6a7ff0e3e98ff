#include "effigy/people/body_shape.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/people/noise.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kTable = 96;

// Rounded at the mirror plane, so that the two halves meet without a crease.
Vec3d left_half(const Vec3d& p) {
  return {std::sqrt(p.x() * p.x() + 9.0), p.y(), p.z()};
}

// Monotone cubic through (s, value) pairs (Fritsch and Carlson 1980).
double spline(const std::vector<double>& s, const std::vector<double>& value, double x) {
  const size_t n = s.size();
  size_t i = 0;
  while (i + 2 < n && x > s[i + 1]) ++i;
  const auto slope = [&](size_t k) { return (value[k + 1] - value[k]) / (s[k + 1] - s[k]); };
  const auto tangent = [&](size_t k) {
    if (k == 0) return slope(0);
    if (k == n - 1) return slope(n - 2);
    const double a = slope(k - 1), b = slope(k);
    return a * b <= 0 ? 0.0 : 2 * a * b / (a + b);
  };
  const double h = s[i + 1] - s[i], t = std::clamp((x - s[i]) / h, 0.0, 1.0);
  const double t2 = t * t, t3 = t2 * t;
  return (2 * t3 - 3 * t2 + 1) * value[i] + (t3 - 2 * t2 + t) * h * tangent(i) +
         (3 * t2 - 2 * t3) * value[i + 1] + (t3 - t2) * h * tangent(i + 1);
}

}  // namespace

namespace {

double around(const NeckRing& ring, const std::vector<double>& values, const Vec3d& p) {
  const double n = static_cast<double>(values.size());
  double x = std::atan2(p.x() - ring.centre.x(), p.z() - ring.centre.z()) / (2 * kPi) * n;
  x -= n * std::floor(x / n);
  const size_t i = static_cast<size_t>(x) % values.size();
  return mix(values[i], values[(i + 1) % values.size()], x - std::floor(x));
}

}  // namespace

double NeckRing::radius_at(const Vec3d& p) const {
  return around(*this, radius, p);
}
double NeckRing::height_at(const Vec3d& p) const {
  return around(*this, height, p);
}
double NeckRing::highest() const {
  return *std::max_element(height.begin(), height.end());
}

BodyForm::Tube BodyForm::tube(const Vec3d& a, const Vec3d& axis, const Vec3d& u,
                              const std::vector<Station>& stations, double scale, double exponent) {
  Tube t;
  t.a = a;
  t.axis = axis.normalized();
  t.u = (u - t.axis * t.axis.dot(u)).normalized();
  t.v = t.u.cross(t.axis);
  if (t.v.z() < 0 && std::abs(t.v.z()) > 0.3) t.v = -t.v;  // +v is the front
  t.start = stations.front().s;
  t.end = stations.back().s;
  t.exponent = exponent;
  std::vector<double> s;
  std::array<std::vector<double>, 4> values;
  for (const Station& x : stations) {
    s.push_back(x.s);
    values[0].push_back(x.plus_u * scale);
    values[1].push_back(x.minus_u * scale);
    values[2].push_back(x.plus_v * scale);
    values[3].push_back(x.minus_v * scale);
  }
  for (int i = 0; i <= kTable; ++i) {
    std::array<float, 4> row{};
    for (size_t c = 0; c < 4; ++c)
      row[c] = static_cast<float>(spline(s, values[c], t.start + (t.end - t.start) * i / kTable));
    t.table.push_back(row);
  }
  return t;
}

double BodyForm::Tube::distance(const Vec3d& p, double grow) const {
  const Vec3d q = p - a;
  const double s = q.dot(axis), x = q.dot(u), y = q.dot(v);
  const double place = std::clamp((s - start) / (end - start), 0.0, 1.0) * kTable;
  const int i = std::min(static_cast<int>(place), kTable - 1);
  const double f = place - i;
  const auto& r0 = table[static_cast<size_t>(i)];
  const auto& r1 = table[static_cast<size_t>(i) + 1];
  const size_t cx = x >= 0 ? 0 : 1, cy = y >= 0 ? 2 : 3;
  const double rx = mix(static_cast<double>(r0[cx]), static_cast<double>(r1[cx]), f) + grow;
  const double ry = mix(static_cast<double>(r0[cy]), static_cast<double>(r1[cy]), f) + grow;
  const double beyond = s < start ? (start - s) / cap0 : s > end ? (s - end) / cap1 : 0;
  const double nx = std::abs(x) / rx, ny = std::abs(y) / ry;
  double rho2 = nx * nx + ny * ny;
  if (exponent != 2) {
    const double larger = std::max(nx, ny), share = std::min(nx, ny) / std::max(larger, 1e-12);
    const double whole = larger * std::pow(1 + std::pow(share, exponent), 1 / exponent);
    rho2 = whole * whole;
  }
  const double rho = std::sqrt(rho2 + beyond * beyond);
  if (rho < 1e-6) return -std::min(rx, ry);
  const double outside = s < start ? start - s : s > end ? s - end : 0;
  return (1 - 1 / rho) * std::sqrt(x * x + y * y + outside * outside);
}

BodyForm::BodyForm(const BodyBuild& build, const Outfit& outfit, const NeckRing& ring)
    : build_(build), outfit_(outfit), ring_(ring) {
  place_joints();
  make_torso();
  make_limbs();
  make_hand();
  make_clothes();
}

void BodyForm::place_joints() {
  const double k = build_.stature, leg = k * build_.legs, arm = k * build_.arms;
  BodyJoints& j = joints_;
  const double hip_y = 890 * leg;
  const auto above = [&](double y) { return hip_y + (y - 890) * k; };  // of the trunk
  j.hips = {0, above(925), -6};
  j.spine = {0, above(1015), -16};
  j.chest = {0, above(1120), -26};
  j.upper_chest = {0, above(1240), -34};
  j.neck = {0, above(1398), -38};
  j.head = {0, above(1473), -28};
  j.shoulder = {24, above(1374), 2};
  j.upper_arm = {170 * build_.shoulders * k, above(1356), -32};
  const Vec3d down = Vec3d(0.7071, -0.7071, 0).normalized();
  j.lower_arm = j.upper_arm + 288 * arm * down;
  const Vec3d fore = Vec3d(0.695, -0.71, 0.10).normalized();
  j.hand = j.lower_arm + 250 * arm * fore;
  const double wide = std::max(1.0, build_.hips);
  j.upper_leg = {83 * k * wide, hip_y, -4};
  j.lower_leg = {92 * k, 478 * leg, 4};
  j.foot = {97 * k, 78 * leg, -22};
  j.toes = {112 * k, 26, 108 * k};
  j.toe_tip = {118 * k, 22, 170 * k};

  // The hand: f along it, t towards the thumb, n out of the palm.
  const Vec3d f = fore;
  j.thumb_side = (Vec3d(0.05, 0.0, 1) - f * f.dot(Vec3d(0.05, 0.0, 1))).normalized();
  j.palm_normal = f.cross(j.thumb_side).normalized();
  if (j.palm_normal.x() > 0) j.palm_normal = -j.palm_normal;
  const double h = k * build_.arms;
  struct Finger {
    double f, t, n, spread, lengths[3];
  };
  static constexpr std::array<Finger, 5> kFingers = {{{24, 26, 12, 0, {40, 36, 29}},
                                                      {92, 28, 2, 8, {42, 25, 23}},
                                                      {96, 8, 0, 1.5, {46, 29, 24}},
                                                      {91, -12, 1, -6, {43, 27, 24}},
                                                      {82, -30, 3, -14, {34, 20, 21}}}};
  for (size_t i = 0; i < 5; ++i) {
    const Finger& g = kFingers[i];
    const auto at = [&](double a, double b, double c) {
      return Vec3d(j.hand + h * (a * f + b * j.thumb_side + c * j.palm_normal));
    };
    Vec3d p = at(g.f, g.t, g.n);
    j.fingers[i][0] = p;
    for (size_t b = 0; b < 3; ++b) {
      Vec3d direction;
      if (i == 0) {
        static constexpr double kTurn[3] = {46, 30, 22};
        const double angle = kTurn[b] * kPi / 180;
        direction = std::cos(angle) * f + std::sin(angle) * j.thumb_side +
                    (0.24 - 0.06 * static_cast<double>(b)) * j.palm_normal;
      } else {
        const double angle = g.spread * kPi / 180;
        const double flex = (4 + 8.0 * static_cast<double>(b)) * kPi / 180;
        direction = std::cos(flex) * (std::cos(angle) * f + std::sin(angle) * j.thumb_side) +
                    std::sin(flex) * j.palm_normal;
      }
      p += h * g.lengths[b] * direction.normalized();
      j.fingers[i][b + 1] = p;
    }
  }
}

void BodyForm::make_torso() {
  const BodyBuild& b = build_;
  const double k = b.stature, y0 = joints_.upper_leg.y();
  const auto at = [&](double y) { return (y - 890) * k; };
  const double h = b.hips, w = b.waist, c = b.chest, s = b.shoulders, belly = b.belly;
  const std::vector<Station> stations = {
      {at(800), 62 * h, 62 * h, 46, 62 * h},
      {at(835), 114 * h, 114 * h, 72, 92 * h},
      {at(880), 155 * h, 155 * h, 90, 108 * h},
      {at(930), 156 * h, 156 * h, 98 + 0.3 * belly, 104 * h},
      {at(985), 146 * (h + w) / 2, 146 * (h + w) / 2, 100 + 0.8 * belly, 90 * w},
      {at(1045), 135 * w, 135 * w, 97 * w + belly, 76 * w},
      {at(1110), 139 * w, 139 * w, 97 * w + 0.7 * belly, 84 * w},
      {at(1180), 149 * c, 149 * c, 104 * c + 0.3 * belly, 99 * c},
      {at(1250), 156 * c, 156 * c, 108 * c, 110 * c},
      {at(1310), 157 * (c + s) / 2, 157 * (c + s) / 2, 99 * c, 112 * c},
      {at(1350), 140 * s, 140 * s, 82 * c, 100 * c},
      {at(1384), 100 * s, 100 * s, 60, 82},
      {at(1412), 60, 60, 42, 64}};
  torso_ = tube({0, y0, -12}, {0, 1, 0}, {1, 0, 0}, stations, k, 2.35);
  torso_.cap0 = 40 * k;
  torso_.cap1 = 26 * k;
}

void BodyForm::make_limbs() {
  const BodyBuild& b = build_;
  const BodyJoints& j = joints_;
  const double g = b.limbs * b.stature, m = b.muscle;
  const auto stretched = [](std::vector<Station> stations, double nominal, double length) {
    for (Station& x : stations) x.s *= length / nominal;
    return stations;
  };
  const double thigh = (j.lower_leg - j.upper_leg).norm();
  thigh_ = tube(j.upper_leg, j.lower_leg - j.upper_leg, {1, 0, 0},
                stretched({{-30, 70, 52, 76, 92},
                           {20, 79, 66, 84, 94},
                           {70, 81, 78, 86, 88},
                           {150, 76, 75, 85, 76},
                           {250, 68, 66, 74, 65},
                           {330, 58, 58, 62, 56},
                           {385, 53, 55, 56, 50},
                           {420, 51, 54, 52, 48}},
                          412, thigh),
                g, 2);
  thigh_.cap0 = 60 * g;
  thigh_.cap1 = 40 * g;
  const double shank = (j.foot - j.lower_leg).norm();
  shank_ = tube(j.lower_leg, j.foot - j.lower_leg, {1, 0, 0},
                stretched({{-20, 50, 53, 51, 48},
                           {25, 50, 52, 50, 50},
                           {60, 51, 51, 46, 57},
                           {110, 53, 56, 43, 68 * m},
                           {165, 50, 52, 41, 67 * m},
                           {240, 41, 41, 36, 52},
                           {310, 33, 32, 31, 40},
                           {365, 33, 33, 31, 36},
                           {405, 36, 34, 33, 36}},
                          400, shank),
                g, 2);
  shank_.cap0 = 40 * g;
  const double upper = (j.lower_arm - j.upper_arm).norm();
  // u: towards the front; v: outwards and up.
  upper_arm_ = tube(j.upper_arm, j.lower_arm - j.upper_arm, {0, 0, 1},
                    stretched({{-25, 44, 46, 40 * m, 40},
                               {20, 52 * m, 52 * m, 50 * m, 44},
                               {70, 50 * m, 51 * m, 47 * m, 45},
                               {130, 47 * m, 46 * m, 42, 43},
                               {190, 45 * m, 42, 39, 40},
                               {245, 40, 37, 40, 38},
                               {290, 38, 34, 42, 40}},
                              288, upper),
                    g, 2);
  upper_arm_.cap0 = 34 * g;
  upper_arm_.cap1 = 30 * g;
  const double lower = (j.hand - j.lower_arm).norm();
  lower_arm_ = tube(j.lower_arm, j.hand - j.lower_arm, {0, 0, 1},
                    stretched({{-15, 38, 34, 41, 40},
                               {25, 43, 38, 42, 41},
                               {65, 44 * m, 40 * m, 40, 40},
                               {120, 39 * m, 37 * m, 35, 36},
                               {185, 31, 31, 26, 27},
                               {235, 28, 28, 20, 20},
                               {262, 28, 28, 19, 19}},
                              250, lower),
                    g, 2);
  lower_arm_.cap0 = 30 * g;
  lower_arm_.cap1 = 16 * g;
}

void BodyForm::make_hand() {
  const BodyJoints& j = joints_;
  const double h = build_.stature * build_.arms;
  const Vec3d f = j.hand - j.lower_arm;
  palm_ = tube(j.hand, f, j.thumb_side,
               {{-12 * h, 27, 27, 18, 18},
                {8 * h, 28, 28, 18, 18},
                {30 * h, 31, 33, 17, 17},
                {60 * h, 36, 38, 15, 15},
                {84 * h, 38, 38, 13, 13},
                {94 * h, 36, 36, 11.5, 12}},
               h, 2.6);
  palm_.v = j.palm_normal;
  palm_.cap0 = 14 * h;
  palm_.cap1 = 10 * h;
}

double BodyForm::torso_skin(const Vec3d& p) const {
  const BodyBuild& b = build_;
  const double k = b.stature, y0 = joints_.upper_leg.y() - 890 * k;
  const auto at = [&](double x, double y, double z) { return Vec3d(x * k, y0 + y * k, z * k); };
  const double s = b.shoulders;
  double d = torso_.distance(p);
  // Trapezius and shoulder girdle, shoulder blade, collar bone.
  d = join(d, limb(p, at(14, 1438, -50), at(126 * s, 1386, -42), 35 * k, 21 * k), 40 * k);
  d = join(d, limb(p, at(104 * s, 1380, -38), at(160 * s, 1364, -32), 22 * k, 33 * k), 36 * k);
  d = join(d, ellipsoid(p, at(92 * s, 1300, -96), Vec3d(52, 70, 26) * k), 40 * k);
  d = join(d, limb(p, at(26, 1374, 34), at(148 * s, 1384, -4), 9 * k, 10 * k), 22 * k);
  // Chest muscle, or breast.
  d = join(d, ellipsoid(p, at(76, 1284, 62), Vec3d(80, 54, 23 + 8 * b.muscle) * k), 42 * k);
  if (b.breast > 1)
    d = join(
        d,
        ellipsoid(p, at(78, 1248, 66 + 0.45 * b.breast), Vec3d(62, 60, 26 + 0.75 * b.breast) * k),
        30 * k);
  // Latissimus, buttock, hip.
  d = join(d, ellipsoid(p, at(124 * s, 1240, -52), Vec3d(40, 104, 44) * k), 40 * k);
  d = join(d, ellipsoid(p, at(70 * b.hips, 872, -58), Vec3d(74 * b.hips, 80, 68 * b.hips) * k),
           34 * k);
  return d;
}

double BodyForm::neck_skin(const Vec3d& p) const {
  const double below = ring_.centre.y() - p.y();
  // The neck leans: its middle lies further back further down.
  const double lean = 0.16 * std::clamp(below, -60.0, 80.0);
  const Vec3d q = p - ring_.centre + Vec3d(0, 0, lean);
  const double r = std::hypot(q.x(), q.z());
  const double flare = 1 + 0.05 * smooth_step(0, 60, below);
  const double wall = r - flare * ring_.radius_at(ring_.centre + q);
  // Ends inside the chest.
  return meet(wall, below - 90, 30);
}

double BodyForm::arm_skin(const Vec3d& p) const {
  const double k = build_.stature * build_.limbs;
  double d = upper_arm_.distance(p);
  // Deltoid over the shoulder joint.
  const Vec3d& a = joints_.upper_arm;
  const Vec3d deltoid = a + k * Vec3d(14, -22, 2);
  d = join(d, ellipsoid(p, deltoid, Vec3d(38, 54, 47) * k * (0.6 + 0.4 * build_.muscle)), 34 * k);
  d = join(d, lower_arm_.distance(p), 22 * k);
  // Point of the elbow.
  return join(d, ellipsoid(p, joints_.lower_arm + Vec3d(8, -4, -26) * k, Vec3d(17, 19, 15) * k),
              16 * k);
}

double BodyForm::hand_skin(const Vec3d& p) const {
  const BodyJoints& j = joints_;
  const double h = build_.stature * build_.arms;
  const Vec3d f = (j.hand - j.lower_arm).normalized();
  const auto at = [&](double a, double b, double c) {
    return Vec3d(j.hand + h * (a * f + b * j.thumb_side + c * j.palm_normal));
  };
  double palm = palm_.distance(p);
  palm = join(palm, limb(p, at(18, 20, 8), at(56, 34, 12), 17 * h, 13 * h), 12 * h);
  palm = join(palm, limb(p, at(20, -24, 8), at(70, -30, 5), 14 * h, 10 * h), 14 * h);
  static constexpr std::array<std::array<double, 4>, 5> kRadius = {{{14.5, 11.6, 10.6, 8.2},
                                                                    {10.2, 9.0, 8.2, 6.4},
                                                                    {10.4, 9.2, 8.4, 6.6},
                                                                    {10.0, 8.8, 8.0, 6.3},
                                                                    {9.0, 7.8, 7.0, 5.6}}};
  double d = palm;
  for (size_t i = 0; i < 5; ++i) {
    const auto& joint = j.fingers[i];
    const auto& r = kRadius[i];
    double finger = 1e9;
    for (size_t b = 0; b < 3; ++b) {
      // The last capsule ends where its cap reaches the tip.
      Vec3d end = joint[b + 1];
      if (b == 2) end -= (joint[3] - joint[2]).normalized() * r[3] * h;
      finger = join(finger, limb(p, joint[b], end, r[b] * h, r[b + 1] * h), 3.0 * h);
    }
    d = std::min(d, join(palm, finger, (i == 0 ? 14 : 7) * h));
  }
  return d;
}

double BodyForm::leg_skin(const Vec3d& p) const {
  const double k = build_.stature * build_.limbs;
  double d = join(thigh_.distance(p), shank_.distance(p), 26 * k);
  // Kneecap.
  return join(d, ellipsoid(p, joints_.lower_leg + Vec3d(-2, 8, 38) * k, Vec3d(26, 30, 20) * k),
              22 * k);
}

double BodyForm::along_arm(const Vec3d& point) const {
  const Vec3d p = left_half(point);
  const double upper = (joints_.lower_arm - joints_.upper_arm).norm();
  const double a = upper_arm_.along(p), b = lower_arm_.along(p);
  return mix(a, upper + b, smooth_step(upper - 20, upper + 20, a));
}

double BodyForm::arm_reach() const {
  return (joints_.lower_arm - joints_.upper_arm).norm() + (joints_.hand - joints_.lower_arm).norm();
}

double BodyForm::distance(const Vec3d& point) const {
  // Parts that are too far away to matter are given a safe lower bound of their distance.
  constexpr double kFar = 60;
  const Vec3d p = left_half(point);
  const BodyJoints& j = joints_;
  const double k = build_.stature;
  const auto bounded = [&](double bound, const auto& exact) {
    return bound > kFar ? bound : exact();
  };
  const double neck = bounded(ring_.centre.y() - 120 - p.y(), [&] { return neck_skin(p); });
  const double torso = bounded(std::max(p.x() - 215 * k, j.upper_leg.y() - 170 * k - p.y()),
                               [&] { return torso_skin(p); });
  const Vec3d beside = p - j.upper_arm;
  const double arm = bounded(std::max(-beside.x() - 70 * k, 0.0) +
                                 0.7 * std::max(-(beside.x() + beside.y()) - 170 * k, 0.0),
                             [&] { return arm_skin(p); });
  const double leg = bounded(std::max(p.x() - 230 * k, p.y() - j.upper_leg.y() - 110 * k),
                             [&] { return leg_skin(p); });
  // The neck alone shapes the place where the head joins.
  const double below = ring_.height_at(p) - p.y();
  const double soft = 1 + 42 * k * smooth_step(4, 60, below);
  const double trunk = join(neck, join(torso, arm, 38 * k), soft);
  double d = join(trunk, leg, 26 * k);
  const Vec3d middle = j.hand + 0.6 * (j.fingers[2][3] - j.hand);
  const double hand = bounded((p - middle).norm() - 150 * k, [&] { return hand_skin(p); });
  d = join(d, hand, 8 * k);
  const Cover c = cover(p);
  if (p.x() < 240 * k) d = std::min(d, bottom(p, c, join(torso, leg, 26 * k), leg));
  if (p.y() > j.upper_leg.y() - 200 * k) d = join(d, top(p, c, trunk, arm) - folds(point), 3);
  return join(d, shoe(p), 3);
}

Vec3d BodyForm::normal(const Vec3d& p) const {
  constexpr double kStep = 0.3;
  Vec3d g;
  for (int c = 0; c < 3; ++c) {
    Vec3d e = Vec3d::Zero();
    e[c] = kStep;
    g[c] = distance(p + e) - distance(p - e);
  }
  return g.norm() > 1e-12 ? Vec3d(g.normalized()) : Vec3d(0, 1, 0);
}

Vec3d BodyForm::project(const Vec3d& start) const {
  Vec3d p = start;
  for (int i = 0; i < 4; ++i) {
    const double d = distance(p);
    if (std::abs(d) < 0.02) break;
    constexpr double kStep = 0.3;
    Vec3d g;
    for (int c = 0; c < 3; ++c) {
      Vec3d e = Vec3d::Zero();
      e[c] = kStep;
      g[c] = (distance(p + e) - distance(p - e)) / (2 * kStep);
    }
    p -= g * (d / std::max(g.squaredNorm(), 0.25));
  }
  return p;
}

}  // namespace effigy::people
