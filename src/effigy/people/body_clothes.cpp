// The clothes and shoes of the built-in body's form.

#include <algorithm>
#include <cmath>

#include "effigy/people/body_shape.h"
#include "effigy/people/noise.h"
#include "effigy/people/smooth.h"

namespace effigy::people {

void BodyForm::make_clothes() {
  const BodyBuild& b = build_;
  const BodyJoints& j = joints_;
  const double k = b.stature, y0 = j.upper_leg.y();
  const auto at = [&](double y) { return (y - 890) * k; };
  const double e = outfit_.top_ease, c = std::max(b.chest, b.waist), h = b.hips;
  const double front = 106 * c + 0.6 * b.belly;
  // What hangs from chest and shoulder blades.
  drape_ = tube({0, y0, -12}, {0, 1, 0}, {1, 0, 0},
                {{at(840), 150 * h + 8 * e, 150 * h + 8 * e, front + 6 * e, 106 * h + 8 * e},
                 {at(900), 156 * h + 6 * e, 156 * h + 6 * e, front + 6 * e, 108 * h + 8 * e},
                 {at(960), 150 * h + 6 * e, 150 * h + 6 * e, front + 6 * e, 103 * h + 7 * e},
                 {at(1050), 136 * c + 7 * e, 136 * c + 7 * e, front - 4 + 4 * e, 88 + 6 * e},
                 {at(1140), 142 * c + 6 * e, 142 * c + 6 * e, front - 3 + 3 * e, 97 + 4 * e},
                 {at(1230), 150 * c + 5 * e, 150 * c + 5 * e, front, 104},
                 {at(1300), 130, 130, 80, 90}},
                k, 2.3);
  drape_.cap0 = 30;
  drape_.cap1 = 30;
  const double g = b.limbs * k, w = outfit_.bottom_ease;
  const double leg = (j.foot - j.upper_leg).norm();
  const auto part = [&](double t) { return t * leg; };
  trouser_ = tube(j.upper_leg, j.foot - j.upper_leg, {1, 0, 0},
                  {{part(0.06), 82 * g + 4 * w, 68 * g + 5 * w, 86 * g + 5 * w, 94 * g + 5 * w},
                   {part(0.20), 79 * g + 6 * w, 76 * g + 5 * w, 86 * g + 6 * w, 84 * g + 8 * w},
                   {part(0.36), 70 * g + 9 * w, 68 * g + 8 * w, 75 * g + 8 * w, 72 * g + 10 * w},
                   {part(0.50), 55 * g + 9 * w, 57 * g + 8 * w, 58 * g + 7 * w, 57 * g + 10 * w},
                   {part(0.66), 53 * g + 8 * w, 56 * g + 7 * w, 48 * g + 8 * w, 67 * g + 7 * w},
                   {part(0.85), 42 * g + 10 * w, 42 * g + 9 * w, 40 * g + 10 * w, 53 * g + 9 * w},
                   {part(0.98), 40 * g + 9 * w, 40 * g + 8 * w, 46 * g + 9 * w, 48 * g + 9 * w}},
                  1, 2);
  trouser_.cap0 = 40;
  trouser_.cap1 = 20;
  const double s = b.limbs * k;
  const Vec3d arm = j.lower_arm - j.upper_arm;
  sleeve_ = tube(j.upper_arm, arm, {0, 0, 1},
                 {{-10, 50 * s + 2 * e, 51 * s + 2 * e, 46 * s + 2 * e, 48 * s + 3 * e},
                  {60, 53 * s + 4 * e, 53 * s + 4 * e, 49 * s + 3 * e, 52 * s + 7 * e},
                  {140, 50 * s + 7 * e, 49 * s + 7 * e, 46 * s + 4 * e, 51 * s + 10 * e},
                  {220, 47 * s + 7 * e, 46 * s + 7 * e, 44 * s + 4 * e, 48 * s + 10 * e},
                  {310, 46 * s + 9 * e, 44 * s + 9 * e, 44 * s + 6 * e, 46 * s + 12 * e}},
                 1, 2);
  sleeve_.cap0 = 30;
  sleeve_.cap1 = 26;

  const Vec3d forward = Vec3d(j.toes.x() - j.foot.x(), 0, j.toes.z() - j.foot.z()).normalized();
  const Vec3d heel = Vec3d(j.foot.x(), 34, j.foot.z()) - 62 * k * forward;
  const Vec3d out(forward.z(), 0, -forward.x());
  const double f = k * (0.85 + 0.15 * b.limbs);
  // u: outwards, v: up.
  foot_ = tube(heel, forward, out,
               {{4 * k, 22, 22, 36, 36},
                {22 * k, 32, 31, 56, 38},
                {58 * k, 36, 34, 66, 40},
                {95 * k, 38, 36, 56, 40},
                {130 * k, 42, 40, 40, 40},
                {170 * k, 48, 46, 25, 40},
                {205 * k, 47, 46, 15, 40},
                {240 * k, 36, 40, 9, 38},
                {256 * k, 22, 28, 5, 36}},
               f, 2.4);
  foot_.v = {0, 1, 0};
  foot_.cap0 = 14;
  foot_.cap1 = 12;
  sole_ = foot_;
}

double BodyForm::shoe(const Vec3d& p) const {
  if (p.y() > 190 * build_.stature) return 1e3;
  const double k = build_.stature;
  double upper = foot_.distance(p, 1.5);
  // The opening around the ankle.
  const Vec3d ankle = joints_.foot;
  upper =
      join(upper,
           limb(p, ankle + Vec3d(0, -30, -2) * k, ankle + Vec3d(0, 4, -6) * k, 44 * k, 42 * k), 24);
  upper = meet(upper, 8 - p.y(), 6);
  const double sole = meet(meet(sole_.distance(p, 5), -p.y(), 5), p.y() - 24, 4);
  return join(upper, sole, 3);
}

double BodyForm::folds(const Vec3d& p) const {
  // Long soft folds that hang in the cloth at rest; they fade out at the shoulders.
  const double k = build_.stature;
  const double low = smooth_step(1330 * k, 1080 * k, p.y());
  const double across = std::atan2(p.x(), p.z() + 10) * 3.2;
  const double hang = noise(Vec3d(across + 0.004 * p.y(), p.y() / 260, 3.7));
  return outfit_.top_ease * (0.4 + 2.6 * low) * hang;
}

double BodyForm::top(const Vec3d& p, const Cover& c, double trunk, double arm) const {
  const double k = build_.stature, ease = outfit_.top_ease;
  if (c.top < -25) return 1e3;
  const bool on_arm = p.x() > joints_.upper_arm.x() + 40 * k;
  // Thin where it ends at the neck.
  const double collar = on_arm ? 1 : smooth_step(1330 * k, 1300 * k, p.y());
  const double edge = smooth_step(0, 40, c.top);
  double cloth = trunk - mix(1.2 + (1.8 + 1.5 * ease) * edge, 3.0 + 1.5 * ease, collar);
  if (p.x() < 260 * k) cloth = join(cloth, drape_.distance(p), 30 * k);
  if (p.x() > 90 * k) cloth = join(cloth, meet(sleeve_.distance(p), arm - 30, 8), 16 * k);
  // Long sleeves lie on the forearm with some ease.
  if (outfit_.top == Top::kLongSleeve)
    cloth = join(cloth, lower_arm_.distance(p, 5 + 3 * ease), 12);
  return meet(cloth, -c.top, 2.5);
}

double BodyForm::bottom(const Vec3d& p, const Cover& c, double lower_body, double leg) const {
  if (c.bottom < -25) return 1e3;
  double cloth = join(lower_body - 3.0, meet(trouser_.distance(p), leg - 45, 10), 14);
  return meet(cloth, -c.bottom, 2.5);
}

BodyForm::Cover BodyForm::cover(const Vec3d& point) const {
  const double k = build_.stature;
  const Vec3d p(std::abs(point.x()), point.y(), point.z());
  const double lift = joints_.upper_leg.y() - 890 * k;
  const double arm = along_arm(p);
  Cover c;
  const double reach = arm_reach();
  c.hand = arm - (reach - 6 * k);
  // The top: between the hem and the sleeves, below the neckline.
  const double upper = (joints_.lower_arm - joints_.upper_arm).norm();
  const double sleeve = outfit_.top == Top::kLongSleeve ? reach - 14 * k
                        : outfit_.top == Top::kPolo     ? 0.62 * upper
                                                        : 0.74 * upper;
  // Only where the arm is: the trunk's side of the shoulder joint has no sleeve end.
  const double hem = p.y() - (lift + outfit_.hem * k) - 3 * std::sin(0.021 * p.x() + 1.3);
  const Vec3d from = p - joints_.upper_arm;
  const Vec3d down = (joints_.lower_arm - joints_.upper_arm).normalized();
  const bool on_arm = from.x() > 0 && (from - down * from.dot(down)).norm() < 130 * k;
  // Outside a cone around the neck, lower in front.
  const double high = outfit_.top == Top::kPolo ? 9 * k : 0;
  const double round_neck = std::hypot(p.x() / 1.05, p.z() + 32 * k) - 76 * k + high;
  const double drop = lift + 1392 * k - p.y() - 0.36 * (p.z() + 30 * k);
  c.top = round_neck + 0.9 * std::max(drop, 0.0);
  c.top = std::min(c.top, on_arm ? 1e3 : hem);
  if (on_arm) c.top = std::min(c.top, sleeve - arm);
  // The bottom: below the waist band, above the leg's end.
  const bool trunk_side = arm < 0.4 * upper || !on_arm;
  const double leg_end =
      outfit_.bottom == Bottom::kShorts ? joints_.lower_leg.y() + 26 * k : 56 * k;
  c.bottom = trunk_side ? std::min(lift + 985 * k - p.y(), p.y() - leg_end) : -1e3;
  // Not the shoe in front of the ankle.
  const double from_ankle = std::hypot(p.x() - joints_.foot.x(), p.z() - joints_.foot.z() + 4 * k);
  if (p.y() < 130 * k) c.bottom = std::min(c.bottom, 82 * k - from_ankle + 0.5 * (p.y() - leg_end));
  // The shoe's upper edge rises to the heel tab.
  const double opening = 88 * k - 0.10 * std::abs(p.z() - joints_.foot.z());
  c.shoe = opening - p.y();
  return c;
}

}  // namespace effigy::people
