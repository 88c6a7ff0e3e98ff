#include "effigy/avatar/frame_encoder.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/random.h"
#include "effigy/base/safetensors.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;

// Of the ball rig, with one landmark and two scores, and random numbers everywhere.
FrameEncoder some_encoder(const Rig& rig, size_t codes = 3) {
  FrameEncoder encoder;
  encoder.expression_count = rig.expression_count;
  encoder.joint_count = rig.joint_count();
  encoder.score_count = 2;
  encoder.landmarks = {0};
  Random random(5);
  const auto fill = [&](std::vector<float>& values, size_t count) {
    for (size_t i = 0; i < count; ++i) values.push_back(static_cast<float>(random.normal()));
  };
  fill(encoder.mean, encoder.input_size());
  fill(encoder.projection, codes * encoder.input_size());
  fill(encoder.weights, encoder.pose_size() * codes);
  encoder.limit.assign(codes, 50.0f);
  return encoder;
}

Capture capture_with_landmark(const Path& folder) {
  test::write_tiny_capture(folder);
  Capture capture = read_capture(folder);
  capture.landmark_count = 1;
  capture.score_count = 2;
  Random random(9);
  for (size_t f = 0; f < capture.frames.size(); ++f) {
    const auto& embedding = capture.rig.mediapipe;
    std::vector<float> vertices;
    pose_vertices(shape_rig(capture.rig, capture.identity), capture.poses[f], vertices);
    const auto at = landmark_positions(embedding, capture.rig.mesh.triangles, vertices);
    const Vec2d pixel = capture.camera.project(Vec3f(at.data()).cast<double>());
    capture.landmarks.push_back(static_cast<float>(pixel.x() + 2));
    capture.landmarks.push_back(static_cast<float>(pixel.y() - 1));
    for (int s = 0; s < 2; ++s)
      capture.scores.push_back(static_cast<float>(random.uniform(0.0, 1.0)));
  }
  return capture;
}

// The paper's encoder leaves the head's pose to tracking: figures with another have to say so.
TEST(FrameEncoder, TellsWhetherItCorrectsTheHeadsPose) {
  test::ScratchFolder scratch;
  Capture capture = capture_with_landmark(scratch.path());
  FrameEncoder encoder = some_encoder(capture.rig);
  EXPECT_TRUE(encoder.corrects_head_pose(capture.rig));
  const auto after_expression =
      encoder.weights.begin() +
      static_cast<std::ptrdiff_t>(static_cast<size_t>(encoder.expression_count) *
                                  encoder.code_size());
  std::fill(after_expression, encoder.weights.end(), 0.0f);
  EXPECT_FALSE(encoder.corrects_head_pose(capture.rig));
  encoder.weights.back() = 0.1f;  // of the translation
  EXPECT_TRUE(encoder.corrects_head_pose(capture.rig));
  encoder.weights.back() = 0;
  capture.rig.joint_names.back() = "jaw";
  after_expression[static_cast<std::ptrdiff_t>(3 * (capture.rig.joint_names.size() - 1) *
                                               encoder.code_size())] = 0.1f;
  EXPECT_FALSE(encoder.corrects_head_pose(capture.rig));
}

TEST(FrameEncoder, LooksAtPoseScoresAndLandmarks) {
  test::ScratchFolder scratch;
  const Capture capture = capture_with_landmark(scratch.path());
  const FrameEncoder encoder = some_encoder(capture.rig);
  ASSERT_EQ(encoder.input_size(), 1u + 6 + 3 + 2 + 2);
  const std::vector<float> x = encoder.inputs(capture, 3);
  EXPECT_FLOAT_EQ(x[2], 0.06f);  // joint rotation
  EXPECT_FLOAT_EQ(x[9], -1.0f);  // depth of the translation
  EXPECT_FLOAT_EQ(x[10], capture.scores[6]);
  // Two pixels to the right and one up, at the depth of the ball's front.
  const double metres = (1.0 - 0.1) / capture.camera.fx;
  EXPECT_NEAR(x[12], 2 * metres, 0.2 * metres);
  EXPECT_NEAR(x[13], 1 * metres, 0.2 * metres);
}

