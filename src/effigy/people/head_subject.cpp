#include "effigy/people/head_subject.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/base/random.h"
#include "effigy/people/noise.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

// Height of the hairline over the angle from the front, degrees: forehead, temple, sideburn, over
// the ear, behind it, nape.
double hairline(double angle, const HairStyle& style) {
  const double burn = mix(14, -8, style.sideburn);
  const std::array<std::pair<double, double>, 11> line = {{{0, 64},
                                                           {26, 64},
                                                           {42, 59},
                                                           {52, 46},
                                                           {63, 24},
                                                           {71, burn},
                                                           {78, burn},
                                                           {90, 22},
                                                           {108, 14},
                                                           {122, -34},
                                                           {180, -70}}};
  double height = line.back().second;
  for (size_t i = 1; i < line.size(); ++i)
    if (angle <= line[i].first) {
      const double t = (angle - line[i - 1].first) / (line[i].first - line[i - 1].first);
      height = mix(line[i - 1].second, line[i].second, smooth_step(0, 1, t));
      break;
    }
  const double temple = std::exp(-std::pow((angle - 34) / 18, 2));
  return height + style.recede * temple + style.lift * (1 - smooth_step(50, 75, angle));
}

double angle_of(const Vec3d& p) {
  return std::atan2(std::abs(p.x()), p.z() + 5) * 180 / std::numbers::pi;
}

// Sex, build and age move many proportions together.
void add_build(Subject& s, double male, double build) {
  const std::array<std::pair<const char*, double>, 15> modes = {{{"size", 0.8 * male},
                                                                 {"jaw_width", 0.9 * male},
                                                                 {"jaw_angle", 0.6 * male},
                                                                 {"chin_width", 0.7 * male},
                                                                 {"chin_length", 0.6 * male},
                                                                 {"brow_ridge", 1.1 * male},
                                                                 {"brow_height", -0.9 * male},
                                                                 {"forehead_slope", -0.7 * male},
                                                                 {"nose_length", 0.5 * male},
                                                                 {"nose_bridge", 0.7 * male},
                                                                 {"neck_width", 1.5 * male},
                                                                 {"upper_lip", -0.5 * male},
                                                                 {"lower_lip", -0.5 * male},
                                                                 {"cheek", 1.1 * build},
                                                                 {"width", 0.5 * build}}};
  for (const auto& [name, value] : modes) s.identity.emplace_back(name, value);
}

Subject fair_young_woman() {
  Subject s;
  add_build(s, -1.3, 0.1);
  s.identity.insert(s.identity.end(),
                    {{"nose_tip", 0.8}, {"eye_distance", 0.4}, {"cheekbone", 0.5}});
  s.hair = {15, 9, 7, -4, -2, 1.4, 17, 0, 0, 1};
  s.hair_colour = {0.20, 0.070, 0.025};
  s.brow_colour = {0.16, 0.075, 0.035};
  s.brow_width = 0.72;
  s.melanin = 0.007;
  s.blood = 0.008;
  s.freckles = 1;
  s.stubble = 0;
  s.oil = 0.6;
  s.age = 0;
  s.lip_blood = 1.2;
  s.iris_inner = {0.13, 0.15, 0.07};
  s.iris_outer = {0.06, 0.17, 0.20};
  return s;
}

Subject dark_man() {
  Subject s;
  add_build(s, 0.8, 0.1);
  s.identity.insert(s.identity.end(), {{"nose_width", 1.9},
                                       {"nose_bridge", -1.2},
                                       {"upper_lip", 2.4},
                                       {"lower_lip", 2.2},
                                       {"mouth_forward", 1.6},
                                       {"mouth_width", 0.8},
                                       {"forehead_slope", 0.7}});
  s.hair = {4.5, 2.0, 1.2, 1, 0, 0.6, 6, 1, 1, 0};
  s.hair_colour = {0.014, 0.011, 0.010};
  s.brow_colour = {0.016, 0.012, 0.010};
  s.melanin = 0.14;
  s.blood = 0.012;
  s.freckles = 0;
  s.stubble = 1.0;
  s.oil = 1.3;
  s.age = 0.25;
  s.iris_inner = {0.050, 0.026, 0.014};
  s.iris_outer = {0.030, 0.017, 0.011};
  return s;
}

Subject tan_woman() {
  Subject s;
  add_build(s, -0.9, 0.4);
  s.identity.insert(s.identity.end(), {{"cheekbone", 1.3},
                                       {"nose_bridge", -1.0},
                                       {"width", 0.9},
                                       {"eye_depth", -1.0},
                                       {"nose_width", 0.5},
                                       {"brow_ridge", -0.8},
                                       {"depth", -0.8}});
  s.hair = {11, 8, 8, -6, -4, 0.5, 22, 0, 0, 1};
  s.hair_colour = {0.012, 0.010, 0.010};
  s.brow_colour = {0.025, 0.018, 0.014};
  s.brow_width = 0.85;
  s.melanin = 0.030;
  s.blood = 0.008;
  s.freckles = 0.1;
  s.stubble = 0;
  s.oil = 0.8;
  s.age = 0.15;
  s.lip_blood = 1.4;
  s.iris_inner = {0.070, 0.036, 0.016};
  s.iris_outer = {0.040, 0.022, 0.012};
  return s;
}

