// Teeth and mouth interior: closed, rigid where they must be, with UVs of their own.
#include "effigy/rig/mouth.h"

#include <gtest/gtest.h>

#include <cstdlib>

#include "effigy/base/error.h"
#include "effigy/geometry/topology.h"
#include "effigy/rig/flame.h"
#include "rig/fake_flame.h"

namespace effigy {
namespace {

// FLAME's counts on the made-up head; on the published topology where that is available.
class Mouth : public ::testing::TestWithParam<bool> {
 protected:
  static Path data() {
    const char* folder = std::getenv("EFFIGY_DATA");
    return folder == nullptr ? Path() : Path(folder) / "face/flame_topology";
  }
  void SetUp() override {
    if (GetParam() && data().empty()) GTEST_SKIP() << "EFFIGY_DATA is not set";
  }
  static Rig make(bool published) {
    const Path folder = Path(::testing::TempDir()) / (published ? "mouth_real" : "mouth_fake");
    std::filesystem::remove_all(folder);
    make_folder(folder);
    Mesh head = test::FakeHead().mesh;
    if (published) {
      head = read_obj(data() / "head_template.obj");
      for (size_t i = 1; i < head.vertices.size(); i += 3) head.vertices[i] -= 1.48f;
    }
    write_obj(folder / "head_template.obj", head);
    test::FakeFlame(head).write(folder / "flame2023.pkl", true);
    Rig rig = load_flame(folder / "flame2023.pkl");
    std::filesystem::remove_all(folder);
    return rig;
  }
  static const Rig& rig() {
    static std::map<bool, Rig> rigs;
    if (rigs.count(GetParam()) == 0) rigs[GetParam()] = make(GetParam());
    return rigs[GetParam()];
  }
  static std::vector<Vec3i> part(const std::vector<std::string>& names) {
    std::vector<Vec3i> triangles;
    for (size_t f = 0; f < rig().mesh.triangles.size(); ++f)
      for (const std::string& name : names)
        if (rig().mesh.parts[static_cast<size_t>(rig().mesh.triangle_part[f])] == name)
          triangles.push_back(rig().mesh.triangles[f]);
    return triangles;
  }
  static float weight(int vertex, const char* joint) {
    return rig().weights[static_cast<size_t>(vertex) * 5 + static_cast<size_t>(rig().joint(joint))];
  }
};

TEST_P(Mouth, BagClosesTheLips) {
  // With the bag, only the neck is open, and no edge is used twice in one direction.
  const auto triangles = part({"skin", "mouth"});
  const auto loops = boundary_loops(triangles, rig().mesh.vertex_count());
  ASSERT_EQ(loops.size(), 1u);
  EXPECT_EQ(loops[0], rig().neck_ring);
  if (!GetParam()) return;  // the made-up head's own triangles are not all wound alike
  std::map<std::pair<int, int>, int> uses;
  for (const Vec3i& t : triangles)
    for (int corner = 0; corner < 3; ++corner) ++uses[{t[corner], t[(corner + 1) % 3]}];
  for (const auto& [edge, count] : uses) EXPECT_EQ(count, 1);
}

TEST_P(Mouth, TeethAreTwoRigidStrips) {
  const auto teeth = part({"teeth"});
  EXPECT_EQ(teeth.size(), 168u);
  int upper = 0, lower = 0;
  const size_t v3 = rig().mesh.vertices.size();
  std::vector<bool> seen(v3 / 3);
  for (const Vec3i& t : teeth)
    for (int corner = 0; corner < 3; ++corner) {
      const int v = t[corner];
      if (seen[static_cast<size_t>(v)]) continue;
      seen[static_cast<size_t>(v)] = true;
      if (weight(v, "neck") == 1) ++upper;
      if (weight(v, "jaw") == 1) ++lower;
      for (size_t k = 0; k < static_cast<size_t>(rig().expression_count); ++k)
        for (size_t axis = 0; axis < 3; ++axis)
          ASSERT_EQ(rig().expression_basis[k * v3 + 3 * static_cast<size_t>(v) + axis], 0);
      for (size_t m = 0; m < 36; ++m)
        for (size_t axis = 0; axis < 3; ++axis)
          ASSERT_EQ(rig().pose_basis[m * v3 + 3 * static_cast<size_t>(v) + axis], 0);
    }
  EXPECT_EQ(upper, 60);
  EXPECT_EQ(lower, 60);
}

TEST_P(Mouth, FrontOfTheTeethLooksForward) {
  for (const bool is_upper : {true, false}) {
    Vec3f lowest_normal = Vec3f::Zero();
    float best = -1;
    for (const Vec3i& t : part({"teeth"})) {
      if ((weight(t[0], "neck") == 1) != is_upper) continue;
      const Vec3f a = rig().mesh.vertex(t[0]), b = rig().mesh.vertex(t[1]),
                  c = rig().mesh.vertex(t[2]);
      const Vec3f normal = (b - a).cross(c - a).normalized();
      const Vec3f middle = (a + b + c) / 3;
      if (std::abs(middle.x()) < 0.004f && middle.z() > best) {
        best = middle.z();
        lowest_normal = normal;
      }
    }
    EXPECT_GT(lowest_normal.z(), 0.9f);
  }
}

TEST_P(Mouth, NewVerticesFollowIdentity) {
  // Identity direction 0 moves every vertex by (1, 2, 3) mm.
  const size_t v3 = rig().mesh.vertices.size();
  EXPECT_EQ(v3, 3u * (5023 + 120 + 5 * 32 + 1));
  for (size_t i = 3 * 5023; i < v3; ++i)
    EXPECT_NEAR(rig().identity_basis[i], 0.001f * static_cast<float>(1 + i % 3), 2e-6f);
  // Joints do not depend on them.
  for (size_t j = 0; j < 5; ++j)
    for (size_t v = 5023; v < v3 / 3; ++v) EXPECT_EQ(rig().joint_regressor[j * v3 / 3 + v], 0);
}

TEST_P(Mouth, BagFollowsTheLipsAtTheRimOnly) {
  const size_t v3 = rig().mesh.vertices.size(), bag = 5023 + 120;
  const auto strength = [&](size_t ring) {
    double sum = 0;
    for (size_t k = 0; k < 100; ++k)
      for (size_t v = bag + 32 * ring; v < bag + 32 * (ring + 1); ++v)
        for (size_t axis = 0; axis < 3; ++axis)
          sum += static_cast<double>(std::abs(rig().expression_basis[k * v3 + 3 * v + axis]));
    return sum;
  };
  EXPECT_GT(strength(0), 0);
  EXPECT_GT(strength(0), 2 * strength(1));
  EXPECT_EQ(strength(2), 0);
}

// Counts, texel by texel, how many UV triangles cover it.
TEST_P(Mouth, UvIslandsAreApartAndNotDegenerate) {
  constexpr int kSize = 2048;
  const Mesh& mesh = rig().mesh;
  std::vector<uint8_t> count(kSize * kSize, 0);
  double area = 0;
  for (size_t f = 9976; f < mesh.triangles.size(); ++f) {
    const Vec3i& t = mesh.uv_triangles[f];
    const Vec2f a = mesh.uvs[static_cast<size_t>(t[0])], b = mesh.uvs[static_cast<size_t>(t[1])],
                c = mesh.uvs[static_cast<size_t>(t[2])];
    const float twice = (b - a).x() * (c - a).y() - (b - a).y() * (c - a).x();
    EXPECT_GT(twice, 1e-5f) << f;  // > 20 texels of 2048 squared, turned like the face
    area += 0.5 * static_cast<double>(twice);
    for (const Vec2f& uv : {a, b, c}) {
      EXPECT_GE(uv.y(), 0.957f);
      EXPECT_LE(uv.y(), 0.993f);
      EXPECT_GE(uv.x(), 0.15f);
      EXPECT_LE(uv.x(), 0.85f);
    }
  }
  // Without overlaps the covered area is the sum of the areas.
  Mesh added;
  added.uvs = mesh.uvs;
  added.uv_triangles.assign(mesh.uv_triangles.begin() + 9976, mesh.uv_triangles.end());
  const auto covered = uv_coverage(added, kSize);
  double texels = 0;
  for (const uint8_t value : covered) texels += value;
  EXPECT_NEAR(texels / (kSize * kSize), area, 0.01 * area);
  // Nothing of the head is near.
  Mesh before;
  before.uvs = mesh.uvs;
  before.uv_triangles.assign(mesh.uv_triangles.begin(), mesh.uv_triangles.begin() + 9976);
  const auto head = uv_coverage(before, kSize, 8);
  for (size_t i = 0; i < head.size(); ++i) ASSERT_FALSE(head[i] && covered[i]);
}

TEST_P(Mouth, TeethStandInsideTheBagAndBehindTheLips) {
  // Seen from the front, every tooth is behind the rim of the lips.
  const auto loops = boundary_loops(part({"skin"}), rig().mesh.vertex_count());
  const auto& rim = loops[0] == rig().neck_ring ? loops[1] : loops[0];
  float front = -1;
  for (const int v : rim) front = std::max(front, rig().mesh.vertex(v).z());
  for (const Vec3i& t : part({"teeth"}))
    for (int corner = 0; corner < 3; ++corner) EXPECT_LT(rig().mesh.vertex(t[corner]).z(), front);
}
INSTANTIATE_TEST_SUITE_P(All, Mouth, ::testing::Bool(), [](const auto& test) {
  return std::string(test.param ? "PublishedTopology" : "MadeUpHead");
});

TEST(MouthErrors, NeedsLipsJawAndUvs) {
  Rig rig;
  rig.joint_names = {"root"};
  EXPECT_THROW(add_mouth(rig, "x"), Error);
  rig.joint_names = {"root", "neck", "jaw"};
  EXPECT_THROW(add_mouth(rig, "x"), Error);
}

}  // namespace
}  // namespace effigy
