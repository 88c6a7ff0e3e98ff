// Mattes: following motion, edges of the picture, the cut at the neck.
#include "effigy/track/matte.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/random.h"
#include "effigy/image/resample.h"

namespace effigy {
namespace {

// A disc of `radius` (share of the side) with a soft edge of `blur` pixels.
Image disc(int side, double cx, double cy, double radius, double blur) {
  Image out(side, side, 1);
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      const double d = radius * side - std::hypot(x + 0.5 - cx * side, y + 0.5 - cy * side);
      *out.at(x, y) = static_cast<float>(std::clamp(d / blur + 0.5, 0.0, 1.0));
    }
  return out;
}

TEST(Similarity, RecoversWhatMadeThePoints) {
  Random random(1);
  std::vector<double> from, to;
  for (int i = 0; i < 20; ++i) {
    const double x = random.uniform(0, 100), y = random.uniform(0, 100);
    from.insert(from.end(), {x, y});
    to.insert(to.end(), {0.9 * x - 0.2 * y + 5, 0.2 * x + 0.9 * y - 3});
  }
  const PlaneSimilarity map = fit_similarity(from, to);
  EXPECT_NEAR(map.a, 0.9, 1e-12);
  EXPECT_NEAR(map.b, 0.2, 1e-12);
  EXPECT_NEAR(map.u, 5, 1e-10);
  EXPECT_NEAR(map.v, -3, 1e-10);
  const PlaneSimilarity same = fit_similarity({}, {});
  EXPECT_EQ(same.a, 1.0);
  const PlaneSimilarity point = fit_similarity({1, 2}, {4, 6});
  EXPECT_NEAR(point.u, 3, 1e-12);
  EXPECT_NEAR(point.v, 4, 1e-12);
}

TEST(Steady, MovesNeighboursAlongWithTheHead) {
  // The head moves by 4 pixels a frame; flicker in the middle frame only.
  const Image before = disc(64, 26.0 / 64, 0.5, 0.25, 3), after = disc(64, 34.0 / 64, 0.5, 0.25, 3);
  const Image truth = disc(64, 30.0 / 64, 0.5, 0.25, 3);
  Image here = truth;
  for (float& value : here.data) value *= 0.6f;
  const PlaneSimilarity to_before{1, 0, -4, 0}, to_after{1, 0, 4, 0};
  const Image steady = steady_matte(here, &before, to_before, &after, to_after);
  EXPECT_NEAR(*steady.at(30, 32), (2 * 0.6 + 2) / 4, 1e-5);
  double error = 0;
  for (size_t i = 0; i < truth.data.size(); ++i)
    error = std::max<double>(error, std::abs(steady.data[i] - 0.8 * truth.data[i]));
  EXPECT_LT(error, 0.02) << "edges must not smear";
  const Image alone = steady_matte(here, nullptr, {}, nullptr, {});
  EXPECT_EQ(alone.data, here.data);
}

TEST(Refine, PutsTheEdgeOnThePicturesEdge) {
  // A red disc on a grey noisy ground; the coarse matte is blurred and 2 % too large.
  const int side = 320;
  const Image truth = disc(side, 0.5, 0.5, 0.3, 1);
  Image8 picture(side, side, 3);
  Random random(3);
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      const double t = *truth.at(x, y), noise = random.uniform(-4, 4);
      picture.at(x, y)[0] = static_cast<uint8_t>(90 + 110 * t + noise);
      picture.at(x, y)[1] = static_cast<uint8_t>(100 - 60 * t + noise);
      picture.at(x, y)[2] = static_cast<uint8_t>(110 - 70 * t + noise);
    }
  const Image coarse = disc(128, 0.5, 0.5, 0.305, 6);
  const Image refined = refine_matte(picture, coarse);
  const Image plain = resize(coarse, side, side);
  ASSERT_EQ(refined.width, side);
  double error = 0, plain_error = 0;
  for (size_t i = 0; i < truth.data.size(); ++i) {
    error += std::abs(refined.data[i] - truth.data[i]);
    plain_error += std::abs(plain.data[i] - truth.data[i]);
    ASSERT_GE(refined.data[i], 0.0f);
    ASSERT_LE(refined.data[i], 1.0f);
  }
  EXPECT_LT(error, 0.45 * plain_error);
  EXPECT_GT(*refined.at(side / 2, side / 2), 0.99f);
  EXPECT_LT(*refined.at(3, 3), 0.01f);
}

TEST(Refine, WorksOnAnySize) {
  for (const auto& [w, h] : {std::pair{1, 1}, std::pair{3, 700}, std::pair{512, 480}}) {
    const Image refined = refine_matte(Image8(w, h, 3, 77), Image(16, 16, 1, 1.0f));
    ASSERT_EQ(refined.width, w);
    ASSERT_EQ(refined.height, h);
    for (const float value : refined.data) ASSERT_NEAR(value, 1.0f, 1e-4);
  }
}

TEST(Head, IsCutBelowTheNeckRing) {
  const Image person(100, 120, 1, 1.0f);
  HeadRegion region;
  for (int i = 0; i < 24; ++i) {
    const double a = 6.283185 * i / 24;
    region.neck_ring.push_back(50 + 20 * std::cos(a));
    region.neck_ring.push_back(80 + 6 * std::sin(a));
  }
  region.head_x = 50;
  region.head_y = 40;
  region.softness = 4;
  const Image8 head = head_matte(person, region);
  EXPECT_EQ(*head.at(50, 40), 255);
  EXPECT_EQ(*head.at(50, 80), 255) << "the front of the ring is its lower half";
  EXPECT_EQ(*head.at(50, 92), 0);
  EXPECT_EQ(*head.at(50, 119), 0);
  EXPECT_EQ(*head.at(5, 110), 0) << "shoulders beside the neck";
  EXPECT_EQ(*head.at(10, 20), 255) << "hair beside the head";
  // Soft, falling from top to bottom.
  int steps = 0;
  for (int y = 81; y < 95; ++y) {
    EXPECT_LE(*head.at(50, y), *head.at(50, y - 1));
    steps += *head.at(50, y) > 0 && *head.at(50, y) < 255;
  }
  EXPECT_GE(steps, 2);
}

TEST(Head, LeavesOutWhatIsNotConnected) {
  Image person(160, 100, 1);
  for (int y = 20; y < 80; ++y)
    for (int x = 20; x < 70; ++x) *person.at(x, y) = 1.0f;
  for (int y = 30; y < 50; ++y)
    for (int x = 120; x < 150; ++x) *person.at(x, y) = 1.0f;
  HeadRegion region;
  region.head_x = 45;
  region.head_y = 50;
  const Image8 head = head_matte(person, region);
  EXPECT_EQ(*head.at(45, 50), 255);
  EXPECT_EQ(*head.at(135, 40), 0);
  // A head the network did not see: better all than nothing.
  region.head_x = 100;
  region.head_y = 90;
  EXPECT_EQ(*head_matte(person, region).at(135, 40), 255);
  region.head_x = -50;
  region.head_y = 1000;
  EXPECT_EQ(*head_matte(person, region).at(45, 50), 255);
}

}  // namespace
}  // namespace effigy
