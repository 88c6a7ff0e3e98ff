#include "effigy/geometry/decimate.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <set>

#include "effigy/base/error.h"

namespace effigy {
namespace {

// n x n squares over [0, 1]^2 in the plane z = height(x, y); UVs are x and y.
template <typename Height>
Mesh grid(int n, Height height) {
  Mesh mesh;
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) {
      const float x = static_cast<float>(i) / static_cast<float>(n);
      const float y = static_cast<float>(j) / static_cast<float>(n);
      for (const float c : {x, y, static_cast<float>(height(x, y))}) mesh.vertices.push_back(c);
      mesh.uvs.emplace_back(x, y);
    }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i, b = a + 1, c = a + n + 1, d = c + 1;
      for (const Vec3i& f : {Vec3i(a, b, d), Vec3i(a, d, c)}) {
        mesh.triangles.push_back(f);
        mesh.uv_triangles.push_back(f);
      }
    }
  return mesh;
}

Mesh torus(int n, int m) {
  Mesh mesh;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) {
      const double u = 2 * std::numbers::pi * i / n, v = 2 * std::numbers::pi * j / m;
      const double r = 1 + 0.4 * std::cos(v);
      for (const double c : {r * std::cos(u), r * std::sin(u), 0.4 * std::sin(v)})
        mesh.vertices.push_back(static_cast<float>(c));
    }
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) {
      const int a = i * m + j, b = (i + 1) % n * m + j;
      const int c = i * m + (j + 1) % m, d = (i + 1) % n * m + (j + 1) % m;
      mesh.triangles.emplace_back(a, b, d);
      mesh.triangles.emplace_back(a, d, c);
    }
  return mesh;
}

double area(const Mesh& mesh, size_t t) {
  const Vec3i& f = mesh.triangles[t];
  return 0.5 * static_cast<double>((mesh.vertex(f[1]) - mesh.vertex(f[0]))
                                       .cross(mesh.vertex(f[2]) - mesh.vertex(f[0]))
                                       .norm());
}

double total_area(const Mesh& mesh) {
  double sum = 0;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) sum += area(mesh, t);
  return sum;
}

// Triangles by directed edge; every directed edge at most once means manifold and oriented.
void expect_manifold(const Mesh& mesh, int boundary_edges) {
  std::map<std::pair<int, int>, int> directed;
  for (const Vec3i& f : mesh.triangles)
    for (int k = 0; k < 3; ++k) ++directed[{f[k], f[(k + 1) % 3]}];
  int open = 0;
  for (const auto& [edge, count] : directed) {
    EXPECT_EQ(count, 1);
    open += directed.count({edge.second, edge.first}) == 0;
  }
  if (boundary_edges >= 0) {
    EXPECT_EQ(open, boundary_edges);
  }
}

double distance_to(const Mesh& mesh, const Vec3f& p) {
  // Sampled closely enough for an upper bound.
  double best = 1e300;
  constexpr int kSteps = 12;
  for (const Vec3i& f : mesh.triangles)
    for (int i = 0; i <= kSteps; ++i)
      for (int j = 0; i + j <= kSteps; ++j) {
        const float a = static_cast<float>(i) / kSteps, b = static_cast<float>(j) / kSteps;
        const Vec3f q =
            (1 - a - b) * mesh.vertex(f[0]) + a * mesh.vertex(f[1]) + b * mesh.vertex(f[2]);
        best = std::min(best, static_cast<double>((q - p).norm()));
      }
  return best;
}

TEST(Decimate, FlatSquareBecomesAFewTriangles) {
  const Mesh mesh = grid(12, [](float, float) { return 0; });
  const Decimated small = decimate(mesh, {});
  EXPECT_LE(small.mesh.triangle_count(),
            8);  // however the border was cut up
  EXPECT_NEAR(total_area(small.mesh), 1, 1e-3);
  expect_manifold(small.mesh, -1);
}

TEST(Decimate, VerticesAreInputVerticesInOrder) {
  const Mesh mesh = torus(40, 24);
  DecimateOptions options;
  options.tolerance = 0.02f;
  const Decimated small = decimate(mesh, options);
  ASSERT_EQ(small.vertex.size(), static_cast<size_t>(small.mesh.vertex_count()));
  EXPECT_TRUE(std::is_sorted(small.vertex.begin(), small.vertex.end()));
  for (int v = 0; v < small.mesh.vertex_count(); ++v)
    EXPECT_EQ(small.mesh.vertex(v), mesh.vertex(small.vertex[static_cast<size_t>(v)]));
}