TEST(FrameEncoder, LandmarksTurnWithTheHead) {
  test::ScratchFolder scratch;
  Capture capture = capture_with_landmark(scratch.path());
  FrameEncoder encoder = some_encoder(capture.rig);
  const std::vector<float> upright = encoder.inputs(capture, 0);
  // Head and picture turned by the same angle about the line of sight.
  const double angle = 0.7, c = std::cos(angle), s = std::sin(angle);
  RigPose& pose = capture.poses[0];
  pose.joint_rotation = {0, 0, static_cast<float>(angle), 0, 0, 0};
  const Vec3d joint(0, shape_rig(capture.rig, capture.identity).joints[1], 0);
  const double x = capture.landmarks[0] - capture.camera.cx,
               y = capture.landmarks[1] - capture.camera.cy;
  capture.landmarks[0] = static_cast<float>(capture.camera.cx + c * x + s * y);
  capture.landmarks[1] = static_cast<float>(capture.camera.cy - s * x + c * y);
  const std::vector<float> turned = encoder.inputs(capture, 0);
  EXPECT_LT(joint.norm(), 1e-3);  // so that turning moves it nowhere
  EXPECT_NEAR(turned[12], upright[12], 2e-5);
  EXPECT_NEAR(turned[13], upright[13], 2e-5);
}

TEST(FrameEncoder, WhatACaptureLacksSaysNothing) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path());
  const Capture capture = read_capture(scratch.path());
  const FrameEncoder encoder = some_encoder(capture.rig);
  const std::vector<float> x = encoder.inputs(capture, 1);
  for (size_t d = 10; d < 14; ++d) EXPECT_EQ(x[d], encoder.mean[d]);
  EXPECT_EQ(x[2], capture.poses[1].joint_rotation[1]);
}

TEST(FrameEncoder, CodesStayWithinTheirLimits) {
  const Rig rig = test::ball_rig();
  FrameEncoder encoder = some_encoder(rig);
  encoder.limit = {0.5f, 2.0f, 50.0f};
  std::vector<float> x = encoder.mean;
  for (const float v : encoder.code(x)) EXPECT_EQ(v, 0.0f);
  for (float& v : x) v += 1000;
  const std::vector<float> code = encoder.code(x);
  for (size_t k = 0; k < code.size(); ++k) EXPECT_FLOAT_EQ(std::abs(code[k]), encoder.limit[k]);
}

TEST(FrameEncoder, GradientOfTheWeights) {
  const Rig rig = test::ball_rig();
  FrameEncoder encoder = some_encoder(rig);
  std::vector<float> x = encoder.mean;
  for (size_t d = 0; d < x.size(); ++d) x[d] += 0.1f * static_cast<float>(d % 3);
  const std::vector<float> code = encoder.code(x);
  std::vector<float> d_pose;
  for (size_t p = 0; p < encoder.pose_size(); ++p) d_pose.push_back(0.3f * (1 + p % 4) - 0.5f);
  // The loss is the corrected pose times d_pose.
  const auto loss = [&] {
    const RigPose pose = encoder.corrected(RigPose::rest(rig), code);
    double sum = 0;
    size_t p = 0;
    for (const float v : pose.expression) sum += v * d_pose[p++];
    for (const float v : pose.joint_rotation) sum += v * d_pose[p++];
    for (const float v : pose.translation) sum += v * d_pose[p++];
    return sum;
  };
  std::vector<float> gradient(encoder.weights.size(), 0.0f);
  encoder.backward(code, d_pose, gradient);
  for (size_t i = 0; i < gradient.size(); ++i) {
    const float kept = encoder.weights[i];
    encoder.weights[i] = kept + 0.25f;
    const double above = loss();
    encoder.weights[i] = kept - 0.25f;
    const double below = loss();
    encoder.weights[i] = kept;
    EXPECT_NEAR(gradient[i], (above - below) / 0.5, 1e-4) << i;
  }
}

