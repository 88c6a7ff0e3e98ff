#include <cmath>
#include <numbers>

#include "effigy/people/head_fields.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;

// 0 above the line of the lips, 1 below; beyond the corner it changes with the angle about the
// corner, so that only the line itself is a jump.
double lowerness(const HeadVertex& v) {
  const Vec3d p(std::abs(v.p.x()), v.p.y(), v.p.z());
  if (v.region == Region::kUpperTeeth) return 0;
  if (v.region == Region::kLowerTeeth || v.region == Region::kTongue) return 1;
  const bool ring = v.region == Region::kMouthRing;
  double angle = std::atan2(p.y() - kMouthY, p.x() - kMouthHalfWidth);
  if (ring && v.index != kLipCorner)
    angle = v.index < kLipCorner ? std::abs(angle) : -std::abs(angle);
  const double by_angle = 1 - smooth_step(-80 * kPi / 180, 80 * kPi / 180, angle);
  if (!ring) return by_angle;
  // At the line the mouth opens as an ellipse.
  const double along = std::sin(0.5 * kPi * std::abs(v.index - kLipCorner) / kLipCorner);
  const double by_ring = 0.5 + (v.index < kLipCorner ? -0.5 : 0.5) * along;
  return mix(by_ring, by_angle, smooth_step(0, kMouthRings - 1, v.ring));
}

double jaw_weight(const HeadVertex& v, double lower) {
  switch (v.region) {
    case Region::kEyeRing:
    case Region::kEyeball:
    case Region::kUpperTeeth:
    case Region::kEarRing:
      return 0;
    case Region::kLowerTeeth:
      return 1;
    case Region::kTongue:
      return 0.95;
    default:
      break;
  }
  if (v.region == Region::kMouthRing && v.ring <= -3)
    return lower * mix(1, 0.35, (-3.0 - v.ring) / 3);
  const double high = mix(smooth_step(-38, -76, v.p.y()), 1.0, smooth_step(-60, -72, v.p.y()));
  const double back = smooth_step(8, 62, v.p.z());
  const double neck = smooth_step(-165, -118, v.p.y());
  return lower * high * back * neck;
}

}  // namespace

std::vector<Site> sites(const HeadMesh& head, int side) {
  std::vector<Site> out(head.vertices.size());
  for (size_t i = 0; i < out.size(); ++i) {
    const HeadVertex& v = head.vertices[i];
    Site& site = out[i];
    site.p = Vec3d(v.p.x() * side, v.p.y(), v.p.z());
    site.vertex = &v;
    site.same_side = v.side == side || v.side == 0;
    site.lower = lowerness(v);
    site.jaw = jaw_weight(v, site.lower);
  }
  return out;
}

std::vector<double> jaw_weights(const HeadMesh& head) {
  std::vector<double> out;
  for (const Site& site : sites(head, 1)) out.push_back(site.jaw);
  return out;
}

}  // namespace effigy::people
