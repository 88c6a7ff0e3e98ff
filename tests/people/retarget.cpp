// BVH files on the built-in body and on the users' own.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>

#include "effigy/base/error.h"
#include "effigy/people/body_motion.h"
#include "effigy/people/humanoid.h"
#include "effigy/people/user_body.h"
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

std::vector<Vec3d> joint_places(const RigShape& shape, const RigPose& pose) {
  const std::vector<float> m = joint_transforms(shape, pose);
  std::vector<Vec3d> places;
  for (size_t j = 0; j < shape.parents.size(); ++j) {
    const Vec3f rest = point(shape.joints, static_cast<int>(j));
    Vec3d p;
    for (size_t r = 0; r < 3; ++r)
      p[static_cast<int>(r)] = static_cast<double>(
          Eigen::Map<const Vec3f>(m.data() + 12 * j + 4 * r).dot(rest) + m[12 * j + 4 * r + 3]);
    places.push_back(p);
  }
  return places;
}

// Expects every matched bone to point where the file's bone does; the number of bones.
int check_bones(const Rig& rig, const RigShape& shape, const RigPose& pose, const Bvh& bvh,
                int frame, const Mat3d& ours_from_file = Mat3d::Identity()) {
  std::vector<Mat3d> rotations;
  std::vector<Vec3d> positions;
  bvh.pose(frame, rotations, positions);
  const std::vector<Vec3d> places = joint_places(shape, pose);
  const auto between = [](const std::vector<Vec3d>& p, int from, int to) {
    return Vec3d(p[static_cast<size_t>(to)] - p[static_cast<size_t>(from)]);
  };
  int checked = 0;
  for (const BvhMatch& m : match_bvh(rig, bvh)) {
    if (m.child < 0) continue;
    const Vec3d theirs = ours_from_file * between(positions, m.source, m.source_child);
    if (theirs.norm() < 1e-6) continue;
    EXPECT_GT(between(places, m.joint, m.child).normalized().dot(theirs.normalized()), 0.999)
        << m.name << " at " << frame;
    ++checked;
  }
  return checked;
}

double lowest(const RigShape& shape, const RigPose& pose) {
  std::vector<float> vertices;
  pose_vertices(shape, pose, vertices);
  float low = 9;
  for (size_t i = 1; i < vertices.size(); i += 3) low = std::min(low, vertices[i]);
  return static_cast<double>(low);
}

