#include "effigy/people/head_paint.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/people/head_shape.h"
#include "effigy/people/noise.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;

Vec3d blend(const Vec3d& a, const Vec3d& b, double t) {
  return a + t * (b - a);
}
// How much relief of this wavelength survives at this texel size.
double resolved(double wavelength, double texel) {
  return smooth_step(1.2, 3.0, wavelength / std::max(texel, 1e-3));
}

Vec3d left(const Place& place) {
  return {std::abs(place.p.x()), place.p.y(), place.p.z()};
}

// Distance from the brow's line and its half width there, front view.
double brow_cover(const Vec3d& p) {
  static constexpr std::array<std::array<double, 3>, 5> kLine = {
      {{9, 16.5, 4.0}, {19, 20.5, 4.2}, {30, 22.5, 3.6}, {40, 20.8, 2.6}, {51, 13.5, 1.0}}};
  if (p.z() < 30) return 0;
  double best = 0;
  for (size_t i = 1; i < kLine.size(); ++i) {
    const Vec2d a(kLine[i - 1][0], kLine[i - 1][1]), b(kLine[i][0], kLine[i][1]);
    const Vec2d q(p.x(), p.y()), ab = b - a;
    const double t = std::clamp((q - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0);
    const double width = mix(kLine[i - 1][2], kLine[i][2], t);
    best = std::max(best, 1 - smooth_step(0.55 * width, 1.15 * width, (q - a - t * ab).norm()));
  }
  return best;
}

// Streaks along a direction: noise stretched by `stretch`.
double strands(const Vec3d& p, const Vec3d& along, double thick, double stretch) {
  const Vec3d a = along.normalized();
  const Vec3d across = p - a * a.dot(p);
  return cloud(across / thick + a * (a.dot(p) / (thick * stretch)));
}

Paint skin(const Place& place, double texel) {
  const Vec3d p = left(place);
  Paint out;
  const double mottle = cloud(place.p / 9.0), fine = cloud(place.p / 2.6);
  Vec3d c(0.50, 0.315, 0.230);
  // Blood near the surface: cheeks, nose, ears, chin; yellower forehead; darker about the eyes.
  double red = 0.9 * bump(p, {38, -34, 72}, {22, 20, 30}) +
               0.9 * bump(p, {0, -42, 108}, {16, 13, 16}) +
               0.35 * bump(p, {0, -102, 92}, {20, 14, 20}) + 0.7 * place.ear;
  red = std::clamp(red + 0.25 * mottle, -0.3, 1.2);
  c = c.cwiseProduct(Vec3d(1 + 0.02 * red, 1 - 0.19 * red, 1 - 0.22 * red));
  const double pale = bump(p, {0, 48, 92}, {46, 24, 30});
  c = c.cwiseProduct(Vec3d(1 + 0.05 * pale, 1 + 0.05 * pale, 1 - 0.02 * pale));
  const double shade =
      bump(p, {29, -10, 80}, {16, 8, 16}) + 0.6 * bump(p, {28, 7, 82}, {18, 7, 16});
  c = c.cwiseProduct(Vec3d(1 - 0.12 * shade, 1 - 0.20 * shade, 1 - 0.14 * shade));
  // Stubble: a faint blue-grey over upper lip, chin and jaw.
  const double jaw = smooth_step(-52, -66, p.y()) * (1 - smooth_step(-128, -140, p.y())) *
                     smooth_step(6, 34, p.z()) * (1 - 0.75 * bump(p, {34, -58, 70}, {16, 16, 24}));
  const double stubble = jaw * (1 - place.lip) * (0.75 + 0.5 * fine);
  c = c.cwiseProduct(Vec3d(1 - 0.20 * stubble, 1 - 0.15 * stubble, 1 - 0.08 * stubble));
  // Freckles over nose and cheeks, few.
  const double freckle =
      smooth_step(0.50, 0.75, noise(place.p / 1.25 + Vec3d(17, 3, 5)) + 0.15 * noise(place.p / 7)) *
      bump(p, {24, -26, 84}, {34, 20, 34});
  c = c.cwiseProduct(Vec3d(1 - 0.13 * freckle, 1 - 0.20 * freckle, 1 - 0.24 * freckle));
  c *= 1 + 0.05 * mottle + 0.035 * fine;

  const double oily =
      bump(p, {0, -30, 104}, {14, 26, 20}) + 0.7 * bump(p, {0, 40, 94}, {34, 26, 24});
  out.roughness = 0.53 - 0.10 * std::min(oily, 1.0) + 0.03 * mottle;
  out.specular = 0.028 + 0.003 * fine;
  out.height = 0.020 * resolved(1.6, texel) * noise(place.p / 0.8) +
               0.045 * resolved(4.0, texel) * cloud(place.p / 2.0);
  // Creases of the forehead.
  const double forehead = bump(p, {0, 44, 90}, {40, 16, 26});
  out.height -= 0.06 * forehead * std::pow(0.5 + 0.5 * std::sin(p.y() * 0.78 + 0.9 * mottle), 8);

  // Nostrils, and the line of the lips, lie in the dark.
  const double nostril = bump(p, {6.6, -51.0, 98}, {3.2, 2.6, 4.5});
  c *= 1 - 0.80 * std::min(1.0, nostril);
  out.albedo = c;
  return out;
}

void lips(const Place& place, Paint& out) {
  const double cover = smooth_step(0.30, 0.62, place.lip + 0.06 * noise(place.p / 1.7));
  const double wrinkle = strands(place.p, {0, 1, 0.2}, 1.1, 5);
  const Vec3d red = Vec3d(0.40, 0.180, 0.150) * (1 + 0.10 * wrinkle);
  out.albedo = blend(out.albedo, red, 0.88 * cover);
  out.roughness = mix(out.roughness, 0.34, cover);
  out.specular = mix(out.specular, 0.034, cover);
  out.height = mix(out.height, 0.10 * wrinkle, cover);
}

void hair(const Place& place, Paint& out) {
  const Vec3d p = left(place);
  const double ragged = 5.0 * noise(place.p / 3.1) + 3.0 * noise(place.p / 1.4);
  const double cap = place.ear > 0.02 ? 0.0 : hair_cover(Vec3d(p.x(), p.y() + ragged, p.z()), 9);
  // Combed from a whorl behind the crown: streaks run along meridians about it.
  const Vec3d away = place.p - Vec3d(10, 20, -25);
  const double around = std::atan2(away.x(), away.z() + 0.25 * away.y());
  const double down = std::atan2(std::hypot(away.x(), away.z()), away.y());
  const double streak = cloud(Vec3d(46 * std::cos(around), 46 * std::sin(around), 7 * down) +
                              0.25 * Vec3d::Constant(cloud(place.p / 12)));
  const Vec3d brown = Vec3d(0.060, 0.036, 0.022) * (1 + 0.55 * streak);
  const double cover = smooth_step(0.25, 0.75, cap + 0.12 * streak);
  out.albedo = blend(out.albedo, brown, 0.97 * cover);
  out.roughness = mix(out.roughness, 0.62 + 0.06 * streak, cover);
  out.specular = mix(out.specular, 0.034, cover);
  out.height = mix(out.height, 0.28 * streak, cover);

  const double upright = strands(Vec3d(p.x(), p.y(), 0), {0.45, 1, 0}, 0.8, 5);
  const double lying = strands(Vec3d(p.x(), p.y(), 0), {1, -0.1, 0}, 0.8, 5);
  const double stroke = mix(upright, lying, smooth_step(12, 32, p.x()));
  const double brow = smooth_step(0.28, 0.72, brow_cover(p) * (0.80 + 0.55 * stroke));
  out.albedo = blend(out.albedo, Vec3d(0.075, 0.045, 0.030), 0.85 * brow);
  out.roughness = mix(out.roughness, 0.58, brow);
  out.height += 0.10 * brow * (1 + stroke);
}

Paint eye(const Place& place) {
  Paint out;
  const double side = place.p.x() > 0 ? 1 : -1;
  const Vec3d q = place.p - Vec3d(side * kEyeX, kEyeY, kEyeZ);
  const double angle = std::atan2(std::hypot(q.x(), q.y()), q.z()) * 180 / kPi;
  const double turn = std::atan2(q.y(), q.x());
  const double vein = smooth_step(0.25, 0.6, std::abs(cloud(q / 1.7))) * smooth_step(34, 62, angle);
  const Vec3d white =
      Vec3d(0.56, 0.53, 0.50).cwiseProduct(Vec3d(1, 1 - 0.16 * vein, 1 - 0.18 * vein)) *
      (1 - 0.45 * smooth_step(38, 75, angle));
  const double ray = cloud(Vec3d(9 * std::cos(turn), 9 * std::sin(turn), 0.12 * angle));
  Vec3d iris = blend(Vec3d(0.19, 0.115, 0.045), Vec3d(0.10, 0.13, 0.115),
                     smooth_step(13, 24, angle + 3 * ray));
  iris *= 1 + 0.5 * ray;
  iris *= 1 - 0.75 * smooth_step(25, 29, angle);  // dark limbal ring
  out.albedo = blend(iris, white, smooth_step(27.6, 30.2, angle));
  out.albedo = blend(Vec3d(0.006, 0.006, 0.006), out.albedo, smooth_step(9.6, 11.2, angle));
  out.roughness = 0.10;
  out.specular = 0.030;
  return out;
}

Paint teeth(const Place& place) {
  Paint out;
  // Gaps between the teeth lie at whole numbers.
  const double line = 1 - smooth_step(0.03, 0.11, std::abs(place.along - std::round(place.along)));
  Vec3d c(0.66, 0.60, 0.49);
  c = c.cwiseProduct(Vec3d(1 - 0.28 * line, 1 - 0.36 * line, 1 - 0.42 * line));
  const double gum = smooth_step(0.62, 0.80, place.gum + 0.10 * std::cos(2 * kPi * place.along));
  // Little light reaches the back of the mouth; shading knows no occlusion, so the paint does.
  const double depth = smooth_step(82, 56, place.p.z());
  out.albedo = blend(c, Vec3d(0.36, 0.13, 0.115), gum) * mix(0.85, 0.16, depth);
  out.roughness = mix(mix(0.22, 0.34, gum), 0.8, depth);
  out.specular = mix(0.04, 0.02, depth);
  out.height = -0.15 * line;
  return out;
}

Paint mouth(const Place& place) {
  Paint out;
  const double depth = smooth_step(88, 58, place.p.z());
  out.albedo = blend(Vec3d(0.22, 0.075, 0.065), Vec3d(0.035, 0.012, 0.011), depth) *
               (1 + 0.08 * cloud(place.p / 3));
  out.roughness = mix(0.45, 0.9, depth);
  out.specular = mix(0.028, 0.02, depth);
  return out;
}

}  // namespace

Paint paint_at(const Place& place, double texel) {
  switch (place.part) {
    case PaintPart::kEye:
      return eye(place);
    case PaintPart::kTeeth:
      return teeth(place);
    case PaintPart::kMouth:
      return mouth(place);
    default:
      break;
  }
  Paint out = skin(place, texel);
  lips(place, out);
  hair(place, out);
  // Lashes as a dark line along the rim, and wet pink flesh inside.
  out.albedo =
      blend(out.albedo, Vec3d(0.05, 0.03, 0.025), 0.80 * smooth_step(0.55, 0.95, place.lash));
  out.albedo = blend(out.albedo, Vec3d(0.42, 0.20, 0.17), smooth_step(0.2, 0.8, place.inside));
  out.roughness = mix(out.roughness, 0.30, smooth_step(0.2, 0.8, place.inside));
  return out;
}

}  // namespace effigy::people
