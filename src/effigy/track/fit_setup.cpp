#include "effigy/track/fit_setup.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/mesh.h"
#include "effigy/rig/embedding.h"
#include "effigy/track/mediapipe.h"

namespace effigy {
namespace {

constexpr double kEyeCorners = 0.09;  // metres between the outer corners of the eyes
constexpr int kHoldOutEvery = 5, kHoldOutFirst = 2;

template <size_t n>
bool among(const std::array<int, n>& list, int point) {
  return std::find(list.begin(), list.end(), point) != list.end();
}

bool is_iris(int point) {
  return point >= mediapipe::kFirstIris;
}

bool is_inner(int point) {
  const auto& map = mediapipe_of_multipie();
  return std::find(map.begin() + mediapipe::kFirstInner, map.end(), point) != map.end();
}

// How much a point counts: contours slide over the skin, lips and lids carry the expression.
double importance(int point) {
  if (point == mediapipe::kIrisRight || point == mediapipe::kIrisLeft) return 2.0;
  if (among(mediapipe::kOval, point)) return 0.2;
  if (among(mediapipe::kLips, point)) return 1.6;
  if (among(mediapipe::kEyeRight, point) || among(mediapipe::kEyeLeft, point)) return 1.6;
  if (among(mediapipe::kBrows, point)) return 1.0;
  if (is_inner(point)) return 1.2;
  return 0.5;
}

std::vector<int> all_entries(const Rig& rig) {
  std::vector<int> entries(rig.mediapipe.size());
  for (size_t i = 0; i < entries.size(); ++i) entries[i] = static_cast<int>(i);
  return entries;
}

// Every fifth point in the order of their numbers, irises excepted: what they tell, no other does.
std::vector<bool> choose_held_out(const Rig& rig, bool hold_out) {
  std::vector<bool> held(rig.mediapipe.size(), false);
  if (!hold_out) return held;
  std::vector<int> order = all_entries(rig);
  std::sort(order.begin(), order.end(),
            [&](int a, int b) { return rig.mediapipe.index[a] < rig.mediapipe.index[b]; });
  // Inner landmarks are thinned by themselves, so that a fifth of them is unseen as well.
  int counters[2] = {0, 0};
  for (const int entry : order) {
    const int point = rig.mediapipe.index[entry];
    if (is_iris(point)) continue;
    held[entry] = counters[is_inner(point)]++ % kHoldOutEvery == kHoldOutFirst;
  }
  return held;
}

std::vector<int> not_held_out(const std::vector<bool>& held) {
  std::vector<int> used;
  for (size_t i = 0; i < held.size(); ++i)
    if (!held[i]) used.push_back(static_cast<int>(i));
  return used;
}

double score_of(const FaceObservation& frame, std::string_view name) {
  for (size_t i = 0; i < frame.scores.size(); ++i)
    if (mediapipe::kBlendshapeNames[i] == name) return frame.scores[i];
  return 0;
}

// Rotation of an eye from the gaze scores: a full score is about 30 degrees.
Vec3d gaze(const FaceObservation& frame, bool left) {
  constexpr double kFull = 0.5;
  const double to_left =
      left ? score_of(frame, "eyeLookOutLeft") - score_of(frame, "eyeLookInLeft")
           : score_of(frame, "eyeLookInRight") - score_of(frame, "eyeLookOutRight");
  const double up = left ? score_of(frame, "eyeLookUpLeft") - score_of(frame, "eyeLookDownLeft")
                         : score_of(frame, "eyeLookUpRight") - score_of(frame, "eyeLookDownRight");
  return {-kFull * up, kFull * to_left, 0};
}

}  // namespace

std::vector<float> expression_from_scores(const Rig& rig, const std::vector<float>& scores,
                                          std::vector<bool>* matched) {
  std::vector<float> expression(rig.expression_count, 0.0f);
  if (matched != nullptr) matched->assign(rig.expression_count, false);
  for (int e = 0; e < rig.expression_count; ++e) {
    std::string name = rig.expression_names[e], unsided = name;
    const auto ends_with = [&](const char* ending) {
      const std::string text = ending;
      return name.size() > text.size() &&
             name.compare(name.size() - text.size(), text.size(), text) == 0;
    };
    if (ends_with("_L") || ends_with("_R")) {
      unsided = name.substr(0, name.size() - 2);
      name = unsided + (name.back() == 'L' ? "Left" : "Right");
    }
    for (size_t i = 1; i < scores.size() && i < mediapipe::kBlendshapeNames.size(); ++i) {
      if (mediapipe::kBlendshapeNames[i] != name && mediapipe::kBlendshapeNames[i] != unsided)
        continue;
      expression[e] = std::clamp(scores[i], rig.expression_low[e], rig.expression_high[e]);
      if (matched != nullptr) (*matched)[e] = true;
    }
  }
  return expression;
}

FitSetup::FitSetup(const Rig& rig, const std::vector<FaceObservation>& frames, int width,
                   int height, const FitOptions& options)
    : rig_(rig),
      frames_(frames),
      options_(options),
      center_x_(0.5 * width),
      center_y_(0.5 * height),
      held_out_(choose_held_out(rig, options.hold_out)),
      used_(not_held_out(held_out_)),
      model_(rig, used_),
      all_points_(rig, all_entries(rig)) {
  if (rig.mediapipe.size() < 12)
    throw Error("The rig '" + rig.kind + "' has only " + std::to_string(rig.mediapipe.size()) +
                " landmark points, too few to track; use another rig.");
  for (const int point : rig.mediapipe.index) inner_.push_back(is_inner(point));
  std::vector<double> spans;
  for (size_t f = 0; f < frames.size(); ++f) {
    if (!frames[f].found) continue;
    tracked_.push_back(static_cast<int>(f));
    const auto& points = frames[f].landmarks;
    const int a = 3 * mediapipe::kOuterCornerRight, b = 3 * mediapipe::kOuterCornerLeft;
    spans.push_back(std::hypot(points[a] - points[b], points[a + 1] - points[b + 1]));
  }
  if (tracked_.empty()) throw Error("No frame of the video shows a face that could be tracked.");
  std::nth_element(spans.begin(), spans.begin() + static_cast<std::ptrdiff_t>(spans.size() / 2),
                   spans.end());
  const double span = spans[spans.size() / 2], longer = std::max(width, height);
  pixel_sigma_ = std::max(options.landmark_sigma * span, 1e-3);
  // One face tells little of the focal length: it is the distance that is guessed.
  typical_focal_ = std::clamp(span * options.distance / kEyeCorners, 0.6 * longer, 12.0 * longer);

  neck_ = std::max(rig.joint("neck"), 0);
  const std::vector<float> normals = vertex_normals(rig.mesh.vertices, rig.mesh.triangles);
  for (const int entry : used_) {
    importance_.push_back(importance(rig.mediapipe.index[entry]));
    Vec3d normal = Vec3d::Zero();
    const Vec3i triangle = rig.mesh.triangles[rig.mediapipe.triangle[entry]];
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c)
        normal[c] += static_cast<double>(rig.mediapipe.barycentric[entry][k]) *
                     normals[3 * static_cast<size_t>(triangle[k]) + c];
    normal_.push_back(normal.normalized());
  }
  // The torso stays: the root keeps the mean rotation, the neck does the rest.
  std::vector<double> turns[3];
  for (const int f : tracked_) {
    double scale = 1;
    Vec3d model_center, seen_center;
    const Vec3d turn = axis_angle_of(similarity(f, model_, &scale, &model_center, &seen_center));
    for (int c = 0; c < 3; ++c) turns[c].push_back(turn[c]);
  }
  for (int c = 0; c < 3; ++c) {
    const auto middle = turns[c].begin() + static_cast<std::ptrdiff_t>(turns[c].size() / 2);
    std::nth_element(turns[c].begin(), middle, turns[c].end());
    torso_[c] = *middle;
  }
}