// Every other tool's names are found, whatever their prefix; joints: {name, parent}.
TEST(Humanoid, KnowsManyToolsNames) {
  const auto roles = [](const std::vector<std::pair<const char*, int>>& joints) {
    std::vector<std::string> names;
    std::vector<int> parents;
    for (const auto& [name, parent] : joints) {
      names.emplace_back(name);
      parents.push_back(parent);
    }
    std::map<std::string, std::string> out;
    for (const auto& [role, joint] : humanoid_joints(names, parents))
      out[role] = names[static_cast<size_t>(joint)];
    return out;
  };
  const auto mixamo = roles({{"Armature", -1},
                             {"mixamorig:Hips", 0},
                             {"mixamorig:Spine", 1},
                             {"mixamorig:Spine1", 2},
                             {"mixamorig:Spine2", 3},
                             {"mixamorig:Neck", 4},
                             {"mixamorig:Head", 5},
                             {"mixamorig:RightShoulder", 4},
                             {"mixamorig:RightArm", 7},
                             {"mixamorig:RightForeArm", 8},
                             {"mixamorig:RightHand", 9},
                             {"mixamorig:LeftUpLeg", 1},
                             {"mixamorig:LeftLeg", 11},
                             {"mixamorig:LeftFoot", 12},
                             {"mixamorig:LeftToeBase", 13},
                             {"mixamorig:RightUpLeg", 1}});
  EXPECT_EQ(mixamo.size(), 15u);
  EXPECT_EQ(mixamo.at("hips"), "mixamorig:Hips");
  EXPECT_EQ(mixamo.at("spine"), "mixamorig:Spine");
  EXPECT_EQ(mixamo.at("chest"), "mixamorig:Spine1");
  EXPECT_EQ(mixamo.at("upper_chest"), "mixamorig:Spine2");
  EXPECT_EQ(mixamo.at("upper_arm_right"), "mixamorig:RightArm");
  EXPECT_EQ(mixamo.at("lower_leg_left"), "mixamorig:LeftLeg");
  EXPECT_EQ(mixamo.at("toes_left"), "mixamorig:LeftToeBase");
  // The armature's root has the same name as the joint at the hips.
  const auto makehuman = roles({{"root", -1},
                                {"root", 0},
                                {"spine05", 1},
                                {"spine04", 2},
                                {"spine03", 3},
                                {"spine02", 4},
                                {"spine01", 5},
                                {"neck01", 6},
                                {"shoulder01_L", 6},
                                {"upperarm01.L", 8},
                                {"lowerarm01.L", 9},
                                {"wrist.L", 10},
                                {"pelvis.L", 1},
                                {"upperleg01.L", 12},
                                {"lowerleg01.L", 13},
                                {"foot.L", 14},
                                {"pelvis.R", 1},
                                {"upperleg01.R", 16}});
  EXPECT_EQ(makehuman.at("hips"), "root");
  EXPECT_EQ(makehuman.at("spine"), "spine05");
  EXPECT_EQ(makehuman.at("chest"), "spine03");
  EXPECT_EQ(makehuman.at("upper_chest"), "spine01");
  EXPECT_EQ(makehuman.at("upper_arm_left"), "upperarm01.L");
  EXPECT_EQ(makehuman.at("hand_left"), "wrist.L");
  const auto unreal = roles({{"pelvis", -1},
                             {"spine_01", 0},
                             {"spine_02", 1},
                             {"neck_01", 2},
                             {"clavicle_l", 2},
                             {"upperarm_l", 4},
                             {"lowerarm_l", 5},
                             {"thigh_l", 0},
                             {"calf_l", 7},
                             {"foot_l", 8},
                             {"ball_l", 9},
                             {"thigh_r", 0}});
  EXPECT_EQ(unreal.at("spine"), "spine_01");
  EXPECT_EQ(unreal.at("upper_chest"), "spine_02");
  EXPECT_EQ(unreal.count("chest"), 0u);
  EXPECT_EQ(unreal.at("lower_leg_left"), "calf_l");
  EXPECT_EQ(unreal.at("toes_left"), "ball_l");
  EXPECT_EQ(roles({{"Bip01 L Thigh", -1}, {"Bip01 L Calf", 0}}).at("lower_leg_left"),
            "Bip01 L Calf");
  // The built-in body's names are the roles themselves.
  for (const auto& [role, joint] : humanoid_joints(body().rig.joint_names, body().rig.parents))
    EXPECT_EQ(body().rig.joint_names[static_cast<size_t>(joint)], role);
  EXPECT_EQ(humanoid_joints(body().rig.joint_names, body().rig.parents).size(), 22u);
  EXPECT_TRUE(humanoid_joints({}, {}).empty());
}

TEST(Retarget, BonesPointWhereTheFilesBonesPoint) {
  const BvhFile file(sound_file(70));
  const Bvh bvh = read_bvh(file.path());
  const BodyMotion motion = retarget_bvh(body(), bvh, "test.bvh", 2, 30);
  ASSERT_EQ(motion.poses.size(), 2u);
  EXPECT_GE(check_bones(body().rig, body().shape, motion.poses[0], bvh, 0), 10);
  // The arm is stretched out, the forearm turned by the angle.
  const std::vector<Vec3d> places = joint_places(body().shape, motion.poses[0]);
  const auto bone = [&](const char* from, const char* to) {
    return Vec3d(places[static_cast<size_t>(body().rig.joint(to))] -
                 places[static_cast<size_t>(body().rig.joint(from))])
        .normalized();
  };
  EXPECT_NEAR(bone("upper_arm_left", "lower_arm_left").x(), 1, 1e-3);
  EXPECT_NEAR(std::acos(bone("lower_arm_left", "hand_left").x()), 70 * M_PI / 180, 1e-3);
}

// A body that looks along +x and hangs in the air, as the users' own may.
TEST(Retarget, FindsWhereABodyLooksAndStands) {
  Mat3d turn;
  turn << 0, 0, 1, 0, 1, 0, -1, 0, 0;
  RigShape shape = body().shape;
  for (std::vector<float>* places : {&shape.rest, &shape.joints})
    for (size_t i = 0; i < places->size(); i += 3) {
      Eigen::Map<Vec3f> p(places->data() + i);
      p = turn.cast<float>() * Vec3f(p) + Vec3f(0.2f, 0.7f, -0.1f);
    }
  const BvhFile file(sound_file(70));
  const Bvh bvh = read_bvh(file.path());
  const BodyMotion motion = retarget_bvh(body().rig, shape, bvh, "test.bvh", 2, 30),
                   usual = retarget_bvh(body(), bvh, "test.bvh", 2, 30);
  EXPECT_GE(check_bones(body().rig, shape, motion.poses[0], bvh, 0, turn), 10);
  const std::vector<Vec3d> places = joint_places(shape, motion.poses[0]),
                           straight = joint_places(body().shape, usual.poses[0]);
  for (size_t j = 0; j < places.size(); ++j)
    EXPECT_LT((places[j] - turn * straight[j]).norm(), 2e-3) << body().rig.joint_names[j];
}

