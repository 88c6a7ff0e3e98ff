#include <array>
#include <cmath>
#include <numbers>

#include "effigy/people/head_domain.h"
#include "effigy/people/head_half.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;

// The skin in front of (x, y).
Vec3d front_point(double x, double y) {
  return march_head({x, y, 160}, {0, 0, -1}, 160);
}

Vec2d uv_of(const Vec3d& p) {
  const Vec2d d = domain_of(p);
  return uv_at(d.x(), d.y());
}

struct Loop {
  std::vector<Vec3d> points;
  double shrink = 1;  // UV: towards the loops' common centre; 1 = the outermost loop
  int ring = 0;
};

// ---- mouth -------------------------------------------------------------------------------------

// Front view of mouth ring `ring` (0 line of the lips, 2 vermilion border, 4 outermost).
Vec2d mouth_curve(double ring, int index) {
  const bool upper = index < kLipCorner, corner = index == kLipCorner;
  const int step = upper ? index : 2 * kLipCorner - index;  // 0 middle .. kLipCorner corner
  const double s = std::sin(0.5 * kPi * step / kLipCorner);
  const Vec2d line(kMouthHalfWidth * s, kMouthY + 0.5 * std::cos(3 * kPi * s) * (1 - s));
  Vec2d border = line;
  border.x() = 27.5 * s;
  const double fall = std::pow(std::max(0.0, 1 - s * s), 0.6);
  if (upper) border.y() = kMouthY + 8.2 * fall - 1.3 * std::exp(-std::pow(border.x() / 3.0, 2));
  if (!upper && !corner) border.y() = kMouthY - 9.6 * fall;
  const double angle = 0.5 * kPi * step / kLipCorner;
  const Vec2d outer(37 * std::sin(angle), kMouthY + (upper ? 16.5 : -20.0) * std::cos(angle));
  if (ring <= 2) return line + (border - line) * (ring / 2);
  return border + (outer - border) * ((ring - 2) / 2);
}

Vec3d lip_line_point(int index) {
  const Vec2d at = mouth_curve(0, index);
  Vec3d p = front_point(at.x(), at.y());
  p.z() -= 2.2 * (1 - std::pow(at.x() / (kMouthHalfWidth + 4), 2));
  return p;
}

Loop mouth_inner(int ring) {
  // Half height, half width and depth of the loops behind the lips, then the bag.
  struct Size {
    double up, down, wide, front, corner;
  };
  static constexpr std::array<Size, 5> kSizes = {{{0.7, 0.7, 24.5, 90.0, 76.0},
                                                  {4.5, 5.0, 27.0, 88.0, 68.0},
                                                  {13, 15, 30, 86.0, 55.0},
                                                  {15, 19, 26, 62.0, 42.0},
                                                  {9, 10, 14, 34.0, 32.0}}};
  static constexpr std::array<double, 5> kShrink = {0.41, 0.36, 0.28, 0.16, 0.07};
  const Size& size = kSizes[-ring - 1];
  Loop loop{{}, kShrink[-ring - 1], ring};
  for (int i = 0; i <= 2 * kLipCorner; ++i) {
    const double angle = kPi * i / (2 * kLipCorner);
    const double s = std::sin(angle), c = std::cos(angle);
    const double y = kMouthY - 0.5 + (c > 0 ? size.up : size.down) * c;
    loop.points.emplace_back(i % (2 * kLipCorner) == 0 ? 0.0 : size.wide * s, y,
                             mix(size.front, size.corner, s * s));
  }
  return loop;
}

// ---- eye ---------------------------------------------------------------------------------------

Vec2d lid_curve(int index) {
  const bool upper = index <= kEyeLoop / 2;
  const int step = upper ? index : kEyeLoop - index;  // 0 inner corner .. kEyeLoop / 2 outer
  const double c = 0.5 - 0.5 * std::cos(kPi * step / (kEyeLoop / 2));
  const double x = mix(16.2, 46.2, c), base = mix(-2.4, 1.0, smooth_step(0, 1, c));
  const double arch = std::pow(4 * c * (1 - c), 0.72);
  return upper ? Vec2d(x, base + arch * (5.6 + 1.2 * (0.5 - c)))
               : Vec2d(x, base - arch * (4.6 + 1.4 * (c - 0.5)));
}

