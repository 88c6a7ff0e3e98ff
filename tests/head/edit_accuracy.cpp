#include "effigy/head/edit_accuracy.h"

#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

HeadAvatar ball_avatar() {
  HeadAvatar avatar;
  avatar.rig = test::ball_rig(24, 36);
  avatar.shape = shape_rig(avatar.rig, {});
  avatar.surfels = sample_surfels(avatar.rig.mesh, 6000, 1);
  avatar.material = MaterialTexture(512, 512);
  avatar.environment = Cubemap(32, 1.0f);
  avatar.camera = test::small_camera(320);
  return avatar;
}

std::vector<EditView> views(const HeadAvatar& avatar) {
  RigPose pose = RigPose::rest(avatar.rig);
  pose.translation = {0, 0, -1};
  RigPose turned = pose;
  turned.joint_rotation[1] = 0.3f;
  return {{pose, avatar.camera}, {turned, avatar.camera}};
}

TEST(EditAccuracy, SurfelsOnTheSurfaceKeepTheChecker) {
  const HeadAvatar avatar = ball_avatar();
  const EditAccuracy accuracy = measure_edit_accuracy(avatar, views(avatar), 24);
  EXPECT_GE(accuracy.corners, 15);
  EXPECT_LT(accuracy.corner_error_median, 1.0);
  EXPECT_GT(accuracy.edge_width_median, 0.1);
  EXPECT_LT(accuracy.edge_width_median, 4.0);
}

TEST(EditAccuracy, ShiftedSurfelsAreNoticed) {
  HeadAvatar avatar = ball_avatar();
  const EditAccuracy before = measure_edit_accuracy(avatar, views(avatar), 24);
  // Surfels lifted off the surface show their texture in the wrong place from the side.
  for (float& d : avatar.surfels.displacement) d = 0.015f;
  const EditAccuracy after = measure_edit_accuracy(avatar, views(avatar), 24);
  EXPECT_GT(after.corner_error_median, before.corner_error_median + 0.5);
}

}  // namespace
}  // namespace effigy
