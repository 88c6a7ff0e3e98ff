#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/people/builtin_head.h"

namespace effigy {
namespace {

// The mean of a channel over a small patch about a UV.
double mean_at(const Image& image, float u, float v, int channel, int radius = 2) {
  const int x = static_cast<int>(u * static_cast<float>(image.width)),
            y = static_cast<int>((1 - v) * static_cast<float>(image.height));
  double sum = 0;
  for (int dy = -radius; dy <= radius; ++dy)
    for (int dx = -radius; dx <= radius; ++dx) sum += image.at(x + dx, y + dy)[channel];
  return sum / ((2 * radius + 1) * (2 * radius + 1));
}

Vec2f uv_of_landmark(const Rig& rig, int landmark) {
  const int f = rig.multipie.triangle[landmark];
  const Vec3f& w = rig.multipie.barycentric[landmark];
  const Vec3i& t = rig.mesh.uv_triangles[f];
  return w[0] * rig.mesh.uvs[t[0]] + w[1] * rig.mesh.uvs[t[1]] + w[2] * rig.mesh.uvs[t[2]];
}

TEST(BuiltinMaterials, AreInRangeEverywhere) {
  const HeadMaterials m = builtin_head_materials(256);
  ASSERT_EQ(m.albedo.channels, 3);
  ASSERT_EQ(m.normal.channels, 3);
  ASSERT_EQ(m.roughness.channels, 1);
  ASSERT_EQ(m.specular.channels, 1);
  for (size_t i = 0; i < 256 * 256; ++i) {
    for (int c = 0; c < 3; ++c) {
      ASSERT_GT(m.albedo.data[3 * i + c], 0.0f);
      ASSERT_LT(m.albedo.data[3 * i + c], 0.95f);
    }
    ASSERT_GE(m.roughness.data[i], 0.05f);
    ASSERT_LE(m.roughness.data[i], 1.0f);
    ASSERT_GE(m.specular.data[i], 0.02f);
    ASSERT_LE(m.specular.data[i], 0.08f);
    const Vec3f n(&m.normal.data[3 * i]);
    ASSERT_NEAR(n.norm(), 1.0f, 1e-5f);
    ASSERT_GT(n.z(), 0.2f);
  }
}

TEST(BuiltinMaterials, PaintIsWhereItBelongs) {
  const Rig rig = builtin_head_rig();
  const HeadMaterials m = builtin_head_materials(512);
  // Lips are redder than the cheek beside the nose wing; brows darker than the forehead above.
  const Vec2f lip = uv_of_landmark(rig, 66), chin = uv_of_landmark(rig, 8);
  auto redness = [&](const Vec2f& uv) {
    return mean_at(m.albedo, uv.x(), uv.y(), 0) / mean_at(m.albedo, uv.x(), uv.y(), 1);
  };
  EXPECT_GT(redness(Vec2f(lip.x(), lip.y() - 0.012f)), 1.15 * redness(chin));
  // The brow lies along its landmarks (the hair begins not far above its thin tail).
  for (int i = 18; i < 26; ++i) {
    const Vec2f brow = uv_of_landmark(rig, i);
    EXPECT_LT(mean_at(m.albedo, brow.x(), brow.y() - 0.004f, 1, 1),
              0.7 * mean_at(m.albedo, brow.x(), brow.y() + 0.04f, 1, 1))
        << i;
  }
  // The crown is hair.
  EXPECT_LT(mean_at(m.albedo, 0.5f, 0.97f, 0), 0.2);
  // Eye: pupil, iris and white from the middle outwards; wet.
  EXPECT_LT(mean_at(m.albedo, 0.918f, 0.918f, 0, 0), 0.03);
  EXPECT_GT(mean_at(m.albedo, 0.918f + 0.035f, 0.918f, 0, 1), 0.4);
  EXPECT_LT(mean_at(m.roughness, 0.918f, 0.918f, 0), 0.2);
}

TEST(BuiltinMaterials, AreTheSameForEveryThreadCount) {
  const int threads = thread_count();
  set_thread_count(1);
  const HeadMaterials one = builtin_head_materials(128);
  set_thread_count(3);
  const HeadMaterials three = builtin_head_materials(128);
  set_thread_count(threads);
  EXPECT_EQ(one.albedo.data, three.albedo.data);
  EXPECT_EQ(one.normal.data, three.normal.data);
}

TEST(BuiltinMaterials, RefusesImpossibleSizes) {
  EXPECT_THROW(builtin_head_materials(0), Error);
  EXPECT_THROW(builtin_head_materials(1 << 20), Error);
}

}  // namespace
}  // namespace effigy
