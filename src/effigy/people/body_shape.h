// The outer form of the built-in body below the head's neck as a signed distance function: tubes
// with free cross-sections along the bones, joined smoothly, set to adult anthropometric means
// (stature 1.70 m), and clothes as offset and draped tubes over them. Millimetres; origin on the
// floor below the hips, y up, face +z, subject's left +x. Rest pose: arms 45 degrees down (A-pose),
// palms towards the thighs.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "effigy/geometry/types.h"

namespace effigy::people {

// What varies from person to person; 1 or 0 is the mean.
struct BodyBuild {
  double stature = 1;    // of everything below the neck ring
  double legs = 1;       // leg length beyond stature
  double arms = 1;       // arm length beyond stature
  double shoulders = 1;  // breadths and girths
  double chest = 1, waist = 1, hips = 1, limbs = 1;
  double belly = 0;   // millimetres in front of the waist
  double breast = 0;  // millimetres
  double muscle = 1;  // pectoral, deltoid, calf relief
};

enum class Top : uint8_t { kTee, kLongSleeve, kPolo };
enum class Bottom : uint8_t { kTrousers, kShorts };

struct Outfit {
  Top top = Top::kTee;
  Bottom bottom = Bottom::kTrousers;
  double top_ease = 1, bottom_ease = 1;  // width of the garments beyond the body, relative
  double hem = 868;                      // height of the top's hem
};

// Joints of the left half and the middle, millimetres. Fingers: thumb, index, middle, ring, little;
// each has three joints and a tip.
struct BodyJoints {
  Vec3d hips, spine, chest, upper_chest, neck, head;
  Vec3d shoulder, upper_arm, lower_arm, hand;
  std::array<std::array<Vec3d, 4>, 5> fingers;
  Vec3d upper_leg, lower_leg, foot, toes, toe_tip;
  Vec3d palm_normal, thumb_side;  // unit: out of the palm; towards the thumb
};

// Where the head's open neck ring lies in the body's frame: a curve around the vertical through
// `centre`; radius and height (y) at equal steps of the angle from +z (front) towards +x.
struct NeckRing {
  Vec3d centre = Vec3d::Zero();
  std::vector<double> radius, height;
  double radius_at(const Vec3d& p) const;
  double height_at(const Vec3d& p) const;
  double highest() const;
};

class BodyForm {
 public:
  BodyForm(const BodyBuild& build, const Outfit& outfit, const NeckRing& ring);

  const BodyJoints& joints() const { return joints_; }
  const NeckRing& ring() const { return ring_; }
  const BodyBuild& build() const { return build_; }
  const Outfit& outfit() const { return outfit_; }

  // Negative inside; clothes and shoes are part of the form.
  double distance(const Vec3d& p) const;
  Vec3d normal(const Vec3d& p) const;
  // The nearest surface point along the gradient.
  Vec3d project(const Vec3d& p) const;

  // How far a place is inside each garment's extent, millimetres (positive: covered).
  struct Cover {
    double top = 0, bottom = 0, shoe = 0, hand = 0;
  };
  Cover cover(const Vec3d& p) const;
  // Positions along the limbs: millimetres from the joint, and 0..1 beyond the ends.
  double along_arm(const Vec3d& p) const;  // from the shoulder joint; > upper + lower arm: hand
  double arm_reach() const;                // shoulder joint to wrist

 private:
  // A tube around the segment from `a` along `axis`: half widths in four directions at stations.
  struct Tube {
    Vec3d a, axis, u, v;
    double start = 0, end = 0, cap0 = 1, cap1 = 1, exponent = 2;
    std::vector<std::array<float, 4>> table;  // +u -u +v -v, equal steps from start to end
    double distance(const Vec3d& p, double grow = 0) const;
    double along(const Vec3d& p) const { return (p - a).dot(axis); }
  };
  struct Station {
    double s, plus_u, minus_u, plus_v, minus_v;
  };
  static Tube tube(const Vec3d& a, const Vec3d& axis, const Vec3d& u,
                   const std::vector<Station>& stations, double scale, double exponent);

  void place_joints();
  void make_torso();
  void make_limbs();
  void make_hand();
  void make_clothes();
  double torso_skin(const Vec3d& p) const;
  double neck_skin(const Vec3d& p) const;
  double arm_skin(const Vec3d& p) const;
  double hand_skin(const Vec3d& p) const;
  double leg_skin(const Vec3d& p) const;
  double shoe(const Vec3d& p) const;
  double top(const Vec3d& p, const Cover& c, double torso, double arm) const;
  double bottom(const Vec3d& p, const Cover& c, double torso, double leg) const;
  double folds(const Vec3d& p) const;

  BodyBuild build_;
  Outfit outfit_;
  NeckRing ring_;
  BodyJoints joints_;
  Tube torso_, upper_arm_, lower_arm_, palm_, thigh_, shank_, foot_, sole_, drape_, trouser_,
      sleeve_;
};

}  // namespace effigy::people