TEST(FrameEncoder, PosesOfACapture) {
  test::ScratchFolder scratch;
  const Capture capture = capture_with_landmark(scratch.path());
  const FrameEncoder encoder = some_encoder(capture.rig);
  const std::vector<RigPose> poses = encoded_poses(encoder, capture, {2, 5});
  ASSERT_EQ(poses.size(), 2u);
  const RigPose expected =
      encoder.corrected(capture.poses[5], encoder.code(encoder.inputs(capture, 5)));
  EXPECT_EQ(poses[1].expression, expected.expression);
  EXPECT_EQ(poses[1].joint_rotation, expected.joint_rotation);
  EXPECT_EQ(poses[1].translation, expected.translation);
  EXPECT_NE(poses[1].translation, capture.poses[5].translation);
}

TEST(FrameEncoder, FileKeepsEverythingAndDamageIsNamed) {
  test::ScratchFolder scratch;
  const Rig rig = test::ball_rig();
  const FrameEncoder encoder = some_encoder(rig);
  const Path path = scratch / "encoder.safetensors";
  write_frame_encoder(path, encoder);
  const FrameEncoder again = read_frame_encoder(path, rig);
  EXPECT_EQ(again.score_count, 2);
  EXPECT_EQ(again.landmarks, encoder.landmarks);
  EXPECT_EQ(again.mean, encoder.mean);
  EXPECT_EQ(again.projection, encoder.projection);
  EXPECT_EQ(again.weights, encoder.weights);
  EXPECT_EQ(again.limit, encoder.limit);

  const auto broken = [&](auto&& change) {
    write_frame_encoder(path, encoder);
    TensorFile file = read_safetensors(path);
    change(file.tensors);
    write_safetensors(path, file);
    return error_of([&] { read_frame_encoder(path, rig); });
  };
  using Tensors = std::map<std::string, Tensor>;
  const auto ints = [](int32_t value) {
    const std::vector<int32_t> values = {value};
    return Tensor::from(std::span<const int32_t>(values), {1});
  };
  EXPECT_TRUE(contains(broken([&](Tensors& t) { t["landmarks"] = ints(7); }), "'landmarks'"));
  EXPECT_TRUE(contains(broken([&](Tensors& t) { t["landmarks"] = ints(-1); }), "'landmarks'"));
  EXPECT_TRUE(contains(broken([&](Tensors& t) { t["scores"] = ints(-3); }), "'scores'"));
  EXPECT_TRUE(contains(broken([&](Tensors& t) { t["scores"] = ints(1 << 30); }), "'scores'"));
  EXPECT_TRUE(contains(broken([&](Tensors& t) { t["scores"] = ints(3); }), "'mean'"));
  EXPECT_TRUE(contains(broken([&](Tensors& t) { t.erase("projection"); }), "'projection'"));
  EXPECT_TRUE(contains(broken([&](Tensors& t) {
                         t["weights"].shape[0] -= 1;
                         t["weights"].bytes.resize(t["weights"].bytes.size() - 12);
                       }),
                       "'weights'"));
  const auto number = [&](const char* name, size_t at, float value) {
    return broken([&](Tensors& t) {
      std::copy_n(reinterpret_cast<const uint8_t*>(&value), 4, &t[name].bytes[4 * at]);
    });
  };
  EXPECT_TRUE(contains(number("limit", 1, -1), "'limit'"));
  EXPECT_TRUE(contains(number("limit", 1, 1e30f), "'limit'"));
  EXPECT_TRUE(contains(number("weights", 4, std::nanf("")), "not finite"));
}

}  // namespace
}  // namespace effigy
