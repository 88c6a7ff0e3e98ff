#include "effigy/track/fit_model.h"

#include <cmath>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr double kLeastMass = 1e-7;  // smaller skinning weights move nothing visible

Mat3d cross_matrix(const Vec3d& w) {
  Mat3d k;
  k << 0, -w.z(), w.y(), w.z(), 0, -w.x(), -w.y(), w.x(), 0;
  return k;
}

Vec3d at(std::span<const float> values, size_t vertex) {
  return {values[3 * vertex], values[3 * vertex + 1], values[3 * vertex + 2]};
}

}  // namespace

Mat3d rotation_of(const Vec3d& w, Mat3d* derivative) {
  const double square = w.squaredNorm();
  const Mat3d k = cross_matrix(w);
  Mat3d rotation;
  if (square < 1e-12) {
    rotation = Mat3d::Identity() + k + 0.5 * (k * k);
  } else {
    const double angle = std::sqrt(square);
    rotation = Mat3d::Identity() + std::sin(angle) / angle * k +
               (1.0 - std::cos(angle)) / square * (k * k);
  }
  if (derivative != nullptr) {
    for (int a = 0; a < 3; ++a) {
      const Vec3d axis = Vec3d::Unit(a);
      if (square < 1e-12) {
        const Mat3d e = cross_matrix(axis);
        derivative[a] = e + 0.5 * (e * k + k * e);
      } else {
        // Gallego and Yezzi 2015, equation 9.
        const Vec3d turned = w.cross((Mat3d::Identity() - rotation) * axis);
        derivative[a] = (w[a] * k + cross_matrix(turned)) / square * rotation;
      }
    }
  }
  return rotation;
}

Vec2d project_point(const Vec3d& point, double focal, Eigen::Matrix<double, 2, 3>* derivative) {
  const double inverse = -1.0 / std::min(point.z(), -1e-3);
  const Vec2d pixel(focal * point.x() * inverse, -focal * point.y() * inverse);
  if (derivative != nullptr) {
    *derivative << focal * inverse, 0, pixel.x() * inverse,  //
        0, -focal * inverse, pixel.y() * inverse;
  }
  return pixel;
}

Vec3d axis_angle_of(const Mat3d& rotation) {
  const Eigen::AngleAxisd turn(rotation);
  return turn.angle() * turn.axis();
}

// Rotations and offsets of all joints (world = rotation * rest + mass * offset), and how they move
// with each rotation parameter and with identity.
struct FitModel::Chain {
  std::vector<Mat3d> rotation;
  std::vector<Vec3d> offset;
  Eigen::VectorXd features;                    // 9 (J - 1): R_j - I, row-major
  std::vector<std::vector<Mat3d>> d_rotation;  // [joint][3 J]; empty matrices when zero
  std::vector<std::vector<Vec3d>> d_offset;    // [joint][3 J]
  std::vector<std::vector<bool>> moves;        // [joint][3 J]
  std::vector<Eigen::Matrix<double, 3, Eigen::Dynamic>> d_offset_identity;  // [joint]
  std::vector<std::array<Mat3d, 3>> d_local;                                // [joint]
};

FitModel::FitModel(const Rig& rig, const std::vector<int>& points)
    : identity_count_(rig.identity_count),
      expression_count_(rig.expression_count),
      parents_(rig.parents) {
  const size_t vertices = static_cast<size_t>(rig.mesh.vertex_count());
  const size_t joints = parents_.size();
  const size_t stride = 3 * vertices;
  for (size_t j = 0; j < joints; ++j) {
    Vec3d joint = Vec3d::Zero();
    Eigen::Matrix<double, 3, Eigen::Dynamic> moved(3, identity_count_);
    moved.setZero();
    for (size_t v = 0; v < vertices; ++v) {
      const double weight = rig.joint_regressor[j * vertices + v];
      if (weight == 0) continue;
      joint += weight * at(rig.mesh.vertices, v);
      for (int i = 0; i < identity_count_; ++i)
        for (int c = 0; c < 3; ++c)
          moved(c, i) += weight * rig.identity_basis[static_cast<size_t>(i) * stride + 3 * v + c];
    }
    joints_.push_back(joint);
    joint_identity_.push_back(std::move(moved));
  }
  first_part_.push_back(0);
  for (const int point : points)
    add_surface_point(
        {rig.mesh.vertices, rig.identity_basis, rig.expression_basis, rig.pose_basis, rig.weights},
        rig.mesh.triangles[rig.mediapipe.triangle[point]], rig.mediapipe.barycentric[point]);
}

