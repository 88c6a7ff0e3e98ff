// The standard subjects, skin pigments and pose shapes of the built-in head.
#include <gtest/gtest.h>

#include <cmath>

#include "effigy/people/builtin_head.h"
#include "effigy/people/head_mesh.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/skin_optics.h"

namespace effigy {
namespace {

TEST(Subjects, ShareTopologyAndDifferInForm) {
  const Rig first = builtin_head_rig(1);
  for (uint64_t subject = 2; subject <= kStandardSubjects + 3; ++subject) {
    const Rig rig = builtin_head_rig(subject);
    check_rig(rig, "subject");
    ASSERT_EQ(rig.mesh.triangles.size(), first.mesh.triangles.size());
    EXPECT_EQ(rig.identity_basis, first.identity_basis);
    EXPECT_EQ(rig.multipie.triangle, first.multipie.triangle);
    double sum = 0;
    for (size_t i = 0; i < rig.mesh.vertices.size(); i += 3)
      sum += static_cast<double>(
          (Vec3f(&rig.mesh.vertices[i]) - Vec3f(&first.mesh.vertices[i])).norm());
    EXPECT_GT(3 * sum / static_cast<double>(rig.mesh.vertices.size()), 1e-3) << subject;
    EXPECT_EQ(builtin_head_rig(subject).mesh.vertices, rig.mesh.vertices);
  }
}

TEST(Subjects, SkinRunsFromDarkToFair) {
  // Mean albedo of forehead texels, below the hairline.
  auto forehead = [](uint64_t subject) {
    const HeadMaterials m = builtin_head_materials(256, subject);
    const Rig rig = builtin_head_rig(subject);
    const int f = rig.multipie.triangle[27];
    const Vec2f uv = rig.mesh.uvs[rig.mesh.uv_triangles[f][0]];
    const int x = static_cast<int>(uv.x() * 256), y = static_cast<int>((1 - uv.y()) * 256) - 20;
    double sum = 0;
    for (int dy = -3; dy <= 3; ++dy)
      for (int dx = -3; dx <= 3; ++dx)
        for (int c = 0; c < 3; ++c) sum += m.albedo.at(x + dx, y + dy)[c] / 147;
    return sum;
  };
  EXPECT_GT(forehead(2), 1.1 * forehead(4));
  EXPECT_GT(forehead(4), 2.0 * forehead(3));
}

TEST(SkinOptics, BloodAbsorbsWhereHaemoglobinDoes) {
  // Dips at 542 and 577 nm with a rise between, and hardly any absorption in the red.
  auto at = [](double wavelength) { return skin_reflectance(wavelength, 0.01, 0.02); };
  EXPECT_LT(at(542), at(560));
  EXPECT_LT(at(577), at(560));
  EXPECT_GT(at(650), 1.6 * at(577));
  EXPECT_LT(at(420), at(500));
  for (double w = 400; w <= 700; w += 10) {
    EXPECT_GT(at(w), 0.0);
    EXPECT_LT(at(w), 0.9);
    // More pigment, less light.
    EXPECT_GT(skin_reflectance(w, 0.01, 0.005), skin_reflectance(w, 0.10, 0.005));
    EXPECT_GT(skin_reflectance(w, 0.02, 0.004), skin_reflectance(w, 0.02, 0.040));
  }
}

TEST(SkinOptics, ColoursAreThoseOfSkin) {
  for (const double melanin : {0.004, 0.02, 0.08, 0.3})
    for (const double blood : {0.002, 0.008, 0.03}) {
      const Vec3d c = skin_albedo(melanin, blood);
      EXPECT_GT(c[0], c[1]) << melanin << " " << blood;
      EXPECT_GT(c[1], c[2]) << melanin << " " << blood;
      EXPECT_GT(c[2], 0.005);
      EXPECT_LT(c[0], 0.9);
    }
  const Vec3d fair = skin_albedo(0.008, 0.008), flushed = skin_albedo(0.008, 0.03);
  EXPECT_NEAR(fair[0], 0.58, 0.15);
  EXPECT_GT(flushed[0] / flushed[1], 1.2 * fair[0] / fair[1]);
}

std::vector<float> turned(const Rig& rig, int joint, const Vec3f& turn) {
  RigPose pose = RigPose::rest(rig);
  for (int c = 0; c < 3; ++c) pose.joint_rotation[3 * joint + c] = turn[c];
  std::vector<float> out;
  pose_vertices(shape_rig(rig, {}), pose, out);
  return out;
}

TEST(PoseShapes, AreZeroAtRestAndKeepTheNecksGirth) {
  const Rig rig = builtin_head_rig();
  ASSERT_EQ(rig.pose_basis.size(), 9 * 4 * rig.mesh.vertices.size());
  EXPECT_EQ(turned(rig, 1, Vec3f::Zero()), turned(rig, 2, Vec3f::Zero()));
  Rig plain = rig;
  plain.pose_basis.clear();
  // A turned head: blended rotations alone lose more of the neck's girth.
  const Vec3f turn(0, 0.9f, 0);
  auto girth = [&](const Rig& r) {
    const auto vertices = turned(r, 1, turn);
    double sum = 0;
    int count = 0;
    for (size_t v = 0; 3 * v < vertices.size(); ++v) {
      const float y = rig.mesh.vertices[3 * v + 1];
      if (y > -0.150f || y < -0.165f) continue;
      sum += std::hypot(static_cast<double>(vertices[3 * v]),
                        static_cast<double>(vertices[3 * v + 2]) + 0.028);
      ++count;
    }
    return sum / count;
  };
  EXPECT_GT(girth(rig), girth(plain));
}

TEST(PoseShapes, TheChinGoesWithTheHeadAndTheRingStays) {
  const Rig rig = builtin_head_rig();
  const auto rest = turned(rig, 1, Vec3f::Zero()), side = turned(rig, 1, Vec3f(0, 0.5f, 0));
  const auto a = landmark_positions(rig.multipie, rig.mesh.triangles, rest);
  const auto b = landmark_positions(rig.multipie, rig.mesh.triangles, side);
  // Chin (8) and tip of the nose (30) keep their distance.
  auto length = [](const std::vector<float>& marks) {
    return (Vec3f(&marks[3 * 8]) - Vec3f(&marks[3 * 30])).norm();
  };
  EXPECT_NEAR(length(b), length(a), 0.5e-3f);
  for (const int v : rig.neck_ring)
    EXPECT_LT((Vec3f(&side[3 * v]) - Vec3f(&rest[3 * v])).norm(), 0.5e-3f);
}

TEST(PoseShapes, LidsGiveWayToTheCornea) {
  const Rig rig = builtin_head_rig();
  Rig plain = rig;
  plain.pose_basis.clear();
  auto clearance = [&](const Rig& r) {
    const auto vertices = turned(r, 3, Vec3f(-0.45f, 0, 0));  // looks up
    const auto& head = people::shared_head_mesh();
    double least = 1e9;
    for (size_t v = 0; v < head.vertices.size(); ++v)
      if (head.vertices[v].region == people::Region::kEyeRing && head.vertices[v].side > 0 &&
          head.vertices[v].ring >= 0 && head.vertices[v].ring <= 3 && head.vertices[v].index > 3 &&
          head.vertices[v].index < 9)
        least =
            std::min(least, static_cast<double>((1000 * Vec3f(&vertices[3 * v]) -
                                                 Vec3f(people::kEyeX, people::kEyeY, people::kEyeZ))
                                                    .norm()));
    return least;
  };
  EXPECT_GT(clearance(rig), clearance(plain) + 0.05);
}

}  // namespace
}  // namespace effigy
