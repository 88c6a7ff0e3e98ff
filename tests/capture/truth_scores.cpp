#include "effigy/capture/truth_scores.h"

#include <numbers>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"
#include "support.h"

namespace effigy {
namespace {

SurfaceImages surface(int side) {
  SurfaceImages s{Image(side, side, 3), Image(side, side, 1, 0.5f), Image(side, side, 1, 0.04f),
                  Image(side, side, 3), Image(side, side, 1, 1.0f), Image(side, side, 1, 1.0f)};
  for (size_t i = 0; i < s.albedo.data.size(); ++i)
    s.albedo.data[i] = 0.2f + 0.01f * static_cast<float>(i % 30);
  for (size_t i = 2; i < s.normal.data.size(); i += 3) s.normal.data[i] = 2.0f;  // any length
  return s;
}

TEST(SurfaceErrors, OfATruthAgainstItselfAreZero) {
  SurfaceErrors errors;
  EXPECT_TRUE(errors.empty());
  errors.add(surface(8), surface(8));
  EXPECT_FALSE(errors.empty());
  const SurfaceScores s = errors.scores();
  EXPECT_LT(s.albedo_error, 1e-6);
  EXPECT_EQ(s.roughness_error, 0);
  EXPECT_EQ(s.specular_error, 0.0);
  EXPECT_LT(s.normal_degrees, 1e-4);
  EXPECT_EQ(s.depth_error_mm, 0);
}

TEST(SurfaceErrors, KnownErrorsScoreThemselves) {
  const SurfaceImages truth = surface(8);
  SurfaceImages drawn = surface(8);
  for (float& v : drawn.albedo.data) v *= 0.5f;  // the free scale
  for (float& v : drawn.roughness.data) v += 0.1f;
  for (float& v : drawn.depth.data) v -= 0.002f;
  for (size_t i = 0; i < drawn.normal.data.size(); i += 3) {
    drawn.normal.data[i] = std::sin(0.3f);
    drawn.normal.data[i + 2] = std::cos(0.3f);
  }
  drawn.specular = Image();
  // Pixels that either does not cover do not count.
  drawn.alpha.data[5] = 0.5f;
  drawn.roughness.data[5] = 9;
  SurfaceErrors errors;
  errors.add(drawn, truth);
  const SurfaceScores s = errors.scores();
  EXPECT_LT(s.albedo_error, 1e-6);
  EXPECT_NEAR(s.roughness_error, 0.1, 1e-6);
  EXPECT_FALSE(s.specular_error.has_value());
  EXPECT_NEAR(s.normal_degrees, 0.3 * 180 / std::numbers::pi, 1e-3);
  EXPECT_NEAR(s.depth_error_mm, 2, 1e-3);
  EXPECT_THROW(errors.add(surface(7), truth), Error);
}

TEST(ScaleFit, FindsTheScaleThatLightWasMultipliedBy) {
  Image truth(6, 6, 3), drawn(6, 6, 3), brighter(6, 6, 3);
  for (size_t i = 0; i < truth.data.size(); ++i) {
    const float light = 0.01f * static_cast<float>(i % 40);
    truth.data[i] = srgb_from_linear(light);
    drawn.data[i] = srgb_from_linear(1.6f * light);
    brighter.data[i] = srgb_from_linear(0.4f * light);
  }
  ScaleFit fit;
  EXPECT_EQ(fit.scale(), 1.0);
  fit.add(drawn, truth);
  EXPECT_NEAR(fit.scale(), 1 / 1.6, 1e-5);
  ScaleFit other;
  other.add(brighter, truth);
  EXPECT_NEAR(other.scale(), 2.5, 1e-4);
  other.add(fit);  // least squares over both: the brighter one weighs more
  EXPECT_GT(other.scale(), 0.62);
  EXPECT_LT(other.scale(), 0.9);
}

}  // namespace
}  // namespace effigy
