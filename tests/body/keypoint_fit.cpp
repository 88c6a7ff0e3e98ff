#include "effigy/body/keypoint_fit.h"

#include <cmath>
#include <limits>

#include "effigy/base/error.h"
#include "lit_ball.h"
#include "support.h"

namespace effigy {
namespace {

KeypointTrack track_of(const StageCapture& capture) {
  KeypointTrack track;
  track.frames = capture.frames.size();
  track.body = capture.body_keypoints;
  track.face = capture.face_keypoints;
  return track;
}

TEST(KeypointFit, FindsThePosesAgain) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path(), 5, 24);
  const BodyDriver driver(capture);
  KeypointTrack track = track_of(capture);
  // The whole recording turned about by 150 degrees and moved away: nothing to start from.
  const Mat3f turn = Eigen::AngleAxisf(2.6f, Vec3f(0.1f, 1, 0.2f).normalized()).toRotationMatrix();
  const Vec3f away(0.5f, 1.0f, -2.0f);
  for (auto* points : {&track.body, &track.face})
    for (size_t i = 0; i < points->size(); i += 3) {
      Eigen::Map<Vec3f> point(points->data() + i);
      point = (turn * point + away).eval();
    }
  double left = 1;
  const std::vector<RigPose> poses = fit_keypoints(driver, capture.rig, track, left);
  ASSERT_EQ(poses.size(), 5u);
  EXPECT_LT(left, 1e-4);
  for (size_t f = 0; f < poses.size(); ++f) {
    const BodyMoment found = driver.moment(poses[f]), truth = driver.moment(capture.poses[f]);
    for (size_t v = 0; v < found.vertices.size(); v += 3)
      EXPECT_LT((Vec3f(&found.vertices[v]) - (turn * Vec3f(&truth.vertices[v]) + away)).norm(),
                1e-3f);
    for (size_t i = 0; i < found.body_keypoints.size(); ++i)
      EXPECT_NEAR(found.body_keypoints[i], truth.body_keypoints[i], 5e-4f);
  }
}

TEST(KeypointFit, RefusesBrokenFiles) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path(), 3, 24);
  const BodyDriver driver(capture);
  const KeypointTrack good = track_of(capture);
  const auto body = static_cast<int64_t>(driver.body().size());
  const auto face = static_cast<int64_t>(driver.face().size());
  const Path path = scratch.path() / "points.safetensors";
  const auto write = [&](const KeypointTrack& track, int64_t body_count, const char* rate) {
    TensorFile file;
    file.metadata["frames_per_second"] = rate;
    file.tensors["body_keypoints"] =
        Tensor::from(std::span<const float>(track.body), {3, body_count, 3});
    file.tensors["face_keypoints"] = Tensor::from(std::span<const float>(track.face), {3, face, 3});
    write_safetensors(path, file);
  };
  const auto error = [&](const KeypointTrack& track, int64_t body_count, const char* rate) {
    write(track, body_count, rate);
    return test::error_of([&] { read_keypoint_track(path, driver); });
  };
  write(good, body, "25");
  const auto read = read_keypoint_track(path, driver);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->frames_per_second, 25);
  EXPECT_EQ(read->body, good.body);
  TensorFile poses = read_safetensors(path);
  poses.tensors["joint_rotation"] = poses.tensors["body_keypoints"];
  write_safetensors(path, poses);
  EXPECT_FALSE(read_keypoint_track(path, driver));
  EXPECT_TRUE(test::contains(error(good, body, "often"), "frames_per_second"));
  KeypointTrack broken = good;
  broken.body[4] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(test::contains(error(broken, body, "25"), "body_keypoints"));
  broken = good;
  broken.body.resize(3 * 3 * static_cast<size_t>(body - 1));
  EXPECT_TRUE(test::contains(error(broken, body - 1, "25"), "body_keypoints"));
}

}  // namespace
}  // namespace effigy