TEST(Decimate, TorusStaysATorusNearTheOriginal) {
  const Mesh mesh = torus(40, 24);
  DecimateOptions options;
  options.tolerance = 0.02f;
  const Decimated small = decimate(mesh, options);
  EXPECT_LT(small.mesh.triangle_count(), mesh.triangle_count() / 2);
  EXPECT_GT(small.mesh.triangle_count(), 50);
  expect_manifold(small.mesh, 0);
  const int edges =
      static_cast<int>(mesh_edges(small.mesh.triangles, small.mesh.vertex_count()).size());
  EXPECT_EQ(small.mesh.vertex_count() - edges + small.mesh.triangle_count(), 0);  // genus 1
  for (int v = 0; v < mesh.vertex_count(); v += 7)
    EXPECT_LT(distance_to(small.mesh, mesh.vertex(v)), 0.1);
  // No triangle turned over: all normals leave the ring's core.
  for (size_t t = 0; t < small.mesh.triangles.size(); ++t) {
    const Vec3i& f = small.mesh.triangles[t];
    const Vec3f a = small.mesh.vertex(f[0]), b = small.mesh.vertex(f[1]),
                c = small.mesh.vertex(f[2]);
    const Vec3f center = (a + b + c) / 3;
    const Vec3f core = Vec3f(center.x(), center.y(), 0).normalized();
    EXPECT_GT((b - a).cross(c - a).dot(center - core), 0);
  }
}

TEST(Decimate, StopsAtTheTargetAndIsDeterministic) {
  const Mesh mesh = torus(40, 24);
  DecimateOptions options;
  options.tolerance = 1;
  options.target_triangles = 700;
  const Decimated a = decimate(mesh, options), b = decimate(mesh, options);
  EXPECT_LE(a.mesh.triangle_count(), 700);
  EXPECT_GE(a.mesh.triangle_count(), 698);
  EXPECT_EQ(a.vertex, b.vertex);
  EXPECT_EQ(a.mesh.triangles, b.mesh.triangles);
}

TEST(Decimate, SizeLimitsEdges) {
  const Mesh mesh = grid(30, [](float, float) { return 0; });
  DecimateOptions options;
  options.size.assign(static_cast<size_t>(mesh.vertex_count()), 0.1f);
  options.stretch = 1.5f;
  const Decimated small = decimate(mesh, options);
  double longest = 0, sum = 0;
  const auto edges = mesh_edges(small.mesh.triangles, small.mesh.vertex_count());
  for (const auto& [a, b] : edges) {
    const double length = static_cast<double>((small.mesh.vertex(a) - small.mesh.vertex(b)).norm());
    longest = std::max(longest, length);
    sum += length;
  }
  EXPECT_LE(longest, 0.15 + 1e-6);
  EXPECT_GT(sum / static_cast<double>(edges.size()), 0.07);  // and it does grow that far
}

TEST(Decimate, PosesKeepWhatTheRestShapeDoesNotShow) {
  const Mesh mesh = grid(24, [](float, float) { return 0; });
  DecimateOptions options;
  options.tolerance = 0.004f;
  options.size.assign(static_cast<size_t>(mesh.vertex_count()), 0.25f);
  const Decimated plain = decimate(mesh, options);
  // A wave that appears only in the pose.
  options.poses.push_back(mesh.vertices);
  for (size_t v = 0; v < options.poses[0].size(); v += 3)
    options.poses[0][v + 2] = 0.05f * std::sin(12 * options.poses[0][v]);
  const Decimated waved = decimate(mesh, options);
  EXPECT_GT(waved.mesh.triangle_count(), plain.mesh.triangle_count() * 3 / 2);
  // In the pose the simplified sheet follows the wave.
  Mesh posed = waved.mesh;
  for (size_t v = 0; v < waved.vertex.size(); ++v)
    for (size_t k = 0; k < 3; ++k)
      posed.vertices[3 * v + k] = options.poses[0][3 * static_cast<size_t>(waved.vertex[v]) + k];
  for (size_t v = 0; v < mesh.vertices.size() / 3; v += 5)
    EXPECT_LT(distance_to(posed, Vec3f(options.poses[0].data() + 3 * v)), 0.02);
}

TEST(Decimate, LockedVerticesStay) {
  const Mesh mesh = grid(20, [](float, float) { return 0; });
  DecimateOptions options;
  options.locked.assign(static_cast<size_t>(mesh.vertex_count()), 0);
  const std::vector<int> locked = {47, 101, 222, 300};
  for (const int v : locked) options.locked[static_cast<size_t>(v)] = 1;
  const Decimated small = decimate(mesh, options);
  for (const int v : locked)
    EXPECT_TRUE(std::binary_search(small.vertex.begin(), small.vertex.end(), v)) << v;
  EXPECT_LT(small.mesh.triangle_count(), 40);
}

