#include "effigy/people/body_paint.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "effigy/people/noise.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;

// How much relief of this wavelength survives at this texel size.
double resolved(double wavelength, double texel) {
  return smooth_step(1.6, 3.2, wavelength / std::max(texel, 1e-3));
}
// A stitched line: 1 on it.
double line(double distance, double half_width) {
  return 1 - smooth_step(0.5 * half_width, 1.5 * half_width, std::abs(distance));
}
Vec3d tinted(const Vec3d& c, double red, double r, double g, double b) {
  return c.cwiseProduct(Vec3d(1 - r * red, 1 - g * red, 1 - b * red));
}

// Nearest finger bone: which, how far along (0..1), and the direction from its axis.
struct OnFinger {
  int finger = -1, bone = 0;
  double along = 0, off = 1e9;
  Vec3d away = Vec3d::Zero(), axis = Vec3d::UnitX();
};
OnFinger find_finger(const BodyJoints& j, const Vec3d& p) {
  OnFinger best;
  for (int f = 0; f < 5; ++f)
    for (int b = 0; b < 3; ++b) {
      const auto& finger = j.fingers[static_cast<size_t>(f)];
      const Vec3d a = finger[static_cast<size_t>(b)], ab = finger[static_cast<size_t>(b) + 1] - a;
      const double t = (p - a).dot(ab) / ab.squaredNorm();
      const Vec3d away = p - a - std::clamp(t, 0.0, 1.0) * ab;
      if (away.norm() < best.off) best = {f, b, t, away.norm(), away, ab.normalized()};
    }
  return best;
}

void paint_hand(const BodyModel& model, const BodyPlace& place, BodyPaint& out) {
  const BodyJoints& j = model.form.joints();
  const Vec3d p(std::abs(place.p.x()), place.p.y(), place.p.z());
  const Vec3d n(place.p.x() < 0 ? -place.normal.x() : place.normal.x(), place.normal.y(),
                place.normal.z());
  const double palm = smooth_step(-0.15, 0.45, n.dot(j.palm_normal));
  const OnFinger f = find_finger(j, p);
  const double back = 1 - palm, on = smooth_step(16, 11, f.off);
  // Little melanin and more blood in the palm; knuckles and finger tips redder.
  out.albedo = out.albedo.cwiseProduct(Vec3d(1 + 0.06 * palm, 1 + 0.03 * palm, 1 + 0.06 * palm));
  const double tip = f.bone == 2 ? on * smooth_step(0.3, 1.0, f.along) : 0;
  const double joint =
      on * std::max(line(f.along * 30, 5), f.bone == 2 ? 0.0 : line((1 - f.along) * 30, 5));
  const double red =
      std::clamp(0.5 * tip + 0.45 * joint * back + 0.25 * palm * cloud(p / 9), 0.0, 1.0);
  out.albedo = tinted(out.albedo, red, 0.02, 0.20, 0.20);
  // Creases across the fingers' joints and in the palm.
  const double ripple = std::cos(2 * kPi * f.along * 30 / 1.9);
  out.height -= 0.10 * joint * on *
                (back * (0.5 + 0.5 * ripple) + 1.2 * palm * line(f.along * 30, 1.2)) *
                resolved(2.5, place.texel);
  const Vec3d q = p - j.hand;
  const Vec3d along = (j.hand - j.lower_arm).normalized();
  const double x = q.dot(along), y = q.dot(j.thumb_side);
  const double crease =
      std::max(line(y - 0.0095 * (x - 70) * (x - 70) + 12, 1.1) * smooth_step(20, 30, x),
               line(x - 74 - 0.006 * y * y - 0.1 * y, 1.0) * smooth_step(30, 20, y));
  const double lines = palm * crease * smooth_step(110, 95, x) * smooth_step(5, 15, x);
  out.albedo = tinted(out.albedo, 0.5 * lines, 0.10, 0.35, 0.35);
  out.height -= 0.15 * lines;
  // Nails: on the back of the last bone.
  const Vec3d dorsal = (-j.palm_normal + f.axis * f.axis.dot(j.palm_normal)).normalized();
  const Vec3d lateral = f.axis.cross(dorsal);
  const double wide = f.finger == 0 ? 6.2 : f.finger == 4 ? 4.0 : 5.0;
  const double side = std::abs(f.away.dot(lateral)) / wide;
  const double rise =
      f.finger == 0
          ? f.away.normalized().dot((dorsal + 0.8 * j.thumb_side.cross(f.axis)).normalized())
          : f.away.normalized().dot(dorsal);
  if (f.bone == 2 && rise > 0.35) {
    const double u = (f.along - 0.68) / 0.30;
    const double inside = 1 - std::pow(std::pow(std::abs(u), 3) + std::pow(side, 3), 1.0 / 3);
    const double nail = smooth_step(0.0, 0.14, inside);
    const double moon = smooth_step(0.35, 0.2, std::hypot(u + 1.0, 0.7 * side)),
                 edge = smooth_step(0.72, 0.85, u);
    Vec3d c = tinted(out.albedo * 1.12, 0.4, 0.0, 0.16, 0.10);
    c = mix(0, 1, 1) * (c + (Vec3d(0.60, 0.52, 0.46) - c) * std::max(0.45 * moon, 0.7 * edge));
    out.albedo += nail * (c - out.albedo);
    out.roughness = mix(out.roughness, 0.28, nail);
    out.specular = mix(out.specular, 0.045, nail);
    out.height += 0.16 * nail - 0.2 * smooth_step(0.14, 0.0, std::abs(inside));
  }
}

