#include "effigy/geometry/atlas.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/random.h"

namespace effigy {
namespace {

// Appends a flat n x n patch of the given size in metres, its UVs a similarity of it.
void add_patch(Mesh& mesh, int n, float width, float height, float uv_scale, float turn,
               bool mirror, int part) {
  const int base = mesh.vertex_count(), base_uv = static_cast<int>(mesh.uvs.size());
  const Eigen::Rotation2Df rotation(turn);
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) {
      const float x = width * static_cast<float>(i) / static_cast<float>(n);
      const float y = height * static_cast<float>(j) / static_cast<float>(n);
      for (const float c : {x, y, static_cast<float>(part)}) mesh.vertices.push_back(c);
      mesh.uvs.push_back(uv_scale * (rotation * Vec2f(mirror ? -x : x, y)));
    }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i, b = a + 1, c = a + n + 1, d = c + 1;
      for (const Vec3i& f : {Vec3i(a, b, d), Vec3i(a, d, c)}) {
        mesh.triangles.push_back(f + Vec3i::Constant(base));
        mesh.uv_triangles.push_back(f + Vec3i::Constant(base_uv));
        mesh.triangle_part.push_back(part);
      }
    }
}

Mesh patches() {
  Mesh mesh;
  mesh.parts = {"large", "fine", "coarse"};
  add_patch(mesh, 6, 1.0f, 0.9f, 3.0f, 0.3f, false, 0);
  Random random(7);
  for (int k = 0; k < 12; ++k)
    add_patch(mesh, 3, 0.1f + 0.2f * static_cast<float>(random.uniform()),
              0.1f + 0.1f * static_cast<float>(random.uniform()),
              0.2f + static_cast<float>(random.uniform()), static_cast<float>(6 * random.uniform()),
              k % 2 == 1, 1 + k % 2);
  return mesh;
}

double uv_area(const Mesh& mesh, size_t t) {
  const Vec3i& u = mesh.uv_triangles[t];
  const Vec2d a = mesh.uvs[static_cast<size_t>(u[0])].cast<double>();
  const Vec2d e = mesh.uvs[static_cast<size_t>(u[1])].cast<double>() - a;
  const Vec2d g = mesh.uvs[static_cast<size_t>(u[2])].cast<double>() - a;
  return 0.5 * (e.x() * g.y() - e.y() * g.x());
}

double area(const Mesh& mesh, size_t t) {
  const Vec3i& f = mesh.triangles[t];
  return 0.5 * static_cast<double>((mesh.vertex(f[1]) - mesh.vertex(f[0]))
                                       .cross(mesh.vertex(f[2]) - mesh.vertex(f[0]))
                                       .norm());
}

TEST(Atlas, IslandsAreFound) {
  const Mesh mesh = patches();
  const std::vector<int> island = uv_islands(mesh);
  EXPECT_EQ(island.front(), 0);
  EXPECT_EQ(island[6 * 6 * 2 - 1], 0);
  EXPECT_EQ(island[6 * 6 * 2], 1);
  EXPECT_EQ(*std::max_element(island.begin(), island.end()), 12);
}

TEST(Atlas, PackingKeepsProportionsAndLeavesNoOverlaps) {
  Mesh mesh = patches();
  AtlasOptions options;
  options.density = {1.0f, 1.5f, 0.5f};
  pack_atlas(mesh, options);
  for (const Vec2f& uv : mesh.uvs) {
    EXPECT_GE(uv.minCoeff(), 0);
    EXPECT_LE(uv.maxCoeff(), 1);
  }
  const AtlasReport report = inspect_atlas(mesh, 1024);
  EXPECT_EQ(report.overlaps, 0);
  EXPECT_EQ(report.clockwise, 0);
  EXPECT_GT(report.coverage, 0.5);
  // sqrt(UV area / area) per triangle is in the proportions asked for.
  const double unit = std::sqrt(uv_area(mesh, 0) / area(mesh, 0));
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    EXPECT_NEAR(std::sqrt(uv_area(mesh, t) / area(mesh, t)) / unit,
                static_cast<double>(options.density[static_cast<size_t>(mesh.triangle_part[t])]),
                2e-3);
}