Loop eye_outer(int ring) {
  static constexpr std::array<double, kEyeRings> kOut = {0, 0.13, 0.32, 0.62, 1};
  static constexpr std::array<double, kEyeRings> kShrink = {0.50, 0.58, 0.70, 0.85, 1};
  Loop loop{{}, kShrink[ring], ring};
  for (int i = 0; i < kEyeLoop; ++i) {
    const double angle = kPi - 2 * kPi * i / kEyeLoop;
    const Vec2d lid = lid_curve(i);
    const Vec2d far(31.2 + 21.5 * std::cos(angle),
                    (i <= kEyeLoop / 2 ? 14.5 : 15.5) * std::sin(angle));
    const Vec2d at = lid + (far - lid) * kOut[ring];
    Vec3d p = front_point(at.x(), at.y());
    const Vec3d eye(kEyeX, kEyeY, kEyeZ);
    const double upper = i <= kEyeLoop / 2 ? std::sin(kPi * i / (kEyeLoop / 2)) : 0.0;
    if (ring == 0) p += 0.25 * (eye - p).normalized();
    if (ring == 1) p -= 0.25 * (eye - p).normalized();
    if (ring == 2) p += 1.0 * upper * (eye - p).normalized();  // crease of the upper lid
    if (ring == 3) p -= 0.8 * upper * (eye - p).normalized();
    loop.points.push_back(p);
  }
  return loop;
}

Loop eye_inner(int ring, const Loop& rim) {
  static constexpr std::array<double, 3> kShrink = {0.44, 0.32, 0.16};
  static constexpr std::array<double, 3> kRadius = {12.15, 12.9, 13.4};
  static constexpr std::array<double, 3> kTurn = {0, 0.45, 1.3};  // radians, away from the opening
  Loop loop{{}, kShrink[-ring - 1], ring};
  const Vec3d eye(kEyeX, kEyeY, kEyeZ);
  for (const Vec3d& p : rim.points) {
    const Vec3d direction = (p - eye).normalized();
    const double angle = std::acos(std::clamp(direction.z(), -1.0, 1.0)) + kTurn[-ring - 1];
    const Vec2d around = Vec2d(direction.x(), direction.y()).normalized();
    loop.points.push_back(eye + kRadius[-ring - 1] * Vec3d(around.x() * std::sin(angle),
                                                           around.y() * std::sin(angle),
                                                           std::cos(angle)));
  }
  return loop;
}

// ---- ear ---------------------------------------------------------------------------------------

// Seen from the side: (z forward, y up) relative to the ear's middle; leans back by 14 degrees.
Vec2d ear_outline(double angle, double scale) {
  const double back = 0.5 - 0.5 * std::cos(angle);  // 0 in front, 1 behind
  double high = 31, wide = mix(12.0, 19.0, back);
  if (std::sin(angle) < 0) wide *= 1 + 0.30 * std::sin(angle);  // lobe is narrower
  const Vec2d q(wide * std::cos(angle) * scale, high * std::sin(angle) * scale);
  const double lean = 14 * kPi / 180;
  return {q.x() * std::cos(lean) - q.y() * std::sin(lean),
          q.x() * std::sin(lean) + q.y() * std::cos(lean)};
}

constexpr double kEarY = -14, kEarZ = -10;

Vec3d side_point(double y, double z) {
  return march_head({160, y, z}, {-1, 0, 0}, 160);
}

Loop ear_loop(int ring) {
  // Scale of the outline and how far out, per ring: root, back of the ear, rim, helix, groove,
  // antihelix, wall of the concha, floor.
  static constexpr std::array<double, 8> kScale = {0.86, 0.92, 1.0, 0.93, 0.80, 0.66, 0.46, 0.25};
  static constexpr std::array<double, 8> kOut = {0, 0.42, 0.86, 1.0, 0.74, 0.86, 0.22, 0.10};
  static constexpr std::array<double, 8> kShrink = {1, 0.90, 0.80, 0.72, 0.60, 0.48, 0.33, 0.17};
  Loop loop{{}, kShrink[ring], ring};
  for (int i = 0; i < kEarLoop; ++i) {
    const double angle = 2 * kPi * i / kEarLoop;  // 0 front, quarter = top
    const Vec2d root = ear_outline(angle, 0.80 - 0.16 * (0.5 - 0.5 * std::cos(angle)));
    const Vec2d wing = ear_outline(angle, kScale[ring]);
    const double lift = ring == 0 ? 0.0 : std::min(1.0, 0.3 + 0.45 * ring);
    const Vec2d at = root + (wing - root) * lift;
    const double back = 0.5 - 0.5 * std::cos(angle);
    const Vec3d base = side_point(kEarY + at.y(), kEarZ + at.x());
    // Behind, the ear stands off the head; the root's x keeps the wing in one gentle plane.
    const Vec3d plane = side_point(kEarY, kEarZ);
    const double x = mix(base.x(), plane.x() + 0.10 * (kEarZ - base.z()), ring == 0 ? 0.0 : 0.6);
    double out = mix(4.5, 16.0, std::pow(back, 0.8)) * kOut[ring];
    if (std::sin(angle) < -0.6) out *= 0.75;                                 // lobe
    if (ring >= 4 && ring <= 5 && back < 0.25) out += 2.0 * (1 - 4 * back);  // tragus
    loop.points.emplace_back(x + out, base.y(), base.z());
  }
  return loop;
}