BodyPaint paint_skin(const BodyModel& model, const Vec3d& skin, const BodyPlace& place, bool hand) {
  BodyPaint out;
  out.part = hand ? kHands : kSkin;
  const Vec3d p(std::abs(place.p.x()), place.p.y(), place.p.z());
  const BodyJoints& j = model.form.joints();
  const double mottle = cloud(place.p / 16.0), fine = cloud(place.p / 3.0);
  out.albedo = skin * (1 + 0.045 * mottle + 0.03 * fine);
  const double elbow = bump(p, j.lower_arm + Vec3d(6, 0, -34), {26, 26, 22});
  const double knee = bump(p, j.lower_leg + Vec3d(0, 6, 44), {34, 36, 30});
  out.albedo = tinted(out.albedo, std::clamp(0.5 * (elbow + knee) + 0.12 * mottle, -0.2, 1.0), 0.06,
                      0.16, 0.16);
  // Veins on the inside of the forearm and the back of the hand, faint; freckles and a few moles.
  const double vein = smooth_step(0.80, 0.96, 1 - std::abs(noise(place.p / 31 + Vec3d(3, 9, 1))));
  out.albedo = tinted(out.albedo, 0.35 * vein, 0.14, 0.03, 0.0);
  out.height += 0.12 * vein;
  const double mole = smooth_step(0.90, 0.97, noise(place.p / 6.5 + Vec3d(41, 7, 3)));
  out.albedo = tinted(out.albedo, mole, 0.45, 0.6, 0.65);
  out.roughness = 0.55 + 0.03 * mottle;
  out.specular = 0.028;
  out.height += 0.03 * resolved(3.0, place.texel) * cloud(place.p / 1.6);
  if (hand) paint_hand(model, place, out);
  return out;
}

// Knit: rows of loops; fine heather in the colour.
void knit(const BodyPlace& place, const Vec3d& across, double pitch, BodyPaint& out) {
  const double u = place.p.dot(across) / pitch, v = place.p.y() / pitch;
  const double visible = resolved(2 * pitch, place.texel);
  const double loop =
      std::cos(2 * kPi * u) * (0.6 + 0.4 * std::cos(2 * kPi * (v + 0.5 * std::cos(kPi * u))));
  out.height += 0.14 * visible * loop;
  out.albedo *=
      1 + 0.05 * visible * loop + 0.05 * cloud(place.p / 2.2) + 0.03 * cloud(place.p / 19);
}