void FitModel::add_surface_point(const Surface& surface, const Vec3i& triangle,
                                 const Vec3f& barycentric) {
  const size_t joints = parents_.size(), stride = surface.rest.size();
  const int pose_features = surface.pose_basis.empty() ? 0 : 9 * (static_cast<int>(joints) - 1);
  for (size_t j = 0; j < joints; ++j) {
    Part part;
    part.joint = static_cast<int>(j);
    part.rest.setZero();
    part.identity.setZero(3, identity_count_);
    part.expression.setZero(3, expression_count_);
    part.pose.setZero(3, pose_features);
    for (int k = 0; k < 3; ++k) {
      const size_t v = static_cast<size_t>(triangle[k]);
      const double w = static_cast<double>(barycentric[k]) * surface.weights[v * joints + j];
      if (w == 0) continue;
      part.mass += w;
      part.rest += w * at(surface.rest, v);
      const auto add = [&](std::span<const float> basis,
                           Eigen::Matrix<double, 3, Eigen::Dynamic>& to) {
        for (Eigen::Index i = 0; i < to.cols(); ++i)
          for (int c = 0; c < 3; ++c)
            to(c, i) += w * basis[static_cast<size_t>(i) * stride + 3 * v + c];
      };
      add(surface.identity_basis, part.identity);
      add(surface.expression_basis, part.expression);
      add(surface.pose_basis, part.pose);
    }
    if (std::abs(part.mass) > kLeastMass) parts_.push_back(std::move(part));
  }
  first_part_.push_back(static_cast<int>(parts_.size()));
}

void FitModel::shift_point(int point, const Vec3d& shift) {
  for (int p = first_part_[point]; p < first_part_[point + 1]; ++p)
    parts_[p].rest += parts_[p].mass * shift;
}

void FitModel::add_point(int joint, const Vec3d& rest) {
  Part part;
  part.joint = joint;
  part.mass = 1;
  part.rest = rest;
  part.identity.setZero(3, identity_count_);
  part.expression.setZero(3, expression_count_);
  part.pose.resize(3, 0);
  parts_.push_back(std::move(part));
  first_part_.push_back(static_cast<int>(parts_.size()));
}

void FitModel::add_points(const Rig& rig, const RigShape& shape, const LandmarkEmbedding& points) {
  EFFIGY_CHECK_EQ(identity_count_, 0);
  for (size_t i = 0; i < points.size(); ++i)
    add_surface_point({shape.rest, {}, shape.expression_basis, shape.pose_basis, shape.weights},
                      rig.mesh.triangles[points.triangle[i]], points.barycentric[i]);
}

FitModel FitModel::with_identity(const double* identity) const {
  FitModel baked = *this;
  const Eigen::Map<const Eigen::VectorXd> beta(identity, identity_count_);
  baked.identity_count_ = 0;
  for (size_t j = 0; j < joints_.size(); ++j) {
    baked.joints_[j] = joints_[j] + joint_identity_[j] * beta;
    baked.joint_identity_[j].resize(3, 0);
  }
  for (size_t p = 0; p < parts_.size(); ++p) {
    baked.parts_[p].rest = parts_[p].rest + parts_[p].identity * beta;
    baked.parts_[p].identity.resize(3, 0);
  }
  return baked;
}

Mat3d FitModel::rotation_in_world(const Eigen::VectorXd& frame, int joint) const {
  const Mat3d root = rotation_of(frame.segment<3>(rotation_begin(0)), nullptr);
  if (joint == 0) return root;
  return root * rotation_of(frame.segment<3>(rotation_begin(joint)), nullptr);
}

