#include "effigy/track/fit_photo.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr int kPoints = 1000;
constexpr size_t kMostViews = 150;  // frames that decide what a point looks like
constexpr double kLeastFacing = 0.3, kFullFacing = 0.6;
constexpr double kLeastSeen = 3;  // views' worth of weight

}  // namespace

PhotoFit::PhotoFit(const Rig& rig, const std::vector<float>& identity, const FitSetup& setup,
                   const std::vector<PhotoWindow>& photos, double focal, const FitOptions& options,
                   FitModel& model)
    : setup_(setup),
      photos_(photos),
      model_(model),
      options_(options),
      focal_(focal),
      first_(model.point_count()) {
  const RigShape shape = shape_rig(rig, identity);
  const LandmarkEmbedding points = choose_photo_points(rig, shape.rest, kPoints);
  model.add_points(rig, shape, points);
  for (const int t : points.triangle) {
    Vec3d corner[3];
    for (int k = 0; k < 3; ++k)
      corner[k] =
          Vec3f(&shape.rest[3 * static_cast<size_t>(rig.mesh.triangles[t][k])]).cast<double>();
    normal_.push_back((corner[1] - corner[0]).cross(corner[2] - corner[0]).normalized());
  }
}

PhotoFit::Look PhotoFit::look(size_t i, const Eigen::VectorXd& frame) const {
  Look look{std::vector<float>(normal_.size(), 0.0f), std::vector<float>(normal_.size(), 0.0f)};
  const PhotoWindow& window = photos_[static_cast<size_t>(setup_.tracked()[i])];
  if (window.contrast.empty()) return look;
  FitModel::Result result;
  model_.evaluate(nullptr, frame.data(), false, false, result);
  const Mat3d turn = model_.rotation_in_world(frame, setup_.neck());
  for (size_t k = 0; k < normal_.size(); ++k) {
    const Vec3d world = result.position.row(first_ + static_cast<Eigen::Index>(k)).transpose();
    if (!(world.z() < -1e-3)) continue;
    const double facing = -(turn * normal_[k]).dot(world.normalized());
    const double weight =
        std::clamp((facing - kLeastFacing) / (kFullFacing - kLeastFacing), 0.0, 1.0);
    const Vec2d pixel = project_point(world, focal_, nullptr);
    double value = 0;
    Vec2d slope;
    if (weight <= 0 || !window.sample(pixel + setup_.center(), &value, &slope)) continue;
    look.value[k] = static_cast<float>(value);
    look.weight[k] = static_cast<float>(weight);
  }
  return look;
}

void PhotoFit::expect(const std::vector<Eigen::VectorXd>& frames,
                      std::vector<FrameTarget>& targets) const {
  std::vector<Look> looks(frames.size());
  parallel_for(frames.size(), 4, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) looks[i] = look(i, frames[i]);
  });
  const size_t stride = (frames.size() + kMostViews - 1) / kMostViews;
  std::vector<double> sum(normal_.size(), 0.0), mean(normal_.size(), 0.0), square(normal_.size());
  for (size_t i = 0; i < frames.size(); i += stride)
    for (size_t k = 0; k < normal_.size(); ++k) {
      const double w = looks[i].weight[k], v = looks[i].value[k];
      sum[k] += w;
      mean[k] += w * v;
      square[k] += w * v * v;
    }
  const double noise = options_.photo_sigma * options_.photo_sigma;
  for (size_t i = 0; i < frames.size(); ++i) {
    FrameTarget& target = targets[i];
    target.photo = &photos_[static_cast<size_t>(setup_.tracked()[i])];
    target.center = setup_.center();
    // The torso's points, behind the landmarks, keep their weight.
    for (int l = 0; l < setup_.model().point_count(); ++l) {
      target.weight[static_cast<size_t>(l)] *= options_.photo_landmarks;
      target.depth_weight[static_cast<size_t>(l)] *= options_.photo_landmarks;
    }
    target.photo_value.assign(normal_.size(), 0.0f);
    target.photo_weight.assign(normal_.size(), 0.0f);
    for (size_t k = 0; k < normal_.size(); ++k) {
      if (sum[k] < kLeastSeen) continue;
      const double m = mean[k] / sum[k];
      const double variance = std::max(square[k] / sum[k] - m * m, 0.0);
      target.photo_value[k] = static_cast<float>(m);
      target.photo_weight[k] = static_cast<float>(looks[i].weight[k] / std::sqrt(noise + variance));
    }
  }
}

}  // namespace effigy
