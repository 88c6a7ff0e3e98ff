// Meshes: normals, checks, edges, OBJ files, UV coverage.
#include "effigy/geometry/mesh.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <functional>
#include <limits>
#include <numeric>
#include <random>

#include "effigy/base/error.h"

namespace effigy {
namespace {

std::string refusal(const std::function<void()>& body) {
  try {
    body();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

Mesh square() {
  Mesh mesh;
  mesh.vertices = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};
  mesh.triangles = {Vec3i(0, 1, 2), Vec3i(0, 2, 3)};
  mesh.uvs = {Vec2f(0, 0), Vec2f(0.5f, 0), Vec2f(0.5f, 0.5f), Vec2f(0, 0.5f)};
  mesh.uv_triangles = mesh.triangles;
  mesh.triangle_part = {1, 0};
  mesh.parts = {"cloth", "skin"};
  return mesh;
}

Path written(const std::string& text) {
  const Path path = Path(::testing::TempDir()) / "mesh_test.obj";
  write_text(path, text);
  return path;
}

TEST(VertexNormals, AreUnitAndWeightedByArea) {
  // A corner of a box whose faces have areas 2, 1 (xy) and 1: the first counts twice.
  const std::vector<float> v = {0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, 1};
  const auto normals = vertex_normals(v, {Vec3i(0, 1, 2), Vec3i(0, 3, 1), Vec3i(0, 2, 3)});
  const Vec3f expected = Vec3f(1, 1, 2).normalized();  // yz, zx, xy faces
  for (int axis = 0; axis < 3; ++axis)
    EXPECT_NEAR(normals[static_cast<size_t>(axis)], expected[axis], 1e-6f);
  for (size_t i = 0; i < 4; ++i)
    EXPECT_NEAR(std::hypot(normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]), 1, 1e-6f);
}

TEST(VertexNormals, LonelyVerticesGetAUnitNormal) {
  const auto normals = vertex_normals(std::vector<float>(12, 1.0f), {Vec3i(0, 1, 2)});
  for (size_t i = 0; i < 4; ++i) EXPECT_EQ(normals[3 * i + 1], 1);
}

TEST(CheckMesh, NamesWhatIsWrong) {
  check_mesh(square(), "square");
  struct Damage {
    const char* word;
    std::function<void(Mesh&)> apply;
  };
  const std::vector<Damage> damages = {
      {"vertex 1", [](Mesh& m) { m.vertices[4] = std::numeric_limits<float>::infinity(); }},
      {"3 numbers", [](Mesh& m) { m.vertices.pop_back(); }},
      {"no vertices", [](Mesh& m) { m.triangles.clear(); }},
      {"triangle 1 has index 4", [](Mesh& m) { m.triangles[1][2] = 4; }},
      {"triangle 0 has index -1", [](Mesh& m) { m.triangles[0][0] = -1; }},
      {"UV vertex 2", [](Mesh& m) { m.uvs[2].x() = std::numeric_limits<float>::quiet_NaN(); }},
      {"UV triangle 0", [](Mesh& m) { m.uv_triangles[0][0] = 9; }},
      {"UV triangles", [](Mesh& m) { m.uv_triangles.pop_back(); }},
      {"part numbers", [](Mesh& m) { m.triangle_part.pop_back(); }},
      {"part number 2", [](Mesh& m) { m.triangle_part[0] = 2; }},
  };
  for (const Damage& damage : damages) {
    Mesh mesh = square();
    damage.apply(mesh);
    const std::string message = refusal([&] { check_mesh(mesh, "square"); });
    EXPECT_EQ(message.rfind("square: ", 0), 0u) << message;
    EXPECT_NE(message.find(damage.word), std::string::npos) << message;
  }
}

TEST(MeshEdges, AreUniqueAndSorted) {
  const auto edges = mesh_edges(square().triangles, 4);
  const std::vector<std::pair<int, int>> expected = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {2, 3}};
  EXPECT_EQ(edges, expected);
}

TEST(Obj, RoundTrip) {
  const Path path = Path(::testing::TempDir()) / "round_trip.obj";
  Mesh mesh = square();
  mesh.vertices[4] = 0.1234567f;
  write_obj(path, mesh);
  const Mesh back = read_obj(path);
  EXPECT_EQ(back.vertices, mesh.vertices);
  EXPECT_EQ(back.triangles, mesh.triangles);
  EXPECT_EQ(back.uvs, mesh.uvs);
  EXPECT_EQ(back.uv_triangles, mesh.uv_triangles);
  // Parts are numbered in order of appearance.
  EXPECT_EQ(back.parts, (std::vector<std::string>{"skin", "cloth"}));
  EXPECT_EQ(back.triangle_part, (std::vector<int>{0, 1}));
}

TEST(Obj, DialectsOfTheFormat) {
  const Mesh mesh = read_obj(
      written("# comment\r\nmtllib x.mtl\nv 0 0 0 1 0 0\r\nv +1 0 0\nv 1 1e0 0\nv\t0 1 \\\n 0\n"
              "vn 0 0 1\ns off\nf -4//1 -3//1 -2//1 -1//1\n"));
  EXPECT_EQ(mesh.vertices, square().vertices);
  EXPECT_EQ(mesh.triangles, square().triangles);  // the polygon became a fan
  EXPECT_TRUE(mesh.uv_triangles.empty());
  EXPECT_TRUE(mesh.parts.empty());
  const std::string points = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  // Groups count only when there are no materials.
  EXPECT_EQ(read_obj(written(points + "g a b\nf 1 2 3\ng c\nf 3 2 1\n")).parts,
            (std::vector<std::string>{"a b", "c"}));
  EXPECT_EQ(read_obj(written(points + "g a\nf 1 2 3\nusemtl m\nf 3 2 1\n")).parts,
            (std::vector<std::string>{"default", "m"}));
}

TEST(Obj, DamagedFilesAreRefusedWithTheLine) {
  const std::string points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n";
  const std::vector<std::pair<std::string, std::string>> cases = {
      {points + "f 1 2 4\n", "line 5"},
      {points + "f 1 2 0\n", "line 5"},
      {points + "f 1 2 -4\n", "line 5"},
      {points + "f 1 2 99999999999999999999\n", "line 5"},
      {points + "f 1 2\n", "fewer than 3"},
      {points + "f a b c\n", "not an index"},
      {points + "f 1/1 2/2 3/1\n", "texture coordinates"},
      {points + "f 1/1 2 3\n", "some corners only"},
      {points + "f 1/1 2/1 3/1\nf 1 2 3\n", "line 6"},
      {points + "f 1 2 3\nf 1/1 2/1 3/1\n", "line 6"},
      {points + "v 0 0\n", "line 5"},
      {points + "v 0 nan 0\n", "not a finite"},
      {points + "v 0 1e99 0\n", "not a finite"},
      {points + "v 0 1x 0\n", "not a number"},
      {points, "no faces"},
      {"", "no faces"},
  };
  for (const auto& [text, word] : cases) {
    const std::string message = refusal([&, &t = text] { read_obj(written(t)); });
    EXPECT_NE(message.find(word), std::string::npos) << text << " -> " << message;
    EXPECT_NE(message.find("mesh_test.obj"), std::string::npos) << message;
  }
}

TEST(UvCoverage, CountsTexelCentres) {
  // The lower left quarter: rows 4..7 (row 0 is the top), columns 0..3.
  const auto mask = uv_coverage(square(), 8);
  for (size_t y = 0; y < 8; ++y)
    for (size_t x = 0; x < 8; ++x) EXPECT_EQ(mask[8 * y + x], y >= 4 && x < 4 ? 1 : 0);
  const auto grown = uv_coverage(square(), 8, 2);
  for (size_t y = 0; y < 8; ++y)
    for (size_t x = 0; x < 8; ++x) EXPECT_EQ(grown[8 * y + x], y >= 2 && x < 6 ? 1 : 0);
}

TEST(TexelMap, TexelsKnowTheirPointOfTheSurface) {
  constexpr int kSize = 16;
  const Mesh mesh = square();
  const TexelMap map = texel_map(mesh, kSize);
  const auto covered = uv_coverage(mesh, kSize);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const size_t t = static_cast<size_t>(y) * kSize + x;
      ASSERT_EQ(map.triangle[t] >= 0, covered[t] != 0) << x << " " << y;
      if (map.triangle[t] < 0) continue;
      const Vec3i& corner = mesh.uv_triangles[map.triangle[t]];
      const float b = map.barycentric[2 * t], c = map.barycentric[2 * t + 1];
      const Vec2f uv =
          (1 - b - c) * mesh.uvs[corner[0]] + b * mesh.uvs[corner[1]] + c * mesh.uvs[corner[2]];
      EXPECT_NEAR(uv.x(), (x + 0.5f) / kSize, 1e-6f);
      EXPECT_NEAR(uv.y(), 1 - (y + 0.5f) / kSize, 1e-6f);
    }
}

