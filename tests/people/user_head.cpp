// The users' own heads: what is cut, what the joints and shapes are called, how it looks.

#include "effigy/people/user_head.h"

#include <algorithm>

#include "effigy/geometry/atlas.h"
#include "effigy/people/expression_names.h"
#include "effigy/people/humanoid.h"
#include "support.h"
#include "tiny_head_gltf.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;
using test::TinyHeadGltf;
using test::TinyHeadOptions;

UserHead head_of(const TinyHeadOptions& options) {
  const test::ScratchFolder scratch;
  TinyHeadGltf(options).write(scratch.path(), "person.gltf");
  return read_user_head(scratch / "person.gltf", 128);
}

Vec3f low_of(const Rig& rig) {
  Vec3f low = rig.mesh.vertex(0);
  for (int v = 0; v < rig.mesh.vertex_count(); ++v) low = low.cwiseMin(rig.mesh.vertex(v));
  return low;
}

TEST(ExpressionNames, AreFoundHoweverTheyAreSpelt) {
  const std::vector<std::pair<const char*, const char*>> names = {
      {"jawOpen", "jawOpen"},
      {"JawOpen", "jawOpen"},
      {"blendShape1.jawOpen", "jawOpen"},
      {"Wolf3D_Head:jaw_open", "jawOpen"},
      {"mouthSmile_L", "mouthSmile_L"},
      {"mouthSmileLeft", "mouthSmile_L"},
      {"face_MouthSmile.R", "mouthSmile_R"},
      {"EYE_BLINK_LEFT", "eyeBlink_L"},
      {"Blink_R", "eyeBlink_R"},
      {"eyesClosed", "eyeBlink"},
      {"mouthLeft", "mouthLeft"},
      {"jawRight", "jawRight"},
      {"browInnerUp", "browInnerUp"},
      {"cheekPuff", "cheekPuff"},
      {"mouthOpen", "jawOpen"},
      {"eye-left-closure", "eyeBlink_L"},
      {"eyebrows-right-extern-up", "browOuterUp_R"},
      {"mouth-corner-puller", "mouthSmile"},
      {"viseme_aa", ""},
      {"Bulge", ""},
      {"left", ""},
      {"", ""}};
  for (const auto& [name, expression] : names)
    EXPECT_EQ(known_expression(name), expression) << name;
}

TEST(FaceJoints, AreFoundByTheirUsualNames) {
  const auto find = [](const std::vector<std::string>& names) { return face_joints(names); };
  EXPECT_EQ(find({"head", "jaw", "eye.L", "eye.R"}),
            (std::map<std::string, int>{{"jaw", 1}, {"eye_left", 2}, {"eye_right", 3}}));
  EXPECT_EQ(find({"mixamorig:LeftEye", "J_Adj_R_FaceEye", "FACIAL_C_Jaw"}),
            (std::map<std::string, int>{{"jaw", 2}, {"eye_left", 0}, {"eye_right", 1}}));
  EXPECT_TRUE(find({"LeftEyebrow", "arm"}).empty());
}

TEST(UserHead, OfABodyOnlyTheHeadStays) {
  const UserHead head = head_of({});
  const Rig& rig = head.look.rig;
  EXPECT_TRUE(head.cut);
  EXPECT_EQ(rig.kind, "user");
  EXPECT_EQ(rig.joint_names, (std::vector<std::string>{"root", "neck", "jaw"}));
  EXPECT_GT(low_of(rig).y(), 1.48f);
  // The seam's doubled vertices and poles are one each.
  EXPECT_EQ(rig.mesh.vertex_count(), 11 * 20 + 2);
  EXPECT_EQ(inspect_atlas(rig.mesh, 128).overlaps, 0);
  // The trunk's target moves nothing here.
  EXPECT_EQ(rig.expression_names, (std::vector<std::string>{"jawOpen", "mouthSmile_L"}));
  EXPECT_EQ(head.known_expressions, 2);
  EXPECT_EQ(rig.expression_high, (std::vector<float>{1, 1}));
  EXPECT_EQ(rig.mediapipe.size(), 0u);
  const RigShape shape = shape_rig(rig, {});
  EXPECT_NEAR(shape.joints[3 * 2 + 1], 1.55, 1e-4);
  EXPECT_NEAR(shape.joints[3 * 1 + 1], 1.48, 1e-4);
  // Speech moves the lower half down, the jaw's joint turns only the chin.
  RigPose pose = RigPose::rest(rig);
  pose.expression[0] = 1;
  std::vector<float> vertices;
  pose_vertices(shape, pose, vertices);
  double most = 0;
  for (size_t i = 1; i < vertices.size(); i += 3)
    most = std::max(most, static_cast<double>(rig.mesh.vertices[i] - vertices[i]));
  EXPECT_NEAR(most, 0.02, 1e-5);
  pose = RigPose::rest(rig);
  pose.joint_rotation[6] = 0.3f;
  pose_vertices(shape, pose, vertices);
  int moved = 0;
  float chin = 0;
  for (size_t i = 0; i < vertices.size(); i += 3)
    if ((Vec3f(&vertices[i]) - Vec3f(&rig.mesh.vertices[i])).norm() > 1e-4f) {
      ++moved;
      chin = std::min(chin, vertices[i + 1] - rig.mesh.vertices[i + 1]);
    }
  EXPECT_GT(moved, 5);
  EXPECT_LT(moved, 60);
  EXPECT_LT(chin, -0.01f);  // it opens downwards
}

