#include "effigy/body/moments.h"

#include "effigy/body/driver.h"
#include "lit_ball.h"
#include "support.h"

namespace effigy {
namespace {

TEST(StageEnvironment, KeepsTheLampsLight) {
  PointLights lamps;
  lamps.center = Vec3f(0.1f, 0.9f, 0);
  lamps.lights = {{Vec3f(1, 2, 0.5f), Vec3f(1, 2, 3), false},
                  {Vec3f(-2, 0.5f, 1), Vec3f(0.5f, 0.5f, 0.5f), false}};
  const Cubemap radiance = stage_environment(lamps, 16);
  Vec3d sum = Vec3d::Zero();
  int lit = 0;
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < 16; ++y)
      for (int x = 0; x < 16; ++x) {
        const float* texel = &radiance.texels[static_cast<size_t>(3 * ((face * 16 + y) * 16 + x))];
        sum += cubemap_solid_angle(x, y, 16) * Vec3f(texel).cast<double>();
        if (texel[0] == 0) continue;
        ++lit;
        const Vec3f d = cubemap_direction(face, x, y, 16);
        const Vec3f to =
            (lamps.lights[texel[2] > texel[0] ? 0 : 1].position - lamps.center).normalized();
        EXPECT_GT(d.dot(to), 0.995f);
      }
  EXPECT_EQ(lit, 2);
  EXPECT_LT((sum - Vec3d(1.5, 2.5, 3.5)).norm(), 1e-5);
}

TEST(StageMoments, LightAndShadowOfEveryFrame) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path(), 4, 24);
  const UvTexels texels = uv_texels(capture.rig.mesh, 16);
  const StageSource source(capture);
  BodyTrainSettings settings;
  StageMoments moments(source, texels, settings);
  const StageMoment full = source.moment(0), part = source.moment(1);
  EXPECT_EQ(moments.light(full)->points.lights.size(), 6u);
  EXPECT_EQ(moments.light(part)->points.lights.size(), 2u);
  const std::vector<float>& own = moments.irradiance(part, part);
  ASSERT_EQ(own.size(), 16u * 16u);
  float least = 1, most = 0;
  for (const float value : own) {
    least = std::min(least, value);
    most = std::max(most, value);
  }
  EXPECT_EQ(least, 0.0f);
  EXPECT_GT(most, 0.45f);
  // In another frame's light it is another picture; asked again, the same one.
  EXPECT_NE(moments.irradiance(part, full), own);
  EXPECT_EQ(&moments.irradiance(part, part), &own);

  // Many lamps are an environment, shared by the frames it lights.
  settings.environment_from = 6;
  StageMoments few(source, texels, settings);
  EXPECT_FALSE(few.light(full)->sh.empty());
  EXPECT_EQ(few.light(full), few.light(source.moment(3)));
  EXPECT_TRUE(few.light(part)->sh.empty());
  // With groups, light and irradiance have as many parts, which together are what there was: one
  // lamp a group, so each sees all or nothing.
  BodyTrainSettings grouped;
  grouped.shadow_groups = 2;
  grouped.shadow_samples = 64;
  StageMoments two(source, texels, grouped);
  const auto lamps = two.light(part);
  ASSERT_EQ(lamps->parts().size(), 2u);
  EXPECT_EQ(lamps->parts()[0].points.lights.size() + lamps->parts()[1].points.lights.size(), 2u);
  const std::vector<float>& both = two.irradiance(part, part);
  ASSERT_EQ(both.size(), 2u * 16u * 16u);
  for (const float value : both) EXPECT_TRUE(value == 0.0f || value == 1.0f) << value;
  EXPECT_EQ(two.mean_irradiance({0, 1}).size(), 16u * 16u);
  grouped.environment_from = 6;
  StageMoments sky(source, texels, grouped);
  ASSERT_EQ(sky.light(full)->parts().size(), 2u);
  EXPECT_FALSE(sky.light(full)->parts()[1].sh.empty());
  EXPECT_EQ(sky.irradiance(full, full).size(), 2u * 16u * 16u);

  settings.shadow = false;
  StageMoments none(source, texels, settings);
  EXPECT_TRUE(none.irradiance(part, part).empty());
}

TEST(BodyDriver, KeypointsFollowFromTheRig) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path(), 5, 24);
  const BodyDriver driver(capture);
  EXPECT_LT(driver.worst(), 1e-5);
  const StageSource source(capture);
  TensorFile file;
  driver.save(file);
  const BodyDriver again(capture.rig, file);
  for (int f = 0; f < 5; ++f) {
    const StageMoment truth = source.moment(f);
    for (const BodyDriver* d : {&driver, &again}) {
      const BodyMoment moment = d->moment(capture.poses[static_cast<size_t>(f)]);
      for (size_t i = 0; i < truth.body_keypoints.size(); ++i)
        EXPECT_NEAR(moment.body_keypoints[i], truth.body_keypoints[i], 1e-5f);
      for (size_t i = 0; i < truth.face_keypoints.size(); ++i)
        EXPECT_NEAR(moment.face_keypoints[i], truth.face_keypoints[i], 1e-5f);
      for (size_t i = 0; i < truth.vertices.size(); i += 31)
        EXPECT_NEAR(moment.vertices[i], truth.vertices[i], 1e-6f);
    }
  }
  file.metadata["keypoint_roots"] = "0 99";
  EXPECT_TRUE(
      test::contains(test::error_of([&] { BodyDriver(capture.rig, file); }), "keypoint_roots"));
}

}  // namespace
}  // namespace effigy
