// Posing and its derivative against a second implementation in double precision.
#include <gtest/gtest.h>

#include <chrono>

#include "effigy/base/error.h"
#include "rig/rig_oracle.h"

namespace effigy {
namespace {

double largest_difference(const std::vector<float>& a, const std::vector<double>& b) {
  EXPECT_EQ(a.size(), b.size());
  double largest = 0;
  for (size_t i = 0; i < std::min(a.size(), b.size()); ++i)
    largest = std::max(largest, std::abs(static_cast<double>(a[i]) - b[i]));
  return largest;
}

TEST(Pose, RestIsTheTemplate) {
  const Rig rig = oracle::random_rig(301, 3, 4, true, 1);
  std::vector<float> vertices;
  pose_vertices(shape_rig(rig, {}), RigPose::rest(rig), vertices);
  ASSERT_EQ(vertices.size(), rig.mesh.vertices.size());
  for (size_t i = 0; i < vertices.size(); ++i)
    EXPECT_NEAR(vertices[i], rig.mesh.vertices[i], 1e-7f);
}

TEST(Pose, MatchesTheOracle) {
  for (const bool pose_basis : {false, true})
    for (const int vertices : {3, 255, 256, 257, 700}) {
      const Rig rig = oracle::random_rig(vertices, 3, 9, pose_basis, 2);
      const std::vector<float> identity = {0.3f, -1.2f};  // shorter than identity_count
      const RigShape shape = shape_rig(rig, identity);
      for (size_t i = 0; i < shape.rest.size(); ++i)
        EXPECT_NEAR(shape.rest[i],
                    rig.mesh.vertices[i] + 0.3f * rig.identity_basis[i] -
                        1.2f * rig.identity_basis[shape.rest.size() + i],
                    1e-7f);
      const RigPose pose = oracle::random_pose(rig, 0.8f, 3);
      std::vector<float> posed;
      pose_vertices(shape, pose, posed);
      EXPECT_LT(largest_difference(posed, oracle::pose_vertices(oracle::parameters(shape, pose))),
                1e-6);
    }
}

TEST(Pose, RootRotationTurnsAboutTheRootJoint) {
  Rig rig = oracle::random_rig(50, 0, 0, false, 4);
  const RigShape shape = shape_rig(rig, {});
  RigPose pose = RigPose::rest(rig);
  pose.joint_rotation[1] = static_cast<float>(M_PI) / 2;  // about +y: x -> -z, z -> x
  pose.translation = {1, 2, 3};
  std::vector<float> posed;
  pose_vertices(shape, pose, posed);
  for (size_t v = 0; v < 50; ++v) {
    const float dx = shape.rest[3 * v] - shape.joints[0];
    const float dz = shape.rest[3 * v + 2] - shape.joints[2];
    EXPECT_NEAR(posed[3 * v], shape.joints[0] + dz + 1, 1e-6f);
    EXPECT_NEAR(posed[3 * v + 1], shape.rest[3 * v + 1] + 2, 1e-6f);
    EXPECT_NEAR(posed[3 * v + 2], shape.joints[2] - dx + 3, 1e-6f);
  }
}

TEST(Pose, JointTransformsMoveRigidlySkinnedVertices) {
  Rig rig = oracle::random_rig(20, 0, 0, false, 5);
  for (size_t v = 0; v < 20; ++v)
    for (size_t j = 0; j < 5; ++j) rig.weights[5 * v + j] = v % 5 == j ? 1.0f : 0.0f;
  const RigShape shape = shape_rig(rig, {});
  const RigPose pose = oracle::random_pose(rig, 1, 6);
  std::vector<float> posed;
  pose_vertices(shape, pose, posed);
  const std::vector<float> transforms = joint_transforms(shape, pose);
  ASSERT_EQ(transforms.size(), 60u);
  for (size_t v = 0; v < 20; ++v)
    for (size_t row = 0; row < 3; ++row) {
      const float* m = transforms.data() + 12 * (v % 5) + 4 * row;
      const float* p = shape.rest.data() + 3 * v;
      EXPECT_NEAR(posed[3 * v + row], m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3], 1e-6f);
    }
}

TEST(Pose, LandmarksAreBarycentricPoints) {
  LandmarkEmbedding embedding;
  embedding.index = {4, 9};
  embedding.triangle = {1, 0};
  embedding.barycentric = {Vec3f(0.5f, 0.25f, 0.25f), Vec3f(0, 0, 1)};
  const std::vector<float> vertices = {0, 0, 0, 1, 0, 0, 0, 4, 0, 0, 0, 8};
  const auto points = landmark_positions(embedding, {Vec3i(0, 1, 2), Vec3i(1, 2, 3)}, vertices);
  EXPECT_EQ(points, (std::vector<float>{0.5f, 1, 2, 0, 4, 0}));
}

// The loss is a fixed random weighting of the posed vertices.
struct GradientCase {
  RigShape shape;
  RigPose pose;
  std::vector<float> d_vertices;
  RigGradient gradient;
  oracle::Parameters parameters;

