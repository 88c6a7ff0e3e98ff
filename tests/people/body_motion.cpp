// Motions of the built-in body, and BVH files as hostile input.

#include "effigy/people/body_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/file.h"

namespace effigy {
namespace {

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

const std::string kHierarchy = R"(HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
)";

std::string limb(const std::string& side, double s) {
  const auto joint = [&](const std::string& name, double x, double y, double z,
                         const std::string& inner) {
    return "JOINT " + side + name + "\n{\nOFFSET " + std::to_string(s * x) + " " +
           std::to_string(y) + " " + std::to_string(z) +
           "\nCHANNELS 3 Zrotation Yrotation Xrotation\n" + inner + "}\n";
  };
  const std::string end = "End Site\n{\nOFFSET 0 -5 0\n}\n";
  return joint(
             "UpLeg", 9, -4, 0,
             joint("Leg", 0, -40, 0, joint("Foot", 0, -40, 0, joint("ToeBase", 0, -4, 13, end)))) +
         joint("Arm", 18, 45, 0, joint("ForeArm", 28, 0, 0, joint("Hand", 25, 0, 0, end)));
}

// A T-posed skeleton in centimetres whose left forearm is turned by `angle` degrees about y.
std::string sound_file(double angle) {
  std::string text = kHierarchy + limb("Left", 1) + limb("Right", -1) +
                     "}\nMOTION\nFrames: 2\nFrame Time: 0.0333333\n";
  for (int frame = 0; frame < 2; ++frame) {
    text += "1 90 0 0 0 0";
    for (int joint = 0; joint < 14; ++joint)
      text += joint == 5 ? " 0 " + std::to_string(-angle) + " 0" : " 0 0 0";
    text += "\n";
  }
  return text;
}

class BvhFile {
 public:
  explicit BvhFile(const std::string& text)
      : path_(std::filesystem::temp_directory_path() /
              ("effigy_body_" + std::to_string(::getpid()) + ".bvh")) {
    write_text(path_, text);
  }
  ~BvhFile() { std::filesystem::remove(path_); }
  const Path& path() const { return path_; }

 private:
  Path path_;
};

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

Vec3f bone(const RigPose& pose, const char* a, const char* b) {
  const std::vector<float> m = joint_transforms(body().shape, pose);
  const auto at = [&](const char* name) {
    const int j = body().rig.joint(name);
    const Vec3f rest = point(body().shape.joints, j);
    Vec3f p;
    for (int r = 0; r < 3; ++r)
      p[r] = Eigen::Map<const Vec3f>(m.data() + 12 * j + 4 * r).dot(rest) + m[12 * j + 4 * r + 3];
    return p;
  };
  return (at(b) - at(a)).normalized();
}

TEST(Retarget, BonesPointWhereTheFilesBonesPoint) {
  const BvhFile file(sound_file(70));
  const Bvh bvh = read_bvh(file.path());
  const BodyMotion motion = retarget_bvh(body(), bvh, "test.bvh", 2, 30);
  ASSERT_EQ(motion.poses.size(), 2u);
  std::vector<Mat3d> rotations;
  std::vector<Vec3d> positions;
  bvh.pose(0, rotations, positions);
  int checked = 0;
  for (const BvhMatch& m : match_bvh(body().rig, bvh)) {
    if (m.child < 0) continue;
    const Vec3f theirs =
        (positions[m.source_child] - positions[m.source]).normalized().cast<float>();
    const Vec3f ours = bone(motion.poses[0], body().rig.joint_names[m.joint].c_str(),
                            body().rig.joint_names[m.child].c_str());
    EXPECT_GT(ours.dot(theirs), 0.9999f) << body().rig.joint_names[m.joint];
    ++checked;
  }
  EXPECT_GE(checked, 10);
  // The arm is stretched out, the forearm turned by the angle.
  EXPECT_NEAR(bone(motion.poses[0], "upper_arm_left", "lower_arm_left").x(), 1, 1e-3);
  EXPECT_NEAR(std::acos(bone(motion.poses[0], "lower_arm_left", "hand_left").x()), 70 * M_PI / 180,
              1e-3);
}

TEST(Retarget, NeedsLimbs) {
  const BvhFile file(
      kHierarchy +
      "End Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\nFrame Time: 0.03\n0 0 0 0 0 0\n");
  const Bvh bvh = read_bvh(file.path());
  EXPECT_THROW(retarget_bvh(body(), bvh, "test.bvh", 1, 30), Error);
}

TEST(Retarget, PlaysACmuClip) {
  const char* data = std::getenv("EFFIGY_DATA");
  const Path path = Path(data ? data : "") / "body/mocap/cmu_01_01.bvh";
  if (!data || !std::filesystem::exists(path))
    GTEST_SKIP() << "needs EFFIGY_DATA/body/mocap/cmu_01_01.bvh";
  const Bvh bvh = read_bvh(path);
  EXPECT_EQ(bvh.frames(), 2752);
  // From the tenth frame on, as the clip starts in a T-pose of one frame.
  const double first = 10 * bvh.frame_seconds;
  const BodyMotion motion = retarget_bvh(body(), bvh, path.string(), 100, 10, first);
  ASSERT_EQ(motion.poses.size(), 100u);
  EXPECT_LT(largest_step(motion), 0.5);
  for (size_t f = 0; f < motion.poses.size(); f += 10) {
    std::vector<Mat3d> rotations;
    std::vector<Vec3d> positions;
    bvh.pose(static_cast<int>((first + static_cast<double>(f) / 10) / bvh.frame_seconds + 0.5),
             rotations, positions);
    for (const BvhMatch& m : match_bvh(body().rig, bvh)) {
      if (m.child < 0) continue;
      const Vec3d theirs = positions[m.source_child] - positions[m.source];
      if (theirs.norm() < 1e-6) continue;
      const Vec3f ours = bone(motion.poses[f], body().rig.joint_names[m.joint].c_str(),
                              body().rig.joint_names[m.child].c_str());
      EXPECT_GT(ours.dot(theirs.normalized().cast<float>()), 0.999f)
          << body().rig.joint_names[m.joint];
    }
    std::vector<float> vertices;
    pose_vertices(body().shape, motion.poses[f], vertices);
    for (const float x : vertices) ASSERT_TRUE(std::isfinite(x));
  }
}

}  // namespace
}  // namespace effigy
