#include <array>
#include <cmath>
#include <numbers>

#include "effigy/people/head_domain.h"
#include "effigy/people/head_features.h"
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
  const Vec2d line(kMouthHalfWidth * s, lip_line(kMouthHalfWidth * s));
  Vec2d border(26.6 * s, 0);
  border.y() = corner ? line.y() : upper ? lip_top(border.x()) : lip_bottom(border.x());
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
  static constexpr std::array<Size, 5> kSizes = {{{0.7, 0.7, 24.5, 95.0, 78.0},
                                                  {4.5, 5.0, 27.0, 93.0, 70.0},
                                                  {13, 15, 30, 91.0, 56.0},
                                                  {15, 19, 26, 64.0, 42.0},
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
  const double arch = std::pow(4 * c * (1 - c), 0.82);
  return upper ? Vec2d(x, base + arch * (5.6 + 1.2 * (0.5 - c)))
               : Vec2d(x, base - arch * (4.6 + 1.4 * (c - 0.5)));
}

Loop eye_outer(int ring) {
  static constexpr std::array<double, kEyeRings> kOut = {0, 0.08, 0.25, 0.45, 0.54, 0.78, 1};
  static constexpr std::array<double, kEyeRings> kShrink = {0.48, 0.54, 0.62, 0.70, 0.77, 0.88, 1};
  Loop loop{{}, kShrink[ring], ring};
  for (int i = 0; i < kEyeLoop; ++i) {
    const double angle = kPi - 2 * kPi * i / kEyeLoop;
    const Vec2d lid = lid_curve(i);
    const Vec2d far(31.2 + 21.5 * std::cos(angle),
                    (i <= kEyeLoop / 2 ? 16.0 : 16.0) * std::sin(angle));
    const Vec2d at = lid + (far - lid) * kOut[ring];
    Vec3d p = front_point(at.x(), at.y());
    const Vec3d eye(kEyeX, kEyeY, kEyeZ);
    const double upper = i <= kEyeLoop / 2 ? std::sin(kPi * i / (kEyeLoop / 2)) : 0.0;
    const Vec3d out = (p - eye).normalized();
    const double lower = i > kEyeLoop / 2 ? std::sin(kPi * (kEyeLoop - i) / (kEyeLoop / 2)) : 0.0;
    // Out of the skin, and up: rim, lashes' edge, tarsal plate, crease, fold above it.
    static constexpr std::array<double, kEyeRings> kUpper = {-0.1, 0.15, 0.1, -0.9, 0.6, 0.3, 0};
    static constexpr std::array<double, kEyeRings> kLower = {-0.1, 0.15, 0.1, -0.1, 0, 0, 0};
    p += (kUpper[ring] * upper + kLower[ring] * lower) * out;
    if (ring == 4) p.y() -= 0.9 * upper;
    loop.points.push_back(p);
  }
  return loop;
}

Loop eye_inner(int ring, const Loop& rim) {
  static constexpr std::array<double, 3> kShrink = {0.43, 0.32, 0.16};
  static constexpr std::array<double, 3> kRadius = {12.1, 12.9, 13.4};
  static constexpr std::array<double, 3> kTurn = {-0.03, 0.45,
                                                  1.3};  // radians, away from the opening
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

// The ear's plane stands off the head: `a` runs backwards from its front edge, `b` up, both
// leaning back; `h` is the height above the plane, outwards.
constexpr double kEarY = -15, kEarZ = -1, kEarOut = 25 * kPi / 180, kEarLean = 11 * kPi / 180;
constexpr double kEarMiddle = 17;

Vec3d side_point(double y, double z) {
  return march_head({160, y, z}, {-1, 0, 0}, 160);
}

// The edge of the ear, angle 0 in front, a quarter = top; wide above, narrow at the lobe.
Vec2d ear_rim(double angle) {
  const double s = std::sin(angle);
  const double wide = (std::cos(angle) > 0 ? 16.0 : 18.5) * (1 + (s > 0 ? 0.14 : 0.22) * s);
  return {kEarMiddle - wide * std::cos(angle), 31 * s};
}

double around(double angle, double middle, double half_width) {
  const double turn = std::remainder(angle - middle * kPi / 180, 2 * kPi);
  return 1 - smooth_step(0.35, 1, std::abs(turn) / (half_width * kPi / 180));
}

constexpr int kEarRings = 10;

// (a, b, h) of ring `ring`: root, behind, edge from behind, edge, helix, its inner side, groove,
// antihelix, wall and floor of the concha.
Vec3d ear_form(int ring, double angle) {
  static constexpr std::array<double, kEarRings> kScale = {0,    0.80, 0.97, 1.0,  0.955,
                                                           0.87, 0.79, 0.63, 0.47, 0.26};
  static constexpr std::array<double, kEarRings> kHigh = {0,   -6.5, -3.0, 0.2,  1.8,
                                                          0.9, -2.4, 2.4,  -5.0, -9.0};
  static constexpr std::array<double, kEarRings> kLobe = {0,   -5.0, -3.0, -0.6, 0.8,
                                                          1.2, 1.3,  1.6,  0.6,  -7.0};
  static constexpr std::array<double, kEarRings> kFrontWay = {0,    0.10, 0.20, 0.28, 0.35,
                                                              0.42, 0.49, 0.57, 0.70, 0.88};
  static constexpr std::array<double, kEarRings> kFrontHigh = {0,   0.1, 0.3, 0.7,  1.3,
                                                               2.2, 3.2, 3.0, -3.0, -8.0};
  const Vec2d concha(13.5, -5), rim = ear_rim(angle);
  const Vec2d at = concha + kScale[static_cast<size_t>(ring)] * (rim - concha);
  const double lobe = around(angle, 275, 52);
  const Vec3d wing(at.x(), at.y(),
                   mix(kHigh[static_cast<size_t>(ring)], kLobe[static_cast<size_t>(ring)], lobe));
  const Vec2d root(rim.x() - 2.0, rim.y());
  const Vec2d way = root + kFrontWay[static_cast<size_t>(ring)] * (concha - root);
  // The helix runs into the concha above the tragus; a notch lies below it.
  const double crus = around(angle, 38, 26);
  const Vec3d front(way.x(), way.y(),
                    kFrontHigh[static_cast<size_t>(ring)] + (ring == 8 ? 2.5 * crus : 0.0) -
                        (ring >= 5 && ring <= 7 ? 2.2 * around(angle, 24, 14) : 0));
  return wing + around(angle, 0, 62) * (front - wing);
}

Loop ear_loop(int ring) {
  static constexpr std::array<double, kEarRings> kShrink = {1,    0.91, 0.84, 0.77, 0.70,
                                                            0.62, 0.53, 0.42, 0.30, 0.16};
  Loop loop{{}, kShrink[static_cast<size_t>(ring)], ring};
  const double s = std::sin(kEarOut), c = std::cos(kEarOut);
  auto lean = [](const Vec2d& q) {
    const Vec2d from(q.x() - kEarMiddle, q.y());
    return Vec2d(kEarMiddle + from.x() * std::cos(kEarLean) + from.y() * std::sin(kEarLean),
                 from.y() * std::cos(kEarLean) - from.x() * std::sin(kEarLean));
  };
  const double plane = side_point(kEarY, kEarZ).x() - 0.8;
  for (int i = 0; i < kEarLoop; ++i) {
    const double angle = 2 * kPi * i / kEarLoop;
    const Vec2d rim = ear_rim(angle);
    // It grows out of the head in front and along its middle.
    const double behind = rim.x() > kEarMiddle ? 0.25 : 1.0;
    const Vec2d root =
        lean({kEarMiddle + behind * (rim.x() - kEarMiddle) - 2.5 * around(angle, 0, 80),
              rim.y() * 0.88});
    const Vec3d ground = side_point(kEarY + root.y(), kEarZ - root.x());
    if (ring == 0) {
      loop.points.push_back(ground);
      continue;
    }
    const Vec3d form = ear_form(ring, angle);
    const Vec2d at = lean(form.head<2>());
    Vec3d p(plane + at.x() * s + form.z() * c, kEarY + at.y(), kEarZ - at.x() * c + form.z() * s);
    // In front it is flush with the cheek, which is no plane.
    const double flush = around(angle, 0, 95) * (1 - smooth_step(2, 6, ring));
    p.x() = mix(p.x(), side_point(p.y(), p.z()).x() + form.z() * c, flush);
    loop.points.push_back(p);
  }
  return loop;
}

// ---- nostril -----------------------------------------------------------------------------------

Loop nostril_loop(int ring) {
  // The opening below the nose, and the loops inside it: scale, and how far up and back.
  static constexpr std::array<double, 4> kScale = {1.0, 0.72, 0.62, 0.45};
  static constexpr std::array<double, 4> kUp = {0, 0.6, 3.5, 8.0};
  static constexpr std::array<double, 4> kShrink = {1, 0.70, 0.45, 0.22};
  Loop loop{{}, kShrink[static_cast<size_t>(ring)], ring};
  for (int i = 0; i < kNostrilLoop; ++i) {
    // Counter-clockwise seen from above is clockwise from below; the opening turns outwards behind.
    const double angle = -2 * kPi * i / kNostrilLoop;
    const double scale = kScale[static_cast<size_t>(ring)];
    const Vec2d q(3.2 * scale * std::cos(angle), 5.2 * scale * std::sin(angle));
    const double turn = 24 * kPi / 180;
    const Vec2d turned(q.x() * std::cos(turn) - q.y() * std::sin(turn),
                       q.x() * std::sin(turn) + q.y() * std::cos(turn));
    // Seen from below and before the nose.
    const Vec3d up(0, 0.55, 0.835), into(0, 0.835, -0.55);
    Vec3d p = march_head(
        Vec3d(7.3, -50.5, 101) + turned.x() * Vec3d::UnitX() + turned.y() * up - 12 * into, into,
        30);
    if (ring > 0) p += kUp[static_cast<size_t>(ring)] * Vec3d(0.02, 0.92, -0.35);
    loop.points.push_back(p);
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
  for (int ring = 0; ring < kEarRings; ++ring) loops.push_back(ear_loop(ring));
  Vec3d floor = Vec3d::Zero();
  for (const Vec3d& p : loops.back().points) floor += p / static_cast<double>(kEarLoop);
  floor.x() -= 1.5;
  return add_loops(half, loops, Region::kEarRing, false, floor, -99);
}

std::vector<int> add_nostril_rings(Half& half) {
  std::vector<Loop> loops;
  for (int ring = 0; ring < 4; ++ring) loops.push_back(nostril_loop(ring));
  Vec3d end = Vec3d::Zero();
  for (const Vec3d& p : loops.back().points) end += p / static_cast<double>(kNostrilLoop);
  end.y() += 1;
  return add_loops(half, loops, Region::kNostrilRing, false, end, -99);
}

}  // namespace effigy::people
