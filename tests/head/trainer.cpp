#include "effigy/head/trainer.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/base/safetensors.h"
#include "effigy/base/threads.h"
#include "effigy/head/evaluate.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;

TrainSettings tiny_settings() {
  TrainSettings settings = TrainSettings::from_preset("quick");
  settings.iterations = 40;
  settings.surfels = 400;
  settings.texture_size = 64;
  settings.uv_distortion_start = 5;
  settings.evaluate_every = 0;
  return settings;
}

std::vector<uint8_t> checkpoint_bytes(const HeadTrainer& trainer, const Path& path) {
  trainer.save_checkpoint(path);
  return read_file(path);
}

TEST(Trainer, LossFalls) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path());
  const Capture capture = read_capture(scratch.path());
  HeadTrainer trainer(capture, tiny_settings());
  double first = 0, last = 0;
  for (int i = 0; i < 60; ++i) {
    const LossValues losses = trainer.step();
    (i < 6 ? first : last) += i < 6 || i >= 54 ? losses.at("l1") / 6 : 0;
  }
  EXPECT_LT(last, 0.6 * first);
}

TEST(Trainer, SameSeedSameBits) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch / "c");
  const Capture capture = read_capture(scratch / "c");
  HeadTrainer a(capture, tiny_settings()), b(capture, tiny_settings());
  for (int i = 0; i < 12; ++i) {
    a.step();
    b.step();
  }
  EXPECT_EQ(checkpoint_bytes(a, scratch / "a.safetensors"),
            checkpoint_bytes(b, scratch / "b.safetensors"));
}

TEST(Trainer, ResumeGoesOnBitForBit) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch / "c");
  const Capture capture = read_capture(scratch / "c");
  HeadTrainer whole(capture, tiny_settings()), first(capture, tiny_settings());
  for (int i = 0; i < 20; ++i) whole.step();
  for (int i = 0; i < 9; ++i) first.step();
  first.save_checkpoint(scratch / "half.safetensors");
  HeadTrainer second(capture, tiny_settings());
  second.load_checkpoint(scratch / "half.safetensors");
  EXPECT_EQ(second.iteration(), 9);
  for (int i = 0; i < 11; ++i) second.step();
  EXPECT_EQ(checkpoint_bytes(whole, scratch / "a.safetensors"),
            checkpoint_bytes(second, scratch / "b.safetensors"));
}

TEST(Trainer, CheckpointOfAnotherRunIsRefused) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch / "c");
  test::write_tiny_capture(scratch / "d", 9);
  const Capture capture = read_capture(scratch / "c"), other = read_capture(scratch / "d");
  HeadTrainer trainer(capture, tiny_settings());
  trainer.save_checkpoint(scratch / "x.safetensors");
  HeadTrainer foreign(other, tiny_settings());
  EXPECT_TRUE(contains(error_of([&] { foreign.load_checkpoint(scratch / "x.safetensors"); }),
                       "another capture"));
  TrainSettings changed = tiny_settings();
  changed.rates.opacity *= 2;
  HeadTrainer different(capture, changed);
  EXPECT_TRUE(contains(error_of([&] { different.load_checkpoint(scratch / "x.safetensors"); }),
                       "other settings"));
  EXPECT_TRUE(
      contains(error_of([&] { trainer.load_checkpoint(scratch / "none"); }), "no such file"));
}

TEST(Trainer, WholeRunWritesAnAvatarThatScoresTheSame) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch / "c");
  const Capture capture = read_capture(scratch / "c");
  const Json result = train_head(capture, tiny_settings(), scratch / "a", {false, "yes"});
  EXPECT_EQ(result["iterations"], 40);
  EXPECT_FALSE(std::filesystem::exists(scratch / "a/checkpoint.safetensors"));
  const HeadAvatar avatar = read_head_avatar(scratch / "a");
  EXPECT_EQ(avatar.info["provenance"]["consent"], "yes");
  const auto scores = evaluate_tracker(avatar, capture, capture.test_frames());
  EXPECT_GT(scores.mean().psnr, 15);
  EXPECT_GT(scores.mean().coverage, 0.8);
  const auto refined = evaluate_refined(avatar, capture, capture.test_frames(), 5);
  EXPECT_GE(refined.mean().psnr, scores.mean().psnr - 0.3);
}

