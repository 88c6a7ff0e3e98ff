#include <cmath>
#include <functional>
#include <utility>

#include "effigy/people/head_fields.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

// A displacement of space (x >= 0), millimetres for one standard deviation.
using Field = std::function<Vec3d(const Vec3d&)>;

// 1 around the whole eye, lids and ball alike.
double around_eye(const Vec3d& p) {
  return bump(p, {kEyeX, 0, 72}, {25, 20, 34});
}
double around_mouth(const Vec3d& p) {
  return bump(p, {0, kMouthY, 80}, {46, 26, 60});
}
Field local(const Vec3d& centre, const Vec3d& radii, const Vec3d& move) {
  return [=](const Vec3d& p) { return Vec3d(bump(p, centre, radii) * move); };
}
Field widen(const Vec3d& centre, const Vec3d& radii, double share) {
  return [=](const Vec3d& p) { return Vec3d(bump(p, centre, radii) * share * p.x(), 0, 0); };
}

std::vector<std::pair<std::string, Field>> proportions() {
  return {
      {"size", [](const Vec3d& p) { return Vec3d(0.035 * p); }},
      {"width", [](const Vec3d& p) { return Vec3d(0.045 * p.x(), 0, 0); }},
      {"height", [](const Vec3d& p) { return Vec3d(0, 0.035 * p.y(), 0); }},
      {"depth", [](const Vec3d& p) { return Vec3d(0, 0, 0.045 * p.z()); }},
      {"lower_face",
       [](const Vec3d& p) { return Vec3d(0, -3.5 * smooth_step(-50, -112, p.y()), 0); }},
      {"middle_face",
       [](const Vec3d& p) { return Vec3d(0, -3.0 * smooth_step(-8, -50, p.y()), 0); }},
      {"crown", [](const Vec3d& p) { return Vec3d(0, 6.0 * smooth_step(30, 112, p.y()), 0); }},
      {"back", [](const Vec3d& p) { return Vec3d(0, 0, -6.0 * smooth_step(10, -95, p.z())); }},
      {"convexity",  // the middle of the face against brow and chin
       local({0, -55, 95}, {60, 34, 60}, {0, 0, 3.5})},
      {"neck_width",
       [](const Vec3d& p) {
         const double s = smooth_step(-95, -140, p.y());
         return Vec3d(0.08 * s * p.x(), 0, 0.06 * s * (p.z() + 25));
       }},
  };
}

std::vector<std::pair<std::string, Field>> bones() {
  return {
      {"jaw_width",
       [](const Vec3d& p) {
         const double s = smooth_step(-45, -80, p.y()) * (1 - smooth_step(-120, -145, p.y()));
         return Vec3d(0.10 * s * p.x(), 0, 0);
       }},
      {"jaw_angle", local({48, -76, 14}, {24, 22, 30}, {1.5, -4.5, -1})},
      {"chin_forward", local({0, -106, 84}, {30, 24, 36}, {0, 0, 4})},
      {"chin_length", local({0, -112, 80}, {32, 20, 40}, {0, -3.5, 0})},
      {"chin_width", widen({0, -106, 76}, {36, 20, 34}, 0.14)},
      {"brow_ridge", local({24, 17, 82}, {32, 12, 26}, {0, 0, 2.2})},
      {"forehead_slope", local({0, 62, 80}, {60, 34, 50}, {0, 0, 4.5})},
      {"forehead_width", widen({0, 40, 40}, {90, 40, 60}, 0.05)},
      {"cheekbone", local({54, -18, 42}, {22, 18, 34}, {3.2, 0, 1.5})},
      {"cheek", local({42, -60, 54}, {24, 28, 34}, {3.5, 0, 2})},
  };
}

std::vector<std::pair<std::string, Field>> features() {
  auto eye = [](const Vec3d& move) {
    return [move](const Vec3d& p) { return Vec3d(around_eye(p) * move); };
  };
  return {
      {"eye_distance", eye({1.8, 0, 0})},
      {"eye_height", eye({0, 2.0, 0})},
      {"eye_depth", eye({0, 0, -2.0})},
      {"brow_height", local({28, 21, 80}, {34, 13, 34}, {0, 2.6, 0})},
      {"nose_length", local({0, -44, 100}, {26, 20, 34}, {0, -3, 0})},
      {"nose_forward", local({0, -38, 104}, {20, 22, 26}, {0, 0, 3})},
      {"nose_width", widen({0, -44, 94}, {32, 16, 28}, 0.15)},
      {"nose_tip", local({0, -41, 106}, {14, 13, 18}, {0, 2.4, 0})},
      {"nose_bridge", local({0, -8, 90}, {13, 26, 24}, {0, 0, 2.4})},
      {"nose_bridge_width", widen({0, -12, 84}, {20, 24, 24}, 0.16)},
      {"mouth_width", [](const Vec3d& p) { return Vec3d(around_mouth(p) * 0.09 * p.x(), 0, 0); }},
      {"mouth_height", [](const Vec3d& p) { return Vec3d(0, 2.0 * around_mouth(p), 0); }},
      {"mouth_forward", [](const Vec3d& p) { return Vec3d(0, 0, 2.5 * around_mouth(p)); }},
      {"upper_lip", local({0, -64.5, 98}, {24, 5, 16}, {0, 1.6, 0.8})},
      {"lower_lip", local({0, -82, 94}, {22, 6, 16}, {0, -1.6, 1.0})},
      {"ear_size",
       [](const Vec3d& p) {
         const double s = bump(p, {80, -14, -14}, {14, 34, 26});
         return Vec3d(s * Vec3d(2.0, 0.10 * (p.y() + 14), 0.10 * (p.z() + 8)));
       }},
  };
}

}  // namespace

std::vector<Shape> identity_shapes(const HeadMesh& head) {
  std::vector<Shape> shapes;
  for (const auto& group : {proportions(), bones(), features()})
    for (const auto& [name, field] : group) {
      Shape shape{name, {}};
      for (const HeadVertex& v : head.vertices) {
        // Eyeballs keep their form and go with their centre.
        Vec3d p(std::abs(v.p.x()), v.p.y(), v.p.z());
        if (v.region == Region::kEyeball) p = {kEyeX, kEyeY, kEyeZ};
        Vec3d d = field(p);
        if (v.p.x() < 0) d.x() = -d.x();
        if (v.side == 0) d.x() = 0;
        shape.offsets.push_back(d);
      }
      shapes.push_back(std::move(shape));
    }
  return shapes;
}

}  // namespace effigy::people