Subject old_man() {
  Subject s;
  add_build(s, 0.5, 1.0);
  s.identity.insert(s.identity.end(), {{"nose_length", 1.4},
                                       {"nose_forward", 1.0},
                                       {"nose_tip", -1.0},
                                       {"upper_lip", -1.2},
                                       {"lower_lip", -0.8},
                                       {"ear_size", 1.6},
                                       {"eye_depth", 0.6},
                                       {"convexity", 0.8}});
  s.hair = {3, 3, 2.5, 22, 6, 0.8, 10, 1, 0, 0.5};
  s.hair_colour = {0.060, 0.050, 0.042};
  s.grey = 0.75;
  s.brow_colour = {0.16, 0.13, 0.11};
  s.brow_width = 1.15;
  s.melanin = 0.012;
  s.blood = 0.011;
  s.freckles = 0.5;
  s.stubble = 1.7;
  s.age = 1;
  s.lip_blood = 0.7;
  s.iris_inner = {0.12, 0.15, 0.17};
  s.iris_outer = {0.07, 0.13, 0.19};
  return s;
}

Subject anybody(uint64_t seed) {
  Random random(seed, 71);
  Subject s;
  const double male = random.uniform() < 0.5 ? 1 : -1;
  add_build(s, male * random.uniform(0.3, 1.2), random.normal());
  static constexpr std::array<const char*, 22> kFree = {"height",
                                                        "depth",
                                                        "lower_face",
                                                        "middle_face",
                                                        "crown",
                                                        "back",
                                                        "convexity",
                                                        "chin_forward",
                                                        "forehead_width",
                                                        "cheekbone",
                                                        "eye_distance",
                                                        "eye_height",
                                                        "eye_depth",
                                                        "nose_forward",
                                                        "nose_width",
                                                        "nose_tip",
                                                        "nose_bridge_width",
                                                        "mouth_width",
                                                        "mouth_height",
                                                        "mouth_forward",
                                                        "upper_lip",
                                                        "ear_size"};
  for (const char* name : kFree)
    s.identity.emplace_back(name, std::clamp(0.8 * random.normal(), -1.8, 1.8));
  s.melanin = 0.008 * std::pow(30.0, random.uniform());
  s.blood = random.uniform(0.007, 0.013);
  s.freckles = s.melanin < 0.03 ? std::pow(random.uniform(), 2) : 0;
  s.age = random.uniform();
  s.stubble = male > 0 ? random.uniform(0, 2) : 0;
  s.oil = random.uniform(0.5, 1.4);
  s.lip_blood = random.uniform(0.7, 1.4);
  // Eumelanin darkens hair; fair skin goes with any colour, dark skin with dark hair.
  const double dark = std::max(random.uniform(), smooth_step(0.015, 0.05, s.melanin));
  const Vec3d light = random.uniform() < 0.25 ? Vec3d(0.21, 0.07, 0.025) : Vec3d(0.27, 0.18, 0.085);
  const Vec3d black(0.013, 0.011, 0.010);
  for (int c = 0; c < 3; ++c)
    s.hair_colour[c] = std::exp(mix(std::log(light[c]), std::log(black[c]), dark));
  s.brow_colour = 0.9 * s.hair_colour;
  s.grey = s.age > 0.6 ? random.uniform(0, 0.9) : 0;
  s.brow_width = male > 0 ? random.uniform(0.9, 1.2) : random.uniform(0.65, 0.9);
  const double longer = random.uniform();
  s.hair = {mix(3, 16, longer),
            mix(2, 9, longer),
            mix(1.5, 7, longer),
            male > 0 ? 22 * s.age * random.uniform() : -4.0,
            0,
            random.uniform(0.4, 1.6),
            random.uniform(8, 20),
            male > 0 ? 1.0 : 0.0,
            random.uniform() < 0.3 ? 1.0 : 0.0,
            random.uniform()};
  const double blue = dark < 0.7 ? random.uniform() : 0.0;
  s.iris_inner = Vec3d(mix(0.13, 0.13, blue), mix(0.07, 0.15, blue), mix(0.025, 0.12, blue));
  s.iris_outer = Vec3d(mix(0.06, 0.07, blue), mix(0.035, 0.14, blue), mix(0.016, 0.19, blue));
  return s;
}

}  // namespace

Subject make_subject(uint64_t subject) {
  Subject out;
  if (subject == 2) out = fair_young_woman();
  if (subject == 3) out = dark_man();
  if (subject == 4) out = tan_woman();
  if (subject == 5) out = old_man();
  if (subject < 1 || subject > 5) out = anybody(subject);
  Random random(subject, 72);
  for (double& x : out.pattern) x = random.uniform(-500, 500);
  return out;
}

double hair_cover(const Vec3d& p, double soft, const HairStyle& style) {
  return smooth_step(-0.5 * soft, 0.5 * soft, p.y() - hairline(angle_of(p), style));
}

double hair_thickness(const Vec3d& p, const HairStyle& style) {
  const double cover = hair_cover(p, 24, style);
  if (cover <= 0) return 0;
  double thick = mix(style.sides, style.top, smooth_step(25, 88, p.y()));
  thick = mix(thick, style.nape, smooth_step(10, -60, p.y()));
  return cover * std::max(0.4, thick + style.clumps * 1.6 * cloud(p / style.clump_size));
}

}  // namespace effigy::people