// Random triangles against a per-texel test of signs, with dilation by brute force.
TEST(UvCoverage, MatchesBruteForce) {
  std::mt19937 engine(3);
  std::uniform_real_distribution<float> uniform(-0.3f, 1.3f);
  constexpr int kSize = 37;
  Mesh mesh;
  for (int i = 0; i < 12; ++i) mesh.uvs.emplace_back(uniform(engine), uniform(engine) * 0.3f);
  for (int i = 0; i < 4; ++i) mesh.uv_triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  std::vector<uint8_t> expected(kSize * kSize, 0), grown(kSize * kSize, 0);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x)
      for (const Vec3i& t : mesh.uv_triangles) {
        const Vec2d p((x + 0.5) / kSize, 1 - (y + 0.5) / kSize);
        int positive = 0, negative = 0;
        for (int c = 0; c < 3; ++c) {
          const Vec2d a = mesh.uvs[static_cast<size_t>(t[c])].cast<double>();
          const Vec2d b = mesh.uvs[static_cast<size_t>(t[(c + 1) % 3])].cast<double>();
          const double side = (b - a).x() * (p - a).y() - (b - a).y() * (p - a).x();
          ++(side > 0 ? positive : negative);
        }
        if (positive == 3 || negative == 3) expected[static_cast<size_t>(y * kSize + x)] = 1;
      }
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x)
      for (int dy = -3; dy <= 3; ++dy)
        for (int dx = -3; dx <= 3; ++dx)
          if (y + dy >= 0 && y + dy < kSize && x + dx >= 0 && x + dx < kSize &&
              expected[static_cast<size_t>((y + dy) * kSize + x + dx)])
            grown[static_cast<size_t>(y * kSize + x)] = 1;
  EXPECT_GT(std::accumulate(expected.begin(), expected.end(), 0), 20);
  EXPECT_EQ(uv_coverage(mesh, kSize), expected);
  EXPECT_EQ(uv_coverage(mesh, kSize, 3), grown);
}

