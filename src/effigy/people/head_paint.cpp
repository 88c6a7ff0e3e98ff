#include "effigy/people/head_paint.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/people/head_shape.h"
#include "effigy/people/noise.h"
#include "effigy/people/skin_optics.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

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

// Distance to the nearest of points scattered one to a unit cell (Worley 1996); exact up to 0.5.
double nearest_spot(const Vec3d& p) {
  const Vec3d base((p.array() - 0.5).floor());
  double best = 1;
  for (int k = 0; k < 8; ++k) {
    const Vec3d cell = base + Vec3d(k & 1, k >> 1 & 1, k >> 2);
    const auto x = static_cast<int64_t>(cell.x()), y = static_cast<int64_t>(cell.y()),
               z = static_cast<int64_t>(cell.z());
    const Vec3d spot = cell + Vec3d::Constant(0.5) +
                       0.45 * Vec3d(lattice(x, y, z), lattice(y + 71, z, x), lattice(z, x + 37, y));
    best = std::min(best, (p - spot).squaredNorm());
  }
  return std::sqrt(best);
}

// Distance from the brow's line in half widths there, front view, as cover 0 .. 1.
double brow_cover(const Vec3d& p, double width_scale) {
  static constexpr std::array<std::array<double, 3>, 6> kLine = {{{10.5, 17.2, 3.4},
                                                                  {20, 20.8, 4.3},
                                                                  {31, 23.4, 3.9},
                                                                  {41.5, 23.5, 3.3},
                                                                  {50.5, 20.6, 2.4},
                                                                  {58, 15.0, 0.9}}};
  if (p.z() < 30) return 0;
  double best = 0;
  for (size_t i = 1; i < kLine.size(); ++i) {
    const Vec2d a(kLine[i - 1][0], kLine[i - 1][1]), b(kLine[i][0], kLine[i][1]);
    const Vec2d q(p.x(), p.y()), ab = b - a;
    const double t = std::clamp((q - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0);
    const double width = width_scale * mix(kLine[i - 1][2], kLine[i][2], t);
    best = std::max(best, 1 - smooth_step(0.45 * width, 1.25 * width, (q - a - t * ab).norm()));
  }
  return best;
}

// Streaks along a direction: noise stretched by `stretch`.
double strands(const Vec3d& p, const Vec3d& along, double thick, double stretch) {
  const Vec3d a = along.normalized();
  const Vec3d across = p - a * a.dot(p);
  return cloud(across / thick + a * (a.dot(p) / (thick * stretch)));
}

// Where a beard grows: upper lip, chin, jaw and sideburn, less on the cheek.
double beard_cover(const Vec3d& p) {
  const double jaw = smooth_step(-50, -68, p.y()) * (1 - smooth_step(-122, -140, p.y()));
  const double cheek = bump(p, {36, -52, 72}, {17, 17, 26});
  const double front = smooth_step(-8, 26, p.z());
  const double burn = bump(p, {66, -34, 14}, {14, 30, 12});
  const double lip_gap = bump(p, {11, -89, 92}, {8, 5, 14});  // bare beside the soul patch
  return std::max(jaw * front * (1 - 0.8 * cheek) * (1 - 0.55 * lip_gap), 0.8 * burn);
}

struct Pigment {
  double melanin, blood;
};

Pigment pigment_at(const Place& place, const Subject& s) {
  const Vec3d p = left(place);
  const Vec3d own = place.p + s.pattern;
  const double mottle = cloud(own / 9.0), fine = cloud(own / 2.2);
  // Blood near the surface: cheeks, nose, ears, chin; little on the forehead.
  double red =
      1.0 * bump(p, {38, -32, 74}, {20, 18, 30}) + 1.0 * bump(p, {4, -42, 108}, {13, 12, 16}) +
      0.5 * bump(p, {16, -46, 92}, {7, 8, 10}) + 0.45 * bump(p, {0, -102, 93}, {18, 13, 18}) +
      0.5 * place.ear + 0.4 * bump(p, {15, -3, 82}, {7, 6, 10});
  red -= 0.30 * bump(p, {0, 46, 90}, {46, 24, 30}) + 0.25 * bump(p, {0, -86, 92}, {20, 5, 12});
  red += (0.28 + 0.25 * s.age) * mottle + 0.12 * fine;
  // Melanin: more around the eyes and on the neck's sides, less below the chin.
  double dark =
      0.35 * bump(p, {27, -11, 81}, {14, 7, 16}) + 0.35 * bump(p, {29, 8, 82}, {17, 7, 16});
  dark += 0.15 * s.age * bump(p, {24, -13, 82}, {12, 6, 16}) - 0.2 * smooth_step(-108, -124, p.y());
  dark += 0.12 * cloud(own / 15.0) + 0.06 * fine;
  Pigment out{s.melanin * std::exp(0.8 * dark), s.blood * std::exp(0.85 * red)};
  // Freckles and moles: spots of melanin where the sun falls; age spots are larger.
  const double sun =
      bump(p, {20, -22, 90}, {40, 26, 40}) + 0.5 * bump(p, {0, 40, 90}, {60, 30, 40});
  if (s.freckles * sun > 0.01) {
    const double freckle = smooth_step(0.42, 0.18, nearest_spot(own / 2.3)) *
                           smooth_step(-0.35, 0.45, noise(own / 6) + 0.3);
    out.melanin *= 1 + 1.9 * s.freckles * sun * freckle;
  }
  if (s.age > 0.3) {
    const double spot = smooth_step(0.32, 0.12, nearest_spot(own / 13));
    out.melanin *= 1 + 0.7 * s.age * spot;
  }
  const double mole = smooth_step(0.045, 0.025, nearest_spot(own / 34));
  out.melanin += 0.10 * mole;
  return out;
}

// Pores, fine wrinkles, creases of age: millimetres.
double skin_relief(const Place& place, double texel, const Subject& s) {
  const Vec3d p = left(place);
  const double mottle = cloud(place.p / 9.0);
  const double nose = bump(p, {0, -38, 104}, {20, 18, 22}),
               cheek = bump(p, {30, -32, 80}, {22, 20, 30});
  const double seen = resolved(1.3, texel);
  const double pore = seen > 0 ? std::exp(-std::pow(nearest_spot(place.p / 1.25) / 0.30, 2)) : 0.0;
  double height = -(0.030 + 0.035 * nose + 0.030 * cheek) * seen * pore;
  height += 0.012 * resolved(1.6, texel) * noise(place.p / 0.8) +
            0.040 * resolved(4.0, texel) * cloud(place.p / 2.0);
  const double lines = 0.35 + 1.5 * s.age;
  auto crease = [](double phase, double sharp) {
    return std::pow(0.5 + 0.5 * std::sin(phase), sharp);
  };
  const double forehead = bump(p, {0, 46, 90}, {42, 17, 26});
  height -=
      0.07 * lines * forehead * crease(p.y() * 0.75 + 0.9 * mottle + 0.0006 * p.x() * p.x(), 8);
  const double crow = bump(p, {55, -1, 62}, {9, 13, 14});
  const double fan = std::atan2(p.y() + 1, p.x() - 38);
  height -= 0.09 * lines * crow * crease(14 * fan + 1.2 * mottle, 6);
  const double bags = bump(p, {29, -15, 82}, {13, 5, 14});
  height -= 0.06 * lines * bags * crease(1.5 * (p.y() + 0.012 * std::pow(p.x() - 30, 2)), 5);
  const double frown = bump(p, {6, 20, 92}, {4, 9, 10});
  return height - 0.10 * s.age * frown * std::exp(-std::pow((p.x() - 6) / 1.0, 2));
}

Paint skin(const Place& place, double texel, const Subject& s) {
  const Vec3d p = left(place);
  Paint out;
  const Pigment pigment = pigment_at(place, s);
  out.albedo = skin_albedo(pigment.melanin, pigment.blood);

  const double fine = cloud(place.p / 2.6), mottle = cloud(place.p / 9.0);
  const double oily =
      bump(p, {0, -30, 106}, {15, 28, 22}) + 0.75 * bump(p, {0, 40, 94}, {36, 26, 24}) +
      0.5 * bump(p, {0, -103, 93}, {14, 11, 12}) + 0.35 * bump(p, {40, -24, 70}, {14, 9, 20});
  const double dry = bump(p, {46, -60, 50}, {20, 26, 26}) + smooth_step(-118, -135, p.y());
  out.roughness = 0.52 - 0.13 * s.oil * std::min(oily, 1.0) + 0.06 * std::min(dry, 1.0) +
                  0.03 * mottle + 0.02 * fine;
  out.specular = 0.028 + 0.003 * fine;
  out.height = skin_relief(place, texel, s);
  out.albedo *= 1 - 0.85 * smooth_step(0.15, 0.8, place.nostril);
  return out;
}

void lips(const Place& place, const Subject& s, Paint& out) {
  const double cover = smooth_step(0.36, 0.60, place.lip + 0.07 * noise(place.p / 1.7));
  const double wrinkle = strands(place.p, {0, 1, 0.2}, 1.1, 5);
  // Hardly any melanin over much blood; dark skin keeps some of its own.
  const Vec3d red =
      skin_albedo(0.35 * s.melanin + 0.004, 0.042 * s.lip_blood) * (1 + 0.10 * wrinkle);
  out.albedo = blend(out.albedo, red, 0.85 * cover);
  out.roughness = mix(out.roughness, 0.36, cover);
  out.specular = mix(out.specular, 0.034, cover);
  out.height = mix(out.height, 0.09 * wrinkle, cover);
}

void stubble(const Place& place, const Subject& s, Paint& out) {
  if (s.stubble <= 0) return;
  const Vec3d p = left(place);
  const double cover = beard_cover(p) * (1 - smooth_step(0.1, 0.5, place.lip));
  if (cover <= 0.01) return;
  const double fine = cloud(place.p / 2.6);
  const double shadow = std::min(s.stubble, 1.0) * cover * (0.75 + 0.4 * fine);
  // Cut hairs below the skin look blue grey.
  out.albedo = out.albedo.cwiseProduct(
      Vec3d(1 - 0.34 * shadow, 1 - 0.27 * shadow, 1 - 0.17 * shadow).cwiseMax(0.3));
  const double hairs = strands(place.p, {0.12 * (place.p.x() > 0 ? 1 : -1), -1, 0.1}, 0.55, 3.2);
  const double longer =
      smooth_step(0.9, 1.8, s.stubble) * smooth_step(0.15, 0.75, cover + 0.25 * fine);
  const Vec3d colour =
      blend(s.brow_colour, Vec3d::Constant(0.34), 0.8 * s.grey) * (1 + 0.5 * hairs);
  out.albedo =
      blend(out.albedo, colour.cwiseMax(0.004), 0.80 * longer * smooth_step(-0.5, 0.35, hairs));
  out.roughness = mix(out.roughness, 0.62, longer);
  out.height += (0.10 * longer + 0.02 * cover) * hairs;
}

// How the hair lies: streaks along meridians about a whorl behind the crown, or combed back from
// the forehead; curls as spots.
double hair_streak(const Vec3d& p, const HairStyle& style) {
  const Vec3d away = p - Vec3d(10, 20, -25);
  const double around = std::atan2(away.x(), away.z() + 0.25 * away.y());
  const double down = std::atan2(std::hypot(away.x(), away.z()), away.y());
  const double bend = 0.25 * cloud(p / 12);
  const double whorl =
      cloud(Vec3d(64 * std::cos(around), 64 * std::sin(around), 7 * down) + Vec3d::Constant(bend));
  const double back = cloud(
      Vec3d((p.x() + 3 * std::sin(0.09 * p.y() + bend)) / 1.7, bend, (p.z() - 0.7 * p.y()) / 22));
  const double straight = mix(whorl, back, style.comb);
  const double curl = 1.6 * (0.55 - nearest_spot(p / 4.2)) + 0.3 * cloud(p / 1.6);
  return mix(straight, curl, style.curl);
}

void hair(const Place& place, const Subject& s, Paint& out) {
  const Vec3d p = left(place);
  const double thin = std::clamp(std::max(s.hair.top, s.hair.sides) / 3.0, 0.55, 1.0);
  const double streak = hair_streak(place.p, s.hair);
  // Single hairs cross the hairline.
  const double ragged = 5.0 * streak + 1.2 * noise(place.p / 1.2);
  const double cap =
      place.ear > 0.02 ? 0.0 : hair_cover(Vec3d(p.x(), p.y() + ragged, p.z()), 15, s.hair);
  const double cover = thin * smooth_step(0.10, 0.85, cap);
  Vec3d colour = s.hair_colour * (1 + 0.60 * streak);
  const double white = smooth_step(0.75 - s.grey, 1.1 - s.grey, 0.5 + 0.5 * cloud(place.p / 1.3));
  colour = blend(colour, Vec3d(0.36, 0.35, 0.33) * (1 + 0.4 * streak), s.grey > 0 ? white : 0.0);
  out.albedo = blend(out.albedo, colour.cwiseMax(0.003), 0.97 * cover);
  out.roughness = mix(out.roughness, 0.58 + 0.08 * s.hair.curl + 0.08 * streak, cover);
  out.scatter *= 1 - cover;
  out.specular = mix(out.specular, 0.046, cover);
  out.height = mix(out.height, (0.42 + 0.15 * s.hair.curl) * streak, cover);
}

void brows(const Place& place, const Subject& s, Paint& out) {
  const Vec3d p = left(place);
  const double upright = strands(Vec3d(p.x(), p.y(), 0), {0.45, 1, 0}, 0.7, 6);
  const double lying = strands(Vec3d(p.x(), p.y(), 0), {1, -0.1, 0}, 0.7, 6);
  const double stroke = mix(upright, lying, smooth_step(12, 30, p.x()));
  const double cover = brow_cover(p, s.brow_width);
  if (cover <= 0) return;
  const double brow = smooth_step(0.25, 0.85, cover * (0.82 + 0.60 * stroke));
  const Vec3d colour =
      blend(s.brow_colour, Vec3d::Constant(0.30), 0.6 * s.grey) * (1 + 0.35 * stroke);
  out.albedo = blend(out.albedo, colour.cwiseMax(0.004), 0.88 * brow);
  out.roughness = mix(out.roughness, 0.66, brow);
  out.scatter *= 1 - 0.88 * brow;
  out.height += 0.09 * brow * (1 + stroke);
}

}  // namespace

Paint paint_at(const Place& place, double texel, const Subject& subject) {
  switch (place.part) {
    case PaintPart::kEye:
      return paint_eye(place, subject);
    case PaintPart::kTeeth:
      return paint_teeth(place);
    case PaintPart::kMouth:
      return paint_mouth(place);
    default:
      break;
  }
  Paint out = skin(place, texel, subject);
  stubble(place, subject, out);
  lips(place, subject, out);
  hair(place, subject, out);
  brows(place, subject, out);
  // Lashes as a dark line along the rim, and wet pink flesh inside.
  const double lash = smooth_step(0.50, 0.92, place.lash) * (subject.stubble > 0 ? 0.80 : 0.92);
  out.albedo = blend(out.albedo, Vec3d(0.035, 0.022, 0.018), lash);
  const double inside = smooth_step(0.2, 0.8, place.inside);
  out.albedo = blend(out.albedo, Vec3d(0.44, 0.20, 0.165), inside);
  out.roughness = mix(out.roughness, 0.22, inside);
  return out;
}

}  // namespace effigy::people