BodyPaint paint_top(const BodyModel& model, const BodyPlace& place, double edge) {
  const BodyStyle& s = model.style;
  const BodyForm& form = model.form;
  const double k = s.build.stature;
  BodyPaint out;
  out.part = kTop;
  out.roughness = 0.82;
  out.specular = 0.03;
  const Vec3d p(std::abs(place.p.x()), place.p.y(), place.p.z());
  const double arm = form.along_arm(p);
  const bool sleeve = p.x() > form.joints().upper_arm.x() - 10 * k && arm > 18 * k;
  Vec3d colour = s.top_colour;
  if (s.print == Print::kStripes) {
    const double y = sleeve ? arm : place.p.y();
    const double stripe = smooth_step(-0.12, 0.12, std::sin(2 * kPi * y / 46) - 0.35);
    colour += stripe * (s.top_second - colour);
  } else if (s.print == Print::kChecks) {
    const double angle = std::atan2(place.p.x(), place.p.z() + 10) * 150;
    const double u = sleeve ? place.p.z() : angle, v = sleeve ? arm : place.p.y();
    const double a = smooth_step(-0.2, 0.2, std::sin(2 * kPi * u / 58));
    const double b = smooth_step(-0.2, 0.2, std::sin(2 * kPi * v / 58));
    colour += 0.5 * (a + b) * (s.top_second - colour);
  } else if (s.print == Print::kRaglan && sleeve) {
    colour = s.top_second;
  }
  out.albedo = colour;
  const double angle = std::atan2(place.p.x(), place.p.z() + 10);
  const Vec3d across = sleeve ? Vec3d(0.2, 0.2, 1).normalized()
                              : Vec3d(std::cos(angle), 0, -std::sin(angle)).normalized();
  knit(place, across, 1.6, out);
  // Hems: a folded band with two rows of stitches; ribbed at the neck.
  const bool at_neck = p.y() > form.joints().upper_arm.y() - 20 * k && !sleeve;
  const double band = at_neck ? 20 * k : 18 * k;
  const double inside = smooth_step(band + 0.8, band - 0.8, edge);
  out.height += 0.5 * inside;
  if (at_neck) {
    const double around = std::atan2(place.p.x(), place.p.z() + 34) * 60;
    out.height += 0.25 * inside * std::cos(2 * kPi * around / 3.4) * resolved(3.4, place.texel);
    out.albedo *= 1 - 0.10 * inside;
  }
  const double stitch =
      std::max(line(edge - band, 0.8), at_neck ? 0.0 : line(edge - band + 4, 0.7));
  out.albedo *= 1 - 0.22 * stitch;
  out.height -= 0.25 * stitch;
  // Side and shoulder seams.
  const double seam = sleeve ? 0.0 : line(place.p.z() + 22, 0.8) * smooth_step(110, 130, p.x());
  out.height -= 0.2 * seam;
  out.albedo *= 1 - 0.12 * seam;
  // A polo's placket and buttons.
  if (s.outfit.top == Top::kPolo && place.p.z() > 0) {
    const double top = form.joints().upper_chest.y() + 122 * k, low = top - 150 * k;
    const double placket = smooth_step(17, 16, p.x()) * smooth_step(low, low + 1, p.y());
    out.height += 0.4 * placket;
    out.albedo *= 1 - 0.2 * line(p.x() - 15, 0.7) * placket;
    for (const double y : {low + 30, low + 80}) {
      const double r = std::hypot(p.x(), place.p.y() - y);
      const double button = smooth_step(5.4, 4.8, r);
      out.albedo += button * (Vec3d(0.55, 0.52, 0.46) - out.albedo);
      out.roughness = mix(out.roughness, 0.3, button);
      out.height += 0.8 * button;
    }
  }
  return out;
}

BodyPaint paint_bottom(const BodyModel& model, const BodyPlace& place, double edge) {
  const BodyStyle& s = model.style;
  const BodyJoints& j = model.form.joints();
  const double k = s.build.stature;
  BodyPaint out;
  out.part = kBottom;
  out.roughness = s.denim ? 0.86 : 0.78;
  out.specular = 0.03;
  const Vec3d p(std::abs(place.p.x()), place.p.y(), place.p.z());
  Vec3d colour = s.bottom_colour;
  if (s.denim) {
    // Worn pale on thighs, knees and seat.
    const double worn = 0.8 * bump(p, Vec3d(88, j.lower_leg.y() + 190, 80), {50, 150, 60}) +
                        0.7 * bump(p, j.lower_leg + Vec3d(0, 10, 55), {42, 60, 40}) +
                        0.5 * bump(p, Vec3d(80, j.upper_leg.y() - 20, -120), {60, 70, 60});
    colour += std::clamp(worn + 0.25 * cloud(place.p / 26), 0.0, 1.0) * 0.7 *
              (Vec3d(0.20, 0.26, 0.36) - colour);
  }
  // Twill: diagonal ribs.
  const double pitch = s.denim ? 1.9 : 1.5;
  const double angle = std::atan2(place.p.x() - std::copysign(90.0, place.p.x()), place.p.z()) * 70;
  const double rib = std::cos(2 * kPi * (0.7 * angle + 0.7 * place.p.y()) / pitch);
  const double visible = resolved(2 * pitch, place.texel);
  out.height += 0.12 * visible * rib;
  const double slub = noise(Vec3d(place.p.x() / 1.7, place.p.y() / 30, place.p.z() / 1.7));
  out.albedo = colour * (1 + 0.10 * visible * rib + (s.denim ? 0.13 : 0.03) * slub +
                         0.05 * cloud(place.p / 11));
  // Seams along the outside and inside of the legs, hem, fly and pockets.
  const double below = j.upper_leg.y() - 60 * k;
  const double side =
      line(place.p.z() + 12, 1.0) * (p.y() < below ? 1.0 : smooth_step(110, 125, p.x()));
  const double hem = line(edge - 26, 0.9);
  const double pocket =
      place.p.z() > 0 ? line(std::hypot(p.x() - 168, p.y() - (j.upper_leg.y() + 62)) - 88, 0.9) *
                            smooth_step(j.upper_leg.y() + 75, j.upper_leg.y() + 60, p.y())
                      : 0.0;
  double back_pocket = 0;
  if (place.p.z() < -40) {
    const double u = std::abs(p.x() - 74 * k) - 52,
                 v = std::abs(p.y() - (j.upper_leg.y() - 8 * k)) - 60;
    back_pocket = line(std::max(u, v), 0.9);
    out.height += 0.5 * smooth_step(1, -1, std::max(u, v));
  }
  const double stitch = std::max({0.8 * hem, pocket, back_pocket});
  const Vec3d thread = s.denim ? Vec3d(0.42, 0.24, 0.08) : Vec3d(0.7 * colour);
  out.albedo += 0.7 * stitch * resolved(4.0, place.texel) * (thread - out.albedo);
  out.height -= 0.35 * side + 0.2 * stitch;
  out.albedo *= 1 - 0.25 * side;
  return out;
}