TEST(UvCoverage, HugeAndEmptyTrianglesAreHarmless) {
  Mesh mesh = square();
  mesh.uvs = {Vec2f(-1e30f, 0), Vec2f(1e30f, 0), Vec2f(0, 1e30f), Vec2f(0, 0)};
  EXPECT_EQ(uv_coverage(mesh, 16).size(), 256u);
  mesh.uvs.assign(4, Vec2f(0.5f, 0.5f));
  const auto none = uv_coverage(mesh, 16);
  EXPECT_EQ(std::accumulate(none.begin(), none.end(), 0), 0);
}

TEST(PublishedMeshes, FlameTemplate) {
  const char* data = std::getenv("EFFIGY_DATA");
  if (data == nullptr) GTEST_SKIP() << "EFFIGY_DATA is not set";
  const Mesh mesh = read_obj(Path(data) / "face/flame_topology/head_template.obj");
  check_mesh(mesh, "head_template.obj");
  EXPECT_EQ(mesh.vertex_count(), 5023);
  EXPECT_EQ(mesh.triangle_count(), 9976);
  EXPECT_EQ(mesh.uvs.size(), 5118u);
  const auto mask = uv_coverage(mesh, 256);
  EXPECT_NEAR(std::accumulate(mask.begin(), mask.end(), 0.0) / (256 * 256), 0.897, 0.005);
}

}  // namespace
}  // namespace effigy