TEST(UserHead, EyesThatTurnAreParts) {
  TinyHeadOptions options;
  options.targets.clear();
  const UserHead head = head_of(options);
  EXPECT_EQ(head.look.rig.expression_count, 0);
  // No vertex follows the file's eye joints, so the rig has none.
  EXPECT_EQ(head.look.rig.joint("eye_left"), -1);
  const std::vector<std::string>& parts = head.look.rig.mesh.parts;
  EXPECT_NE(std::find(parts.begin(), parts.end(), "skin"), parts.end());
}

// Pictures arrive where the surface is, and normals in the new atlas's frame.
TEST(UserHead, LooksAsTheFileSays) {
  const UserBody look = head_of({}).look;
  const Mesh& mesh = look.rig.mesh;
  const TexelMap map = texel_map(mesh, 128);
  ASSERT_FALSE(look.normal.empty());
  int seen = 0;
  for (size_t i = 0; i < map.triangle.size(); ++i) {
    if (map.triangle[i] < 0) continue;
    const auto f = static_cast<size_t>(map.triangle[i]);
    const Vec3i &t = mesh.triangles[f], &u = mesh.uv_triangles[f];
    const float b1 = map.barycentric[2 * i], b2 = map.barycentric[2 * i + 1];
    const Vec3f p =
        (1 - b1 - b2) * mesh.vertex(t[0]) + b1 * mesh.vertex(t[1]) + b2 * mesh.vertex(t[2]);
    const Vec3f out = (p - Vec3f(0, 1.6f, 0.02f)) / 0.11f;
    if (std::abs(out.y()) < 0.1f || std::abs(out.y()) > 0.8f) continue;
    const float* colour = &look.albedo.data[3 * i];
    EXPECT_EQ(colour[0] > colour[1], out.y() > 0);
    EXPECT_NEAR(look.roughness.data[i], 0.8, 1e-3);
    // The file's +u runs to the person's left around the head, seen from the front to the right.
    const Vec3f n(&look.normal.data[3 * i]);
    EXPECT_NEAR(n.norm(), 1, 1e-4);
    const Vec2f d1 = mesh.uvs[static_cast<size_t>(u[1])] - mesh.uvs[static_cast<size_t>(u[0])],
                d2 = mesh.uvs[static_cast<size_t>(u[2])] - mesh.uvs[static_cast<size_t>(u[0])];
    const Vec3f e1 = mesh.vertex(t[1]) - mesh.vertex(t[0]),
                e2 = mesh.vertex(t[2]) - mesh.vertex(t[0]), normal = e1.cross(e2).normalized();
    const float area = d1.x() * d2.y() - d1.y() * d2.x();
    const Vec3f along = ((e1 * d2.y() - e2 * d1.y()) / area).normalized();
    const Vec3f across = (area < 0 ? -1.0f : 1.0f) * normal.cross(along);
    const Vec3f world = n.x() * along + n.y() * across + n.z() * normal;
    const Vec3f around = Vec3f(out.z(), 0, -out.x()).normalized();
    EXPECT_GT(world.dot(around), 0.2f);
    ++seen;
  }
  EXPECT_GT(seen, 1000);
}

TEST(UserHead, TurnsToTheFront) {
  TinyHeadOptions options;
  const Rig ahead = head_of(options).look.rig;
  options.turn = 1.5708;
  const Rig turned = head_of(options).look.rig;
  ASSERT_EQ(ahead.mesh.vertex_count(), turned.mesh.vertex_count());
  for (size_t i = 0; i < ahead.mesh.vertices.size(); ++i)
    ASSERT_NEAR(ahead.mesh.vertices[i], turned.mesh.vertices[i], 1e-4);
  for (size_t i = 0; i < ahead.expression_basis.size(); ++i)
    ASSERT_NEAR(ahead.expression_basis[i], turned.expression_basis[i], 1e-4);
}

