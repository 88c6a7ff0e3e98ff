#include "effigy/body/driver.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr size_t kFitFrames = 24;
using Affine = Eigen::Map<const Eigen::Matrix<float, 3, 4, Eigen::RowMajor>>;

Affine transform(std::span<const float> transforms, int joint) {
  return Affine(transforms.data() + 12 * static_cast<size_t>(joint));
}
Vec3f vertex(std::span<const float> vertices, int index) {
  return Vec3f(vertices.data() + 3 * static_cast<size_t>(index));
}
Vec3f point_on(const Vec3i& corners, const Vec3f& weights, std::span<const float> vertices) {
  return weights[0] * vertex(vertices, corners[0]) + weights[1] * vertex(vertices, corners[1]) +
         weights[2] * vertex(vertices, corners[2]);
}

// The joint whose transform is nearest to the given frames over the capture.
int root_joint(const std::vector<std::array<float, 12>>& wanted, const std::vector<int>& frames,
               const std::vector<std::vector<float>>& transforms, int joints) {
  int best = 0;
  double least = std::numeric_limits<double>::max();
  for (int j = 0; j < joints; ++j) {
    double sum = 0;
    for (size_t k = 0; k < frames.size(); ++k)
      for (size_t i = 0; i < 12; ++i) {
        const double off = wanted[static_cast<size_t>(frames[k])][i] -
                           transforms[k][12 * static_cast<size_t>(j) + i];
        sum += off * off;
      }
    if (sum < least) {
      least = sum;
      best = j;
    }
  }
  return best;
}

// Mean and worst distance from it.
struct Spread {
  Vec3f mean = Vec3f::Zero();
  float worst = 0;
};
Spread spread_of(const std::vector<Vec3f>& points) {
  Spread spread;
  for (const Vec3f& p : points) spread.mean += p / static_cast<float>(points.size());
  for (const Vec3f& p : points) spread.worst = std::max(spread.worst, (p - spread.mean).norm());
  return spread;
}

// Corner of the triangle nearest to a point; a triangle is chosen by its centre.
int nearest_triangle(const std::vector<Vec3i>& triangles, std::span<const float> vertices,
                     const Vec3f& point) {
  int best = 0;
  float least = std::numeric_limits<float>::max();
  for (size_t t = 0; t < triangles.size(); ++t) {
    const float distance =
        (point_on(triangles[t], Vec3f::Constant(1.0f / 3), vertices) - point).squaredNorm();
    if (distance < least) {
      least = distance;
      best = static_cast<int>(t);
    }
  }
  return best;
}

std::vector<int> spread_frames_of(const StageCapture& capture) {
  const std::vector<int> all = capture.frames_of(StageSplit::kTrain);
  std::vector<int> picked;
  const size_t count = std::min(all.size(), kFitFrames);
  for (size_t k = 0; k < count; ++k) picked.push_back(all[k * all.size() / count]);
  return picked;
}

}  // namespace

BodyDriver::BodyDriver(const StageCapture& capture)
    : shape_(shape_rig(capture.rig, {})), triangles_(capture.rig.mesh.triangles) {
  if (capture.rig.joint_count() == 0)
    throw Error(capture.folder.string() + ": the rig has no joints; give a rigged mesh.");
  const std::vector<int> frames = spread_frames_of(capture);
  std::vector<std::vector<float>> transforms;
  transforms.reserve(frames.size());
  for (const int f : frames)
    transforms.push_back(joint_transforms(shape_, capture.poses[static_cast<size_t>(f)]));
  body_root_ = root_joint(capture.body_from_rest, frames, transforms, capture.rig.joint_count());
  face_root_ = root_joint(capture.face_from_rest, frames, transforms, capture.rig.joint_count());
  bind(capture, capture.body_keypoints, capture.body_keypoint_names.size(), frames, body_);
  bind(capture, capture.face_keypoints, capture.face_keypoint_names.size(), frames, face_);
}

void BodyDriver::bind(const StageCapture& capture, std::span<const float> all, size_t count,
                      const std::vector<int>& frames, std::vector<KeypointBinding>& bindings) {
  std::vector<std::vector<float>> transforms, vertices;
  for (const int f : frames) {
    const RigPose& pose = capture.poses[static_cast<size_t>(f)];
    transforms.push_back(joint_transforms(shape_, pose));
    vertices.emplace_back();
    pose_vertices(shape_, pose, vertices.back());
  }
  const int joints = capture.rig.joint_count();
  const auto seen = [&](size_t k, size_t point) {
    return Vec3f(all.data() + 3 * (static_cast<size_t>(frames[k]) * count + point));
  };
  for (size_t point = 0; point < count; ++point) {
    KeypointBinding best;
    float least = std::numeric_limits<float>::max();
    std::vector<Vec3f> at(frames.size());
    const auto consider = [&](const KeypointBinding& binding) {
      for (size_t k = 0; k < frames.size(); ++k) {
        const Affine world = transform(transforms[k], binding.joint);
        const Vec3f from = binding.triangle < 0
                               ? Vec3f(world.col(3))
                               : point_on(triangles_[static_cast<size_t>(binding.triangle)],
                                          binding.barycentric, vertices[k]);
        at[k] = world.leftCols<3>().transpose() * (seen(k, point) - from);
      }
      const Spread spread = spread_of(at);
      if (spread.worst >= least) return;
      least = spread.worst;
      best = binding;
      best.rest = spread.mean;
    };
    for (int j = 0; j < joints; ++j) consider({j, -1, Vec3f::Zero(), Vec3f::Zero()});
    // On the surface: turned by the joint that moves the nearest triangle most.
    KeypointBinding surface;
    surface.triangle = nearest_triangle(triangles_, vertices[0], seen(0, point));
    surface.barycentric = Vec3f::Constant(1.0f / 3);
    const auto corner = static_cast<size_t>(triangles_[static_cast<size_t>(surface.triangle)][0]);
    const float* weights = &shape_.weights[corner * static_cast<size_t>(joints)];
    surface.joint = static_cast<int>(std::max_element(weights, weights + joints) - weights);
    consider(surface);
    bindings.push_back(best);
    worst_ = std::max(worst_, static_cast<double>(least));
  }
}