double FitSetup::freedom(int point) const {
  const int number = rig_.mediapipe.index[used_[point]];
  if (is_iris(number)) return 0;
  const bool moves = among(mediapipe::kLips, number) || among(mediapipe::kEyeRight, number) ||
                     among(mediapipe::kEyeLeft, number);
  return moves ? 0.25 : 1.0;
}

Vec2d FitSetup::seen(int f, int point) const {
  const float* p = frames_[f].landmarks.data() + 3 * static_cast<size_t>(point);
  return {p[0] - center_x_, p[1] - center_y_};
}

// The rotation of the least-squares similarity (Umeyama 1991) from the model's neutral points to
// the network's points, both y up and towards the viewer.
Mat3d FitSetup::similarity(int f, const FitModel& model, double* scale, Vec3d* model_center,
                           Vec3d* seen_center) const {
  Eigen::VectorXd frame = Eigen::VectorXd::Zero(model.frame_size());
  FitModel::Result result;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(model.identity_count());
  model.evaluate(zero.data(), frame.data(), false, false, result);
  std::vector<Vec3d> from, to;
  for (size_t i = 0; i < used_.size(); ++i) {
    const int point = rig_.mediapipe.index[used_[i]];
    if (is_iris(point) || among(mediapipe::kOval, point) || among(mediapipe::kLips, point))
      continue;
    const float* p = frames_[f].landmarks.data() + 3 * static_cast<size_t>(point);
    from.emplace_back(result.position.row(static_cast<Eigen::Index>(i)).transpose());
    to.emplace_back(p[0] - center_x_, -(p[1] - center_y_), -p[2]);
  }
  const double count = static_cast<double>(from.size());
  *model_center = *seen_center = Vec3d::Zero();
  for (size_t i = 0; i < from.size(); ++i) {
    *model_center += from[i] / count;
    *seen_center += to[i] / count;
  }
  Mat3d covariance = Mat3d::Zero();
  double spread = 0;
  for (size_t i = 0; i < from.size(); ++i) {
    covariance += (to[i] - *seen_center) * (from[i] - *model_center).transpose();
    spread += (from[i] - *model_center).squaredNorm();
  }
  const Eigen::JacobiSVD<Mat3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vec3d signs = Vec3d::Ones();
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0) signs[2] = -1;
  const Mat3d rotation = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  *scale = std::max(rotation.cwiseProduct(covariance).sum() / spread, 1e-6);
  return rotation;
}