BodyPaint paint_shoe(const BodyModel& model, const BodyPlace& place) {
  const BodyStyle& s = model.style;
  const BodyJoints& j = model.form.joints();
  const double k = s.build.stature;
  BodyPaint out;
  out.part = kShoes;
  const Vec3d p(std::abs(place.p.x()), place.p.y(), place.p.z());
  const double sole = smooth_step(23.5, 22.5, p.y());
  const double toe = smooth_step(j.toes.z() + 22, j.toes.z() + 30, p.z());
  out.albedo = s.shoe_colour * (1 - 0.12 * toe + 0.05 * cloud(place.p / 5));
  out.roughness = 0.55;
  out.specular = 0.04;
  out.height = 0.06 * cloud(place.p / 1.5) + 0.3 * toe;
  // Laces across the instep.
  const double middle =
      mix(j.foot.x(), j.toes.x(), (p.z() - j.foot.z()) / (j.toes.z() - j.foot.z()));
  const double off = std::abs(p.x() - middle);
  const bool instep =
      p.z() > j.foot.z() + 38 * k && p.z() < j.toes.z() - 8 * k && place.normal.y() > 0.1;
  if (instep) {
    const double row = std::cos(2 * kPi * p.z() / 15);
    const double lace = smooth_step(0.2, 0.5, row) * smooth_step(24, 22, off);
    const double tongue = smooth_step(22, 20, off);
    out.albedo *= 1 - 0.3 * tongue;
    out.albedo += lace * (Vec3d(0.62, 0.60, 0.56) - out.albedo);
    out.roughness = mix(out.roughness, 0.85, lace);
    out.height += 1.0 * lace - 0.5 * tongue;
  }
  const Vec3d rubber(0.52, 0.50, 0.46);
  const double groove = line(p.y() - 12, 0.8);
  out.albedo += sole * (rubber * (1 - 0.3 * groove) - out.albedo);
  out.roughness = mix(out.roughness, 0.62, sole);
  if (place.normal.y() < -0.7 && p.y() < 8) {
    const double tread =
        smooth_step(-0.2, 0.2, std::cos(2 * kPi * p.z() / 12) * std::cos(2 * kPi * p.x() / 12));
    out.albedo = Vec3d(0.10, 0.10, 0.10) * (0.8 + 0.4 * tread);
    out.height += 0.8 * tread;
  }
  return out;
}

}  // namespace

BodyPaint paint_body(const BodyModel& model, const Vec3d& skin, const BodyPlace& place) {
  const BodyForm::Cover c = model.form.cover(place.p);
  const bool hand = c.hand > 0 && std::abs(place.p.x()) > model.form.joints().hand.x() - 60;
  if (hand) return paint_skin(model, skin, place, true);
  if (c.top > 0) return paint_top(model, place, c.top);
  if (c.bottom > 0) return paint_bottom(model, place, std::max(c.bottom, 0.0));
  return c.shoe > 0 ? paint_shoe(model, place) : paint_skin(model, skin, place, false);
}

}  // namespace effigy::people
