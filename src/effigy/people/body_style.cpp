#include <algorithm>
#include <cmath>

#include "effigy/base/random.h"
#include "effigy/people/body_model.h"

namespace effigy::people {
namespace {

BodyStyle random_style(uint64_t subject) {
  Random random(subject, 0x626f6479);
  const auto normal = [&](double sigma) { return sigma * std::clamp(random.normal(), -2.0, 2.0); };
  BodyStyle s;
  BodyBuild& b = s.build;
  const double female =
      random.uniform() < 0.5 ? random.uniform(0.6, 1.0) : random.uniform(0.0, 0.15);
  const double heavy = normal(1.0);
  b.stature = 1.02 - 0.055 * female + normal(0.03);
  b.legs = 1 + normal(0.015);
  b.arms = 1 + normal(0.015);
  b.shoulders = 1.02 - 0.08 * female + normal(0.02);
  b.chest = 1.01 - 0.05 * female + 0.03 * heavy;
  b.waist = 1.0 - 0.08 * female + 0.05 * heavy;
  b.hips = 0.99 + 0.05 * female + 0.025 * heavy;
  b.limbs = 1.01 - 0.06 * female + 0.025 * heavy;
  b.belly = std::max(0.0, 14 * heavy + normal(4));
  b.breast = 34 * female * random.uniform(0.7, 1.2);
  b.muscle = 1.05 - 0.12 * female + normal(0.05);
  Outfit& o = s.outfit;
  o.top = static_cast<Top>(random.below(3));
  o.bottom = random.uniform() < 0.7 ? Bottom::kTrousers : Bottom::kShorts;
  o.top_ease = random.uniform(0.6, 1.5);
  o.bottom_ease = random.uniform(0.7, 1.3);
  o.hem = random.uniform(856, 892);
  const auto colour = [&](double low, double high) {
    return Vec3d(random.uniform(low, high), random.uniform(low, high), random.uniform(low, high));
  };
  s.top_colour = colour(0.04, 0.6);
  s.top_second = colour(0.04, 0.6);
  s.bottom_colour = colour(0.02, 0.25);
  s.shoe_colour = colour(0.02, 0.5);
  s.print = static_cast<Print>(random.below(4));
  s.denim = random.uniform() < 0.5;
  return s;
}

}  // namespace

BodyStyle body_style(uint64_t subject) {
  BodyStyle s;
  switch (subject) {
    case 1:
      s.top_colour = {0.28, 0.33, 0.36};
      s.top_second = {0.05, 0.07, 0.10};
      s.bottom_colour = {0.045, 0.07, 0.13};
      s.shoe_colour = {0.55, 0.54, 0.52};
      s.print = Print::kPlain;
      return s;
    case 2:
      s.build = {0.96, 1.0, 0.99, 0.94, 0.96, 0.92, 1.04, 0.94, 0, 32, 0.92};
      s.outfit = {Top::kLongSleeve, Bottom::kTrousers, 0.7, 0.7, 884};
      s.top_colour = {0.42, 0.08, 0.07};
      s.top_second = {0.55, 0.50, 0.42};
      s.bottom_colour = {0.035, 0.035, 0.04};
      s.shoe_colour = {0.03, 0.03, 0.03};
      s.print = Print::kStripes;
      s.denim = false;
      return s;
    case 3:
      s.build = {1.05, 1.0, 1.01, 1.04, 1.04, 1.06, 1.0, 1.05, 12, 0, 1.05};
      s.outfit = {Top::kPolo, Bottom::kShorts, 1.2, 1.2, 872};
      s.top_colour = {0.07, 0.20, 0.11};
      s.top_second = {0.50, 0.48, 0.40};
      s.bottom_colour = {0.33, 0.26, 0.17};
      s.shoe_colour = {0.12, 0.13, 0.16};
      s.print = Print::kRaglan;
      s.denim = false;
      return s;
    case 4:
      s.build = {0.985, 1.01, 1.0, 0.97, 0.99, 1.0, 1.05, 0.98, 4, 38, 0.94};
      s.outfit = {Top::kTee, Bottom::kTrousers, 1.3, 1.2, 866};
      s.top_colour = {0.58, 0.56, 0.50};
      s.top_second = {0.10, 0.16, 0.30};
      s.bottom_colour = {0.07, 0.10, 0.17};
      s.shoe_colour = {0.45, 0.10, 0.08};
      s.print = Print::kChecks;
      return s;
    case 5:
      s.build = {1.0, 0.985, 1.0, 1.02, 1.06, 1.12, 1.06, 1.07, 34, 0, 1.0};
      s.outfit = {Top::kLongSleeve, Bottom::kTrousers, 1.4, 1.3, 864};
      s.top_colour = {0.09, 0.12, 0.20};
      s.top_second = {0.35, 0.32, 0.28};
      s.bottom_colour = {0.20, 0.17, 0.13};
      s.shoe_colour = {0.10, 0.06, 0.035};
      s.print = Print::kPlain;
      s.denim = false;
      return s;
    default:
      return random_style(subject);
  }
}

}  // namespace effigy::people