TEST(Trainer, WhatAllFramesShareIsTakenBack) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path());
  const Capture capture = read_capture(scratch.path());
  const std::vector<int> frames = capture.train_frames();
  // Mean and spread of the refinements of the x translation.
  const auto refined = [&](bool hold) {
    TrainSettings settings = tiny_settings();
    settings.hold_mean_pose = hold;
    settings.encoder = false;  // it would take its part
    settings.rates.frame_translation = 1e-3;
    HeadTrainer trainer(capture, settings);
    for (size_t i = 0; i < 6 * frames.size() + 1; ++i) trainer.step();
    const std::vector<RigPose> poses = trainer.avatar().tracks["train"].poses;
    double mean = 0, spread = 0;
    for (const int f : frames) {
      const double moved = poses[f].translation[2] - capture.poses[f].translation[2];
      mean += moved / static_cast<double>(frames.size());
      spread += std::abs(moved) / static_cast<double>(frames.size());
    }
    return std::pair(std::abs(mean), spread);
  };
  const auto [held_mean, held_spread] = refined(true);
  const auto [free_mean, free_spread] = refined(false);
  EXPECT_GT(held_spread, 1e-4);
  EXPECT_LT(held_mean, 3e-4);  // one step after the mean was taken back
  EXPECT_GT(free_mean, held_mean);
}

// Tracking that goes wrong in the same way with every turn of the head is put right on frames that
// training has not seen, and not without the encoder.
TEST(Trainer, EncoderLearnsWhatTrackingGetsWrong) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path(), 12);
  Capture capture = read_capture(scratch.path());
  for (size_t f = 0; f < capture.frames.size(); ++f) {
    // Frames in no order of their turn, so that the held-out ones lie among the others.
    const float turn = 0.1f * static_cast<float>((5 * f) % 12) - 0.55f;
    capture.poses[f].joint_rotation[1] = 0.1f * turn;
    capture.poses[f].translation[0] = 0.02f * turn;  // the pictures all show it in the middle
  }
  const auto score = [&](bool encoder) {
    TrainSettings settings = tiny_settings();
    settings.encoder = encoder;
    settings.encoder_head_pose = true;
    settings.rates.encoder = 0.03;
    settings.rates.frame_translation = 0;
    HeadTrainer trainer(capture, settings);
    for (int i = 0; i < 150; ++i) trainer.step();
    const HeadAvatar avatar = trainer.avatar();
    EXPECT_EQ(avatar.encoder.has_value(), encoder);
    double moved = 0;
    const std::vector<int> frames = capture.test_frames();
    const auto scores = evaluate_tracked(avatar, capture, frames);
    for (const RigPose& pose : scores.poses) moved += std::abs(pose.translation[0]);
    return std::pair(scores.mean().psnr, moved);
  };
  const auto [with, left] = score(true);
  const auto [without, wrong] = score(false);
  EXPECT_GT(with, without + 0.5);
  EXPECT_LT(left, 0.6 * wrong);
}

TEST(Trainer, EncoderLeavesTheHeadsPoseToTracking) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path());
  const Capture capture = read_capture(scratch.path());
  HeadTrainer trainer(capture, tiny_settings());
  for (int i = 0; i < 20; ++i) trainer.step();
  const HeadAvatar avatar = trainer.avatar();
  ASSERT_TRUE(avatar.encoder);
  const std::vector<RigPose> poses = encoded_poses(*avatar.encoder, capture, {1});
  EXPECT_NE(poses[0].expression, capture.poses[1].expression);
  EXPECT_EQ(poses[0].joint_rotation, capture.poses[1].joint_rotation);
  EXPECT_EQ(poses[0].translation, capture.poses[1].translation);
}

