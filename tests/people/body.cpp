// The built-in body: what makes it usable as a rig and a capture's subject, and what makes it a
// body.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "effigy/base/error.h"
#include "effigy/geometry/atlas.h"
#include "effigy/geometry/topology.h"
#include "effigy/people/builtin_body.h"
#include "effigy/rays/ray_scene.h"

namespace effigy {
namespace {

const BuiltinBody& body() {
  return builtin_body(1);
}

Vec3f point(const std::vector<float>& values, int i) {
  return Vec3f(values.data() + 3 * i);
}

void turn(RigPose& pose, const std::string& joint, const Vec3f& rotation) {
  const int j = body().rig.joint(joint);
  ASSERT_GE(j, 0) << joint;
  for (int c = 0; c < 3; ++c) pose.joint_rotation[3 * j + c] = rotation[c];
}

RigPose squat() {
  RigPose pose = RigPose::rest(body().rig);
  for (const std::string side : {"_left", "_right"}) {
    turn(pose, "upper_leg" + side, {-1.5f, 0, 0});
    turn(pose, "lower_leg" + side, {1.8f, 0, 0});
    turn(pose, "foot" + side, {-0.4f, 0, 0});
  }
  turn(pose, "spine", {0.5f, 0, 0});
  drive_body_helpers(body(), pose);
  return pose;
}

TEST(BuiltinBody, SkinAndClothesAreOneClosedSurface) {
  // Face, mouth and body hang together; eyes, teeth and tongue are pieces of their own.
  const Mesh& mesh = body().rig.mesh;
  const auto pieces = connected_pieces(mesh.triangles, mesh.vertex_count());
  const int trunk = pieces[mesh.triangles.back()[0]];
  std::vector<Vec3i> skin;
  for (const Vec3i& t : mesh.triangles)
    if (pieces[t[0]] == trunk) skin.push_back(t);
  EXPECT_GT(skin.size(), 0.9 * mesh.triangles.size());
  EXPECT_TRUE(boundary_loops(skin, mesh.vertex_count()).empty());
  std::set<std::pair<int, int>> directed;
  for (const Vec3i& t : skin)
    for (int k = 0; k < 3; ++k) EXPECT_TRUE(directed.insert({t[k], t[(k + 1) % 3]}).second);
}

TEST(BuiltinBody, AtlasHasNoOverlaps) {
  const AtlasReport report = inspect_atlas(body().rig.mesh, 1024);
  EXPECT_EQ(report.overlaps, 0);
  EXPECT_EQ(report.clockwise, 0);
  EXPECT_GT(report.coverage, 0.6);
}

TEST(BuiltinBody, FaceAndHandsGetMoreTexels) {
  const Mesh& mesh = body().rig.mesh;
  std::map<std::string, double> uv, space;
  for (int f = 0; f < mesh.triangle_count(); ++f) {
    const Vec3i &t = mesh.triangles[f], &u = mesh.uv_triangles[f];
    const Vec2f a = mesh.uvs[u[1]] - mesh.uvs[u[0]], b = mesh.uvs[u[2]] - mesh.uvs[u[0]];
    const std::string& part = mesh.parts[mesh.triangle_part[f]];
    uv[part] += 0.5 * (a.x() * b.y() - a.y() * b.x());
    space[part] +=
        0.5 *
        (mesh.vertex(t[1]) - mesh.vertex(t[0])).cross(mesh.vertex(t[2]) - mesh.vertex(t[0])).norm();
  }
  const auto density = [&](const std::string& part) { return std::sqrt(uv[part] / space[part]); };
  EXPECT_GT(density("face"), 2 * density("top"));
  EXPECT_GT(density("hands"), 1.5 * density("top"));
}

TEST(BuiltinBody, HasAPersonsMeasures) {
  const Mesh& mesh = body().rig.mesh;
  float low = 9, high = -9;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    low = std::min(low, mesh.vertex(v).y());
    high = std::max(high, mesh.vertex(v).y());
  }
  EXPECT_NEAR(low, 0, 0.01);
  EXPECT_NEAR(high, 1.70, 0.02);
  const auto joint = [](const char* name) {
    return point(body().shape.joints, body().rig.joint(name));
  };
  const auto length = [&](const char* a, const char* b) { return (joint(a) - joint(b)).norm(); };
  // Segment lengths over stature after Drillis and Contini 1966: upper arm 0.186 with the acromion,
  // forearm 0.146, thigh 0.245, shank 0.246; hand 0.108.
  EXPECT_NEAR(length("upper_arm_left", "lower_arm_left") / 1.70, 0.172, 0.016);
  EXPECT_NEAR(length("lower_arm_left", "hand_left") / 1.70, 0.146, 0.01);
  EXPECT_NEAR(length("upper_leg_left", "lower_leg_left") / 1.70, 0.245, 0.012);
  EXPECT_NEAR(length("lower_leg_left", "foot_left") / 1.70, 0.240, 0.012);
}

TEST(BuiltinBody, SkeletonHasFingersAndWeightsSumToOne) {
  const Rig& rig = body().rig;
  EXPECT_GE(rig.joint_count(), 50);
  for (const char* name :
       {"hips", "head", "hand_left", "thumb_distal_right", "little_proximal_left"})
    EXPECT_GE(rig.joint(name), 0) << name;
  const size_t joints = rig.parents.size();
  for (size_t v = 0; v < rig.weights.size() / joints; ++v) {
    double sum = 0;
    for (size_t j = 0; j < joints; ++j) {
      EXPECT_GE(rig.weights[v * joints + j], 0);
      sum += rig.weights[v * joints + j];
    }
    EXPECT_NEAR(sum, 1, 1e-5);
  }
}

TEST(BuiltinBody, EveryJointMovesOnlyItsOwnSide) {
  const Rig& rig = body().rig;
  const size_t joints = rig.parents.size();
  for (size_t v = 0; v < rig.weights.size() / joints; ++v) {
    const float x = rig.mesh.vertex(static_cast<int>(v)).x();
    if (std::abs(x) < 0.12f) continue;
    for (size_t j = 0; j < joints; ++j)
      if (rig.joint_names[j].ends_with(x > 0 ? "_right" : "_left")) {
        EXPECT_LT(rig.weights[v * joints + j], 0.02f) << rig.joint_names[j];
      }
  }
}

// Whether p is inside the closed surface: most rays leave through an odd number of faces.
bool inside(const RayScene& scene, const Vec3f& p) {
  int votes = 0;
  for (const Vec3f& direction :
       {Vec3f(0.3f, 0.8f, 0.52f), Vec3f(-0.7f, 0.1f, 0.7f), Vec3f(0.2f, -0.3f, -0.93f)}) {
    int hits = 0;
    float near = 0;
    for (int i = 0; i < 60; ++i) {
      const RayHit hit = scene.closest(p, direction, near);
      if (hit.triangle < 0) break;
      ++hits;
      near = hit.distance + 1e-5f;
    }
    votes += hits % 2;
  }
  return votes >= 2;
}

TEST(BuiltinBody, KeypointsAreInsideTheBody) {
  const std::vector<std::string> names = body_keypoint_names(body());
  std::set<std::string> unique(names.begin(), names.end());
  EXPECT_EQ(unique.size(), names.size());
  EXPECT_TRUE(unique.count("index_tip_left") && unique.count("little_intermediate_right"));
  for (const RigPose& pose : {RigPose::rest(body().rig), squat()}) {
    std::vector<float> vertices;
    pose_vertices(body().shape, pose, vertices);
    const RayScene scene(vertices, body().rig.mesh.triangles);
    const BodyKeypoints keypoints = body_keypoints(body(), pose);
    ASSERT_EQ(keypoints.body.size(), 3 * names.size());
    EXPECT_EQ(keypoints.face.size(), 3 * (body().rig.multipie.size() + 2));
    for (size_t i = 0; i < names.size(); ++i) {
      const Vec3f p = point(keypoints.body, static_cast<int>(i));
      // The tips lie on the surface.
      if (names[i].find("_tip") == std::string::npos) {
        EXPECT_TRUE(inside(scene, p)) << names[i];
      }
    }
  }
}

TEST(BuiltinBody, SubjectsDifferAndAreTheSameEveryTime) {
  const BuiltinBody& other = builtin_body(2);
  EXPECT_NE(other.rig.mesh.vertices, body().rig.mesh.vertices);
  EXPECT_EQ(other.head_vertices, body().head_vertices);
  const AtlasReport report = inspect_atlas(other.rig.mesh, 1024);
  EXPECT_EQ(report.overlaps, 0);
  EXPECT_EQ(report.clockwise, 0);
}

TEST(BodyCloth, NoWrinklesAtRest) {
  BodyCloth cloth(body());
  cloth.settle(RigPose::rest(body().rig));
  for (const float w : cloth.wrinkles()) EXPECT_EQ(w, 0);
  // Linear blend skinning rounds.
  for (size_t i = 0; i < cloth.vertices().size(); ++i)
    EXPECT_NEAR(cloth.vertices()[i], body().rig.mesh.vertices[i], 2e-6);
}

double roughness_of(const std::vector<float>& wrinkles) {
  double sum = 0;
  for (const float w : wrinkles) sum += static_cast<double>(w) * w;
  return std::sqrt(sum / static_cast<double>(wrinkles.size()));
}

TEST(BodyCloth, WrinklesFollowThePoseWithALag) {
  BodyCloth settled(body()), moving(body());
  settled.settle(squat());
  const double full = roughness_of(settled.wrinkles());
  EXPECT_GT(full, 3e-4);
  moving.settle(RigPose::rest(body().rig));
  double before = 0;
  for (int frame = 0; frame < 60; ++frame) {
    moving.advance(squat(), 1.0 / 30);
    const double now = roughness_of(moving.wrinkles());
    EXPECT_GE(now, before - 1e-9);
    before = now;
    if (frame == 0) {
      EXPECT_LT(now, 0.5 * full);
    }
  }
  EXPECT_NEAR(before, full, 0.02 * full);
  // The tracked mesh knows nothing of it.
  std::vector<float> tracked;
  pose_vertices(body().shape, squat(), tracked);
  EXPECT_EQ(moving.tracked(), tracked);
  // And they go again, more slowly than they came.
  moving.advance(RigPose::rest(body().rig), 1.0 / 30);
  EXPECT_GT(roughness_of(moving.wrinkles()), 0.5 * full);
}

TEST(BodyCloth, MovesClothOnly) {
  BodyCloth cloth(body());
  cloth.settle(RigPose::rest(body().rig));
  cloth.advance(squat(), 1.0 / 30);
  const Mesh& mesh = body().rig.mesh;
  std::vector<char> clothed(mesh.vertex_count(), 0);
  for (int f = 0; f < mesh.triangle_count(); ++f)
    if (body_part_label(mesh.parts[mesh.triangle_part[f]]) == BodyLabel::kCloth)
      for (int k = 0; k < 3; ++k) clothed[mesh.triangles[f][k]] = 1;
  double largest = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const double moved = (point(cloth.vertices(), v) - point(cloth.tracked(), v)).norm();
    if (!clothed[v]) {
      EXPECT_EQ(moved, 0);
    }
    largest = std::max(largest, moved);
  }
  EXPECT_GT(largest, 0.003);
  EXPECT_LT(largest, 0.05);
}

