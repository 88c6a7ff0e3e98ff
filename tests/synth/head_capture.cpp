// Captures of the built-in head: what is written can be read, and shows what it says.

#include "effigy/synth/head_capture.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/capture/capture.h"
#include "effigy/image/files.h"
#include "support.h"

namespace effigy {
namespace {

SynthHeadOptions tiny() {
  SynthHeadOptions options;
  options.frames = 4;
  options.size = 64;
  options.texture_size = 256;
  options.relight_frames = 1;
  return options;
}

TEST(SynthHead, TinyCaptureReadsBackWithItsTruth) {
  const test::ScratchFolder scratch;
  synth_head_capture(tiny(), scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  ASSERT_EQ(capture.frames.size(), 4u);
  EXPECT_EQ(capture.rig.kind, "builtin");
  EXPECT_EQ(capture.test_frames().size(), 1u);
  for (int f = 0; f < 4; ++f) {
    const Image8 image = capture.load_image(f), mask = capture.load_mask(f);
    double covered = 0, soft = 0, outside = 0;
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) {
        const int m = mask.at(x, y)[0];
        covered += m / 255.0;
        soft += m > 0 && m < 255 ? 1 : 0;
        if (m == 0) outside = std::max<double>(outside, image.at(x, y)[1]);
      }
    // A head fills a quarter to three quarters of the frame; its rim is anti-aliased; the rest is
    // black.
    EXPECT_GT(covered / (64 * 64), 0.2);
    EXPECT_LT(covered / (64 * 64), 0.75);
    EXPECT_GT(soft, 20);
    EXPECT_EQ(outside, 0);
    EXPECT_FALSE(capture.frames[f].albedo.empty());
    EXPECT_EQ(read_image8(capture.folder / capture.frames[f].albedo).width, 64);
  }
}

// The stored parameters and camera put the vertices where the mask is.
TEST(SynthHead, TrueParametersProjectOntoTheMask) {
  const test::ScratchFolder scratch;
  synth_head_capture(tiny(), scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  const RigShape shape = shape_rig(capture.rig, capture.identity);
  for (int f = 0; f < 4; ++f) {
    std::vector<float> vertices;
    pose_vertices(shape, capture.poses[f], vertices);
    const Image8 mask = capture.load_mask(f);
    int inside = 0, all = 0;
    double left = 64, right = 0;
    for (size_t v = 0; v + 2 < vertices.size(); v += 3) {
      const Vec2d p = capture.camera.project(Vec3d(vertices[v], vertices[v + 1], vertices[v + 2]));
      left = std::min(left, p.x());
      right = std::max(right, p.x());
      const int x = static_cast<int>(std::floor(p.x())), y = static_cast<int>(std::floor(p.y()));
      if (x < 1 || y < 1 || x >= 63 || y >= 63) continue;
      ++all;
      // On the silhouette a pixel may round to nothing; its neighbour then shows the head.
      bool covered = false;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) covered |= mask.at(x + dx, y + dy)[0] > 0;
      inside += covered ? 1 : 0;
    }
    ASSERT_GT(all, 3000);
    EXPECT_EQ(inside, all);
    double first = 64, last = 0;
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x)
        if (mask.at(x, y)[0] > 127) {
          first = std::min<double>(first, x);
          last = std::max<double>(last, x + 1);
        }
    EXPECT_NEAR(first, std::max(left, 0.0), 1.2);
    EXPECT_NEAR(last, std::min(right, 64.0), 1.2);
  }
}

TEST(SynthHead, RelightingTruthIsListedAndDiffers) {
  const test::ScratchFolder scratch;
  synth_head_capture(tiny(), scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  const Json relight = capture.extra.at("relight");
  ASSERT_EQ(relight.size(), 2u);
  const int held_out = capture.test_frames().front();
  const Image8 original = capture.load_image(held_out);
  for (const auto& [name, entry] : relight.items()) {
    const Image light = read_image(capture.folder / entry.at("light").get<std::string>());
    EXPECT_EQ(light.width, 2 * light.height) << name;
    const auto& images = entry.at("images");
    const auto number = std::to_string(capture.frames[held_out].number);
    ASSERT_TRUE(images.contains(number)) << name;
    const Image8 relit = read_image8(capture.folder / images.at(number).get<std::string>());
    ASSERT_EQ(relit.data.size(), original.data.size());
    double difference = 0;
    for (size_t i = 0; i < relit.data.size(); ++i)
      difference += std::abs(relit.data[i] - original.data[i]);
    EXPECT_GT(difference / static_cast<double>(relit.data.size()), 1.0) << name;
  }
}

TEST(SynthHead, SameSeedSamePicturesOtherSeedOtherPoses) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.relight.clear();
  synth_head_capture(options, scratch / "a");
  synth_head_capture(options, scratch / "b");
  const Capture a = read_capture(scratch / "a"), b = read_capture(scratch / "b");
  for (int f = 0; f < 4; ++f) {
    EXPECT_EQ(a.load_image(f).data, b.load_image(f).data);
    EXPECT_EQ(a.poses[f].expression, b.poses[f].expression);
  }
  const RigPose other = performance_pose(a.rig, 1.0, 99), same = performance_pose(a.rig, 1.0, 1);
  EXPECT_NE(other.expression, same.expression);
}

// Thirty frames a second apart by a thirtieth: no jumps beyond a blink's.
TEST(SynthHead, PerformanceIsSmoothAndLively) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.relight.clear();
  synth_head_capture(options, scratch / "a");
  const Rig rig = read_capture(scratch / "a").rig;
  const int blink = rig.expression("eyeBlink_L"), jaw = rig.expression("jawOpen");
  ASSERT_GE(blink, 0);
  ASSERT_GE(jaw, 0);
  float most_yaw = 0, most_jaw = 0, most_blink = 0, most_step = 0;
  RigPose previous = performance_pose(rig, 0, 1);
  for (int i = 1; i < 300; ++i) {
    const RigPose pose = performance_pose(rig, i / 30.0, 1);
    for (size_t k = 0; k < pose.joint_rotation.size(); ++k) {
      if (k >= 9) continue;  // gaze jumps, as it does
      most_step =
          std::max(most_step, std::abs(pose.joint_rotation[k] - previous.joint_rotation[k]));
    }
    most_yaw = std::max(most_yaw, std::abs(pose.joint_rotation[1]));
    most_jaw = std::max(most_jaw, pose.expression[jaw]);
    most_blink = std::max(most_blink, pose.expression[blink]);
    previous = pose;
  }
  EXPECT_LT(most_step, 0.12f);
  EXPECT_GT(most_yaw, 0.2f);
  EXPECT_LT(most_yaw, 0.7f);
  EXPECT_GT(most_jaw, 0.2f);
  EXPECT_GT(most_blink, 0.6f);
}

TEST(SynthHead, RefusesNonsense) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.frames = 0;
  EXPECT_THROW(synth_head_capture(options, scratch / "x"), Error);
  options = tiny();
  options.light = "no-such-light";
  EXPECT_THROW(synth_head_capture(options, scratch / "x"), Error);
  EXPECT_FALSE(std::filesystem::exists(scratch / "x"));
}

}  // namespace
}  // namespace effigy
