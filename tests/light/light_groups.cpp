#include "effigy/light/light_groups.h"

#include <gtest/gtest.h>

#include <set>

#include "effigy/base/random.h"
#include "effigy/light/builtin_lights.h"

namespace effigy {
namespace {

Vec3f random_direction(Random& random) {
  return Vec3d(random.normal(), random.normal(), random.normal()).normalized().cast<float>();
}

TEST(LightGroups, NearDirectionsShareAGroup) {
  // Four bundles at the corners of a tetrahedron, mixed.
  const Vec3f corners[4] = {Vec3f(1, 1, 1).normalized(), Vec3f(1, -1, -1).normalized(),
                            Vec3f(-1, 1, -1).normalized(), Vec3f(-1, -1, 1).normalized()};
  Random random(3, 1);
  std::vector<Vec3f> directions;
  std::vector<float> weights;
  for (int i = 0; i < 40; ++i) {
    directions.push_back((corners[i % 4] + 0.2f * random_direction(random)).normalized());
    weights.push_back(static_cast<float>(0.5 + random.uniform()));
  }
  const std::vector<int> group = group_directions(directions, weights, 4);
  for (size_t i = 0; i < 40; ++i) EXPECT_EQ(group[i], group[i % 4]);
  EXPECT_EQ(std::set<int>(group.begin(), group.end()), (std::set<int>{0, 1, 2, 3}));
  EXPECT_EQ(group, group_directions(directions, weights, 4));
  for (const int one : group_directions(directions, weights, 1)) EXPECT_EQ(one, 0);
  // No more groups than there are directions that give light.
  const std::vector<Vec3f> few = {corners[0], corners[1], corners[0]};
  const std::vector<int> of_few = group_directions(few, std::vector<float>{1, 2, 1}, 8);
  EXPECT_EQ(of_few, (std::vector<int>{0, 1, 0}));
  const std::vector<int> dark = group_directions(few, std::vector<float>{0, 0, 0}, 8);
  EXPECT_EQ(dark, (std::vector<int>{0, 0, 0}));
}

TEST(LightGroups, PointsAreKept) {
  PointLights points;
  points.falloff = true;
  points.center = Vec3f(0, 1, 0);
  Random random(4, 1);
  for (int i = 0; i < 17; ++i)
    points.lights.push_back({points.center + 2 * random_direction(random),
                             Vec3f::Constant(static_cast<float>(1 + i)), i % 5 == 0});
  const std::vector<PointLights> parts = group_points(points, 5);
  ASSERT_EQ(parts.size(), 5u);
  std::multiset<float> before, after;
  for (const PointLight& light : points.lights) before.insert(light.intensity.x());
  for (const PointLights& part : parts) {
    EXPECT_FALSE(part.lights.empty());
    EXPECT_TRUE(part.falloff);
    EXPECT_EQ(part.center, points.center);
    for (const PointLight& light : part.lights) after.insert(light.intensity.x());
  }
  EXPECT_EQ(before, after);
  EXPECT_EQ(group_points({}, 4).size(), 1u);
}

TEST(LightGroups, EnvironmentsAreCutUp) {
  const Cubemap sky = cubemap_from_equirectangular(builtin_light("sunset"), 16);
  const std::vector<Cubemap> parts = group_environment(sky, 4);
  ASSERT_EQ(parts.size(), 4u);
  size_t brightest = 0;
  for (size_t i = 0; i < sky.texels.size(); i += 3) {
    int owners = 0;
    for (size_t c = 0; c < 3; ++c) {
      float sum = 0;
      for (const Cubemap& part : parts) sum += part.texels[i + c];
      EXPECT_EQ(sum, sky.texels[i + c]);
    }
    for (const Cubemap& part : parts) owners += part.texels[i] > 0;
    EXPECT_EQ(owners, 1);
    if (sky.texels[i] > sky.texels[brightest]) brightest = i;
  }
  // The sun's group holds most of the light and little of the sky.
  for (const Cubemap& part : parts) {
    if (part.texels[brightest] == 0) continue;
    size_t texels = 0;
    for (size_t i = 0; i < part.texels.size(); i += 3) texels += part.texels[i] > 0;
    EXPECT_LT(texels, part.texels.size() / 3 / 2);
  }
}

}  // namespace
}  // namespace effigy