FitModel::Chain FitModel::make_chain(const double* identity, const double* frame, bool want_frame,
                                     bool want_identity) const {
  const size_t joints = parents_.size();
  const Eigen::Map<const Eigen::VectorXd> beta(identity, identity_count_);
  Chain chain;
  chain.rotation.resize(joints);
  chain.offset.resize(joints);
  chain.features.resize(9 * (static_cast<int>(joints) - 1));
  chain.d_local.resize(joints);
  std::vector<Vec3d> rest(joints), position(joints);
  std::vector<std::vector<Vec3d>> d_position;
  if (want_frame) {
    chain.d_rotation.assign(joints, std::vector<Mat3d>(3 * joints, Mat3d::Zero()));
    chain.d_offset.assign(joints, std::vector<Vec3d>(3 * joints, Vec3d::Zero()));
    chain.moves.assign(joints, std::vector<bool>(3 * joints, false));
    d_position = chain.d_offset;
  }
  std::vector<Eigen::Matrix<double, 3, Eigen::Dynamic>> d_position_identity(joints);
  for (size_t j = 0; j < joints; ++j) {
    rest[j] = joints_[j];
    if (identity_count_ > 0) rest[j] += joint_identity_[j] * beta;
    const double* w = frame + rotation_begin(static_cast<int>(j));
    const Mat3d local =
        rotation_of(Vec3d(w[0], w[1], w[2]), want_frame ? chain.d_local[j].data() : nullptr);
    if (j > 0)
      for (int c = 0; c < 9; ++c)
        chain.features[9 * (static_cast<int>(j) - 1) + c] = local(c / 3, c % 3) - (c % 4 == 0);
    const size_t p = j == 0 ? 0 : static_cast<size_t>(parents_[j]);
    const Mat3d above = j == 0 ? Mat3d::Identity().eval() : chain.rotation[p];
    const Vec3d bone = j == 0 ? rest[j] : (rest[j] - rest[p]).eval();
    chain.rotation[j] = above * local;
    position[j] = (j == 0 ? Vec3d::Zero().eval() : position[p]) + above * bone;
    chain.offset[j] = position[j] - chain.rotation[j] * rest[j];
    if (want_frame) {
      for (size_t q = 0; q < 3 * joints; ++q) {
        if (q / 3 == j) {
          chain.d_rotation[j][q] = above * chain.d_local[j][q % 3];
        } else if (j > 0 && chain.moves[p][q]) {
          chain.d_rotation[j][q] = chain.d_rotation[p][q] * local;
          d_position[j][q] = d_position[p][q] + chain.d_rotation[p][q] * bone;
        } else {
          continue;
        }
        chain.moves[j][q] = true;
        chain.d_offset[j][q] = d_position[j][q] - chain.d_rotation[j][q] * rest[j];
      }
    }
    if (want_identity) {
      d_position_identity[j] =
          j == 0
              ? joint_identity_[j]
              : (d_position_identity[p] + above * (joint_identity_[j] - joint_identity_[p])).eval();
      chain.d_offset_identity.push_back(d_position_identity[j] -
                                        chain.rotation[j] * joint_identity_[j]);
    }
  }
  return chain;
}

void FitModel::evaluate(const double* identity, const double* frame, bool want_frame,
                        bool want_identity, Result& result) const {
  const Chain chain = make_chain(identity, frame, want_frame, want_identity);
  const Eigen::Map<const Eigen::VectorXd> beta(identity, identity_count_);
  const Eigen::Map<const Eigen::VectorXd> psi(frame + expression_begin(), expression_count_);
  const Vec3d translation(frame[0], frame[1], frame[2]);
  const int points = point_count(), rotations = 3 * joint_count();
  result.position.resize(points, 3);
  if (want_frame) result.d_frame.setZero(3 * points, frame_size());
  if (want_identity) result.d_identity.setZero(3 * points, identity_count_);
  for (int i = 0; i < points; ++i) {
    Vec3d world = translation;
    if (want_frame) result.d_frame.block<3, 3>(3 * i, 0).setIdentity();
    for (int p = first_part_[i]; p < first_part_[i + 1]; ++p) {
      const Part& part = parts_[p];
      const size_t j = static_cast<size_t>(part.joint);
      Vec3d local = part.rest;
      local.noalias() += part.expression * psi;
      if (identity_count_ > 0) local.noalias() += part.identity * beta;
      if (part.pose.cols() > 0) local.noalias() += part.pose * chain.features;
      const Mat3d& rotation = chain.rotation[j];
      world += rotation * local + part.mass * chain.offset[j];
      if (want_frame) {
        for (int q = 0; q < rotations; ++q) {
          if (chain.moves[j][q])
            result.d_frame.block<3, 1>(3 * i, 3 + q) +=
                chain.d_rotation[j][q] * local + part.mass * chain.d_offset[j][q];
          if (part.pose.cols() > 0 && q >= 3) {
            Eigen::Matrix<double, 9, 1> d_features;
            for (int c = 0; c < 9; ++c) d_features[c] = chain.d_local[q / 3][q % 3](c / 3, c % 3);
            result.d_frame.block<3, 1>(3 * i, 3 + q) +=
                rotation * (part.pose.middleCols<9>(9 * (q / 3 - 1)) * d_features);
          }
        }
        result.d_frame.block(3 * i, expression_begin(), 3, expression_count_) +=
            rotation.lazyProduct(part.expression);
      }
      if (want_identity)
        result.d_identity.middleRows<3>(3 * i) +=
            rotation.lazyProduct(part.identity) + part.mass * chain.d_offset_identity[j];
    }
    result.position.row(i) = world.transpose();
  }
}

}  // namespace effigy
