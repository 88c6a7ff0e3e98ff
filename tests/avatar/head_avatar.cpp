#include "effigy/avatar/head_avatar.h"

#include "effigy/avatar/renderer.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;

HeadAvatar ball_avatar() {
  HeadAvatar avatar;
  avatar.rig = test::ball_rig();
  avatar.shape = shape_rig(avatar.rig, {});
  avatar.surfels = sample_surfels(avatar.rig.mesh, 600, 1);
  avatar.material = MaterialTexture(32, 32);
  for (size_t i = 0; i < avatar.material.texels.size(); i += 8) {
    avatar.material.texels[i] = 0.6f;
    avatar.material.texels[i + 3] = 0.5f;
    avatar.material.texels[i + 4] = 0.04f;
  }
  avatar.environment = Cubemap(32, 1.0f);
  avatar.camera = test::small_camera(64);
  Track track;
  RigPose pose = RigPose::rest(avatar.rig);
  pose.translation = {0, 0, -1};
  track.numbers = {0, 1};
  track.poses = {pose, pose};
  avatar.tracks["train"] = track;
  avatar.info = {{"provenance", {{"consent", "a test"}}}};
  return avatar;
}

TEST(HeadAvatar, FolderRoundTripDrawsTheSame) {
  test::ScratchFolder scratch;
  const HeadAvatar avatar = ball_avatar();
  write_head_avatar(avatar, scratch / "ball");
  const HeadAvatar back = read_head_avatar(scratch / "ball");
  EXPECT_EQ(back.info["provenance"]["consent"], "a test");
  EXPECT_EQ(back.tracks.at("train").poses.size(), 2u);
  HeadRenderer first(avatar), second(back);
  first.set_pose(avatar.tracks.at("train").poses[0]);
  second.set_pose(back.tracks.at("train").poses[0]);
  const Planes a = first.draw(avatar.camera);
  const Planes& b = second.draw(back.camera);
  double most = 0, brightest = 0;
  for (size_t i = 0; i < a.data.size(); ++i) {
    most = std::max(most, std::abs(1.0 * a.data[i] - b.data[i]));
    brightest = std::max<double>(brightest, a.data[i]);
  }
  EXPECT_LT(most, 0.01);
  EXPECT_GT(brightest, 0.3);
}

TEST(HeadAvatar, TheEncoderGoesWithTheFolder) {
  test::ScratchFolder scratch;
  HeadAvatar avatar = ball_avatar();
  FrameEncoder encoder;
  encoder.expression_count = avatar.rig.expression_count;
  encoder.joint_count = avatar.rig.joint_count();
  encoder.mean.assign(encoder.input_size(), 0.1f);
  encoder.projection.assign(encoder.input_size(), 0.2f);
  encoder.limit = {3};
  encoder.weights.assign(encoder.pose_size(), 0.3f);
  avatar.encoder = encoder;
  write_head_avatar(avatar, scratch / "ball");
  const HeadAvatar back = read_head_avatar(scratch / "ball");
  ASSERT_TRUE(back.encoder);
  EXPECT_EQ(back.encoder->weights, encoder.weights);
  avatar.encoder.reset();
  write_head_avatar(avatar, scratch / "ball");
  EXPECT_FALSE(read_head_avatar(scratch / "ball").encoder);
}

TEST(HeadAvatar, DamageIsNamed) {
  test::ScratchFolder scratch;
  EXPECT_TRUE(
      contains(error_of([&] { read_head_avatar(scratch.path()); }), "avatar.json is missing"));
  write_head_avatar(ball_avatar(), scratch / "ball");
  HeadAvatar bad = ball_avatar();
  bad.surfels.triangle[5] = 1 << 20;
  write_head_avatar(bad, scratch / "bad");
  EXPECT_TRUE(contains(error_of([&] { read_head_avatar(scratch / "bad"); }), "'triangle'"));
  std::filesystem::resize_file(scratch / "ball/splats.safetensors", 100);
  EXPECT_TRUE(
      contains(error_of([&] { read_head_avatar(scratch / "ball"); }), "splats.safetensors"));
}

TEST(HeadAvatar, RetargetMatchesByName) {
  const Rig from = test::ball_rig();
  Rig to = test::ball_rig();
  to.expression_names = {"other"};
  RigPose pose = RigPose::rest(from);
  pose.expression[0] = 0.7f;
  pose.joint_rotation[4] = 0.2f;
  EXPECT_FLOAT_EQ(retarget(pose, from, from).expression[0], 0.7f);
  EXPECT_FLOAT_EQ(retarget(pose, from, to).expression[0], 0.0f);
  EXPECT_FLOAT_EQ(retarget(pose, from, to).joint_rotation[4], 0.2f);
}

TEST(Renderer, BuffersAreDividedByAlpha) {
  const HeadAvatar avatar = ball_avatar();
  HeadRenderer renderer(avatar);
  renderer.set_pose(avatar.tracks.at("train").poses[0]);
  renderer.draw(avatar.camera);
  const Image albedo = buffer_values(renderer.gbuffer(), "albedo");
  EXPECT_NEAR(albedo.at(32, 32)[0], 0.6f, 0.01);
  EXPECT_EQ(*buffer_values(renderer.gbuffer(), "alpha").at(0, 0), 0.0f);
  EXPECT_TRUE(contains(error_of([&] { view_buffer(renderer.gbuffer(), "beauty"); }), "beauty"));
}

}  // namespace
}  // namespace effigy
