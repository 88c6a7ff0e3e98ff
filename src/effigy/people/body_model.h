// What the built-in body's files share about one subject.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "effigy/people/body_mesh.h"
#include "effigy/people/body_shape.h"

namespace effigy::people {

enum class Print : uint8_t { kPlain, kStripes, kChecks, kRaglan };

struct BodyStyle {
  BodyBuild build;
  Outfit outfit;
  Vec3d top_colour, top_second, bottom_colour, shoe_colour;  // linear
  Print print = Print::kPlain;
  bool denim = true;
};
// Deterministic; the five standard subjects are chosen by hand.
BodyStyle body_style(uint64_t subject);

inline constexpr int kFoldDirections = 4;

// How each vertex's cloth can fold.
struct ClothField {
  std::vector<char> cloth;      // V
  std::vector<float> loose;     // V, 0..1: how far it can swing
  std::vector<float> strength;  // V, 0..1: fades at seams and hems
  // [V][directions]: the waves' heights at this vertex, and their wavelengths in metres.
  std::vector<float> wave;
  std::array<float, kFoldDirections> wavelength{};
  // [F][directions]: the direction as a combination of the triangle's two edges from corner 0.
  std::vector<Vec2f> along;
  std::vector<float> area;      // [F], metres^2 at rest; 0 where there is no cloth
  std::vector<float> area_sum;  // [V]
};

struct BodyModel {
  BodyStyle style;
  BodyForm form;
  BodyMesh mesh;
  ClothField cloth;
  struct HeadShape {  // a pose shape of the head: expression = R(row, column) of the joint -
                      // identity
    int expression, joint, row, column;
  };
  std::vector<HeadShape> head_shapes;
  struct Twist {  // helper joint that takes `share` of the driver's turn about `axis`
    int helper, driver;
    Vec3d axis;
    double share;
  };
  std::vector<Twist> twists;
};

ClothField make_cloth_field(const BodyModel& model, const Rig& rig);

}  // namespace effigy::people