TEST(Retarget, NeedsLimbs) {
  const BvhFile file(
      kHierarchy +
      "End Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\nFrame Time: 0.03\n0 0 0 0 0 0\n");
  const Bvh bvh = read_bvh(file.path());
  EXPECT_THROW(retarget_bvh(body(), bvh, "test.bvh", 1, 30), Error);
  // The fault is the body's.
  const BvhFile sound(sound_file(0));
  Rig rig = body().rig;
  rig.joint_names[static_cast<size_t>(rig.joint("upper_arm_left"))] = "bone.017";
  try {
    retarget_bvh(rig, body().shape, read_bvh(sound.path()), "test.bvh", 1, 30);
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("of the body is known as 'upper_arm_left'"),
              std::string::npos)
        << error.what();
  }
}

Path outside(const std::string& name) {
  const char* data = std::getenv("EFFIGY_DATA");
  const Path path = Path(data != nullptr ? data : "") / "body" / name;
  return data != nullptr && std::filesystem::exists(path) ? path : Path();
}

TEST(Retarget, PlaysACmuClip) {
  const Path path = outside("mocap/cmu_01_01.bvh");
  if (path.empty()) GTEST_SKIP() << "needs EFFIGY_DATA/body/mocap/cmu_01_01.bvh";
  const Bvh bvh = read_bvh(path);
  EXPECT_EQ(bvh.frames(), 2752);
  // From the tenth frame on, as the clip starts in a T-pose of one frame.
  const double first = 10 * bvh.frame_seconds;
  const BodyMotion motion = retarget_bvh(body(), bvh, path.string(), 100, 10, first);
  ASSERT_EQ(motion.poses.size(), 100u);
  for (size_t f = 0; f < motion.poses.size(); f += 10) {
    const double seconds = first + static_cast<double>(f) / 10;
    EXPECT_GE(check_bones(body().rig, body().shape, motion.poses[f], bvh,
                          static_cast<int>(seconds / bvh.frame_seconds + 0.5)),
              10);
    EXPECT_TRUE(std::isfinite(lowest(body().shape, motion.poses[f])));
  }
}

// Two bodies of other makers under the motions of two tools.
TEST(Retarget, MovesTheUsersOwn) {
  const Path cmu = outside("mocap/cmu_01_01.bvh"),
             walk = outside("makehuman/animations/walks/walk1.bvh"),
             morse = outside("morse_human/morse_makehuman_human.glb"), base = outside("makehuman");
  if (cmu.empty() || walk.empty() || morse.empty() || base.empty())
    GTEST_SKIP() << "needs EFFIGY_DATA/body";
  Mat3d looks_along_x, z_is_up;
  looks_along_x << 0, 0, 1, 0, 1, 0, -1, 0, 0;
  z_is_up << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  for (const auto& [own, turn] : {std::pair{read_gltf_body(morse, 64), looks_along_x},
                                  {read_makehuman_body(base, {}, 64), Mat3d(Mat3d::Identity())}}) {
    const RigShape shape = shape_rig(own.rig, {});
    for (const Path& path : {cmu, walk}) {
      const Bvh bvh = read_bvh(path);
      const BodyMotion motion = retarget_bvh(own.rig, shape, bvh, path.string(), 10, 20);
      ASSERT_GE(motion.poses.size(), 8u);
      double low = 9;
      for (size_t f = 0; f < motion.poses.size(); f += 3) {
        const double seconds = static_cast<double>(f) / 20;
        const Mat3d up = path == cmu ? turn : Mat3d(turn * z_is_up);
        EXPECT_GE(check_bones(own.rig, shape, motion.poses[f], bvh,
                              static_cast<int>(seconds / bvh.frame_seconds + 0.5), up),
                  own.rig.kind == "gltf" ? 8 : 10);
        low = std::min(low, lowest(shape, motion.poses[f]));
      }
      EXPECT_NEAR(low, 0, 0.06) << own.rig.kind << " " << path;
    }
  }
}

}  // namespace
}  // namespace effigy
