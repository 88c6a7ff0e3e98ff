#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>
#include <utility>

#include "effigy/people/head_fields.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

using Field = std::function<Vec3d(const Site&)>;

constexpr double kRadians = std::numbers::pi / 180;
constexpr double kFullOpening = 20 * kRadians;

// ---- places (left side) ------------------------------------------------------------------------

bool soft(const Site& s) {
  const Region r = s.vertex->region;
  return r == Region::kSkin || r == Region::kEyeRing || r == Region::kMouthRing ||
         r == Region::kNostrilRing;
}
// How much of a field of the lips reaches the loops behind them.
double reach(const Site& s) {
  if (!soft(s)) return 0;
  if (s.vertex->region != Region::kMouthRing || s.vertex->ring >= -1) return 1;
  static constexpr std::array<double, 5> kShare = {0.85, 0.35, 0.08, 0, 0};
  return kShare[static_cast<size_t>(std::min(-2 - s.vertex->ring, 4))];
}
// Fields of brow and cheek hardly move the rim of the lids.
double lids_held(const Site& s) {
  if (s.vertex->region != Region::kEyeRing) return 1;
  static constexpr std::array<double, kEyeRings> kShare = {0.08, 0.12, 0.24, 0.42, 0.55, 0.80, 1};
  return s.vertex->ring < 0 ? 0.04 : kShare[static_cast<size_t>(s.vertex->ring)];
}
Vec3d at(const Site& s, const Vec3d& centre, const Vec3d& radii, const Vec3d& move) {
  return soft(s) ? Vec3d(bump(s.p, centre, radii) * lids_held(s) * reach(s) * move) : Vec3d::Zero();
}
double mouth(const Site& s) {
  return reach(s) * bump(s.p, {0, kMouthY, 90}, {36, 24, 40});
}
double left_mouth(const Site& s) {
  return mouth(s) * smooth_step(-10, 10, s.p.x());
}
double upper(const Site& s) {
  return 1 - smooth_step(0.15, 0.85, s.lower);
}
double lower(const Site& s) {
  return smooth_step(0.15, 0.85, s.lower);
}
// Largest at the middle of the lips' line, none at the corners.
double arch(const Site& s) {
  const double x = std::min(std::abs(s.p.x()) / (kMouthHalfWidth + 3), 1.0);
  return std::sqrt(1 - x * x);
}
Vec3d corner(const Site& s, const Vec3d& move) {
  return at(s, {kMouthHalfWidth, kMouthY, 80}, {17, 15, 24}, move);
}

// ---- jaw ---------------------------------------------------------------------------------------

Vec3d jaw_turn(const Site& s, double angle) {
  const Vec3d q = s.p - kJawHinge;
  const double c = std::cos(angle) - 1, n = std::sin(angle);
  return s.jaw * Vec3d(0, c * q.y() - n * q.z(), n * q.y() + c * q.z());
}
Vec3d jaw_open(const Site& s) {
  // The lips part a little more than the teeth.
  Vec3d d = jaw_turn(s, kFullOpening) +
            arch(s) * mouth(s) * (lower(s) * Vec3d(0, -3, -1) + upper(s) * Vec3d(0, 1.5, 0));
  d += corner({s.p.cwiseAbs(), s.vertex, true, s.jaw, s.lower}, {-2.5, 0, -1})
           .cwiseProduct(Vec3d(s.p.x() < 0 ? -1 : 1, 1, 1));
  return d;
}
Vec3d mouth_close(const Site& s) {
  // Lips meet while the jaw stays open: the lower lip comes most of the way.
  const Vec3d open = jaw_open(s);
  const double lips = reach(s) * bump(s.p, {0, kMouthY, 92}, {30, 15, 26}) * arch(s);
  return lips * (Vec3d(-0.72 * open * lower(s)) + upper(s) * Vec3d(0, -7.5, -1.5));
}

// ---- lids --------------------------------------------------------------------------------------

class Lids {
 public:
  explicit Lids(const HeadMesh& head) {
    for (const HeadVertex& v : head.vertices)
      if (v.region == Region::kEyeRing && v.ring == 0 && v.side > 0)
        rim_[static_cast<size_t>(v.index)] = v.p;
  }