TEST(UserHead, AHeadAloneIsTakenWhole) {
  TinyHeadOptions options;
  options.body = false;
  EXPECT_FALSE(head_of(options).cut);
  // Without a skeleton it turns about the middle of its lowest part.
  options.skin = false;
  options.sparse = true;
  const UserHead head = head_of(options);
  EXPECT_EQ(head.look.rig.joint_names, (std::vector<std::string>{"root", "neck"}));
  EXPECT_EQ(head.look.rig.expression_names, (std::vector<std::string>{"jawOpen", "mouthSmile_L"}));
  const RigShape shape = shape_rig(head.look.rig, {});
  EXPECT_NEAR(shape.joints[3], 0, 1e-3);
  EXPECT_NEAR(shape.joints[4], 1.5, 0.03);
}

TEST(UserHead, WhatCannotBeAHeadIsRefused) {
  TinyHeadOptions options;
  options.scale = 100;
  EXPECT_TRUE(contains(error_of([&] { head_of(options); }), "metres tall"));
  const test::ScratchFolder scratch;
  TinyHeadGltf({}).write(scratch.path(), "person.gltf");
  const std::string good = read_text(scratch / "person.gltf");
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size()))
      text.replace(at, from.size(), to);
    EXPECT_NE(text, good) << from;
    write_text(scratch / "bad.gltf", text);
    return error_of([&] { read_user_head(scratch / "bad.gltf", 64); });
  };
  const auto nameless = [&] {
    std::string all = good;
    for (const char* name : {"mixamorig:Head", "mixamorig:Neck"}) {
      const size_t at = all.find(name);
      all.replace(at, std::string(name).size(), "bone");
    }
    write_text(scratch / "bad.gltf", all);
    return error_of([&] { read_user_head(scratch / "bad.gltf", 64); });
  };
  EXPECT_TRUE(contains(nameless(), "no joint called neck or head"));
  EXPECT_TRUE(contains(with("\"TEXCOORD_0\"", "\"TEXCOORD_7\""), "no UVs"));
  EXPECT_TRUE(contains(error_of([&] { read_user_head(scratch / "none.glb", 64); }), "none.glb"));
  std::string extended = good;
  extended.insert(1, "\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],");
  write_text(scratch / "bad.gltf", extended);
  EXPECT_TRUE(contains(error_of([&] { read_user_head(scratch / "bad.gltf", 64); }),
                       "KHR_draco_mesh_compression"));
}

TEST(UserHead, OfAClothedPersonFromAFile) {
  const Path data = test::outside_data("EFFIGY_DATA");
  const Path file = data / "body/morse_human/morse_makehuman_human.glb";
  if (data.empty() || !std::filesystem::exists(file))
    GTEST_SKIP() << "needs EFFIGY_DATA/body/morse_human";
  const UserHead head = read_user_head(file, 128);
  EXPECT_TRUE(head.cut);
  const Rig& rig = head.look.rig;
  EXPECT_EQ(rig.joint_names, (std::vector<std::string>{"root", "neck"}));
  EXPECT_GT(low_of(rig).y(), 1.35f);
  EXPECT_FALSE(rig.neck_ring.empty());
  // In the file it looks along +x.
  float front = -9, side = -9;
  for (int v = 0; v < rig.mesh.vertex_count(); ++v) {
    front = std::max(front, rig.mesh.vertex(v).z());
    side = std::max(side, std::abs(rig.mesh.vertex(v).x()));
  }
  EXPECT_GT(front, 0.12f);
  EXPECT_LT(side, 0.16f);
}

TEST(UserHead, OfMakeHuman) {
  const Path data = test::outside_data("EFFIGY_DATA");
  if (data.empty() || !std::filesystem::exists(data / "body/makehuman/3dobjs/base.obj"))
    GTEST_SKIP() << "needs EFFIGY_DATA/body/makehuman";
  const UserHead head = read_user_head(data / "body/makehuman", 128);
  const Rig& rig = head.look.rig;
  EXPECT_EQ(rig.joint_names,
            (std::vector<std::string>{"root", "neck", "jaw", "eye_left", "eye_right"}));
  for (const char* name : {"jawOpen", "eyeBlink_L", "eyeBlink_R", "mouthSmile", "browDown_L"})
    EXPECT_GE(rig.expression(name), 0) << name;
  const RigShape shape = shape_rig(rig, {});
  EXPECT_GT(shape.joints[3 * 3], 0.02f);  // the left eye
}

}  // namespace
}  // namespace effigy
