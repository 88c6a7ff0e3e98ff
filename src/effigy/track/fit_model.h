// The points of a rig that the landmark networks see, as a function of identity and pose, with
// exact derivatives. Private to track/.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/rig/rig.h"

namespace effigy {

// Parameters of a frame are one vector: translation (3), rotation of each joint (3 J, axis-angle),
// expression (E).
class FitModel {
 public:
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  // `points`: which entries of rig.mediapipe to model, in this order.
  FitModel(const Rig& rig, const std::vector<int>& points);

  int point_count() const { return static_cast<int>(first_part_.size()) - 1; }
  int identity_count() const { return identity_count_; }
  int expression_count() const { return expression_count_; }
  int joint_count() const { return static_cast<int>(parents_.size()); }
  int frame_size() const { return 3 + 3 * joint_count() + expression_count_; }
  int rotation_begin(int joint) const { return 3 + 3 * joint; }
  int expression_begin() const { return 3 + 3 * joint_count(); }

  // Moves a joint of the rest pose (that of a model with its identity folded in, or of identity 0).
  void shift_joint(int joint, const Vec3d& shift) { joints_[joint] += shift; }
  // Moves a point of the rest pose.
  void shift_point(int point, const Vec3d& shift);
  // One more point, at `rest` and carried by `joint` alone.
  void add_point(int joint, const Vec3d& rest);
  // Points on the surface of the shape (identity folded in), as of an embedding.
  void add_points(const Rig& rig, const RigShape& shape, const LandmarkEmbedding& points);
  // Of the rest pose, at identity 0.
  Vec3d joint_position(int joint) const { return joints_[joint]; }

  // The same points with the identity folded in: identity_count() is 0 and each step is cheaper.
  FitModel with_identity(const double* identity) const;
  // Rotation of a joint right below the root (or of the root, 0) in the world.
  Mat3d rotation_in_world(const Eigen::VectorXd& frame, int joint) const;

  struct Result {
    Matrix position;    // [points][3], world
    Matrix d_frame;     // [3 points][frame_size]
    Matrix d_identity;  // [3 points][identity_count]
  };
  // `identity` may be null when identity_count() is 0. Derivatives only where asked for.
  void evaluate(const double* identity, const double* frame, bool want_frame, bool want_identity,
                Result& result) const;

 private:
  // What one joint carries of a point: sums over the triangle's vertices of barycentric times
  // skinning weight. Exact, because skinning is linear in both.
  struct Part {
    int joint = 0;
    double mass = 0;
    Vec3d rest;
    Eigen::Matrix<double, 3, Eigen::Dynamic> identity, expression, pose;
  };
  // What a point's parts are made of, as in Rig.
  struct Surface {
    std::span<const float> rest, identity_basis, expression_basis, pose_basis, weights;
  };
  void add_surface_point(const Surface& surface, const Vec3i& triangle, const Vec3f& barycentric);
  struct Chain;
  Chain make_chain(const double* identity, const double* frame, bool want_frame,
                   bool want_identity) const;

  int identity_count_ = 0, expression_count_ = 0;
  std::vector<int> parents_;
  std::vector<Vec3d> joints_;                                             // at identity 0
  std::vector<Eigen::Matrix<double, 3, Eigen::Dynamic>> joint_identity_;  // their derivative
  std::vector<int> first_part_;  // of each point; one more at the end
  std::vector<Part> parts_;
};

// The pixel, relative to the principal point, of a world point (z < 0) in the fit's camera, which
// is at the origin and looks along -z; its derivative when not null.
Vec2d project_point(const Vec3d& point, double focal, Eigen::Matrix<double, 2, 3>* derivative);

// Rodrigues' rotation of an axis-angle vector; derivative[a] = dR / dw_a when not null.
Mat3d rotation_of(const Vec3d& axis_angle, Mat3d* derivative);
// The axis-angle vector of a rotation, length in [0, pi].
Vec3d axis_angle_of(const Mat3d& rotation);

}  // namespace effigy
