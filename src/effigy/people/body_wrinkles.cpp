// Wrinkles and swing of the built-in body's clothes.

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/people/body_model.h"
#include "effigy/people/builtin_body.h"
#include "effigy/people/noise.h"
#include "effigy/people/smooth.h"

namespace effigy {
namespace people {
namespace {

constexpr double kPi = std::numbers::pi;

// A limb or the trunk as a cylinder that folds are laid around.
struct Cylinder {
  Vec3d a, axis, front;
  double length;
};

Cylinder cylinder(const Vec3d& a, const Vec3d& b) {
  Cylinder c{a, (b - a).normalized(), Vec3d::UnitZ(), (b - a).norm()};
  c.front = (c.front - c.axis * c.axis.dot(c.front)).normalized();
  return c;
}

// Trunk, left and right arm, left and right leg.
std::vector<Cylinder> cylinders(const BodyJoints& j) {
  std::vector<Cylinder> out{cylinder(j.neck, j.hips)};
  for (const int side : {1, -1}) {
    const auto at = [&](const Vec3d& p) { return Vec3d(side * p.x(), p.y(), p.z()); };
    out.push_back(cylinder(at(j.upper_arm), at(j.hand)));
    out.push_back(cylinder(at(j.upper_leg), at(j.foot)));
  }
  return out;
}

// Which cylinder a joint's cloth belongs to.
int cylinder_of(const std::string& joint) {
  const int right = joint.ends_with("_right") ? 1 : 0;
  if (joint.find("_arm") != std::string::npos || joint.starts_with("hand")) return 1 + 2 * right;
  if (joint.find("_leg") != std::string::npos || joint.starts_with("foot") ||
      joint.starts_with("toes"))
    return 2 + 2 * right;
  return 0;
}

// Ridges one wavelength apart, mean near zero, in about [-0.5, 1].
double ridge(double phase) {
  const double c = 0.5 + 0.5 * std::cos(phase);
  return 1.5 * c * std::sqrt(c) - 0.5;
}

constexpr std::array<double, kFoldDirections> kWavelength = {52, 64, 60, 60};  // millimetres

// Heights of the waves at p on one cylinder: compression along the axis raises rings, around it
// lengthwise folds, along the diagonals helices.
std::array<double, kFoldDirections> waves(const Cylinder& c, const Vec3d& p, double girth) {
  const Vec3d q = p - c.a;
  const double s = q.dot(c.axis);
  const Vec3d side = c.axis.cross(c.front);
  const double angle = std::atan2(q.dot(side), q.dot(c.front));
  const double warp = 1.6 * noise(p / 95) + 0.7 * noise(p / 42 + Vec3d(7, 1, 4));
  const auto around = [&](double wavelength) {
    return std::max(2.0, std::round(girth / wavelength));
  };
  const double turns = std::round(girth / (std::sqrt(2.0) * kWavelength[2]));
  const double pitch = 2 * kPi * s / (std::sqrt(2.0) * kWavelength[2]);
  std::array<double, kFoldDirections> out{};
  out[0] = ridge(2 * kPi * s / kWavelength[0] + 1.3 * std::sin(angle + 0.01 * s) + warp);
  out[1] = ridge(around(kWavelength[1]) * angle + warp);
  out[2] = ridge(pitch + turns * angle + warp);
  out[3] = ridge(pitch - turns * angle + warp);
  return out;
}

// The four directions at a place with normal n, in its tangent plane.
std::array<Vec3d, kFoldDirections> directions(const Vec3d& axis, const Vec3d& n) {
  const Vec3d a = (axis - n * n.dot(axis)).normalized(), c = n.cross(a);
  return {a, c, Vec3d((a + c).normalized()), Vec3d((a - c).normalized())};
}

}  // namespace

ClothField make_cloth_field(const BodyModel& model, const Rig& rig) {
  const size_t count = static_cast<size_t>(rig.mesh.vertex_count()), joints = rig.parents.size();
  const BodyForm& form = model.form;
  const std::vector<Cylinder> tubes = cylinders(form.joints());
  ClothField field;
  field.cloth.assign(count, 0);
  field.loose.assign(count, 0);
  field.strength.assign(count, 0);
  field.wave.assign(count * kFoldDirections, 0);
  for (int d = 0; d < kFoldDirections; ++d)
    field.wavelength[static_cast<size_t>(d)] =
        static_cast<float>(1e-3 * kWavelength[static_cast<size_t>(d)]);
  for (size_t f = 0; f < rig.mesh.triangles.size(); ++f)
    if (rig.mesh.triangle_part[f] == kTop || rig.mesh.triangle_part[f] == kBottom)
      for (int k = 0; k < 3; ++k) field.cloth[static_cast<size_t>(rig.mesh.triangles[f][k])] = 1;
  std::vector<int> group(joints);
  for (size_t j = 0; j < joints; ++j) group[j] = cylinder_of(rig.joint_names[j]);
  std::vector<Vec3d> axes(count, Vec3d::UnitY());
  for (size_t v = 0; v < count; ++v) {
    if (!field.cloth[v]) continue;
    const Vec3d p = 1e3 * rig.mesh.vertex(static_cast<int>(v)).cast<double>();
    std::array<double, 5> share{};
    for (size_t j = 0; j < joints; ++j)
      share[static_cast<size_t>(group[j])] += static_cast<double>(rig.weights[v * joints + j]);
    Vec3d axis = Vec3d::Zero();
    for (size_t g = 0; g < 5; ++g) {
      if (share[g] < 0.02) continue;
      const double girth = g == 0 ? 900 : g % 2 == 1 ? 300 : 420;
      const auto w = waves(tubes[g], p, girth);
      for (size_t d = 0; d < kFoldDirections; ++d)
        field.wave[v * kFoldDirections + d] += static_cast<float>(share[g] * w[d]);
      axis += share[g] * tubes[g].axis;
    }
    axes[v] = axis.normalized();
    const BodyForm::Cover c = form.cover(p);
    const double edge = c.top > 0 ? c.top : c.bottom;
    field.strength[v] =
        static_cast<float>(smooth_step(-2, 24, edge) * (0.65 + 0.35 * noise(p / 130)));
    const double hem = c.top > 0 ? smooth_step(190, 10, p.y() - (form.joints().upper_leg.y() - 25))
                                 : smooth_step(420, 80, p.y()) * 0.6;
    const double ease = c.top > 0 ? model.style.outfit.top_ease : model.style.outfit.bottom_ease;
    field.loose[v] = static_cast<float>(std::min(1.0, ease * (0.12 + 0.88 * hem)) *
                                        (share[0] + 0.6 * (1 - share[0])));
  }
  field.along.assign(rig.mesh.triangles.size() * kFoldDirections, Vec2f::Zero());
  field.area.assign(rig.mesh.triangles.size(), 0);
  field.area_sum.assign(count, 0);
  for (size_t f = 0; f < rig.mesh.triangles.size(); ++f) {
    const Vec3i& t = rig.mesh.triangles[f];
    if (!field.cloth[t[0]] || !field.cloth[t[1]] || !field.cloth[t[2]]) continue;
    const Vec3d p0 = rig.mesh.vertex(t[0]).cast<double>();
    const Vec3d e1 = rig.mesh.vertex(t[1]).cast<double>() - p0;
    const Vec3d e2 = rig.mesh.vertex(t[2]).cast<double>() - p0;
    const Vec3d n = e1.cross(e2);
    field.area[f] = static_cast<float>(0.5 * n.norm());
    const double a = e1.dot(e1), b = e1.dot(e2), c = e2.dot(e2), det = a * c - b * b;
    const Vec3d axis = (axes[t[0]] + axes[t[1]] + axes[t[2]]).normalized();
    const auto list = directions(axis, n.normalized());
    for (size_t d = 0; d < kFoldDirections; ++d) {
      const double x = list[d].dot(e1), y = list[d].dot(e2);
      field.along[f * kFoldDirections + d] =
          Vec2d((c * x - b * y) / det, (a * y - b * x) / det).cast<float>();
    }
    for (int k = 0; k < 3; ++k) field.area_sum[t[k]] += field.area[f];
  }
  return field;
}

}  // namespace people

using people::ClothField;
using people::kFoldDirections;

BodyCloth::BodyCloth(const BuiltinBody& body) : body_(body) {
  const size_t v = static_cast<size_t>(body.rig.mesh.vertex_count());
  fold_.assign(v * kFoldDirections, 0);
  wrinkles_.assign(v, 0);
  offset_.assign(3 * v, 0);
  offset_speed_.assign(3 * v, 0);
  speed_.assign(3 * v, 0);
}

void BodyCloth::pose_tracked(const RigPose& pose) {
  before_ = tracked_;
  pose_vertices(body_.shape, pose, tracked_);
}

// Compression of the tracked cloth along each direction, per vertex.
void BodyCloth::compress(std::vector<float>& wanted) const {
  const ClothField& field = body_.model->cloth;
  const auto& triangles = body_.rig.mesh.triangles;
  constexpr float kSlack = 0.04f;  // compression that cloth takes up without a fold
  wanted.assign(fold_.size(), 0);
  const auto spread = [&](const auto& value_of) {
    std::vector<float> sum(fold_.size(), 0);
    for (size_t f = 0; f < triangles.size(); ++f) {
      if (field.area[f] == 0) continue;
      float value[kFoldDirections];
      value_of(f, value);
      for (int k = 0; k < 3; ++k)
        for (size_t d = 0; d < kFoldDirections; ++d)
          sum[static_cast<size_t>(triangles[f][k]) * kFoldDirections + d] +=
              field.area[f] * value[d];
    }
    for (size_t v = 0; v < field.area_sum.size(); ++v)
      for (size_t d = 0; d < kFoldDirections; ++d)
        wanted[v * kFoldDirections + d] =
            field.area_sum[v] > 0 ? sum[v * kFoldDirections + d] / field.area_sum[v] : 0.0f;
  };
  spread([&](size_t f, float* value) {
    const auto point = [&](int k) {
      return Vec3f(tracked_.data() + 3 * static_cast<size_t>(triangles[f][k]));
    };
    const Vec3f e1 = point(1) - point(0), e2 = point(2) - point(0);
    for (size_t d = 0; d < kFoldDirections; ++d) {
      const Vec2f& a = field.along[f * kFoldDirections + d];
      value[d] = std::clamp(1 - kSlack - (a.x() * e1 + a.y() * e2).norm(), 0.0f, 0.6f);
    }
  });
  // Folds are wider than triangles.
  for (int pass = 0; pass < 3; ++pass) {
    const std::vector<float> now = wanted;
    spread([&](size_t f, float* value) {
      for (size_t d = 0; d < kFoldDirections; ++d) {
        value[d] = 0;
        for (int k = 0; k < 3; ++k)
          value[d] += now[static_cast<size_t>(triangles[f][k]) * kFoldDirections + d] / 3;
      }
    });
  }
}

// Loose cloth as damped oscillators, dragged along by the body.
void BodyCloth::swing(double seconds) {
  const ClothField& field = body_.model->cloth;
  constexpr double kFrequency = 2 * std::numbers::pi * 2.6, kDamping = 0.30;
  constexpr int kSteps = 8;
  const double h = seconds / kSteps;
  for (size_t v = 0; v < field.loose.size(); ++v) {
    if (field.loose[v] == 0) continue;
    const double limit = 0.022 * static_cast<double>(field.loose[v]);
    for (size_t c = 3 * v; c < 3 * v + 3; ++c) {
      const double speed = static_cast<double>(tracked_[c] - before_[c]) / seconds;
      const double push = -(speed - static_cast<double>(speed_[c])) / seconds;
      double x = static_cast<double>(offset_[c]), u = static_cast<double>(offset_speed_[c]);
      for (int s = 0; s < kSteps; ++s) {
        u += h * (static_cast<double>(field.loose[v]) * 0.5 * push - kFrequency * kFrequency * x -
                  2 * kDamping * kFrequency * u);
        x += h * u;
      }
      speed_[c] = static_cast<float>(speed);
      offset_[c] = static_cast<float>(std::clamp(x, -limit, limit));
      offset_speed_[c] = static_cast<float>(std::abs(x) > limit ? 0.0 : u);
    }
  }
}

void BodyCloth::displace() {
  const ClothField& field = body_.model->cloth;
  const std::vector<float> normals = vertex_normals(tracked_, body_.rig.mesh.triangles);
  vertices_ = tracked_;
  for (size_t v = 0; v < field.cloth.size(); ++v) {
    if (!field.cloth[v]) continue;
    double height = 0;
    for (size_t d = 0; d < kFoldDirections; ++d) {
      // A sine of wavelength l that takes up compression c has about the amplitude l sqrt(c) / pi.
      const double c = static_cast<double>(fold_[v * kFoldDirections + d]);
      const double amplitude = std::min(
          0.75 * static_cast<double>(field.wavelength[d]) * std::sqrt(c) / std::numbers::pi, 0.008);
      // Weak folds do not show at all.
      height += amplitude * std::min(1.0, c / 0.06) *
                static_cast<double>(field.wave[v * kFoldDirections + d]);
    }
    height = std::clamp(height, -0.006, 0.012) * static_cast<double>(field.strength[v]);
    wrinkles_[v] = static_cast<float>(height);
    const Vec3d n(normals[3 * v], normals[3 * v + 1], normals[3 * v + 2]);
    Vec3d move(offset_[3 * v], offset_[3 * v + 1], offset_[3 * v + 2]);
    move -= n * std::min(0.0, n.dot(move));  // never into the body
    for (size_t c = 0; c < 3; ++c)
      vertices_[3 * v + c] += static_cast<float>(
          height * n[static_cast<int>(c)] +
          static_cast<double>(std::min(1.0f, 4 * field.strength[v])) * move[static_cast<int>(c)]);
  }
}

void BodyCloth::settle(const RigPose& pose) {
  pose_tracked(pose);
  before_ = tracked_;
  compress(fold_);
  std::fill(offset_.begin(), offset_.end(), 0.0f);
  std::fill(offset_speed_.begin(), offset_speed_.end(), 0.0f);
  std::fill(speed_.begin(), speed_.end(), 0.0f);
  started_ = true;
  displace();
}

void BodyCloth::advance(const RigPose& pose, double seconds) {
  if (!started_) return settle(pose);
  if (!(seconds > 0) || !std::isfinite(seconds))
    throw Error(
        "The time between two frames of a body's motion must be a positive number of seconds.");
  pose_tracked(pose);
  std::vector<float> wanted;
  compress(wanted);
  // Folds come quickly and go slowly.
  const float rise = static_cast<float>(1 - std::exp(-seconds / 0.12));
  const float fall = static_cast<float>(1 - std::exp(-seconds / 0.35));
  for (size_t i = 0; i < fold_.size(); ++i) {
    const float step = wanted[i] - fold_[i];
    fold_[i] += (step > 0 ? rise : fall) * step;
  }
  swing(seconds);
  displace();
}

}  // namespace effigy
