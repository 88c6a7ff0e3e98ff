// Boundary loops, connected pieces and the uniform Laplacian.
#include "effigy/geometry/topology.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <random>

#include "effigy/geometry/laplacian.h"
#include "effigy/geometry/mesh.h"

namespace effigy {
namespace {

// n x n vertices, two triangles a cell.
std::vector<Vec3i> grid(int n) {
  std::vector<Vec3i> triangles;
  for (int y = 0; y + 1 < n; ++y)
    for (int x = 0; x + 1 < n; ++x) {
      const int a = y * n + x;
      triangles.emplace_back(a, a + 1, a + n);
      triangles.emplace_back(a + 1, a + n + 1, a + n);
    }
  return triangles;
}

using Loops = std::vector<std::vector<int>>;

TEST(BoundaryLoops, OfAGrid) {
  EXPECT_EQ(boundary_loops(grid(3), 9), (Loops{{0, 1, 2, 5, 8, 7, 6, 3}}));
}

TEST(BoundaryLoops, ClosedSurfacesHaveNone) {
  const std::vector<Vec3i> tetrahedron = {Vec3i(0, 2, 1), Vec3i(0, 1, 3), Vec3i(1, 2, 3),
                                          Vec3i(0, 3, 2)};
  EXPECT_TRUE(boundary_loops(tetrahedron, 4).empty());
}

TEST(BoundaryLoops, HolesAreLoopsOfTheirOwn) {
  std::vector<Vec3i> triangles = grid(5);
  // Remove the cells around the middle vertex 12: the hole's ring is 6..18 without 12.
  std::erase_if(triangles, [](const Vec3i& t) { return (t.array() == 12).any(); });
  const Loops loops = boundary_loops(triangles, 25);
  ASSERT_EQ(loops.size(), 2u);
  EXPECT_EQ(loops[0].size(), 16u);
  EXPECT_EQ(loops[1].size(), 6u);
}

TEST(BoundaryLoops, LoopsThatTouchAreSeparated) {
  // Two triangles that share vertex 2 only.
  EXPECT_EQ(boundary_loops({Vec3i(0, 1, 2), Vec3i(2, 3, 4)}, 5), (Loops{{0, 1, 2}, {2, 3, 4}}));
}

TEST(BoundaryLoops, BadTopologyStillCloses) {
  // Three triangles at one edge, one of them turned over, and a degenerate one.
  const Loops loops =
      boundary_loops({Vec3i(0, 1, 2), Vec3i(0, 1, 3), Vec3i(1, 0, 4), Vec3i(5, 5, 6)}, 7);
  for (const auto& loop : loops) EXPECT_GE(loop.size(), 2u);
}

TEST(ConnectedPieces, AreNumberedFromTheirSmallestVertex) {
  EXPECT_EQ(connected_pieces({Vec3i(5, 3, 0), Vec3i(1, 4, 6)}, 8),
            (std::vector<int>{0, 1, 2, 0, 1, 0, 1, 3}));
}

TEST(PublishedMeshes, FlameBoundaryAndPieces) {
  const char* data = std::getenv("EFFIGY_DATA");
  if (data == nullptr) GTEST_SKIP() << "EFFIGY_DATA is not set";
  const Mesh mesh = read_obj(Path(data) / "face/flame_topology/head_template.obj");
  const auto pieces = connected_pieces(mesh.triangles, mesh.vertex_count());
  EXPECT_EQ(*std::max_element(pieces.begin(), pieces.end()), 2);
  EXPECT_EQ(std::count(pieces.begin(), pieces.end(), 0), 3931);
  EXPECT_EQ(std::count(pieces.begin(), pieces.end(), 1), 546);
  const Loops loops = boundary_loops(mesh.triangles, mesh.vertex_count());
  ASSERT_FALSE(loops.empty());
  // The neck's rim is the lowest boundary.
  EXPECT_GT(loops[0].size(), 20u);
}

// L as a dense matrix, by its definition.
Eigen::MatrixXd dense_laplacian(const std::vector<Vec3i>& triangles, int vertices) {
  Eigen::MatrixXd near = Eigen::MatrixXd::Zero(vertices, vertices);
  for (const auto& [a, b] : mesh_edges(triangles, vertices)) near(a, b) = near(b, a) = 1;
  Eigen::MatrixXd l = Eigen::MatrixXd::Zero(vertices, vertices);
  for (int i = 0; i < vertices; ++i)
    if (near.row(i).sum() > 0) {
      l.row(i) = -near.row(i) / near.row(i).sum();
      l(i, i) = 1;
    }
  return l;
}

TEST(UniformLaplacian, MatchesTheDenseMatrixAndItsTranspose) {
  const auto triangles = grid(6);
  const int vertices = 38;  // two without triangles
  const UniformLaplacian laplacian(triangles, vertices);
  const Eigen::MatrixXd dense = dense_laplacian(triangles, vertices);
  std::mt19937 engine(5);
  std::uniform_real_distribution<float> uniform(-1, 1);
  std::vector<float> x(3 * vertices), out(3 * vertices), transposed(3 * vertices);
  for (float& value : x) value = uniform(engine);
  laplacian.apply(x, out);
  laplacian.apply_transpose(x, transposed);
  Eigen::MatrixXd points(vertices, 3);
  for (int i = 0; i < 3 * vertices; ++i) points(i / 3, i % 3) = x[static_cast<size_t>(i)];
  const Eigen::MatrixXd expected = dense * points, expected_t = dense.transpose() * points;
  for (int i = 0; i < 3 * vertices; ++i) {
    EXPECT_NEAR(out[static_cast<size_t>(i)], expected(i / 3, i % 3), 1e-6);
    EXPECT_NEAR(transposed[static_cast<size_t>(i)], expected_t(i / 3, i % 3), 1e-6);
  }
}

TEST(UniformLaplacian, NeighboursAreSorted) {
  const UniformLaplacian laplacian(grid(3), 9);
  const auto middle = laplacian.neighbours(4);
  EXPECT_EQ(std::vector<int>(middle.begin(), middle.end()), (std::vector<int>{1, 2, 3, 5, 6, 7}));
}

}  // namespace
}  // namespace effigy
