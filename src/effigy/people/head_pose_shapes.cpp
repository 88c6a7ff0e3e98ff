#include <array>
#include <cmath>

#include "effigy/people/head_fields.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

// Entries of vec(R - I), row by row, of a joint.
enum Entry { kXX, kXY, kXZ, kYX, kYY, kYZ, kZX, kZY, kZZ };

bool soft(const HeadVertex& v) {
  return v.region == Region::kSkin || v.region == Region::kMouthRing ||
         v.region == Region::kEyeRing || v.region == Region::kEarRing ||
         v.region == Region::kNostrilRing;
}

// Halfway between two joints a blend of rotations shrinks towards the axis by about
// (1 - cos) w (1 - w) of the distance; cos - 1 stands on the diagonal.
Vec3d kept_radius(const Vec3d& p, const Vec3d& joint, double w, int axis) {
  Vec3d d = Vec3d::Zero();
  d[axis] = -w * (1 - w) * (p - joint)[axis];
  return d;
}

// The neck, about x (nod: sin is at ZY), y (turn: XZ) and z.
Vec3d neck_shape(const Vec3d& p, double w, int entry) {
  switch (entry) {
    case kXX:
      return kept_radius(p, kNeckJoint, w, 0);
    case kYY:
      return kept_radius(p, kNeckJoint, w, 1);
    case kZZ:
      return kept_radius(p, kNeckJoint, w, 2);
    case kZY:  // chin to chest folds the skin below the chin; looking up folds the nape
      return bump(p, {0, -124, 44}, {36, 14, 34}) * Vec3d(0, -6, 5) +
             bump(p, {0, -78, -78}, {44, 18, 30}) * Vec3d(0, 0, 9);
    case kXZ: {  // looking to the left, the right sternomastoid stands out, the left one rests
      const double side = p.x() < 0 ? 1 : -0.5;
      const Vec3d q(std::abs(p.x()), p.y(), p.z());
      const double cord =
          std::exp(-std::pow(limb(q, {50, -62, -18}, {18, -168, 14}, 0, 0) / 11, 2));
      return 5 * side * cord * Vec3d(p.x() < 0 ? -0.7 : 0.7, 0, 0.7);
    }
    default:
      return Vec3d::Zero();
  }
}

// The jaw opens about x: sin is at ZY.
Vec3d jaw_shape(const HeadVertex& v, double w, int entry) {
  const Vec3d q(std::abs(v.p.x()), v.p.y(), v.p.z());
  const double side = v.p.x() < 0 ? -1 : 1;
  if (entry == kYY) return kept_radius(v.p, kJawHinge, w, 1);
  if (entry == kZZ) return kept_radius(v.p, kJawHinge, w, 2);
  if (entry != kZY) return Vec3d::Zero();
  // Cheeks are drawn in, the skin before the ear sinks, corners of the mouth narrow, the floor of
  // the mouth comes down.
  Vec3d d = bump(q, {50, -56, 44}, {15, 24, 28}) * Vec3d(-7, 0, -1);
  d += bump(q, {68, -18, 8}, {8, 12, 12}) * Vec3d(-4, 0, 0);
  d += bump(q, {kMouthHalfWidth, kMouthY, 80}, {14, 12, 22}) * Vec3d(-8, 0, -2);
  d += bump(q, {0, -114, 48}, {30, 12, 28}) * Vec3d(0, -8, -3);
  d.x() *= side;
  return v.region == Region::kMouthRing && v.ring < -1 ? Vec3d::Zero() : d;
}

// The cornea stands out of the ball and lifts the lids it passes below; the gaze is the third
// column, its x at XZ and its y at YZ.
Vec3d eye_shape(const HeadVertex& v, int side, int entry) {
  if (v.region != Region::kEyeRing || v.side != side || v.ring < 0 ||
      (entry != kXZ && entry != kYZ))
    return Vec3d::Zero();
  static constexpr std::array<double, kEyeRings> kShare = {1, 1, 0.9, 0.6, 0.4, 0.15, 0};
  const Vec3d out = (v.p - Vec3d(side * kEyeX, kEyeY, kEyeZ)).normalized();
  return 0.9 * kShare[static_cast<size_t>(v.ring)] * out[entry == kXZ ? 0 : 1] * out;
}

}  // namespace

std::vector<std::vector<Vec3d>> pose_shapes(const HeadMesh& head,
                                            const std::vector<std::array<double, 3>>& weights) {
  std::vector<std::vector<Vec3d>> out;
  for (int joint = 1; joint <= 4; ++joint)
    for (int entry = 0; entry < 9; ++entry) {
      std::vector<Vec3d> shape;
      for (size_t i = 0; i < head.vertices.size(); ++i) {
        const HeadVertex& v = head.vertices[i];
        Vec3d d = Vec3d::Zero();
        if (soft(v) && joint == 1)  // the open ring stays with the root
          d = smooth_step(kNeckBottom, -155, v.p.y()) *
              neck_shape(v.p, weights[i][1] + weights[i][2], entry);
        if (soft(v) && joint == 2) d = jaw_shape(v, weights[i][2], entry);
        if (joint >= 3) d = eye_shape(v, joint == 3 ? 1 : -1, entry);
        shape.push_back(d.norm() < 0.01 ? Vec3d::Zero() : d);
      }
      out.push_back(std::move(shape));
    }
  return out;
}

}  // namespace effigy::people