  GradientCase(const Rig& rig, float angle) {
    const std::vector<float> identity(static_cast<size_t>(rig.identity_count), 0.4f);
    shape = shape_rig(rig, identity);
    pose = oracle::random_pose(rig, angle, 8);
    std::mt19937 engine(9);
    std::uniform_real_distribution<float> uniform(-1, 1);
    for (size_t i = 0; i < shape.rest.size(); ++i) d_vertices.push_back(uniform(engine));
    gradient.rest.resize(shape.rest.size());
    gradient.expression_basis.resize(shape.expression_basis.size());
    gradient.pose_basis.resize(shape.pose_basis.size());
    gradient.weights.resize(shape.weights.size());
    gradient.expression.resize(pose.expression.size());
    gradient.joint_rotation.resize(pose.joint_rotation.size());
    pose_vertices_backward(shape, pose, d_vertices, gradient);
    parameters = oracle::parameters(shape, pose);
  }

  double loss() const {
    const std::vector<double> posed = oracle::pose_vertices(parameters);
    double sum = 0;
    for (size_t i = 0; i < posed.size(); ++i) sum += static_cast<double>(d_vertices[i]) * posed[i];
    return sum;
  }

  // Central differences of every `step`-th entry of one parameter array against `analytic`.
  void check(std::vector<double>& values, std::span<const float> analytic, size_t step,
             const char* name) {
    ASSERT_EQ(values.size(), analytic.size()) << name;
    double scale = 1e-3;
    for (const float value : analytic) scale = std::max(scale, std::abs(double{value}));
    for (size_t i = 0; i < values.size(); i += step) {
      const double keep = values[i], h = 1e-5;
      values[i] = keep + h;
      const double above = loss();
      values[i] = keep - h;
      const double below = loss();
      values[i] = keep;
      EXPECT_NEAR((above - below) / (2 * h), analytic[i], 3e-6 * scale) << name << " " << i;
    }
  }
};

class PoseGradient : public ::testing::TestWithParam<std::tuple<bool, float>> {};

TEST_P(PoseGradient, MatchesFiniteDifferences) {
  const auto [pose_basis, angle] = GetParam();
  GradientCase c(oracle::random_rig(290, 2, 6, pose_basis, 7), angle);
  c.check(c.parameters.rest, c.gradient.rest, 13, "rest");
  c.check(c.parameters.expression_basis, c.gradient.expression_basis, 101, "expression_basis");
  c.check(c.parameters.pose_basis, c.gradient.pose_basis, 401, "pose_basis");
  c.check(c.parameters.weights, c.gradient.weights, 17, "weights");
  c.check(c.parameters.expression, c.gradient.expression, 1, "expression");
  c.check(c.parameters.joint_rotation, c.gradient.joint_rotation, 1, "joint_rotation");
  c.check(c.parameters.translation, c.gradient.translation, 1, "translation");
}
// Angle 0 is where a careless axis-angle derivative divides by zero; small angles use a series,
// large ones the closed form.
INSTANTIATE_TEST_SUITE_P(All, PoseGradient,
                         ::testing::Combine(::testing::Bool(),
                                            ::testing::Values(0.0f, 1e-4f, 0.1f, 0.9f, 3.0f)));

TEST(PoseGradientArrays, AddsAndLeavesEmptyArraysAlone) {
  const Rig rig = oracle::random_rig(40, 0, 3, true, 10);
  GradientCase c(rig, 0.5f);
  RigGradient some;
  some.rest.assign(c.gradient.rest.size(), 1.0f);
  some.translation = {1, 1, 1};
  pose_vertices_backward(c.shape, c.pose, c.d_vertices, some);
  EXPECT_TRUE(some.expression.empty());
  EXPECT_TRUE(some.joint_rotation.empty());
  EXPECT_TRUE(some.pose_basis.empty());
  for (size_t i = 0; i < some.rest.size(); ++i)
    EXPECT_NEAR(some.rest[i], 1 + c.gradient.rest[i], 1e-6f);
  for (size_t axis = 0; axis < 3; ++axis)
    EXPECT_NEAR(some.translation[axis], 1 + c.gradient.translation[axis], 1e-6f);
}

// Not a pass/fail speed test: prints the time of one call for a head of usual size.
TEST(PoseSpeed, Report) {
  const Rig rig = oracle::random_rig(5278, 0, 53, false, 11);
  const RigShape shape = shape_rig(rig, {});
  const RigPose pose = oracle::random_pose(rig, 0.3f, 12);
  std::vector<float> posed;
  const std::vector<float> d_vertices(shape.rest.size(), 0.5f);
  RigGradient gradient;
  gradient.rest.resize(shape.rest.size());
  gradient.expression_basis.resize(shape.expression_basis.size());
  gradient.weights.resize(shape.weights.size());
  gradient.expression.resize(pose.expression.size());
  gradient.joint_rotation.resize(pose.joint_rotation.size());
  const auto best_of = [](const auto& body) {
    double best = 1e9;
    for (int run = 0; run < 20; ++run) {
      const auto start = std::chrono::steady_clock::now();
      body();
      const std::chrono::duration<double, std::milli> time =
          std::chrono::steady_clock::now() - start;
      best = std::min(best, time.count());
    }
    return best;
  };
  const double forward = best_of([&] { pose_vertices(shape, pose, posed); });
  const double backward =
      best_of([&] { pose_vertices_backward(shape, pose, d_vertices, gradient); });
  std::printf("5278 vertices, 53 expressions: forward %.3f ms, backward %.3f ms\n", forward,
              backward);
  RecordProperty("forward_ms", std::to_string(forward));
  RecordProperty("backward_ms", std::to_string(backward));
  EXPECT_EQ(posed.size(), shape.rest.size());
}

}  // namespace
}  // namespace effigy
