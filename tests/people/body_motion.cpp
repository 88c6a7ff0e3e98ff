// Motions of the built-in body, and BVH files as hostile input.

#include "effigy/people/body_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/file.h"
#include "small_bvh.h"

namespace effigy {
namespace {

using test::BvhFile;
using test::kHierarchy;
using test::sound_file;

const BuiltinBody& body() {
  return builtin_body(1);
}

Vec3f point(const std::vector<float>& values, int i) {
  return Vec3f(values.data() + 3 * i);
}

// Largest step of any vertex from frame to frame, metres.
double largest_step(const BodyMotion& motion) {
  std::vector<float> before, now;
  double largest = 0;
  for (const RigPose& pose : motion.poses) {
    pose_vertices(body().shape, pose, now);
    for (size_t i = 0; i < before.size(); ++i)
      largest = std::max(largest, std::abs(static_cast<double>(now[i] - before[i])));
    before = now;
  }
  return largest;
}

TEST(BodyMotion, IsSmoothDeterministicAndDiffersBySeed) {
  const BodyMotion a = range_of_motion(body(), 30, 30, 5), b = range_of_motion(body(), 30, 30, 5);
  const BodyMotion c = range_of_motion(body(), 30, 30, 6), d = unseen_motion(body(), 30, 30, 5);
  ASSERT_EQ(a.poses.size(), 30u);
  for (size_t f = 0; f < a.poses.size(); ++f) {
    EXPECT_EQ(a.poses[f].joint_rotation, b.poses[f].joint_rotation);
    EXPECT_EQ(a.poses[f].expression, b.poses[f].expression);
  }
  EXPECT_NE(a.poses[9].joint_rotation, c.poses[9].joint_rotation);
  EXPECT_NE(a.poses[9].joint_rotation, d.poses[9].joint_rotation);
  // Below 4 m/s.
  EXPECT_LT(largest_step(a), 0.133);
  EXPECT_LT(largest_step(d), 0.133);
  EXPECT_GT(largest_step(a), 0.001);
}

TEST(BodyMotion, StandsOnTheFloor) {
  const BodyMotion motion = range_of_motion(body(), 40, 4, 3);
  std::vector<float> vertices;
  for (const RigPose& pose : motion.poses) {
    pose_vertices(body().shape, pose, vertices);
    float low = 9;
    for (size_t i = 1; i < vertices.size(); i += 3) low = std::min(low, vertices[i]);
    EXPECT_NEAR(low, 0, 0.03);
  }
}

// Over the range of motion few triangles turn over against the average of their own skinning
// rotation, and few shrink to nothing.
TEST(BodyMotion, SkinDoesNotCollapse) {
  const BodyMotion motion = range_of_motion(body(), 24, 1, 11);
  const Mesh& mesh = body().rig.mesh;
  const size_t joints = body().rig.parents.size();
  std::vector<float> vertices;
  size_t bad = 0, all = 0;
  for (const RigPose& pose : motion.poses) {
    pose_vertices(body().shape, pose, vertices);
    const std::vector<float> m = joint_transforms(body().shape, pose);
    std::vector<Mat3f> turns(static_cast<size_t>(mesh.vertex_count()), Mat3f::Zero());
    for (size_t v = 0; v < turns.size(); ++v)
      for (size_t j = 0; j < joints; ++j) {
        const float w = body().rig.weights[v * joints + j];
        if (w == 0) continue;
        for (int r = 0; r < 3; ++r)
          for (int c = 0; c < 3; ++c) turns[v](r, c) += w * m[12 * j + 4 * r + c] / 3;
      }
    for (size_t f = 0; f < mesh.triangles.size(); ++f) {
      if (mesh.triangle_part[f] < 5) continue;  // the head's own
      const Vec3i& t = mesh.triangles[f];
      const Mat3f turn = turns[t[0]] + turns[t[1]] + turns[t[2]];
      const Vec3f rest =
          (mesh.vertex(t[1]) - mesh.vertex(t[0])).cross(mesh.vertex(t[2]) - mesh.vertex(t[0]));
      const Vec3f now = (point(vertices, t[1]) - point(vertices, t[0]))
                            .cross(point(vertices, t[2]) - point(vertices, t[0]));
      ++all;
      bad += now.dot(turn * rest) <= 0 || now.norm() < 0.05f * rest.norm();
    }
  }
  EXPECT_LT(static_cast<double>(bad), 0.004 * static_cast<double>(all));
}

std::string error_of(const std::string& text) {
  const BvhFile file(text);
  try {
    read_bvh(file.path());
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

TEST(Bvh, RefusesBrokenFilesWithTheLine) {
  const std::string good = sound_file(0);
  EXPECT_EQ(error_of(good), "");
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    text.replace(text.find(from), from.size(), to);
    return error_of(text);
  };
  EXPECT_NE(with("HIERARCHY", "JUNK").find("line 1"), std::string::npos);
  EXPECT_NE(with("Xposition", "Wposition").find("Wposition"), std::string::npos);
  EXPECT_NE(with("CHANNELS 6", "CHANNELS 99"), "");
  EXPECT_NE(with("Frames: 2", "Frames: 900000"), "");
  EXPECT_NE(with("Frames: 2", "Frames: -2"), "");
  EXPECT_NE(with("Frame Time: 0.0333333", "Frame Time: 0"), "");
  EXPECT_NE(with("1 90 0", "nan 90 0"), "");
  EXPECT_NE(with("1 90 0", "1e99 90 0"), "");
  EXPECT_NE(error_of(good.substr(0, good.size() / 2)), "");
  EXPECT_NE(error_of(good + " 1 2 3"), "");
  std::string deep = kHierarchy;
  for (int i = 0; i < 5000; ++i) deep += "JOINT a { OFFSET 0 0 0 CHANNELS 0 ";
  EXPECT_NE(error_of(deep).find("deep"), std::string::npos);
  EXPECT_NE(error_of(""), "");
}

}  // namespace
}  // namespace effigy