TEST(BodyCloth, RefusesImpossibleTimes) {
  BodyCloth cloth(body());
  cloth.settle(squat());
  EXPECT_THROW(cloth.advance(squat(), 0), Error);
  EXPECT_THROW(cloth.advance(squat(), NAN), Error);
}

TEST(BodyMaterials, AreFiniteAndLabelled) {
  const BodyMaterials m = builtin_body_materials(body(), 256);
  std::map<uint8_t, int> labels;
  for (const uint8_t label : m.labels) ++labels[label];
  for (const BodyLabel label :
       {BodyLabel::kSkin, BodyLabel::kHair, BodyLabel::kEyes, BodyLabel::kTeeth, BodyLabel::kHands,
        BodyLabel::kCloth, BodyLabel::kShoes})
    EXPECT_GT(labels[static_cast<uint8_t>(label)], 0) << static_cast<int>(label);
  for (const float x : m.albedo.data) {
    EXPECT_GT(x, 0);
    EXPECT_LT(x, 1);
  }
  // Light spreads in skin, not in cloth and hair.
  for (size_t i = 0; i < m.labels.size(); ++i) {
    const auto label = static_cast<BodyLabel>(m.labels[i]);
    if (label == BodyLabel::kHands) {
      EXPECT_GT(m.scatter.data[i], 0.9f);
    }
    if (label == BodyLabel::kCloth || label == BodyLabel::kShoes) {
      EXPECT_EQ(m.scatter.data[i], 0);
    }
  }
  for (size_t i = 0; i < m.normal.data.size(); i += 3)
    EXPECT_NEAR(Vec3f(m.normal.data.data() + i).norm(), 1, 1e-4);
  EXPECT_EQ(builtin_body_materials(body(), 256).albedo.data, m.albedo.data);
  EXPECT_THROW(builtin_body_materials(body(), 4), Error);
}

}  // namespace
}  // namespace effigy
