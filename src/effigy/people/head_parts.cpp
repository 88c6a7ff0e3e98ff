#include <array>
#include <cmath>
#include <numbers>

#include "effigy/people/head_half.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;

HeadVertex make(const Vec3d& p, Region region, int ring, int index, int side = 1) {
  HeadVertex vertex;
  vertex.p = p;
  vertex.region = region;
  vertex.ring = ring;
  vertex.index = index;
  vertex.side = side;
  return vertex;
}

// Half a dental arch: bands around a profile (gum in front, edge in front, edge behind, gum
// behind).
void add_arch(Half& half, Region region, double gum, double edge, double front, double depth,
              const Vec2d& uv_low, const Vec2d& uv_high) {
  constexpr int kSteps = 12;
  std::vector<std::vector<int>> lines(5);
  for (int i = 0; i <= kSteps; ++i) {
    const double s = static_cast<double>(i) / kSteps, x = 25.5 * std::sin(0.5 * kPi * s);
    const double c = std::cos(0.5 * kPi * s);
    const Vec2d arch(x, front - 33 * (1 - c));
    const Vec2d normal = Vec2d(std::sin(0.5 * kPi * s) * 33, 25.5 * c).normalized();
    const double thin = mix(2.6, 7.5, s);  // incisors are thin, molars wide
    const std::array<std::pair<double, double>, 5> profile = {{{gum, 0.8},
                                                               {mix(gum, edge, 0.5), 0.5},
                                                               {edge, -0.6},
                                                               {edge, -thin},
                                                               {gum, -thin - depth}}};
    for (int k = 0; k < 5; ++k) {
      const Vec2d at = arch + normal * profile[k].second;
      lines[k].push_back(half.add(
          make({i == 0 ? 0.0 : at.x(), profile[k].first, at.y()}, region, k, i, i == 0 ? 0 : 1),
          {mix(uv_low.x(), uv_high.x(), s), mix(uv_low.y(), uv_high.y(), k / 4.0)}));
    }
  }
  for (int k = 0; k < 4; ++k)
    for (int i = 0; i < kSteps; ++i) {
      const int a = lines[k][i], b = lines[k][i + 1], c = lines[k + 1][i], d = lines[k + 1][i + 1];
      if (edge < gum) {
        half.add_triangle(a, c, b, HalfPart::kTeeth);
        half.add_triangle(b, c, d, HalfPart::kTeeth);
      } else {
        half.add_triangle(a, b, c, HalfPart::kTeeth);
        half.add_triangle(b, d, c, HalfPart::kTeeth);
      }
    }
}

}  // namespace

void add_eyeball(Half& half) {
  static constexpr std::array<double, 12> kAngles = {0,    7,  13, 19, 24.5, 29.4,
                                                     35.5, 43, 53, 66, 82,   100};
  constexpr int kSegments = 20;
  // The atlas corner above the crown.
  const Vec2d centre(0.918, 0.918);
  constexpr double kSize = 0.068;
  std::vector<int> previous;
  for (size_t ring = 0; ring < kAngles.size(); ++ring) {
    const double angle = kAngles[ring] * kPi / 180;
    const double cornea = std::max(0.0, 1 - std::pow(kAngles[ring] / 29.4, 2));
    const double radius = kEyeRadius + kCorneaHeight * cornea;
    std::vector<int> current;
    for (int i = 0; i < (ring == 0 ? 1 : kSegments); ++i) {
      const double turn = -2 * kPi * i / kSegments;  // clockwise seen from the front
      const Vec3d p = Vec3d(kEyeX, kEyeY, kEyeZ) + radius * Vec3d(std::cos(turn) * std::sin(angle),
                                                                  std::sin(turn) * std::sin(angle),
                                                                  std::cos(angle));
      const double reach = kSize * kAngles[ring] / kAngles.back();
      current.push_back(half.add(make(p, Region::kEyeball, static_cast<int>(ring), i),
                                 centre + reach * Vec2d(std::cos(turn), std::sin(turn))));
    }
    if (ring == 1)
      for (int i = 0; i < kSegments; ++i)
        half.add_triangle(current[(i + 1) % kSegments], current[i], previous[0], HalfPart::kEye);
    if (ring > 1) half.add_band(current, previous, true, HalfPart::kEye);
    previous = current;
  }
}

void add_teeth(Half& half) {
  add_arch(half, Region::kUpperTeeth, -62, -76.0, 90.0, 3, {0.902, 0.052}, {0.988, 0.012});
  add_arch(half, Region::kLowerTeeth, -87, -74.8, 86.6, 3, {0.902, 0.058}, {0.988, 0.094});
}

void add_tongue(Half& half) {
  constexpr int kRings = 5, kSteps = 8;
  const Vec2d centre(0.945, 0.124);
  std::vector<std::vector<int>> rings;
  for (int r = 0; r <= kRings; ++r) {
    std::vector<int> ring;
    const double s = static_cast<double>(r) / kRings;
    for (int i = 0; i <= (r == 0 ? 0 : kSteps); ++i) {
      const double turn = 0.5 * kPi - kPi * i / kSteps;  // front .. back, seen from above
      const double reach = std::sin(0.5 * kPi * s), high = std::cos(0.5 * kPi * s);
      const Vec3d p(17 * reach * std::cos(turn), -84 + 8 * high, 59 + 24 * reach * std::sin(turn));
      const bool mid = r == 0 || i == 0 || i == kSteps;
      ring.push_back(
          half.add(make({mid ? 0.0 : p.x(), p.y(), p.z()}, Region::kTongue, r, i, mid ? 0 : 1),
                   centre + 0.021 * s * Vec2d(std::cos(turn), -std::sin(turn))));
    }
    rings.push_back(ring);
  }
  for (int i = 0; i < kSteps; ++i)
    half.add_triangle(rings[0][0], rings[1][i], rings[1][i + 1], HalfPart::kMouth);
  for (int r = 1; r < kRings; ++r)
    for (int i = 0; i < kSteps; ++i) {
      half.add_triangle(rings[r][i], rings[r + 1][i], rings[r][i + 1], HalfPart::kMouth);
      half.add_triangle(rings[r][i + 1], rings[r + 1][i], rings[r + 1][i + 1], HalfPart::kMouth);
    }
}

}  // namespace effigy::people
