#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/people/head_paint.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/noise.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;

Vec3d blend(const Vec3d& a, const Vec3d& b, double t) {
  return a + t * (b - a);
}

}  // namespace

// Angles from the axis of the eye: the pupil ends at 10 degrees, the iris at 29 (limbus).
Paint paint_eye(const Place& place, const Subject& subject) {
  Paint out;
  out.scatter = 0;
  const double side = place.p.x() > 0 ? 1 : -1;
  const Vec3d q = place.p - Vec3d(side * kEyeX, kEyeY, kEyeZ);
  const double angle = std::atan2(std::hypot(q.x(), q.y()), q.z()) * 180 / kPi;
  const double turn = std::atan2(q.y(), q.x());
  // Veins: ridges of noise that run towards the cornea and thin out before it.
  const Vec3d along(5 * std::cos(turn), 5 * std::sin(turn), 0.035 * angle);
  const double ridge = 1 - std::abs(noise(1.7 * along + Vec3d::Constant(0.5 * noise(q / 2.5))));
  const double vein = smooth_step(0.86, 0.99, ridge) * smooth_step(36, 62, angle) *
                      (0.5 + 0.5 * subject.age + 0.3 * noise(q / 3));
  const double blotch = smooth_step(45, 80, angle);
  Vec3d white = Vec3d(0.60, 0.57, 0.545) * (1 + 0.03 * cloud(q / 3));
  white = blend(white, Vec3d(0.48, 0.20, 0.16), 0.45 * std::clamp(vein, 0.0, 1.0));
  white = white.cwiseProduct(Vec3d(1, 1 - 0.16 * blotch, 1 - 0.20 * blotch)) *
          (1 - 0.40 * smooth_step(38, 75, angle));

  // Iris: fibres, a paler collarette around the pupil, crypts, a dark limbal ring.
  const double fibre = cloud(Vec3d(13 * std::cos(turn), 13 * std::sin(turn), 0.10 * angle));
  const double crypt =
      smooth_step(0.25, 0.6, noise(Vec3d(5 * std::cos(turn), 5 * std::sin(turn), 0.22 * angle)));
  Vec3d iris =
      blend(subject.iris_inner, subject.iris_outer, smooth_step(13.5, 21, angle + 2.5 * fibre));
  iris *= (1 + 0.55 * fibre) * (1 - 0.30 * crypt) *
          (1 + 0.25 * std::exp(-std::pow((angle - 15) / 1.6, 2)));
  iris *= 1 - 0.72 * smooth_step(24.5, 29, angle);
  out.albedo = blend(iris, white, smooth_step(27.4, 30.6, angle));
  out.albedo = blend(Vec3d(0.006, 0.006, 0.006), out.albedo, smooth_step(9.6, 11.0, angle));
  out.albedo = out.albedo.cwiseMax(0.004);
  // The tear film is smoothest on the cornea.
  out.roughness = mix(0.07, 0.14, smooth_step(26, 34, angle));
  out.specular = 0.025;
  out.height = 0.02 * cloud(q / 1.3) * smooth_step(32, 50, angle);
  return out;
}

Paint paint_teeth(const Place& place) {
  Paint out;
  out.scatter = 0.5;
  // Gaps between the teeth lie at whole numbers.
  const double line = 1 - smooth_step(0.03, 0.11, std::abs(place.along - std::round(place.along)));
  Vec3d c(0.66, 0.60, 0.49);
  c = c.cwiseProduct(Vec3d(1 - 0.28 * line, 1 - 0.36 * line, 1 - 0.42 * line));
  const double gum = smooth_step(0.62, 0.80, place.gum + 0.10 * std::cos(2 * kPi * place.along));
  // Little light reaches the back of the mouth; shading knows no occlusion, so the paint does.
  const double depth = smooth_step(86, 58, place.p.z());
  out.albedo = blend(c, Vec3d(0.36, 0.13, 0.115), gum) * mix(0.85, 0.16, depth);
  out.roughness = mix(mix(0.22, 0.34, gum), 0.8, depth);
  out.specular = mix(0.04, 0.02, depth);
  out.height = -0.15 * line;
  return out;
}

Paint paint_mouth(const Place& place) {
  Paint out;
  const double depth = smooth_step(93, 61, place.p.z());
  out.albedo = blend(Vec3d(0.22, 0.075, 0.065), Vec3d(0.035, 0.012, 0.011), depth) *
               (1 + 0.08 * cloud(place.p / 3));
  out.roughness = mix(0.45, 0.9, depth);
  out.specular = mix(0.028, 0.02, depth);
  return out;
}

}  // namespace effigy::people