TEST(Trainer, JointsAndShapesMoveWhatTheyMovedBefore) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path());
  Capture capture = read_capture(scratch.path());
  // Both joints move the upper half, which the expression does not move.
  for (size_t v = 0; 2 * v < capture.rig.weights.size(); ++v)
    if (capture.rig.mesh.vertices[3 * v + 1] > 0)
      capture.rig.weights[2 * v] = capture.rig.weights[2 * v + 1] = 0.5f;
  // Weights, and rows of the expression basis where joints share the skin, that changed where the
  // rig has none, and where it has.
  const size_t vertices = capture.rig.mesh.vertices.size() / 3, joints = capture.rig.joint_count();
  const auto shared = [&](size_t v) {
    const auto row = capture.rig.weights.begin() + static_cast<int64_t>(v * joints);
    return *std::max_element(row, row + static_cast<int64_t>(joints)) < 0.97f;
  };
  const auto changed = [&](bool local) {
    TrainSettings settings = tiny_settings();
    settings.local_rig = local;
    HeadTrainer trainer(capture, settings);
    for (int i = 0; i < 10; ++i) trainer.step();
    const RigShape shape = trainer.avatar().shape;
    std::array<int, 2> without{}, with{};
    for (size_t i = 0; i < shape.weights.size(); ++i)
      if (shape.weights[i] != capture.rig.weights[i])
        ++(capture.rig.weights[i] == 0 ? without : with)[0];
    for (size_t i = 0; i < shape.expression_basis.size(); i += 3) {
      const Vec3f before(&capture.rig.expression_basis[i]), after(&shape.expression_basis[i]);
      if (before != after && shared(i / 3 % vertices))
        ++(before.norm() < 0.9e-4f ? without : with)[1];
    }
    return std::pair(without, with);
  };
  const auto [held_without, held_with] = changed(true);
  EXPECT_EQ(held_without, (std::array<int, 2>{0, 0}));
  EXPECT_GT(held_with[0], 0);
  const auto [free_without, free_with] = changed(false);
  EXPECT_GT(free_without[0], 0);
  EXPECT_GT(free_without[1], 0);
}

TEST(Trainer, OneTrainingFrameIsRefused) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch / "c", 2);
  Capture capture = read_capture(scratch / "c");
  capture.frames[1].test = true;
  EXPECT_TRUE(contains(error_of([&] { HeadTrainer(capture, tiny_settings()); }), "at least 2"));
}

TEST(Settings, PresetsAndOverrides) {
  TrainSettings settings = TrainSettings::from_preset("standard");
  from_json_checked({{"surfels", 5000}, {"rate.opacity", 0.01}}, "test", settings);
  EXPECT_EQ(settings.surfels, 5000);
  EXPECT_DOUBLE_EQ(settings.rates.opacity, 0.01);
  EXPECT_TRUE(contains(error_of([&] {
                         from_json_checked({{"surfel", 1}}, "test", settings);
                       }),
                       "'surfel'"));
  EXPECT_TRUE(contains(error_of([&] {
                         from_json_checked({{"surfels", "many"}}, "test", settings);
                       }),
                       "surfels"));
  EXPECT_TRUE(contains(error_of([&] {
                         from_json_checked({{"iterations", 0}}, "test", settings);
                       }),
                       "iterations"));
  EXPECT_TRUE(contains(error_of([] { TrainSettings::from_preset("fast"); }), "fast"));
  TrainSettings literal = TrainSettings::from_preset("paper");
  literal.make_paper_literal();
  EXPECT_TRUE(literal.splat_normal_frame && !literal.divide_by_alpha &&
              literal.uv_distortion_start == 0);
  // Table 3a's rates of the rig belong to runs of the paper's length.
  TrainSettings quick = TrainSettings::from_preset("quick");
  EXPECT_GT(quick.rates.basis, 1e-6);
  EXPECT_DOUBLE_EQ(TrainSettings::from_preset("paper").rates.basis, 1e-6);
  quick.make_paper_literal();
  EXPECT_DOUBLE_EQ(quick.rates.template_vertices, 1e-5);
  EXPECT_DOUBLE_EQ(quick.rates.weights, 1e-4);
}

}  // namespace
}  // namespace effigy