Eigen::VectorXd FitSetup::first_guess(int f, const FitModel& model, double focal) const {
  double scale = 1;
  Vec3d model_center, seen_center;
  const Mat3d rotation = similarity(f, model, &scale, &model_center, &seen_center);
  Eigen::VectorXd guess = target(f).prior_mean;
  FitModel::Result still;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(model.identity_count());
  guess.head<3>().setZero();
  guess.segment<3>(model.rotation_begin(0)) = torso_;
  guess.segment<3>(model.rotation_begin(neck_)) =
      neck_ > 0 ? axis_angle_of(rotation_of(torso_, nullptr).transpose() * rotation)
                : axis_angle_of(rotation);
  model.evaluate(zero.data(), guess.data(), false, false, still);
  Vec3d turned_center = Vec3d::Zero();
  double count = 0;
  for (size_t i = 0; i < used_.size(); ++i) {
    const int point = rig_.mediapipe.index[used_[i]];
    if (is_iris(point) || among(mediapipe::kOval, point) || among(mediapipe::kLips, point))
      continue;
    turned_center += still.position.row(static_cast<Eigen::Index>(i)).transpose();
    count += 1;
  }
  turned_center /= count;
  const Vec3d center(seen_center.x() / scale, seen_center.y() / scale, -focal / scale);
  guess.head<3>() = center - turned_center;
  return guess;
}

FrameTarget FitSetup::target(int f) const {
  FrameTarget target;
  double scale = 1;
  Vec3d unused_a, unused_b;
  const Mat3d rotation = similarity(f, model_, &scale, &unused_a, &unused_b);
  target.depth_scale = scale;
  for (size_t i = 0; i < used_.size(); ++i) {
    const int point = rig_.mediapipe.index[used_[i]];
    const bool known = 3 * static_cast<size_t>(point) + 2 < frames_[f].landmarks.size();
    target.seen.push_back(known ? seen(f, point) : Vec2d::Zero());
    // What faces away is the network's guess.
    const double facing = (rotation * normal_[i]).z();
    const double visible = std::clamp((facing + 0.1) / 0.4, 0.1, 1.0);
    target.weight.push_back(known ? importance_[i] * visible / pixel_sigma_ : 0.0);
    target.depth.push_back(known ? -frames_[f].landmarks[3 * static_cast<size_t>(point) + 2] : 0.0);
    target.depth_weight.push_back(is_iris(point) ? 0.0
                                                 : target.weight.back() / options_.depth_sigma);
  }
  const int size = model_.frame_size();
  target.prior_mean = Eigen::VectorXd::Zero(size);
  target.prior_weight = Eigen::VectorXd::Zero(size);
  target.lower = Eigen::VectorXd::Constant(size, -1e9);
  target.upper = Eigen::VectorXd::Constant(size, 1e9);
  const bool irises = frames_[f].landmarks.size() > 3 * mediapipe::kFirstIris;
  if (neck_ > 0) {
    target.prior_mean.segment<3>(model_.rotation_begin(0)) = torso_;
    target.prior_weight.segment<3>(model_.rotation_begin(0)).setConstant(1 / options_.torso_sigma);
  }
  for (int j = 1; j < model_.joint_count(); ++j) {
    const std::string& name = rig_.joint_names[j];
    const int at = model_.rotation_begin(j);
    if (name == "eye_left" || name == "eye_right") {
      target.prior_mean.segment<3>(at) = gaze(frames_[f], name == "eye_left");
      target.prior_weight.segment<3>(at) =
          irises ? Vec3d(1 / 0.4, 1 / 0.4, 1 / 0.02) : Vec3d(1 / 0.1, 1 / 0.1, 1 / 0.02);
      (name == "eye_left" ? target.eye_left : target.eye_right) = j;
    } else if (name == "jaw") {
      target.prior_mean[at] = 0.35 * score_of(frames_[f], "jawOpen");
      target.prior_weight.segment<3>(at) = Vec3d(1 / 0.2, 1 / 0.06, 1 / 0.03);
    } else {
      target.prior_weight.segment<3>(at).setConstant(1.0 / options_.neck_sigma);
    }
  }
  target.eye_weight = 1.0 / 0.06;
  const std::vector<float> guess = expression_from_scores(rig_, frames_[f].scores);
  for (int e = 0; e < rig_.expression_count; ++e) {
    const int at = model_.expression_begin() + e;
    const double range = std::max(rig_.expression_high[e] - rig_.expression_low[e], 1e-3f);
    target.prior_mean[at] = guess[e];
    target.lower[at] = rig_.expression_low[e];
    target.upper[at] = rig_.expression_high[e];
    target.prior_weight[at] = 1.0 / (options_.expression_sigma * range);
  }
  return target;
}

