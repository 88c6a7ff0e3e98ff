#include "effigy/head/silhouette.h"

#include <numeric>

#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

// Mean offset of the vertices that may move.
double mean_offset(const std::vector<float>& offsets) {
  double sum = 0;
  int count = 0;
  for (float offset : offsets)
    if (offset != 0) {
      sum += offset;
      ++count;
    }
  return count > 0 ? sum / count : 0;
}

// The pictures show a disc as large as the ball of radius 0.1 m that the rig describes.
Capture disc_capture(const test::ScratchFolder& scratch) {
  test::write_tiny_capture(scratch.path(), 6, 256);
  return read_capture(scratch.path());
}

TEST(Silhouette, ARigThatFitsStaysAsItIs) {
  test::ScratchFolder scratch;
  const Capture capture = disc_capture(scratch);
  const RigShape shape = shape_rig(capture.rig, {});
  EXPECT_NEAR(mean_offset(silhouette_offsets(capture, shape, {0, 1, 2})), 0.0, 0.003);
}

TEST(Silhouette, ATooSmallRigGrowsToTheMatte) {
  test::ScratchFolder scratch;
  const Capture capture = disc_capture(scratch);
  RigShape shape = shape_rig(capture.rig, {});
  for (float& v : shape.rest) v *= 0.85f;  // 15 mm short of the disc's edge
  const auto offsets = silhouette_offsets(capture, shape, {0, 1, 2});
  EXPECT_NEAR(mean_offset(offsets), 0.013, 0.005);
  const std::vector<float> before = shape.rest;
  apply_offsets(capture.rig.mesh, offsets, shape);
  EXPECT_NE(before, shape.rest);
}

TEST(Silhouette, TheFaceDoesNotMove) {
  test::ScratchFolder scratch;
  const Capture capture = disc_capture(scratch);
  RigShape shape = shape_rig(capture.rig, {});
  for (float& v : shape.rest) v *= 0.85f;
  const auto offsets = silhouette_offsets(capture, shape, {0, 1, 2});
  const auto landmark =
      landmark_positions(capture.rig.mediapipe, capture.rig.mesh.triangles, shape.rest);
  for (size_t v = 0; v < offsets.size(); ++v)
    if ((Vec3f(&shape.rest[3 * v]) - Vec3f(landmark.data())).norm() < 0.015f) {
      EXPECT_EQ(offsets[v], 0.0f);
    }
}

}  // namespace
}  // namespace effigy
