// Cameras: look_at, resizing and cropping keep the picture.
#include <gtest/gtest.h>

#include "effigy/geometry/types.h"

namespace effigy {
namespace {

TEST(Camera, LookAtPutsTheTargetInTheMiddleAndUpAbove) {
  const Vec3d eye(1, 2, 3), target(0.2, 1.8, -0.4);
  const Camera camera = look_at(eye, target, 0.7, 640, 480);
  EXPECT_LT((camera.center() - eye).norm(), 1e-12);
  EXPECT_LT((camera.project(target) - Vec2d(320, 240)).norm(), 1e-9);
  const Mat3d& r = camera.camera_from_world_rotation;
  EXPECT_LT((r * r.transpose() - Mat3d::Identity()).norm(), 1e-12);
  EXPECT_NEAR(r.determinant(), 1, 1e-12);
  EXPECT_NEAR(camera.to_camera(target).z(), (target - eye).norm(), 1e-12);
  // Above in the world is above (smaller v) in the picture, in the same column.
  const Vec2d above = camera.project(target + Vec3d(0, 0.1, 0));
  EXPECT_LT(above.y(), 230);
  EXPECT_NEAR(above.x(), 320, 1e-9);
  // A point half the field of view up touches the picture's top edge.
  const Vec3d up = -r.row(1).transpose(), forward = r.row(2);
  EXPECT_NEAR(camera.project(eye + forward + std::tan(0.35) * up).y(), 0, 1e-9);
}

TEST(Camera, LookingStraightDownIsDefined) {
  const Camera camera = look_at(Vec3d(0, 5, 0), Vec3d(0, 0, 0), 0.5, 100, 100);
  EXPECT_TRUE(camera.camera_from_world_rotation.allFinite());
  EXPECT_NEAR(camera.camera_from_world_rotation.determinant(), 1, 1e-12);
  EXPECT_LT((camera.project(Vec3d(0, 0, 0)) - Vec2d(50, 50)).norm(), 1e-9);
}

TEST(Camera, CroppedAndResizedPicturesShowTheSamePoints) {
  Camera camera = look_at(Vec3d(0, 0, 2), Vec3d(0, 0, 0), 0.6, 640, 480);
  camera.fy *= 1.1;
  camera.cx += 7;
  for (const Vec3d& p : {Vec3d(0.1, 0.2, 0.3), Vec3d(-0.3, 0.05, -0.1)}) {
    const Vec2d pixel = camera.project(p);
    const Vec2d small = camera.resized(320, 120).project(p);
    EXPECT_NEAR(small.x(), pixel.x() / 2, 1e-9);
    EXPECT_NEAR(small.y(), pixel.y() / 4, 1e-9);
    const Camera crop = camera.cropped(100.5, 50, 200, 300, 400, 450);
    EXPECT_EQ(crop.width, 400);
    EXPECT_EQ(crop.height, 450);
    EXPECT_NEAR(crop.project(p).x(), (pixel.x() - 100.5) * 2, 1e-9);
    EXPECT_NEAR(crop.project(p).y(), (pixel.y() - 50) * 1.5, 1e-9);
  }
}

}  // namespace
}  // namespace effigy
