// Rig files: what is written comes back, and damaged files are refused.
#include "effigy/rig/rig_file.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/base/safetensors.h"
#include "rig/rig_oracle.h"

namespace effigy {
namespace {

Path scratch(const std::string& name) {
  return Path(::testing::TempDir()) / name;
}

Rig full_rig() {
  Rig rig = oracle::random_rig(60, 2, 3, true, 20);
  rig.mesh.uvs = {Vec2f(0, 0), Vec2f(1, 0), Vec2f(0.5f, 1)};
  rig.mesh.uv_triangles.assign(rig.mesh.triangles.size(), Vec3i(0, 1, 2));
  rig.mesh.triangle_part.assign(rig.mesh.triangles.size(), 1);
  rig.mesh.parts = {"skin", "teeth \"quoted\""};
  rig.mediapipe.index = {477, 3};
  rig.mediapipe.triangle = {5, 57};
  rig.mediapipe.barycentric = {Vec3f(0.2f, 0.3f, 0.5f), Vec3f(1, 0, 0)};
  rig.multipie.index = {67};
  rig.multipie.triangle = {0};
  rig.multipie.barycentric = {Vec3f(0, 0.5f, 0.5f)};
  rig.neck_ring = {3, 1, 4, 15};
  return rig;
}

std::string refusal(const std::function<void()>& body) {
  try {
    body();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

TEST(RigFile, RoundTrip) {
  const Rig rig = full_rig();
  const Path path = scratch("round_trip_rig.safetensors");
  write_rig(path, rig);
  const Rig back = load_rig(path, {});
  EXPECT_EQ(back.kind, rig.kind);
  EXPECT_EQ(back.licence, rig.licence);
  EXPECT_EQ(back.mesh.vertices, rig.mesh.vertices);
  EXPECT_EQ(back.mesh.triangles, rig.mesh.triangles);
  EXPECT_EQ(back.mesh.uvs, rig.mesh.uvs);
  EXPECT_EQ(back.mesh.uv_triangles, rig.mesh.uv_triangles);
  EXPECT_EQ(back.mesh.triangle_part, rig.mesh.triangle_part);
  EXPECT_EQ(back.mesh.parts, rig.mesh.parts);
  EXPECT_EQ(back.identity_count, 2);
  EXPECT_EQ(back.expression_count, 3);
  EXPECT_EQ(back.identity_basis, rig.identity_basis);
  EXPECT_EQ(back.expression_basis, rig.expression_basis);
  EXPECT_EQ(back.expression_names, rig.expression_names);
  EXPECT_EQ(back.identity_sigma, rig.identity_sigma);
  EXPECT_EQ(back.expression_low, rig.expression_low);
  EXPECT_EQ(back.expression_high, rig.expression_high);
  EXPECT_EQ(back.pose_basis, rig.pose_basis);
  EXPECT_EQ(back.joint_names, rig.joint_names);
  EXPECT_EQ(back.parents, rig.parents);
  EXPECT_EQ(back.joint_regressor, rig.joint_regressor);
  EXPECT_EQ(back.weights, rig.weights);
  EXPECT_EQ(back.mediapipe.index, rig.mediapipe.index);
  EXPECT_EQ(back.mediapipe.triangle, rig.mediapipe.triangle);
  EXPECT_EQ(back.mediapipe.barycentric, rig.mediapipe.barycentric);
  EXPECT_EQ(back.multipie.index, rig.multipie.index);
  EXPECT_EQ(back.neck_ring, rig.neck_ring);
}

TEST(RigFile, MissingAndUnknownFilesAreNamed) {
  EXPECT_NE(refusal([] { load_rig("/nowhere/rig.safetensors", {}); }).find("/nowhere/rig.safe"),
            std::string::npos);
  const Path odd = scratch("rig.xyz");
  write_text(odd, "hello");
  EXPECT_NE(refusal([&] { load_rig(odd, {}); }).find("not a rig"), std::string::npos);
  const Path folder = scratch("folder_of_rig");
  make_folder(folder);
  EXPECT_NE(refusal([&] { load_rig(folder, {}); }).find("folder without a rig"), std::string::npos);
  write_rig(folder / "rig.safetensors", full_rig());
  EXPECT_EQ(load_rig(folder, {}).neck_ring, full_rig().neck_ring);
  std::filesystem::remove_all(folder);
}

// Each way to damage a rig must be refused, with the field named.
TEST(RigCheck, EveryFieldIsChecked) {
  struct Damage {
    const char* field;
    std::function<void(Rig&)> apply;
  };
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<Damage> damages = {
      {"vertex", [&](Rig& r) { r.mesh.vertices[7] = nan; }},
      {"triangle", [](Rig& r) { r.mesh.triangles[2][1] = 60; }},
      {"triangle", [](Rig& r) { r.mesh.triangles[2][1] = -1; }},
      {"UV triangle", [](Rig& r) { r.mesh.uv_triangles[0][0] = 3; }},
      {"UV triangle", [](Rig& r) { r.mesh.uv_triangles.pop_back(); }},
      {"texture coordinates (UVs)", [](Rig& r) { r.mesh.uv_triangles.clear(); }},
      {"UV vertex", [&](Rig& r) { r.mesh.uvs[1][0] = nan; }},
      {"uvs", [](Rig& r) { r.mesh.uvs[1][1] = -1e9f; }},
      {"part", [](Rig& r) { r.mesh.triangle_part[0] = 2; }},
      {"identity_basis", [](Rig& r) { r.identity_basis.pop_back(); }},
      {"identity_sigma", [](Rig& r) { r.identity_sigma[0] = -1; }},
      {"identity_count", [](Rig& r) { r.identity_count = -1; }},
      {"expression_basis", [&](Rig& r) { r.expression_basis[0] = nan; }},
      {"expression_names", [](Rig& r) { r.expression_names.clear(); }},
      {"expression_low", [](Rig& r) { r.expression_low[1] = 2; }},
      {"expression_high", [](Rig& r) { r.expression_high.clear(); }},
      {"pose_basis", [](Rig& r) { r.pose_basis.resize(17); }},
      {"joint_names", [](Rig& r) { r.joint_names.push_back("tail"); }},
      {"parents", [](Rig& r) { r.parents[2] = 3; }},
      {"parents", [](Rig& r) { r.parents[0] = 0; }},
      {"joint_regressor", [&](Rig& r) { r.joint_regressor[5] = nan; }},
      {"weights", [](Rig& r) { r.weights[0] += 0.1f; }},
      {"weights", [](Rig& r) { r.weights.pop_back(); }},
      {"mediapipe", [](Rig& r) { r.mediapipe.triangle[0] = 58; }},
      {"mediapipe", [](Rig& r) { r.mediapipe.index[0] = 478; }},
      {"multipie", [](Rig& r) { r.multipie.barycentric[0] = Vec3f(1, 1, 1); }},
      {"multipie", [](Rig& r) { r.multipie.barycentric.clear(); }},
      {"neck_ring", [](Rig& r) { r.neck_ring[0] = 60; }},
  };
  check_rig(full_rig(), "rig");
  for (size_t i = 0; i < damages.size(); ++i) {
    Rig rig = full_rig();
    damages[i].apply(rig);
    const std::string message = refusal([&] { check_rig(rig, "my_rig"); });
    EXPECT_NE(message.find("my_rig"), std::string::npos) << i;
    EXPECT_NE(message.find(damages[i].field), std::string::npos) << i << ": " << message;
  }
}

// Damage in the file itself: tensors of the wrong shape or type, missing ones, other files.
TEST(RigFile, DamagedFilesAreRefused) {
  const Path path = scratch("damaged_rig.safetensors");
  write_rig(path, full_rig());
  const TensorFile good = read_safetensors(path);
  for (const auto& [name, tensor] : good.tensors) {
    TensorFile bad = good;
    bad.tensors[name].shape = {1, 1, 1, tensor.count()};
    write_safetensors(path, bad);
    EXPECT_NE(refusal([&] { read_rig(path); }).find(path.string()), std::string::npos) << name;
  }
  for (const char* name : {"vertices", "triangles", "weights", "parents", "uv_triangles",
                           "expression_basis", "joint_regressor", "mediapipe.barycentric"}) {
    TensorFile bad = good;
    bad.tensors.erase(name);
    write_safetensors(path, bad);
    EXPECT_NE(refusal([&] { read_rig(path); }).find(path.string()), std::string::npos) << name;
  }
  TensorFile bad = good;
  bad.tensors.erase("uvs");
  bad.tensors.erase("uv_triangles");
  write_safetensors(path, bad);
  EXPECT_NE(refusal([&] { read_rig(path); }).find("no texture coordinates"), std::string::npos);
  bad = good;
  bad.metadata["parts"] = "{}";
  write_safetensors(path, bad);
  EXPECT_NE(refusal([&] { read_rig(path); }).find("parts"), std::string::npos);
  bad = good;
  bad.metadata.clear();
  write_safetensors(path, bad);
  EXPECT_NE(refusal([&] { read_rig(path); }).find("not a rig"), std::string::npos);
}

}  // namespace
}  // namespace effigy