  // amount 1 closes the eye; negative opens it wider. Up: share of the upper lid, low: of the
  // lower.
  Vec3d move(const Site& s, double up, double low) const {
    const HeadVertex& v = *s.vertex;
    if (v.region != Region::kEyeRing || !s.same_side || v.ring >= kEyeRings - 1)
      return Vec3d::Zero();
    static constexpr std::array<double, kEyeRings - 1> kShare = {1, 0.97, 0.86, 0.62, 0.44, 0.16};
    static constexpr std::array<double, 4> kInside = {1, 0.75, 0, 0};
    const bool is_upper = v.index > 0 && v.index < kEyeLoop / 2;
    const double weight = (v.ring >= 0 ? kShare[static_cast<size_t>(v.ring)]
                                       : kInside[static_cast<size_t>(-v.ring - 1)]) *
                          (is_upper ? up : low);
    if (weight == 0 || v.index % (kEyeLoop / 2) == 0 || v.ring <= -3) return Vec3d::Zero();
    const auto i = static_cast<size_t>(v.index);
    const Vec3d meeting = rim_[i] + (is_upper ? 0.86 : 0.14) * (rim_[kEyeLoop - i] - rim_[i]);
    const Vec3d eye(kEyeX, kEyeY, kEyeZ);
    Vec3d target = s.p + weight * (meeting - rim_[i]);
    // Stay on the ball: the way there is straight, so its end lies further out than its middle.
    const double closed = v.ring < -1 ? 12.8 : v.ring < 0 ? 13.8 : v.ring <= 2 ? 14.2 : 13.9;
    const double floor = mix((s.p - eye).norm(), closed, std::min(1.0, std::abs(weight)));
    const double radius = (target - eye).norm();
    if (radius < floor) target = eye + (target - eye) * (floor / radius);
    return target - s.p;
  }

 private:
  std::array<Vec3d, kEyeLoop> rim_;
};

// ---- the table ---------------------------------------------------------------------------------

const Vec3d kBrowIn(13, 19, 86), kBrow(28, 20, 80), kBrowOut(44, 18, 70);

std::vector<std::pair<std::string, Field>> brow_and_eye_fields(const Lids& lids) {
  auto lid = [&lids](double up, double low) {
    return [&lids, up, low](const Site& s) { return lids.move(s, up, low); };
  };
  return {
      {"browDown",
       [](const Site& s) {
         return Vec3d(at(s, kBrowIn, {15, 13, 26}, {-2.5, -5.0, 1.0}) +
                      at(s, kBrow, {20, 12, 26}, {-0.6, -3.2, 0.5}));
       }},
      {"browInnerUp",
       [](const Site& s) {
         return at(s, kBrowIn, {18, 17, 30}, {0.5, 7.5, 0.5});
       }},
      {"browOuterUp",
       [](const Site& s) {
         return at(s, kBrowOut, {20, 17, 30}, {0.5, 7.0, 0});
       }},
      {"cheekSquint",
       [lid](const Site& s) {
         return Vec3d(at(s, {40, -30, 70}, {20, 16, 28}, {1.5, 4.5, 2.5}) + lid(0, 0.8)(s));
       }},
      {"eyeBlink", lid(1, 1)},
      {"eyeLookDown", lid(0.45, -0.8)},
      {"eyeLookUp", lid(-0.22, 0.6)},
      {"eyeLookIn",
       [](const Site& s) {
         return at(s, {24, -1, 82}, {10, 9, 16}, {-0.8, 0, 0.5});
       }},
      {"eyeLookOut",
       [](const Site& s) {
         return at(s, {40, 0, 78}, {10, 9, 16}, {0.8, 0, 0.5});
       }},
      {"eyeSquint",
       [lid](const Site& s) {
         return Vec3d(lid(0.22, 1.9)(s) + at(s, {38, -18, 74}, {16, 10, 24}, {0.5, 2.0, 1.0}));
       }},
      {"eyeWide", lid(-0.30, -0.9)},
      {"noseSneer",
       [](const Site& s) {
         return Vec3d(at(s, {14, -42, 92}, {10, 12, 20}, {1.2, 4.5, 0}) +
                      at(s, {14, -15, 86}, {9, 16, 20}, {0.5, 2.0, 1.5}) +
                      upper(s) * at(s, {12, -62, 92}, {13, 9, 24}, {0.6, 2.5, 0.3}));
       }},
  };
}

std::vector<std::pair<std::string, Field>> mouth_side_fields() {
  return {
      {"cheekPuff",
       [](const Site& s) {
         return at(s, {42, -66, 60}, {22, 24, 32}, {8, 0, 5});
       }},
      {"mouthDimple",
       [](const Site& s) {
         return corner(s, {4.5, 0.8, -4.5});
       }},
      {"mouthFrown",
       [](const Site& s) {
         return Vec3d(corner(s, {1.0, -7, -1.0}) +
                      at(s, {24, -90, 78}, {14, 14, 24}, {1, -2.5, 0.5}));
       }},
      {"mouthLowerDown",
       [](const Site& s) {
         return Vec3d(lower(s) * arch(s) * at(s, {11, -80, 90}, {15, 13, 24}, {1.0, -7.5, -1.0}));
       }},
      {"mouthPress",
       [](const Site& s) {
         const double lips = left_mouth(s) * arch(s) * bump(s.p, {0, kMouthY, 92}, {40, 11, 30});
         return Vec3d(lips * Vec3d(0, -0.45 * (s.p.y() - kMouthY), -1.5));
       }},
      {"mouthSmile",
       [](const Site& s) {
         // The cheek rises above a fold from the wing of the nose to the corner.
         return Vec3d(corner(s, {7, 6.5, -5}) +
                      at(s, {40, -40, 72}, {19, 16, 28}, {2.5, 5.0, 3.8}) +
                      at(s, {30, -56, 82}, {9, 12, 18}, {0.5, 0.5, -1.6}) +
                      left_mouth(s) * Vec3d(1.5 * smooth_step(0, 20, s.p.x()), 0.8, -1.0));
       }},
      {"mouthStretch",
       [](const Site& s) {
         return Vec3d(corner(s, {7, -3.5, -5}) + lower(s) * left_mouth(s) * Vec3d(0, -1.2, -0.8));
       }},
      {"mouthUpperUp",
       [](const Site& s) {
         return Vec3d(upper(s) * arch(s) * at(s, {11, -66, 92}, {15, 12, 24}, {0.8, 6.0, 0.3}));
       }},
  };
}