Vec3f keypoint_position(const KeypointBinding& binding, const std::vector<Vec3i>& triangles,
                        std::span<const float> vertices, std::span<const float> transforms) {
  const Affine world = transform(transforms, binding.joint);
  const Vec3f from = binding.triangle < 0
                         ? Vec3f(world.col(3))
                         : point_on(triangles[static_cast<size_t>(binding.triangle)],
                                    binding.barycentric, vertices);
  return from + world.leftCols<3>() * binding.rest;
}

BodyMoment BodyDriver::moment(const RigPose& pose) const {
  BodyMoment moment;
  pose_vertices(shape_, pose, moment.vertices);
  const std::vector<float> transforms = joint_transforms(shape_, pose);
  const auto fill = [&](const std::vector<KeypointBinding>& bindings, int root,
                        std::vector<float>& out) {
    const Affine world = transform(transforms, root);
    for (const KeypointBinding& binding : bindings) {
      const Vec3f local =
          world.leftCols<3>().transpose() *
          (keypoint_position(binding, triangles_, moment.vertices, transforms) - world.col(3));
      out.insert(out.end(), local.data(), local.data() + 3);
    }
  };
  const Affine root = transform(transforms, body_root_);
  moment.world_from_root = root.leftCols<3>();
  moment.root = root.col(3);
  fill(body_, body_root_, moment.body_keypoints);
  fill(face_, face_root_, moment.face_keypoints);
  return moment;
}

void BodyDriver::save(TensorFile& file) const {
  file.metadata["keypoint_roots"] = std::to_string(body_root_) + " " + std::to_string(face_root_);
  const auto store = [&](const std::string& name, const std::vector<KeypointBinding>& bindings) {
    std::vector<int32_t> index;
    std::vector<float> place;
    for (const KeypointBinding& b : bindings) {
      index.insert(index.end(), {b.joint, b.triangle});
      place.insert(place.end(), b.barycentric.data(), b.barycentric.data() + 3);
      place.insert(place.end(), b.rest.data(), b.rest.data() + 3);
    }
    const auto rows = static_cast<int64_t>(bindings.size());
    file.tensors[name + ".index"] = Tensor::from(std::span<const int32_t>(index), {rows, 2});
    file.tensors[name + ".place"] = Tensor::from(std::span<const float>(place), {rows, 6});
  };
  store("keypoints_on_rig.body", body_);
  store("keypoints_on_rig.face", face_);
}

BodyDriver::BodyDriver(const Rig& rig, const TensorFile& file)
    : shape_(shape_rig(rig, {})), triangles_(rig.mesh.triangles) {
  const int joints = rig.joint_count(), triangles = static_cast<int>(triangles_.size());
  const auto wrong = [&](const std::string& what) {
    throw Error(file.path.string() + ": " + what + "; train again.");
  };
  const auto roots = file.metadata.find("keypoint_roots");
  if (roots == file.metadata.end() ||
      std::sscanf(roots->second.c_str(), "%d %d", &body_root_, &face_root_) != 2 ||
      std::min(body_root_, face_root_) < 0 || std::max(body_root_, face_root_) >= joints)
    wrong("its metadata 'keypoint_roots' do not fit the rig");
  const auto load = [&](const std::string& name, std::vector<KeypointBinding>& bindings) {
    const std::vector<int32_t> index = file.ints(name + ".index", {-1, 2});
    const auto rows = static_cast<int64_t>(index.size() / 2);
    const std::vector<float> place = file.floats(name + ".place", {rows, 6});
    for (size_t i = 0; i < index.size() / 2; ++i) {
      const KeypointBinding b{index[2 * i], index[2 * i + 1], Vec3f(&place[6 * i]),
                              Vec3f(&place[6 * i + 3])};
      if (b.joint < 0 || b.joint >= joints || b.triangle < -1 || b.triangle >= triangles)
        wrong("tensor '" + name + ".index' is out of range");
      bindings.push_back(b);
    }
  };
  load("keypoints_on_rig.body", body_);
  load("keypoints_on_rig.face", face_);
}

}  // namespace effigy