TEST(Atlas, IslandsKeepTheirDistance) {
  Mesh mesh = patches();
  AtlasOptions options;
  options.density = {1, 1, 1};
  pack_atlas(mesh, options);
  // No two islands within 3 texels of 1024: grow each by 1 and look for a third that both reach.
  const std::vector<int> island = uv_islands(mesh);
  constexpr int kSize = 1024, kGrow = 1;
  std::vector<int> owner(kSize * kSize, -1);
  int meetings = 0;
  for (int i = 0; i <= *std::max_element(island.begin(), island.end()); ++i) {
    Mesh one = mesh;
    one.triangles.clear();
    one.uv_triangles.clear();
    one.triangle_part.clear();
    for (size_t t = 0; t < island.size(); ++t)
      if (island[t] == i) {
        one.triangles.push_back(mesh.triangles[t]);
        one.uv_triangles.push_back(mesh.uv_triangles[t]);
        one.triangle_part.push_back(mesh.triangle_part[t]);
      }
    const std::vector<uint8_t> covered = uv_coverage(one, kSize, kGrow);
    for (size_t p = 0; p < covered.size(); ++p) {
      if (!covered[p]) continue;
      meetings += owner[p] >= 0;
      owner[p] = i;
    }
  }
  EXPECT_EQ(meetings, 0);
}

TEST(Atlas, PackingUsesConcavities) {
  // A frame with a hole, and a patch that fits into nothing but the hole at a good scale.
  Mesh mesh;
  mesh.parts = {"frame", "patch"};
  add_patch(mesh, 10, 1, 1, 1, 0, false, 0);
  Mesh frame = mesh;
  frame.triangles.clear();
  frame.uv_triangles.clear();
  frame.triangle_part.clear();
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Vec3i& f = mesh.triangles[t];
    const Vec3f center = (mesh.vertex(f[0]) + mesh.vertex(f[1]) + mesh.vertex(f[2])) / 3;
    if ((center - Vec3f(0.5f, 0.5f, 0)).cwiseAbs().maxCoeff() < 0.3f) continue;
    frame.triangles.push_back(f);
    frame.uv_triangles.push_back(mesh.uv_triangles[t]);
    frame.triangle_part.push_back(0);
  }
  add_patch(frame, 2, 0.5f, 0.5f, 1, 0, false, 1);
  AtlasOptions options;
  options.density = {1, 1};
  pack_atlas(frame, options);
  EXPECT_EQ(inspect_atlas(frame, 1024).overlaps, 0);
  EXPECT_GT(inspect_atlas(frame, 1024).coverage, 0.8);
}

TEST(Atlas, WeldingMakesCutIslandsWhole) {
  Mesh mesh;
  mesh.vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};
  mesh.triangles = {Vec3i(0, 1, 2), Vec3i(1, 3, 2)};
  mesh.uvs = {{0, 0}, {1, 0}, {0, 1}, {1, 0}, {1, 1}, {0, 1}};
  mesh.uv_triangles = {Vec3i(0, 1, 2), Vec3i(3, 4, 5)};
  EXPECT_EQ(uv_islands(mesh)[1], 1);
  Mesh parted = mesh;
  weld_uvs(mesh);
  EXPECT_EQ(uv_islands(mesh)[1], 0);
  EXPECT_EQ(mesh.uv_triangles[1], Vec3i(1, 4, 2));
  parted.parts = {"a", "b"};
  parted.triangle_part = {0, 1};
  weld_uvs(parted);  // parts stay apart
  EXPECT_EQ(uv_islands(parted)[1], 1);
  parted.triangle_part = {0, 0};
  parted.uvs[3].x() += 0.1f;  // as do real seams
  parted.uvs[5].y() += 0.1f;
  weld_uvs(parted);
  EXPECT_EQ(uv_islands(parted)[1], 1);
}

TEST(Atlas, InspectionSeesOverlapsAndTurnedTriangles) {
  Mesh mesh;
  mesh.vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  mesh.triangles = {Vec3i(0, 1, 2), Vec3i(0, 1, 2), Vec3i(0, 2, 1)};
  mesh.uvs = {{0, 0}, {1, 0}, {0, 1}};
  mesh.uv_triangles = {Vec3i(0, 1, 2), Vec3i(0, 1, 2), Vec3i(0, 2, 1)};
  const AtlasReport report = inspect_atlas(mesh, 64);
  EXPECT_EQ(report.clockwise, 1);
  EXPECT_NEAR(static_cast<double>(report.overlaps), 64 * 64 / 2, 64);
  EXPECT_NEAR(report.coverage, 0.5, 0.02);
}

TEST(Atlas, RefusesIslandsWithoutArea) {
  Mesh mesh;
  mesh.vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  mesh.triangles = {Vec3i(0, 1, 2)};
  mesh.uvs = {{0, 0}, {1, 0}, {2, 0}};
  mesh.uv_triangles = {Vec3i(0, 1, 2)};
  EXPECT_THROW(pack_atlas(mesh, {}), Error);
  mesh.uvs.clear();
  mesh.uv_triangles.clear();
  EXPECT_THROW(pack_atlas(mesh, {}), Error);
}

}  // namespace
}  // namespace effigy
