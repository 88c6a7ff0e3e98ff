// What no frame shows goes back to what is known; what frames show keeps its bits.
#include "effigy/head/unseen.h"

#include "effigy/learn/texture_losses.h"
#include "head/untrained_head.h"

namespace effigy {
namespace {

class Unseen : public test::UntrainedHead {
 protected:
  Unseen() : UntrainedHead(1500) {}
  void SetUp() override {
    make_opaque(7.0f);
    start_ = avatar_.surfels;
  }

  BoundSurfels start_;
};

TEST_F(Unseen, SurfelsBehindTheSurfaceReturnToTheStart) {
  std::vector<float> vertices;
  pose_vertices(avatar_.shape, capture_.poses[0], vertices);
  PosedSurfels posed;
  pose_surfels(avatar_.rig.mesh, vertices, start_, {}, posed);
  // Those at the back have become invisible streaks.
  for (size_t i = 0; i < start_.count(); ++i)
    if (posed.center[3 * i + 2] < -1.02f) {
      avatar_.surfels.log_scale[2 * i] += 2.0f;
      avatar_.surfels.opacity_logit[i] = -3.0f;
    }
  const BoundSurfels trained = avatar_.surfels;
  const size_t restored = restore_unseen(capture_, capture_.train_frames(), start_, avatar_);
  EXPECT_GT(restored, start_.count() / 20);
  size_t behind = 0, back = 0;
  for (size_t i = 0; i < start_.count(); ++i) {
    const float z = posed.center[3 * i + 2];
    const bool front = z > -0.96f;
    if (front) {
      EXPECT_EQ(avatar_.surfels.log_scale[2 * i], trained.log_scale[2 * i]) << i;
    }
    if (z < -1.05f) {
      ++behind;
      back += avatar_.surfels.opacity_logit[i] == start_.opacity_logit[i] &&
              avatar_.surfels.log_scale[2 * i] == start_.log_scale[2 * i];
    }
  }
  ASSERT_GT(behind, 50u);
  EXPECT_GT(static_cast<double>(back), 0.9 * static_cast<double>(behind));
}

TEST_F(Unseen, MaterialsThatNoFrameShowsComeFromTheirSurroundings) {
  // The back of the ball (its u near 0.5) black and rough; the front grey.
  const int size = avatar_.material.width;
  const auto texel = [&](int x, int y) {
    return &avatar_.material.texels[kTexelFloats * (static_cast<size_t>(y) * size + x)];
  };
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x)
      for (int c = 0; c < 5; ++c)
        texel(x, y)[c] = std::abs(x - size / 2) < size / 5 ? 0.001f : 0.4f;
  const std::vector<float> before = avatar_.material.texels;
  restore_unseen(capture_, capture_.train_frames(), start_, avatar_);
  int middle = 0;
  for (int y = size / 3; y < 2 * size / 3; ++y) {
    EXPECT_NEAR(texel(size / 2, y)[0], 0.4f, 0.1f) << y;
    EXPECT_NEAR(texel(size / 2, y)[3], 0.4f, 0.1f) << y;
    for (int x : {3, size - 4}) {
      ++middle;
      EXPECT_EQ(texel(x, y)[0], before[kTexelFloats * (static_cast<size_t>(y) * size + x)]);
    }
  }
  EXPECT_GT(middle, 0);
}

}  // namespace
}  // namespace effigy
