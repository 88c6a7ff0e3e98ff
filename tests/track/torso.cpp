// The torso's motion in pictures that were moved by known similarities.
#include "effigy/track/torso.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/random.h"
#include "effigy/image/resample.h"
#include "effigy/track/mediapipe.h"

namespace effigy {
namespace {

constexpr int kSide = 400;

// Blobs of light and dark, as smooth as cloth seen by a camera.
Image texture(uint64_t seed) {
  Random random(seed);
  Image image(kSide, kSide, 1);
  for (float& v : image.data) v = static_cast<float>(random.uniform(0.0, 1.0));
  image = gaussian_blur(image, 5.0);
  for (float& v : image.data) v = std::clamp(0.5f + 6.0f * (v - 0.5f), 0.0f, 1.0f);
  return image;
}

Vec2d apply(const PlaneSimilarity& m, const Vec2d& p) {
  return {m.a * p.x() - m.b * p.y() + m.u, m.b * p.x() + m.a * p.y() + m.v};
}

// The texture moved by `motion`, times `gain`; above row 180 stands another picture, the head.
Image8 picture(const Image& torso, const Image& head, const PlaneSimilarity& motion, double gain,
               bool hand) {
  Image8 out(kSide, kSide, 3);
  const double length = motion.a * motion.a + motion.b * motion.b;
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x) {
      const double dx = x + 0.5 - motion.u, dy = y + 0.5 - motion.v;
      float value = 0;
      if (y < 180)
        sample_bilinear(head, x + 0.5, y + 0.5, &value);
      else
        sample_bilinear(torso, (motion.a * dx + motion.b * dy) / length,
                        (motion.a * dy - motion.b * dx) / length, &value);
      if (hand && x > 220 && x < 300 && y > 260 && y < 340) value = 0.9f;
      for (int c = 0; c < 3; ++c)
        *(out.at(x, y) + c) = static_cast<uint8_t>(std::lround(255 * gain * value));
    }
  return out;
}

FaceObservation face() {
  FaceObservation face;
  face.found = true;
  face.landmarks.assign(3 * 478, 0.0f);
  const auto put = [&](int point, float x, float y) {
    face.landmarks[3 * static_cast<size_t>(point)] = x;
    face.landmarks[3 * static_cast<size_t>(point) + 1] = y;
  };
  put(10, 200, 50);
  put(152, 200, 180);
  put(mediapipe::kOuterCornerRight, 165, 100);
  put(mediapipe::kOuterCornerLeft, 235, 100);
  return face;
}

TEST(Torso, FollowsAKnownMotion) {
  const Image torso = texture(1);
  TorsoFollower follower(nullptr);
  for (int f = 0; f < 30; ++f) {
    const double t = f / 30.0, turn = 0.06 * std::sin(5 * t), size = 1 + 0.05 * std::sin(3 * t);
    PlaneSimilarity motion{size * std::cos(turn), size * std::sin(turn), 0, 0};
    // About the middle of the torso, which itself moves by 15 pixels.
    const Vec2d middle(200, 300), moved = apply(motion, middle);
    motion.u = middle.x() - moved.x() + 15 * std::sin(4 * t);
    motion.v = middle.y() - moved.y() + 6 * std::sin(6 * t);
    const TorsoMotion seen =
        follower.follow(picture(torso, texture(100 + f), motion, 1 - 0.2 * t, f > 10), face());
    ASSERT_TRUE(seen.found) << f;
    for (const Vec2d& p : {Vec2d(120, 260), Vec2d(200, 320), Vec2d(300, 300)})
      EXPECT_LT((apply(seen.here_from_start, p) - apply(motion, p)).norm(), 0.4) << f;
  }
}

TEST(Torso, SaysWhenThereIsNothingToFollow) {
  TorsoFollower follower(nullptr);
  Image8 blank(kSide, kSide, 3);
  EXPECT_FALSE(follower.follow(blank, face()).found);
  EXPECT_FALSE(follower.follow(blank, FaceObservation{}).found);
  // Another picture in its place is not the torso moved.
  const Image torso = texture(1), other = texture(2);
  EXPECT_TRUE(follower.follow(picture(torso, torso, {}, 1, false), face()).found);
  EXPECT_FALSE(follower.follow(picture(other, other, {}, 1, false), face()).found);
  EXPECT_TRUE(follower.follow(picture(torso, torso, {}, 1, false), face()).found);
}

}  // namespace
}  // namespace effigy