std::vector<int> FitSetup::choose_key_frames(int count) const {
  if (static_cast<int>(tracked_.size()) <= count) return tracked_;
  // Shape of the landmark set without position and size: pose and expression both change it.
  std::vector<Eigen::VectorXd> features;
  for (const int f : tracked_) {
    Eigen::VectorXd feature(2 * static_cast<Eigen::Index>(used_.size()));
    Vec2d mean = Vec2d::Zero();
    for (size_t i = 0; i < used_.size(); ++i) {
      const Vec2d p = seen(f, rig_.mediapipe.index[used_[i]]);
      feature.segment<2>(2 * static_cast<Eigen::Index>(i)) = p;
      mean += p / static_cast<double>(used_.size());
    }
    for (Eigen::Index i = 0; i < feature.size(); i += 2) feature.segment<2>(i) -= mean;
    features.push_back(feature / std::max(feature.norm(), 1e-9));
  }
  // Half of them evenly over time, half as far as possible from those chosen (farthest points).
  std::vector<bool> chosen(tracked_.size(), false);
  std::vector<double> distance(tracked_.size(), 1e30);
  const auto take = [&](size_t k) {
    chosen[k] = true;
    for (size_t i = 0; i < features.size(); ++i)
      distance[i] = std::min(distance[i], (features[i] - features[k]).squaredNorm());
  };
  const int even = std::max(count / 2, 1);
  for (int i = 0; i < even; ++i)
    take(static_cast<size_t>((i + 0.5) / even * static_cast<double>(tracked_.size())));
  for (int i = even; i < count; ++i)
    take(
        static_cast<size_t>(std::max_element(distance.begin(), distance.end()) - distance.begin()));
  std::vector<int> keys;
  for (size_t i = 0; i < chosen.size(); ++i)
    if (chosen[i]) keys.push_back(tracked_[i]);
  return keys;
}

Eigen::VectorXd FitSetup::smoothness() const {
  Eigen::VectorXd weight = Eigen::VectorXd::Zero(model_.frame_size());
  weight[0] = weight[1] = 1.0 / options_.smooth_translation;
  weight[2] = 1.0 / options_.smooth_depth;
  for (int j = 0; j < model_.joint_count(); ++j) {
    const bool eye = rig_.joint_names[j] == "eye_left" || rig_.joint_names[j] == "eye_right";
    weight.segment<3>(model_.rotation_begin(j))
        .setConstant(1.0 / (eye ? 0.1 : options_.smooth_rotation));
  }
  for (int e = 0; e < rig_.expression_count; ++e) {
    const double range = std::max(rig_.expression_high[e] - rig_.expression_low[e], 1e-3f);
    // Lids move from open to closed within two or three frames.
    const bool fast = rig_.expression_names[e].find("Blink") != std::string::npos;
    weight[model_.expression_begin() + e] =
        1.0 / ((fast ? 5.0 : 1.0) * options_.smooth_expression * range);
  }
  return weight;
}

RigPose FitSetup::pose_of(const Eigen::VectorXd& frame) const {
  RigPose pose = RigPose::rest(rig_);
  for (int c = 0; c < 3; ++c) pose.translation[c] = static_cast<float>(frame[c]);
  for (size_t i = 0; i < pose.joint_rotation.size(); ++i)
    pose.joint_rotation[i] = static_cast<float>(frame[3 + static_cast<Eigen::Index>(i)]);
  for (int e = 0; e < rig_.expression_count; ++e)
    pose.expression[e] = std::clamp(static_cast<float>(frame[model_.expression_begin() + e]),
                                    rig_.expression_low[e], rig_.expression_high[e]);
  return pose;
}

}  // namespace effigy