TEST(Decimate, SeamsAndPartBordersKeepTheirCourse) {
  // Left and right half are two parts, and two UV islands apart from each other.
  Mesh mesh = grid(20, [](float, float) { return 0; });
  mesh.parts = {"left", "right"};
  const size_t count = mesh.uvs.size();
  for (size_t i = 0; i < count; ++i) mesh.uvs.push_back(mesh.uvs[i] + Vec2f(1, 0));
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Vec3i& f = mesh.triangles[t];
    const float x = (mesh.vertex(f[0]) + mesh.vertex(f[1]) + mesh.vertex(f[2])).x() / 3;
    mesh.triangle_part.push_back(x < 0.5f ? 0 : 1);
    if (x >= 0.5f) mesh.uv_triangles[t] += Vec3i::Constant(static_cast<int>(count));
  }
  const Decimated small = decimate(mesh, {});
  EXPECT_LT(small.mesh.triangle_count(), 60);
  double part_area[2] = {}, uv_area[2] = {};
  for (size_t t = 0; t < small.mesh.triangles.size(); ++t) {
    const int part = small.mesh.triangle_part[t];
    part_area[part] += area(small.mesh, t);
    const Vec3i& u = small.mesh.uv_triangles[t];
    const Vec2f e =
        small.mesh.uvs[static_cast<size_t>(u[1])] - small.mesh.uvs[static_cast<size_t>(u[0])];
    const Vec2f g =
        small.mesh.uvs[static_cast<size_t>(u[2])] - small.mesh.uvs[static_cast<size_t>(u[0])];
    const double signed_area = 0.5 * static_cast<double>(e.x() * g.y() - e.y() * g.x());
    EXPECT_GT(signed_area, 0);
    uv_area[part] += signed_area;
    for (int k = 0; k < 3; ++k)  // each corner still has the UV of its place
      EXPECT_NEAR(small.mesh.uvs[static_cast<size_t>(u[k])].x(),
                  small.mesh.vertex(small.mesh.triangles[t][k]).x() + static_cast<float>(part),
                  1e-6);
  }
  for (int part = 0; part < 2; ++part) {
    EXPECT_NEAR(part_area[part], 0.5, 1e-3);
    EXPECT_NEAR(uv_area[part], 0.5, 1e-3);
  }
}

TEST(Decimate, CreasesStayChainsOfEdges) {
  const Mesh mesh = grid(20, [](float, float) { return 0; });
  DecimateOptions options;
  std::set<int> on_crease;
  for (int i = 2; i < 18; ++i) {
    options.creases.emplace_back(10 * 21 + i, 10 * 21 + i + 1);
    on_crease.insert(10 * 21 + i);
    on_crease.insert(10 * 21 + i + 1);
  }
  options.size.assign(static_cast<size_t>(mesh.vertex_count()), 0.2f);
  const Decimated small = decimate(mesh, options);
  // Walk along edges between crease vertices from one end to the other.
  std::map<int, std::set<int>> next;
  for (const auto& [a, b] : mesh_edges(small.mesh.triangles, small.mesh.vertex_count())) {
    const int u = small.vertex[static_cast<size_t>(a)], v = small.vertex[static_cast<size_t>(b)];
    if (on_crease.count(u) && on_crease.count(v)) {
      next[u].insert(v);
      next[v].insert(u);
    }
  }
  int v = 10 * 21 + 2, steps = 0;
  while (v != 10 * 21 + 18 && steps < 20) {
    int best = v;
    for (const int w : next[v]) best = std::max(best, w);
    ASSERT_GT(best, v) << "the crease breaks off";
    v = best;
    ++steps;
  }
  EXPECT_EQ(v, 10 * 21 + 18);
  EXPECT_LT(steps, 12);  // and it was simplified
}

TEST(Decimate, EdgesOfThreeTrianglesAreLeftAlone) {
  Mesh mesh;
  mesh.vertices = {0, 0, 0, 1, 0, 0, 0.5f, 1, 0, 0.5f, -1, 0, 0.5f, 0, 1};
  mesh.triangles = {Vec3i(0, 1, 2), Vec3i(1, 0, 3), Vec3i(0, 1, 4)};
  const Decimated small = decimate(mesh, {});
  EXPECT_EQ(small.mesh.triangle_count(), 3);
}

TEST(Decimate, RefusesBrokenMeshes) {
  Mesh mesh = grid(2, [](float, float) { return 0; });
  mesh.triangles[0][1] = 99;
  EXPECT_THROW(decimate(mesh, {}), Error);
}

}  // namespace
}  // namespace effigy
