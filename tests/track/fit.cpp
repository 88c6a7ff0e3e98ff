// The rig's points and their derivatives, the solvers, and a whole fit to landmarks with known
// truth.
#include "effigy/track/fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/people/builtin_head.h"
#include "effigy/rig/embedding.h"
#include "effigy/track/fit_box.h"
#include "effigy/track/fit_model.h"
#include "effigy/track/mediapipe.h"
#include "track/small_rig.h"

namespace effigy {
namespace {

std::vector<int> entries(const Rig& rig) {
  std::vector<int> all(rig.mediapipe.size());
  for (size_t i = 0; i < all.size(); ++i) all[i] = static_cast<int>(i);
  return all;
}

Eigen::VectorXd random_vector(Eigen::Index size, double scale, uint64_t seed) {
  Random random(seed);
  Eigen::VectorXd values(size);
  for (Eigen::Index i = 0; i < size; ++i) values[i] = scale * random.normal();
  return values;
}

TEST(Rotation, DerivativeMatchesDifferences) {
  for (const Vec3d& w : {Vec3d(0.3, -0.5, 0.2), Vec3d(1e-8, -2e-8, 0), Vec3d(0, 0, 0),
                         Vec3d(2.0, 1.5, -1.0), Vec3d(1e-4, 0, 1e-5)}) {
    Mat3d derivative[3];
    const Mat3d rotation = rotation_of(w, derivative);
    EXPECT_LT((rotation * rotation.transpose() - Mat3d::Identity()).norm(), 1e-12);
    EXPECT_LT((rotation_of(axis_angle_of(rotation), nullptr) - rotation).norm(), 1e-9);
    for (int a = 0; a < 3; ++a) {
      const double step = 1e-5;
      const Mat3d numeric = (rotation_of(w + step * Vec3d::Unit(a), nullptr) -
                             rotation_of(w - step * Vec3d::Unit(a), nullptr)) /
                            (2 * step);
      EXPECT_LT((numeric - derivative[a]).norm(), 1e-8) << w.transpose();
    }
  }
}

class Model : public testing::TestWithParam<bool> {};

TEST_P(Model, AgreesWithPosedVertices) {
  const Rig rig = test::small_rig(7, 40, 1, GetParam());
  const FitModel model(rig, entries(rig));
  const Eigen::VectorXd identity = random_vector(3, 1.0, 2);
  const Eigen::VectorXd frame = random_vector(model.frame_size(), 0.4, 3);
  FitModel::Result result;
  model.evaluate(identity.data(), frame.data(), false, false, result);

  std::vector<float> beta(identity.begin(), identity.end());
  RigPose pose = RigPose::rest(rig);
  for (int c = 0; c < 3; ++c) pose.translation[c] = static_cast<float>(frame[c]);
  for (int i = 0; i < 15; ++i) pose.joint_rotation[i] = static_cast<float>(frame[3 + i]);
  for (int e = 0; e < 5; ++e) pose.expression[e] = static_cast<float>(frame[18 + e]);
  std::vector<float> vertices;
  pose_vertices(shape_rig(rig, beta), pose, vertices);
  const auto expected = landmark_positions(rig.mediapipe, rig.mesh.triangles, vertices);
  for (int i = 0; i < model.point_count(); ++i)
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(result.position(i, c), expected[3 * i + c], 2e-6) << i << " " << c;
}

TEST_P(Model, DerivativesMatchDifferences) {
  const Rig rig = test::small_rig(6, 20, 4, GetParam());
  const FitModel model(rig, entries(rig));
  const Eigen::VectorXd identity = random_vector(3, 1.0, 5);
  const Eigen::VectorXd frame = random_vector(model.frame_size(), 0.4, 6);
  FitModel::Result result, up, down;
  model.evaluate(identity.data(), frame.data(), true, true, result);
  const double step = 1e-6;
  const auto compare = [&](Eigen::Index column, const FitModel::Matrix& analytic) {
    const FitModel::Matrix numeric = (up.position - down.position) / (2 * step);
    for (Eigen::Index i = 0; i < numeric.rows(); ++i)
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(analytic(3 * i + c, column), numeric(i, c), 1e-8) << column << " " << i;
  };
  for (Eigen::Index k = 0; k < frame.size(); ++k) {
    Eigen::VectorXd moved = frame;
    moved[k] += step;
    model.evaluate(identity.data(), moved.data(), false, false, up);
    moved[k] -= 2 * step;
    model.evaluate(identity.data(), moved.data(), false, false, down);
    compare(k, result.d_frame);
  }
  for (Eigen::Index k = 0; k < identity.size(); ++k) {
    Eigen::VectorXd moved = identity;
    moved[k] += step;
    model.evaluate(moved.data(), frame.data(), false, false, up);
    moved[k] -= 2 * step;
    model.evaluate(moved.data(), frame.data(), false, false, down);
    compare(k, result.d_identity);
  }
}

TEST_P(Model, IdentityFoldedInChangesNothing) {
  const Rig rig = test::small_rig(6, 20, 7, GetParam());
  const FitModel model(rig, entries(rig));
  const Eigen::VectorXd identity = random_vector(3, 1.0, 8);
  const Eigen::VectorXd frame = random_vector(model.frame_size(), 0.4, 9);
  FitModel::Result whole, folded;
  model.evaluate(identity.data(), frame.data(), true, false, whole);
  const FitModel baked = model.with_identity(identity.data());
  EXPECT_EQ(baked.identity_count(), 0);
  baked.evaluate(nullptr, frame.data(), true, false, folded);
  EXPECT_LT((whole.position - folded.position).norm(), 1e-12);
  EXPECT_LT((whole.d_frame - folded.d_frame).norm(), 1e-12);
}
INSTANTIATE_TEST_SUITE_P(PoseBasis, Model, testing::Bool());

// A frame in front of the camera and targets near its projection.
FrameTarget some_target(const FitModel& model, uint64_t seed) {
  FrameTarget target;
  Random random(seed);
  for (int i = 0; i < model.point_count(); ++i) {
    target.seen.emplace_back(random.uniform(-60, 60), random.uniform(-60, 60));
    target.weight.push_back(i % 4 == 0 ? 0.0 : random.uniform(0.1, 0.6));
    target.depth.push_back(random.uniform(-20, 20));
    target.depth_weight.push_back(i % 3 == 0 ? 0.0 : random.uniform(0.1, 0.3));
  }
  target.depth_scale = 700;
  target.prior_mean = random_vector(model.frame_size(), 0.1, seed + 1);
  target.prior_weight = random_vector(model.frame_size(), 1.0, seed + 2).cwiseAbs();
  target.lower = Eigen::VectorXd::Constant(model.frame_size(), -1e9);
  target.upper = Eigen::VectorXd::Constant(model.frame_size(), 1e9);
  target.eye_weight = 3;
  target.eye_left = 3;
  target.eye_right = 4;
  return target;
}

TEST(FrameCost, JacobianMatchesDifferences) {
  const Rig rig = test::small_rig(6, 16, 11, false);
  const FitModel model(rig, entries(rig));
  const FrameTarget target = some_target(model, 12);
  const FrameCost cost(model, target, 2.0, 0);
  double log_focal = std::log(500.0);
  Eigen::VectorXd identity = random_vector(3, 1.0, 13);
  Eigen::VectorXd frame = random_vector(model.frame_size(), 0.2, 14);
  frame[2] = -0.7;
  double* blocks[3] = {&log_focal, identity.data(), frame.data()};
  const int rows = cost.num_residuals();
  std::vector<double> residuals(rows), up(rows), down(rows);
  std::vector<double> j0(rows), j1(rows * 3), j2(static_cast<size_t>(rows) * frame.size());
  double* jacobians[3] = {j0.data(), j1.data(), j2.data()};
  ASSERT_TRUE(cost.Evaluate(blocks, residuals.data(), jacobians));
  const int sizes[3] = {1, 3, static_cast<int>(frame.size())};
  for (int b = 0; b < 3; ++b)
    for (int k = 0; k < sizes[b]; ++k) {
      const double step = 1e-6, kept = blocks[b][k];
      blocks[b][k] = kept + step;
      ASSERT_TRUE(cost.Evaluate(blocks, up.data(), nullptr));
      blocks[b][k] = kept - step;
      ASSERT_TRUE(cost.Evaluate(blocks, down.data(), nullptr));
      blocks[b][k] = kept;
      for (int r = 0; r < rows; ++r)
        ASSERT_NEAR(jacobians[b][r * sizes[b] + k], (up[r] - down[r]) / (2 * step), 2e-4)
            << b << " " << k << " " << r;
    }
}

TEST(FrameCost, ContrastsPullPointsToWhereTheyLookRight) {
  // A picture of a smooth blob; the points expect what they see at the true pose.
  const Rig rig = test::small_rig(7, 40, 21, false);
  FitModel model = FitModel(rig, {}).with_identity(std::vector<double>(3).data());
  model.add_points(rig, shape_rig(rig, {}), rig.mediapipe);
  Image8 picture(512, 512, 3);
  for (int y = 0; y < 512; ++y)
    for (int x = 0; x < 512; ++x)
      for (int c = 0; c < 3; ++c)
        picture.at(x, y)[c] = static_cast<uint8_t>(127 + 60 * std::sin(0.09 * x + 0.02 * y) +
                                                   60 * std::cos(0.11 * y - 0.03 * x));
  FaceObservation face;
  face.found = true;
  face.landmarks.assign(3 * 478, 256.0f);
  face.landmarks[3 * 10 + 1] = 150;
  face.landmarks[3 * 152 + 1] = 350;
  const PhotoWindow window = photo_window(picture, face);
  FrameTarget target;
  const int size = model.frame_size();
  target.prior_mean = target.prior_weight = Eigen::VectorXd::Zero(size);
  target.lower = Eigen::VectorXd::Constant(size, -1e9);
  target.upper = Eigen::VectorXd::Constant(size, 1e9);
  target.photo = &window;
  target.center = Vec2d(256, 256);
  Eigen::VectorXd truth = Eigen::VectorXd::Zero(size);
  truth.head<3>() = Vec3d(0.004, -0.003, -0.7);
  const double focal = 700;
  FitModel::Result result;
  model.evaluate(nullptr, truth.data(), false, false, result);
  for (int i = 0; i < model.point_count(); ++i) {
    const Vec3d p = result.position.row(i).transpose();
    double value = 0;
    Vec2d slope;
    const bool seen = window.sample(
        Vec2d(-focal * p.x() / p.z(), focal * p.y() / p.z()) + target.center, &value, &slope);
    target.photo_value.push_back(static_cast<float>(value));
    target.photo_weight.push_back(seen ? 50.0f : 0.0f);
  }
  // Only the place is free.
  target.prior_weight.tail(size - 3).setConstant(1e4);
  Eigen::VectorXd frame = truth;
  frame.head<2>() += Vec2d(0.006, -0.005);  // 6 and 5 pixels
  const FrameCost cost(model, target, 3.0, focal);
  minimise_in_box(cost, target.lower, target.upper, 20, 1e-8, frame);
  EXPECT_LT((frame - truth).head<2>().norm(), 2e-4);
}

TEST(FrameCost, DepthsHaveNoPlaceOfTheirOwn) {
  // The networks' depths count from any plane: moving all of them, or the head, changes nothing.
  const Rig rig = test::small_rig(6, 16, 15, false);
  const FitModel model = FitModel(rig, entries(rig)).with_identity(std::vector<double>(3).data());
  FrameTarget target = some_target(model, 16);
  target.weight.assign(target.weight.size(), 0.0);
  target.prior_weight.setZero();
  target.eye_weight = 0;
  Eigen::VectorXd frame = random_vector(model.frame_size(), 0.1, 17);
  frame[2] = -0.7;
  const auto cost_of = [&](const FrameTarget& t, const Eigen::VectorXd& x) {
    const FrameCost cost(model, t, 2.0, 500);
    std::vector<double> residuals(cost.num_residuals());
    const double* block = x.data();
    EXPECT_TRUE(cost.Evaluate(&block, residuals.data(), nullptr));
    double sum = 0;
    for (const double r : residuals) sum += r * r;
    return sum;
  };
  const double before = cost_of(target, frame);
  EXPECT_GT(before, 1.0);
  FrameTarget moved = target;
  for (double& d : moved.depth) d += 33;
  EXPECT_NEAR(cost_of(moved, frame), before, 1e-9 * before);
  Eigen::VectorXd nearer = frame;
  nearer.head<3>() += Vec3d(0.1, -0.2, 0.3);
  EXPECT_NEAR(cost_of(target, nearer), before, 1e-9 * before);
  // The depths of the model itself leave nothing.
  FitModel::Result result;
  model.evaluate(nullptr, frame.data(), false, false, result);
  for (int i = 0; i < model.point_count(); ++i)
    target.depth[i] = target.depth_scale * result.position(i, 2) + 12;
  EXPECT_NEAR(cost_of(target, frame), 0, 1e-15);
}

TEST(FrameCost, RobustCostIsSoftL1) {
  const Rig rig = test::small_rig(6, 16, 15, false);
  const FitModel model = FitModel(rig, entries(rig)).with_identity(std::vector<double>(3).data());
  FrameTarget target = some_target(model, 16);
  target.prior_weight.setZero();
  target.eye_weight = 0;
  target.depth_weight.assign(target.depth_weight.size(), 0.0);
  Eigen::VectorXd frame = Eigen::VectorXd::Zero(model.frame_size());
  frame[2] = -0.7;
  const double limit = 2.0, focal = 500;
  const FrameCost cost(model, target, limit, focal);
  const double* block = frame.data();
  std::vector<double> residuals(cost.num_residuals());
  ASSERT_TRUE(cost.Evaluate(&block, residuals.data(), nullptr));
  double sum = 0, expected = 0;
  for (const double r : residuals) sum += r * r;
  FitModel::Result result;
  model.evaluate(nullptr, frame.data(), false, false, result);
  const Camera camera = fit_camera(focal, 512, 512);
  for (int i = 0; i < model.point_count(); ++i) {
    const Vec2d pixel = camera.project(result.position.row(i).transpose()) - Vec2d(256, 256);
    const double s = (target.weight[i] * (pixel - target.seen[i])).squaredNorm();
    expected += 2 * limit * limit * (std::sqrt(1 + s / (limit * limit)) - 1);
  }
  EXPECT_NEAR(sum, expected, 1e-9 * expected);
  frame[2] = 0.5;  // behind the camera
  EXPECT_FALSE(cost.Evaluate(&block, residuals.data(), nullptr));
}

// The minimiser over all 3^n choices of free, low and high.
Eigen::VectorXd brute_force(const Eigen::MatrixXd& h, const Eigen::VectorXd& g,
                            const Eigen::VectorXd& low, const Eigen::VectorXd& high) {
  const int n = static_cast<int>(g.size());
  Eigen::VectorXd best;
  double least = 1e300;
  for (int code = 0; code < std::pow(3, n); ++code) {
    Eigen::VectorXd d(n);
    std::vector<int> free;
    for (int i = 0, rest = code; i < n; ++i, rest /= 3) {
      d[i] = rest % 3 == 0 ? 0 : rest % 3 == 1 ? low[i] : high[i];
      if (rest % 3 == 0) free.push_back(i);
    }
    const Eigen::VectorXd pull = h * d + g;
    const auto m = static_cast<Eigen::Index>(free.size());
    Eigen::MatrixXd reduced(m, m);
    Eigen::VectorXd right(m);
    for (Eigen::Index a = 0; a < m; ++a) {
      right[a] = -pull[free[a]];
      for (Eigen::Index b = 0; b < m; ++b) reduced(a, b) = h(free[a], free[b]);
    }
    const Eigen::VectorXd solved = m > 0 ? reduced.ldlt().solve(right).eval() : right;
    for (Eigen::Index a = 0; a < m; ++a) d[free[a]] = solved[a];
    if ((d.array() < low.array() - 1e-9).any() || (d.array() > high.array() + 1e-9).any()) continue;
    const double value = 0.5 * d.dot(h * d) + g.dot(d);
    if (value < least) {
      least = value;
      best = d;
    }
  }
  return best;
}

TEST(Box, QuadraticMatchesEnumeration) {
  for (uint64_t seed = 0; seed < 60; ++seed) {
    const int n = 6;
    Random random(seed);
    Eigen::MatrixXd a(n, n);
    for (int i = 0; i < n; ++i)
      for (int k = 0; k < n; ++k) a(i, k) = random.normal();
    // From well to badly conditioned.
    const Eigen::MatrixXd h =
        a.transpose() * a + std::pow(10.0, -double(seed % 6)) * Eigen::MatrixXd::Identity(n, n);
    const Eigen::VectorXd g = random_vector(n, 2.0, seed + 1000);
    const Eigen::VectorXd low = -random_vector(n, 0.5, seed + 2000).cwiseAbs();
    const Eigen::VectorXd high = random_vector(n, 0.5, seed + 3000).cwiseAbs();
    const Eigen::VectorXd expected = brute_force(h, g, low, high);
    const Eigen::VectorXd found = minimise_quadratic_in_box(h, g, low, high);
    EXPECT_LT((found - expected).norm(), 1e-6) << seed;
  }
}

TEST(Box, GaussNewtonEndsWhereNothingPushesInwards) {
  const Rig rig = test::small_rig(7, 60, 21, false);
  const FitModel model = FitModel(rig, entries(rig)).with_identity(std::vector<double>(3).data());
  FrameTarget target = some_target(model, 22);
  target.depth_weight.assign(target.depth_weight.size(), 0.0);
  // Targets: the projection of a face with expressions outside the limits.
  Eigen::VectorXd truth = Eigen::VectorXd::Zero(model.frame_size());
  truth[2] = -0.7;
  truth.tail(5) << 0.5, -0.6, 1.7, 0.2, -0.1;
  FitModel::Result result;
  model.evaluate(nullptr, truth.data(), false, false, result);
  const Camera camera = fit_camera(500, 512, 512);
  for (int i = 0; i < model.point_count(); ++i)
    target.seen[i] = camera.project(result.position.row(i).transpose()) - Vec2d(256, 256);
  target.prior_mean.setZero();
  target.prior_weight.setConstant(0.05);
  for (int e = 0; e < 5; ++e) {
    target.lower[model.expression_begin() + e] = 0;
    target.upper[model.expression_begin() + e] = 1;
  }
  const FrameCost cost(model, target, 3.0, 500);
  Eigen::VectorXd x = Eigen::VectorXd::Zero(model.frame_size());
  x[2] = -0.6;
  const double value = minimise_in_box(cost, target.lower, target.upper, 60, 1e-13, x);
  std::vector<double> residuals(cost.num_residuals());
  FitModel::Matrix jacobian(cost.num_residuals(), x.size());
  const double* block = x.data();
  double* to = jacobian.data();
  ASSERT_TRUE(cost.Evaluate(&block, residuals.data(), &to));
  const Eigen::Map<Eigen::VectorXd> r(residuals.data(), cost.num_residuals());
  EXPECT_NEAR(value, 0.5 * r.squaredNorm(), 1e-9);
  const Eigen::VectorXd gradient = jacobian.transpose() * r;
  for (Eigen::Index k = 0; k < x.size(); ++k) {
    EXPECT_GE(x[k], target.lower[k]);
    EXPECT_LE(x[k], target.upper[k]);
    if (x[k] <= target.lower[k]) {
      EXPECT_GT(gradient[k], -1e-4) << k;
    } else if (x[k] >= target.upper[k]) {
      EXPECT_LT(gradient[k], 1e-4) << k;
    } else {
      EXPECT_NEAR(gradient[k], 0, 1e-3 * (1 + jacobian.col(k).norm())) << k;
    }
  }
  EXPECT_LE(x[model.expression_begin() + 1], 1e-9);        // held at 0
  EXPECT_GE(x[model.expression_begin() + 2], 1.0 - 1e-9);  // held at 1
}

TEST(Fit, ScoresBecomeExpressionsByName) {
  const Rig rig = test::small_rig(5, 12, 31, false);
  std::vector<float> scores(52, 0.0f);
  scores[25] = 0.7f;  // jawOpen
  scores[9] = 0.4f;   // eyeBlinkLeft
  scores[3] = 0.9f;   // browInnerUp, unsided
  std::vector<bool> matched;
  const auto expression = expression_from_scores(rig, scores, &matched);
  EXPECT_EQ(expression, (std::vector<float>{0.7f, 0.4f, 0.0f, 0.9f, 0.0f}));
  EXPECT_EQ(matched, (std::vector<bool>{true, true, true, true, false}));
  EXPECT_EQ(expression_from_scores(rig, {}), std::vector<float>(5, 0.0f));
}

// A video of the built-in head, as its landmarks would be seen, with noise.
struct Scene {
  Rig rig = builtin_head_rig();
  std::vector<float> identity;
  std::vector<RigPose> poses;
  std::vector<FaceObservation> frames;
  double focal = 1100;
  int width = 640, height = 480;
};

Scene make_scene(int frames, double noise) {
  Scene scene;
  Random random(41);
  const Rig& rig = scene.rig;
  for (int i = 0; i < rig.identity_count; ++i)
    scene.identity.push_back(static_cast<float>(0.7 * random.normal()));
  const RigShape shape = shape_rig(rig, scene.identity);
  const Camera camera = fit_camera(scene.focal, scene.width, scene.height);
  const int neck = rig.joint("neck"), jaw = rig.expression("jawOpen");
  for (int f = 0; f < frames; ++f) {
    RigPose pose = RigPose::rest(rig);
    const double t = 6.28 * f / 40.0;
    pose.translation = {static_cast<float>(0.01 * std::sin(t)), 0.0f,
                        static_cast<float>(-1.05 + 0.02 * std::cos(t))};
    pose.joint_rotation[3 * neck] = static_cast<float>(0.15 * std::sin(0.7 * t));
    pose.joint_rotation[3 * neck + 1] = static_cast<float>(0.4 * std::sin(t));
    if (jaw >= 0) pose.expression[jaw] = static_cast<float>(0.4 + 0.4 * std::sin(3 * t));
    std::vector<float> vertices;
    pose_vertices(shape, pose, vertices);
    const auto points = landmark_positions(rig.mediapipe, rig.mesh.triangles, vertices);
    FaceObservation frame;
    frame.found = f != frames / 2;  // one frame is lost
    frame.landmarks.assign(3 * 478, 0.0f);
    for (size_t l = 0; l < rig.mediapipe.size(); ++l) {
      const Vec3d p = Vec3f(points.data() + 3 * l).cast<double>();
      const Vec2d pixel = camera.project(p);
      float* out = frame.landmarks.data() + 3 * rig.mediapipe.index[l];
      out[0] = static_cast<float>(pixel.x() + noise * random.normal());
      out[1] = static_cast<float>(pixel.y() + noise * random.normal());
      out[2] = static_cast<float>(-(p.z() + 1.0) * scene.focal / 1.05);
    }
    scene.frames.push_back(frame);
    scene.poses.push_back(pose);
  }
  return scene;
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

// Distance between the middles of the inner lips, metres.
double mouth_gap(const Rig& rig, const std::vector<float>& identity, const RigPose& pose) {
  std::vector<float> vertices;
  pose_vertices(shape_rig(rig, identity), pose, vertices);
  const auto points = landmark_positions(rig.mediapipe, rig.mesh.triangles, vertices);
  Vec3f upper = Vec3f::Zero(), lower = Vec3f::Zero();
  for (size_t l = 0; l < rig.mediapipe.size(); ++l) {
    if (rig.mediapipe.index[l] == 13) upper = Vec3f(points.data() + 3 * l);
    if (rig.mediapipe.index[l] == 14) lower = Vec3f(points.data() + 3 * l);
  }
  return static_cast<double>((upper - lower).norm());
}

TEST(Fit, FollowsAKnownHead) {
  const Scene scene = make_scene(60, 0.3);
  ASSERT_GE(scene.rig.mediapipe.size(), 50U);
  FitOptions options;
  options.key_frames = 12;
  const FitResult fit = fit_rig(scene.rig, scene.frames, {}, scene.width, scene.height, options);
  ASSERT_EQ(fit.poses.size(), scene.frames.size());
  EXPECT_EQ(fit.error[30], -1.0) << "a frame without a face has no error";
  EXPECT_EQ(fit.poses[30].expression, fit.poses[29].expression) << "it keeps the last pose";
  std::vector<double> errors, held;
  for (size_t f = 0; f < fit.error.size(); ++f) {
    if (f == 30) continue;
    errors.push_back(fit.error[f]);
    held.push_back(fit.heldout_error[f]);
  }
  EXPECT_LT(median(errors), 0.8);
  EXPECT_LT(median(held), 2.0);
  EXPECT_GT(fit.heldout_points, 5);
  // The head's turn, the sum of root and neck, is the true one.
  const int neck = scene.rig.joint("neck");
  for (const int f : {5, 10, 20, 45}) {
    const auto turn = [&](const RigPose& pose) {
      const float* w = pose.joint_rotation.data();
      const Mat3d root = rotation_of(Vec3d(w[0], w[1], w[2]), nullptr);
      return (root * rotation_of(Vec3d(w[3 * neck], w[3 * neck + 1], w[3 * neck + 2]), nullptr))
          .eval();
    };
    const Mat3d off = turn(fit.poses[f]) * turn(scene.poses[f]).transpose();
    EXPECT_LT(axis_angle_of(off).norm(), 0.06) << f;
    // The mouth is as open as it was, by whatever shapes and joints.
    EXPECT_NEAR(mouth_gap(scene.rig, fit.identity, fit.poses[f]),
                mouth_gap(scene.rig, scene.identity, scene.poses[f]), 0.003)
        << f;
  }
  for (const RigPose& pose : fit.poses)
    for (int e = 0; e < scene.rig.expression_count; ++e) {
      EXPECT_GE(pose.expression[e], scene.rig.expression_low[e]);
      EXPECT_LE(pose.expression[e], scene.rig.expression_high[e]);
    }
}

// The similarity that takes points to points of the plane exactly, from two of each.
PlaneSimilarity similarity_of(const Vec2d& a0, const Vec2d& a1, const Vec2d& b0, const Vec2d& b1) {
  return fit_similarity({a0.x(), a0.y(), a1.x(), a1.y()}, {b0.x(), b0.y(), b1.x(), b1.y()});
}

TEST(Fit, ShouldersFollowTheTorso) {
  // The head turns about a neck that is not where the rig has it.
  Scene scene = make_scene(60, 0.2);
  const Vec3d shift(0, -0.012, -0.018);
  Rig truth = scene.rig;
  const int neck = truth.joint("neck");
  shift_joint(truth, scene.identity, neck, shift);
  const RigShape shape = shape_rig(truth, scene.identity);
  EXPECT_NEAR(
      shape.joints[3 * neck + 2] - shape_rig(scene.rig, scene.identity).joints[3 * neck + 2],
      shift.z(), 1e-6);
  const Camera camera = fit_camera(scene.focal, scene.width, scene.height);
  std::vector<TorsoMotion> torso;
  std::vector<std::vector<Vec2d>> ring(scene.frames.size());
  for (size_t f = 0; f < scene.frames.size(); ++f) {
    std::vector<float> vertices;
    RigPose pose = scene.poses[f];
    pose.joint_rotation[3 * neck] *= 2;
    pose_vertices(shape, pose, vertices);
    const auto points = landmark_positions(truth.mediapipe, truth.mesh.triangles, vertices);
    for (size_t l = 0; l < truth.mediapipe.size(); ++l) {
      const Vec3d p = Vec3f(points.data() + 3 * l).cast<double>();
      const Vec2d pixel = camera.project(p);
      float* out = scene.frames[f].landmarks.data() + 3 * truth.mediapipe.index[l];
      out[0] = static_cast<float>(pixel.x());
      out[1] = static_cast<float>(pixel.y());
      out[2] = static_cast<float>(-(p.z() + 1.0) * scene.focal / 1.05);
    }
    for (const int v : truth.neck_ring)
      ring[f].push_back(camera.project(Vec3f(&vertices[3 * v]).cast<double>()));
    const size_t half = ring[f].size() / 2;
    torso.push_back({true, similarity_of(ring[0][0], ring[0][half], ring[f][0], ring[f][half])});
  }
  FitOptions options;
  options.key_frames = 12;
  const auto worst = [&](const std::vector<TorsoMotion>& motion) {
    const FitResult fit =
        fit_rig(scene.rig, scene.frames, {motion, {}}, scene.width, scene.height, options);
    Rig rig = scene.rig;
    shift_joint(rig, fit.identity, neck, fit.neck_shift);
    const RigShape fitted = shape_rig(rig, fit.identity);
    const Camera seen = fit_camera(fit.focal, scene.width, scene.height);
    // How much the ring moves otherwise than it should, whatever its size.
    double most = 0;
    Vec2d first = Vec2d::Zero();
    for (size_t f = 0; f < scene.frames.size(); ++f) {
      std::vector<float> vertices;
      pose_vertices(fitted, fit.poses[f], vertices);
      Vec2d off = Vec2d::Zero();
      for (size_t k = 0; k < ring[f].size(); ++k)
        off +=
            (seen.project(Vec3f(&vertices[3 * truth.neck_ring[k]]).cast<double>()) - ring[f][k]) /
            static_cast<double>(ring[f].size());
      if (f == 0) first = off;
      if (scene.frames[f].found) most = std::max(most, (off - first).norm());
    }
    return most;
  };
  const double followed = worst(torso), left = worst({});
  EXPECT_GT(left, 6.0);
  EXPECT_LT(followed, 3.5);
}

TEST(Fit, SameBitsTwice) {
  const Scene scene = make_scene(24, 0.3);
  FitOptions options;
  options.key_frames = 6;
  const FitResult a = fit_rig(scene.rig, scene.frames, {}, scene.width, scene.height, options);
  const FitResult b = fit_rig(scene.rig, scene.frames, {}, scene.width, scene.height, options);
  EXPECT_EQ(a.identity, b.identity);
  EXPECT_EQ(a.focal, b.focal);
  for (size_t f = 0; f < a.poses.size(); ++f) {
    EXPECT_EQ(a.poses[f].joint_rotation, b.poses[f].joint_rotation);
    EXPECT_EQ(a.poses[f].expression, b.poses[f].expression);
  }
}

TEST(Fit, RefusesWhatItCannotFit) {
  Scene scene = make_scene(3, 0.0);
  for (FaceObservation& frame : scene.frames) frame.found = false;
  EXPECT_THROW(fit_rig(scene.rig, scene.frames, {}, 640, 480, {}), Error);
  scene = make_scene(3, 0.0);
  scene.rig.mediapipe = {};
  EXPECT_THROW(fit_rig(scene.rig, scene.frames, {}, 640, 480, {}), Error);
}

}  // namespace
}  // namespace effigy