std::vector<std::pair<std::string, Field>> whole_fields() {
  return {
      {"jawForward", [](const Site& s) { return Vec3d(s.jaw * Vec3d(0, 0, 6)); }},
      {"jawLeft", [](const Site& s) { return Vec3d(s.jaw * Vec3d(8, 0, 0)); }},
      {"jawOpen", jaw_open},
      {"jawRight", [](const Site& s) { return Vec3d(s.jaw * Vec3d(-8, 0, 0)); }},
      {"mouthClose", mouth_close},
      {"mouthFunnel",
       [](const Site& s) {
         const double m = mouth(s), a = arch(s);
         return Vec3d(m * Vec3d(-0.34 * s.p.x(), a * (4.5 * upper(s) - 6.0 * lower(s)), 7.0));
       }},
      {"mouthLeft", [](const Site& s) { return Vec3d(mouth(s) * Vec3d(8, 0, 0)); }},
      {"mouthPucker",
       [](const Site& s) {
         return Vec3d(mouth(s) * Vec3d(-0.46 * s.p.x(), 0.10 * (s.p.y() - kMouthY), 7.0));
       }},
      {"mouthRight", [](const Site& s) { return Vec3d(mouth(s) * Vec3d(-8, 0, 0)); }},
      {"mouthRollLower",
       [](const Site& s) {
         const double lip = bump(s.p, {0, -79, 92}, {28, 9, 24}) * reach(s);
         return Vec3d(lower(s) * arch(s) * lip * Vec3d(0, 3.0, -5.0));
       }},
      {"mouthRollUpper",
       [](const Site& s) {
         const double lip = bump(s.p, {0, -67, 94}, {28, 8, 24}) * reach(s);
         return Vec3d(upper(s) * arch(s) * lip * Vec3d(0, -2.2, -4.5));
       }},
      {"mouthShrugLower",
       [](const Site& s) {
         return Vec3d(at(s, {0, -97, 90}, {22, 14, 24}, {0, 3.5, 1.5}) +
                      lower(s) * arch(s) * mouth(s) * Vec3d(0, 1.8, 2.0) +
                      upper(s) * arch(s) * mouth(s) * Vec3d(0, 2.0, 0.5));
       }},
      {"mouthShrugUpper",
       [](const Site& s) {
         return Vec3d(upper(s) * arch(s) * mouth(s) * Vec3d(0, 3.0, 2.0) +
                      lower(s) * arch(s) * mouth(s) * Vec3d(0, 2.0, 0.5));
       }},
  };
}

Shape evaluate(const std::vector<Site>& side_sites, const std::string& name, const Field& field,
               int side) {
  Shape shape{name, {}};
  for (const Site& site : side_sites) {
    Vec3d d = field(site);
    d.x() *= side;
    // What moves less than a hundredth of a millimetre stays.
    shape.offsets.push_back(d.norm() < 0.01 ? Vec3d::Zero() : d);
  }
  return shape;
}

}  // namespace

std::vector<Shape> expression_shapes(const HeadMesh& head) {
  const Lids lids(head);
  const auto left = sites(head, 1), right = sites(head, -1);
  std::vector<Shape> shapes;
  for (const auto& group : {brow_and_eye_fields(lids), mouth_side_fields()})
    for (const auto& [name, field] : group) {
      shapes.push_back(evaluate(left, name + "_L", field, 1));
      shapes.push_back(evaluate(right, name + "_R", field, -1));
    }
  for (const auto& [name, field] : whole_fields()) shapes.push_back(evaluate(left, name, field, 1));
  std::sort(shapes.begin(), shapes.end(),
            [](const Shape& a, const Shape& b) { return a.name < b.name; });
  for (Shape& shape : shapes)
    for (size_t i = 0; i < shape.offsets.size(); ++i)
      if (head.vertices[i].side == 0 && shape.name.find('_') == std::string::npos &&
          shape.name.find("Left") == std::string::npos &&
          shape.name.find("Right") == std::string::npos)
        shape.offsets[i].x() = 0;
  return shapes;
}

}  // namespace effigy::people