// ---- common ------------------------------------------------------------------------------------

std::vector<int> add_loop(Half& half, const Loop& loop, Region region,
                          const std::vector<Vec2d>& outer_uv, const Vec2d& centre, bool open) {
  std::vector<int> out;
  const int n = static_cast<int>(loop.points.size());
  for (int i = 0; i < n; ++i) {
    HeadVertex vertex;
    vertex.p = loop.points[i];
    vertex.region = region;
    vertex.ring = loop.ring;
    vertex.index = i;
    vertex.side = open && (i == 0 || i == n - 1) ? 0 : 1;
    if (vertex.side == 0) vertex.p.x() = 0;
    out.push_back(half.add(vertex, centre + (outer_uv[i] - centre) * loop.shrink));
  }
  return out;
}

// Bands between consecutive loops from the outermost to the innermost, then a cap to one point.
std::vector<int> add_loops(Half& half, const std::vector<Loop>& loops, Region region, bool open,
                           const Vec3d& bottom, int first_mouth) {
  std::vector<Vec2d> outer_uv;
  Vec2d centre = Vec2d::Zero();
  for (const Vec3d& p : loops[0].points) {
    outer_uv.push_back(uv_of(p));
    centre += outer_uv.back() / static_cast<double>(loops[0].points.size());
  }
  if (open) {
    outer_uv.front().x() = outer_uv.back().x() = 0.5;
    centre = {0.5, 0.5 * (outer_uv.front().y() + outer_uv.back().y())};
  }
  std::vector<int> first, previous;
  for (size_t k = 0; k < loops.size(); ++k) {
    const auto current = add_loop(half, loops[k], region, outer_uv, centre, open);
    const HalfPart part = loops[k].ring < first_mouth ? HalfPart::kMouth : HalfPart::kSkin;
    if (k > 0) half.add_band(previous, current, !open, part);
    if (k == 0) first = current;
    previous = current;
  }
  HeadVertex cap;
  cap.p = bottom;
  cap.region = region;
  cap.ring = loops.back().ring - 1;
  cap.side = open ? 0 : 1;
  const int middle = half.add(cap, centre);
  const HalfPart part = cap.ring < first_mouth ? HalfPart::kMouth : HalfPart::kSkin;
  const size_t n = previous.size();
  for (size_t i = 0; i + (open ? 1 : 0) < n; ++i)
    half.add_triangle(previous[(i + 1) % n], previous[i], middle, part);
  return first;
}

}  // namespace

std::vector<int> add_mouth_rings(Half& half) {
  static constexpr std::array<double, kMouthRings> kShrink = {0.46, 0.60, 0.74, 0.87, 1};
  std::vector<Loop> loops;
  for (int ring = kMouthRings - 1; ring >= 0; --ring) {
    Loop loop{{}, kShrink[ring], ring};
    for (int i = 0; i <= 2 * kLipCorner; ++i) {
      const Vec2d at = mouth_curve(ring, i);
      loop.points.push_back(ring == 0 ? lip_line_point(i) : front_point(at.x(), at.y()));
    }
    loops.push_back(loop);
  }
  for (int ring = -1; ring >= -5; --ring) loops.push_back(mouth_inner(ring));
  return add_loops(half, loops, Region::kMouthRing, true, {0, kMouthY, 26}, -2);
}

std::vector<int> add_eye_rings(Half& half) {
  std::vector<Loop> loops;
  for (int ring = kEyeRings - 1; ring >= 0; --ring) loops.push_back(eye_outer(ring));
  const Loop rim = loops.back();
  for (int ring = -1; ring >= -3; --ring) loops.push_back(eye_inner(ring, rim));
  return add_loops(half, loops, Region::kEyeRing, false, {kEyeX, kEyeY, kEyeZ - 13.6}, -99);
}

std::vector<int> add_ear_rings(Half& half) {
  std::vector<Loop> loops;
  for (int ring = 0; ring < 8; ++ring) loops.push_back(ear_loop(ring));
  Vec3d floor = Vec3d::Zero();
  for (const Vec3d& p : loops.back().points) floor += p / static_cast<double>(kEarLoop);
  floor.x() -= 2;
  return add_loops(half, loops, Region::kEarRing, false, floor, -99);
}

}  // namespace effigy::people
