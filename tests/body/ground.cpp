#include "effigy/body/ground.h"

#include "effigy/base/threads.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

// A ball of radius 0.1 above the plane y = -0.3, seen from the side and above.
struct Scene {
  Mesh mesh = test::ball_rig().mesh;
  RayScene rays{mesh.vertices, mesh.triangles};
  Camera camera = look_at(Vec3d(0, 0.8, 1.2), Vec3d(0, -0.3, 0), 0.8, 48, 48);

  // Value of a plane at the pixel that shows a point.
  float at(const Planes& planes, const Vec3d& point, int c = 0) const {
    const Vec2d p = camera.project(point);
    return planes.plane(c)[static_cast<size_t>(p.y()) * 48 + static_cast<size_t>(p.x())];
  }
};

TEST(GroundShadow, UnderALampOverhead) {
  const Scene s;
  PointLights lamps;
  lamps.lights = {{Vec3f(0, 1, 0), Vec3f(1, 2, 3), true}};
  const Planes share = ground_shadow(s.camera, -0.3f, s.rays, lamps);
  EXPECT_EQ(s.at(share, {0, -0.3, 0}), 0.0f);
  EXPECT_EQ(s.at(share, {0.06, -0.3, 0}), 0.0f);
  EXPECT_EQ(s.at(share, {0.16, -0.3, 0}), 1.0f);
  // The horizon and above: nothing to be shadowed.
  Camera up = look_at(Vec3d(0, 0, 1), Vec3d(0, 1, 0), 0.5, 16, 16);
  for (const float value : ground_shadow(up, -0.3f, s.rays, lamps).data) EXPECT_EQ(value, 1.0f);
}

TEST(GroundShadow, EachLampHidesItsOwnLight) {
  const Scene s;
  PointLights lamps;
  lamps.lights = {{Vec3f(0, 1, 0), Vec3f(1, 0, 1), true},
                  {Vec3f(1, 1, 0).normalized(), Vec3f(0, 1, 1), true}};
  const Planes share = ground_shadow(s.camera, -0.3f, s.rays, lamps);
  EXPECT_EQ(s.at(share, {0, -0.3, 0}, 0), 0.0f);
  EXPECT_EQ(s.at(share, {0, -0.3, 0}, 1), 1.0f);
  const float cosine = std::sqrt(0.5f);
  EXPECT_NEAR(s.at(share, {0, -0.3, 0}, 2), cosine / (1 + cosine), 1e-5f);
}

TEST(GroundShadow, OfALampThatIsNear) {
  const Scene s;
  PointLights lamps;
  lamps.falloff = true;
  // Below the ball: it cannot be in the way.
  lamps.lights = {{Vec3f(0, -0.2f, 0), Vec3f::Ones(), false}};
  EXPECT_EQ(s.at(ground_shadow(s.camera, -0.3f, s.rays, lamps), {0.05, -0.3, 0}), 1.0f);
  // Above it: the shadow is wider than the ball.
  lamps.lights[0].position = Vec3f(0, 0.3f, 0);
  EXPECT_EQ(s.at(ground_shadow(s.camera, -0.3f, s.rays, lamps), {0.14, -0.3, 0}), 0.0f);
}

// Under an even sky the ball hides its solid angle, weighted by the cosine: sin^2 of the half angle
// right below it, (0.1 / 0.3)^2.
TEST(GroundShadow, UnderAnEvenSky) {
  const Scene s;
  const EnvironmentSampler sky(Cubemap(16, 1.0f), EnvironmentDraw::kLuminance);
  const Planes share = ground_shadow(s.camera, -0.3f, s.rays, sky, {4096, 1});
  EXPECT_NEAR(s.at(share, {0, -0.3, 0}), 1 - 1.0f / 9, 0.02f);
  EXPECT_GT(s.at(share, {0.5, -0.3, 0}), 0.97f);
}

TEST(GroundShadow, SameBitsForEveryThreadCount) {
  const Scene s;
  const EnvironmentSampler sky(Cubemap(16, 1.0f), EnvironmentDraw::kLuminance);
  const int before = thread_count();
  set_thread_count(1);
  const Planes one = ground_shadow(s.camera, -0.3f, s.rays, sky, {16, 3});
  set_thread_count(3);
  const Planes three = ground_shadow(s.camera, -0.3f, s.rays, sky, {16, 3});
  set_thread_count(before);
  EXPECT_EQ(one.data, three.data);
}

}  // namespace
}  // namespace effigy
