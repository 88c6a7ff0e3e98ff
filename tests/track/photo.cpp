// The look of the face: windows, points, and the gain over landmarks that lie.
#include "effigy/track/photo.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/people/builtin_head.h"
#include "effigy/track/fit.h"

namespace effigy {
namespace {

FaceObservation face_at(double x, double y, double tall) {
  FaceObservation face;
  face.found = true;
  face.landmarks.assign(3 * 478, 0.0f);
  for (const auto& [point, dy] : {std::pair(10, -0.5), std::pair(152, 0.5)}) {
    face.landmarks[3 * static_cast<size_t>(point)] = static_cast<float>(x);
    face.landmarks[3 * static_cast<size_t>(point) + 1] = static_cast<float>(y + dy * tall);
  }
  return face;
}

Image8 waves(double brightness, double gain) {
  Image8 picture(400, 300, 3);
  for (int y = 0; y < 300; ++y)
    for (int x = 0; x < 400; ++x)
      for (int c = 0; c < 3; ++c)
        picture.at(x, y)[c] = static_cast<uint8_t>(
            std::lround(brightness + gain * (std::sin(0.25 * x) + std::cos(0.2 * y))));
  return picture;
}

TEST(Photo, ContrastForgetsBrightnessAndHasTheRightSlope) {
  const FaceObservation face = face_at(200, 150, 90);
  const PhotoWindow dark = photo_window(waves(80, 20), face);
  const PhotoWindow bright = photo_window(waves(140, 20), face);
  ASSERT_FALSE(dark.contrast.empty());
  int checked = 0;
  for (double x = 130; x < 270; x += 7.3)
    for (double y = 90; y < 210; y += 7.1) {
      double a = 0, b = 0, right = 0, left = 0, down = 0, up = 0;
      Vec2d slope, unused;
      ASSERT_TRUE(dark.sample({x, y}, &a, &slope));
      ASSERT_TRUE(bright.sample({x, y}, &b, &unused));
      EXPECT_NEAR(a, b, 0.006);
      dark.sample({x + 1, y}, &right, &unused);
      dark.sample({x - 1, y}, &left, &unused);
      dark.sample({x, y + 1}, &down, &unused);
      dark.sample({x, y - 1}, &up, &unused);
      EXPECT_NEAR(slope.x(), 0.5 * (right - left), 0.004);
      EXPECT_NEAR(slope.y(), 0.5 * (down - up), 0.004);
      checked += std::abs(a) > 0.05;
    }
  EXPECT_GT(checked, 50);
}

TEST(Photo, NothingOutsideTheWindowOrWithoutAFace) {
  double value = 0;
  Vec2d slope;
  const PhotoWindow window = photo_window(waves(100, 20), face_at(200, 150, 90));
  EXPECT_FALSE(window.sample({10, 10}, &value, &slope));
  EXPECT_FALSE(window.sample({std::nan(""), 10}, &value, &slope));
  EXPECT_TRUE(photo_window(waves(100, 20), FaceObservation{}).contrast.empty());
}

TEST(Photo, PointsLieOnTheSkinAroundLandmarks) {
  const Rig rig = builtin_head_rig();
  const LandmarkEmbedding points = choose_photo_points(rig, rig.mesh.vertices, 300);
  ASSERT_EQ(points.size(), 300U);
  const auto positions = landmark_positions(points, rig.mesh.triangles, rig.mesh.vertices);
  const auto landmarks = landmark_positions(rig.mediapipe, rig.mesh.triangles, rig.mesh.vertices);
  float farthest = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    EXPECT_NEAR(points.barycentric[i].sum(), 1, 1e-5);
    EXPECT_GE(points.barycentric[i].minCoeff(), -1e-6);
    if (!rig.mesh.triangle_part.empty()) {
      EXPECT_EQ(rig.mesh.parts[rig.mesh.triangle_part[points.triangle[i]]], "skin");
    }
    float nearest = 1;
    for (size_t l = 0; l < landmarks.size(); l += 3)
      nearest = std::min(nearest, (Vec3f(&positions[3 * i]) - Vec3f(&landmarks[l])).norm());
    EXPECT_LT(nearest, 0.1f);
    farthest = std::max(farthest, nearest);
  }
  EXPECT_GT(farthest, 0.06f);  // ears and the front of the scalp too
  const LandmarkEmbedding again = choose_photo_points(rig, rig.mesh.vertices, 300);
  EXPECT_EQ(points.triangle, again.triangle);
}

}  // namespace
}  // namespace effigy
