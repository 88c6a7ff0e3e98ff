// Holes in textures are filled from what is near on the surface.
#include "effigy/head/surface_fill.h"

#include "support.h"

namespace effigy {
namespace {

constexpr int kSize = 64;

// Two strips of 0.1 x 0.2 m that are neighbours on the surface, with the seam at x = 0, and lie at
// opposite ends of the atlas; `parts`: each its own part.
Mesh two_strips(bool parts) {
  Mesh mesh;
  mesh.parts = parts ? std::vector<std::string>{"left", "right"} : std::vector<std::string>{"skin"};
  for (int strip = 0; strip < 2; ++strip) {
    const float x = strip == 0 ? -0.1f : 0.0f, u = strip == 0 ? 0.55f : 0.05f;
    const int first = mesh.vertex_count();
    for (int corner = 0; corner < 4; ++corner) {
      const auto right = static_cast<float>(corner % 2), up = static_cast<float>(corner / 2);
      mesh.vertices.insert(mesh.vertices.end(), {x + 0.1f * right, 0.2f * up, 0.0f});
      mesh.uvs.emplace_back(u + 0.4f * right, 0.1f + 0.8f * up);
    }
    for (const Vec3i& t : {Vec3i(0, 1, 3), Vec3i(0, 3, 2)}) {
      mesh.triangles.push_back(t + Vec3i::Constant(first));
      mesh.uv_triangles.push_back(t + Vec3i::Constant(first));
      mesh.triangle_part.push_back(parts ? strip : 0);
    }
  }
  return mesh;
}

// The texel that shows place (x, y) of the strips.
size_t texel_at(float x, float y) {
  const float u = x < 0 ? 0.55f + 4 * (x + 0.1f) : 0.05f + 4 * x, v = 0.1f + 4 * y;
  return static_cast<size_t>(v * kSize) * kSize + static_cast<size_t>(u * kSize);
}

TEST(FillOverSurface, AnEvenColourHasNoHoles) {
  std::vector<float> values(2 * kSize * kSize, -5.0f), weights(kSize * kSize, 0.0f);
  for (size_t i = 0; i < weights.size(); i += 37) {
    weights[i] = 2.0f;
    values[2 * i] = 0.25f;
    values[2 * i + 1] = 0.75f;
  }
  fill_over_surface(two_strips(false), kSize, 2, 1.0f, weights, values);
  const auto covered = uv_coverage(two_strips(false), kSize);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      if (!covered[(kSize - 1 - y) * kSize + x]) continue;
      const size_t i = static_cast<size_t>(y) * kSize + x;
      EXPECT_NEAR(values[2 * i], 0.25f, 1e-5f) << i;
      EXPECT_NEAR(values[2 * i + 1], 0.75f, 1e-5f) << i;
    }
}

TEST(FillOverSurface, ColoursCrossTheSeamsOfTheAtlasButNotParts) {
  // Known: 0 in the left third of the left strip, 1 in the right third of the right one.
  std::vector<float> start(kSize * kSize, 99.0f), weights(kSize * kSize, 0.0f);
  for (float y = 0.001f; y < 0.2f; y += 0.001f)
    for (float x = -0.099f; x < 0.1f; x += 0.001f) {
      if (std::abs(x) < 0.07f) continue;
      start[texel_at(x, y)] = x < 0 ? 0.0f : 1.0f;
      weights[texel_at(x, y)] = 1.0f;
    }
  std::vector<float> values = start;
  fill_over_surface(two_strips(false), kSize, 1, 1.0f, weights, values);
  float before = -1;
  for (float x = -0.095f; x < 0.1f; x += 0.01f) {
    const float value = values[texel_at(x, 0.1f)];
    EXPECT_GE(value, before - 0.08f) << x;  // rises from one side to the other
    before = value;
  }
  EXPECT_EQ(values[texel_at(-0.08f, 0.1f)], 0.0f);
  EXPECT_EQ(values[texel_at(0.08f, 0.1f)], 1.0f);
  EXPECT_NEAR(values[texel_at(-0.002f, 0.1f)], values[texel_at(0.002f, 0.1f)], 0.1f);
  EXPECT_NEAR(values[texel_at(0.002f, 0.1f)], 0.5f, 0.2f);

  values = start;
  fill_over_surface(two_strips(true), kSize, 1, 1.0f, weights, values);
  EXPECT_NEAR(values[texel_at(-0.002f, 0.1f)], 0.0f, 1e-5f);
  EXPECT_NEAR(values[texel_at(0.002f, 0.1f)], 1.0f, 1e-5f);
}

TEST(FillOverSurface, ATexelSeenALittleTakesALittleAndNothingKnownChangesNothing) {
  std::vector<float> values(kSize * kSize, 1.0f), weights(kSize * kSize, 1.0f);
  const size_t one = texel_at(0.05f, 0.1f);
  values[one] = 0.0f;
  weights[one] = 0.25f;
  fill_over_surface(two_strips(false), kSize, 1, 1.0f, weights, values);
  EXPECT_GT(values[one], 0.5f);
  EXPECT_LT(values[one], 0.8f);

  std::fill(weights.begin(), weights.end(), 0.0f);
  const std::vector<float> before = values;
  fill_over_surface(two_strips(false), kSize, 1, 1.0f, weights, values);
  EXPECT_EQ(values, before);
}

}  // namespace
}  // namespace effigy
