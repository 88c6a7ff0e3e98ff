// Loading FLAME: files of both kinds, made by the test, against an independent computation.
#include "effigy/rig/flame.h"

#include <gtest/gtest.h>

#include <cstdlib>

#include "effigy/base/error.h"
#include "effigy/base/json.h"
#include "effigy/rig/rig_file.h"
#include "rig/fake_flame.h"
#include "rig/rig_oracle.h"
#include "write_zip.h"

namespace effigy {
namespace {

using test::FakeFlame;
using test::FakeHead;

class Flame : public ::testing::Test {
 protected:
  void SetUp() override {
    unsetenv("EFFIGY_DATA");
    folder_ =
        Path(::testing::TempDir()) /
        ("flame_" + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()));
    std::filesystem::remove_all(folder_);
    make_folder(folder_);
    write_obj(folder_ / "head_template.obj", head().mesh);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  static const FakeHead& head() {
    static const FakeHead fake;
    return fake;
  }
  Path at(const char* name) const { return folder_ / name; }
  std::string refusal(const Path& path) const {
    try {
      load_flame(path);
    } catch (const Error& error) {
      return error.what();
    }
    return "not refused";
  }
  Path folder_;
};

// FLAME by its equations, straight from the arrays.
oracle::Parameters by_hand(const FakeFlame& f, const std::vector<float>& identity,
                           const RigPose& pose) {
  oracle::Parameters p;
  const size_t rows = f.v_template.size();
  p.rest = f.v_template;
  for (size_t i = 0; i < rows; ++i)
    for (size_t k = 0; k < identity.size(); ++k)
      p.rest[i] += static_cast<double>(identity[k]) * f.shapedirs[400 * i + k];
  for (size_t k = 0; k < 100; ++k)
    for (size_t i = 0; i < rows; ++i) p.expression_basis.push_back(f.shapedirs[400 * i + 300 + k]);
  for (size_t m = 0; m < 36; ++m)
    for (size_t i = 0; i < rows; ++i) p.pose_basis.push_back(f.posedirs[36 * i + m]);
  p.weights = f.weights;
  p.parents = {-1, 0, 1, 1, 1};
  p.joints.resize(15);
  for (size_t v = 0; v < 5023; ++v)
    for (size_t axis = 0; axis < 3; ++axis)
      p.joints[3 * static_cast<size_t>(f.regressor_rows[v]) + axis] +=
          f.regressor[v] * p.rest[3 * v + axis];
  p.expression.assign(pose.expression.begin(), pose.expression.begin() + 100);
  p.joint_rotation.assign(pose.joint_rotation.begin(), pose.joint_rotation.end());
  p.translation.assign(pose.translation.begin(), pose.translation.end());
  return p;
}

TEST_F(Flame, BothFormsGiveTheModelExactly) {
  const FakeFlame fake(head().mesh);
  for (const bool modern : {false, true}) {
    const Path path = at(modern ? "flame2023_Open.pkl" : "generic_model.pkl");
    fake.write(path, modern);
    const Rig rig = load_flame(path);
    EXPECT_EQ(rig.kind, modern ? "flame-2023-open" : "flame-2020");
    EXPECT_EQ(rig.identity_count, 300);
    EXPECT_EQ(rig.expression_count, 100);
    EXPECT_EQ(rig.expression_names[0], "expression_001");
    EXPECT_EQ(rig.expression_names[99], "expression_100");
    EXPECT_EQ(rig.joint_names,
              (std::vector<std::string>{"root", "neck", "jaw", "eye_left", "eye_right"}));
    EXPECT_EQ(rig.neck_ring.size(), 30u);
    EXPECT_EQ(rig.mediapipe.size(), 0u);
    const size_t v3 = rig.mesh.vertices.size();
    for (const size_t k : {size_t{0}, size_t{1}, size_t{299}})
      for (size_t i = 0; i < 3 * 5023; ++i)
        ASSERT_EQ(rig.identity_basis[k * v3 + i], static_cast<float>(fake.shapedirs[400 * i + k]));

    const RigPose pose = oracle::random_pose(rig, 0.4f, 31);
    const std::vector<float> identity = {0.5f, -1, 0.25f};
    const RigShape shape = shape_rig(rig, identity);
    std::vector<float> posed;
    pose_vertices(shape, pose, posed);
    const std::vector<double> expected = oracle::pose_vertices(by_hand(fake, identity, pose));
    double worst = 0;
    for (size_t i = 0; i < expected.size(); ++i)
      worst = std::max(worst, std::abs(static_cast<double>(posed[i]) - expected[i]));
    EXPECT_LT(worst, 2e-6);
  }
}

TEST_F(Flame, LoadRigFindsItAndItSurvivesARoundTrip) {
  FakeFlame(head().mesh, true).write(at("flame2023.pkl"), true);
  const Rig rig = load_rig(at("flame2023.pkl"), {});
  EXPECT_EQ(rig.kind, "flame-2023");
  write_rig(at("rig.safetensors"), rig);
  EXPECT_EQ(load_rig(at("rig.safetensors"), {}).pose_basis, rig.pose_basis);
}

TEST_F(Flame, PartsAreSplitBySide) {
  FakeFlame(head().mesh, true).write(at("flame2023.pkl"), true);
  const Rig rig = load_flame(at("flame2023.pkl"));
  EXPECT_EQ(rig.mesh.parts,
            (std::vector<std::string>{"skin", "eye_left", "eye_right", "teeth", "mouth"}));
  std::map<int, int> count;
  for (size_t f = 0; f < rig.mesh.triangles.size(); ++f) {
    ++count[rig.mesh.triangle_part[f]];
    const float x = rig.mesh.vertex(rig.mesh.triangles[f][0]).x();
    if (rig.mesh.triangle_part[f] == 1) {
      EXPECT_GT(x, 0);
    }
    if (rig.mesh.triangle_part[f] == 2) {
      EXPECT_LT(x, 0);
    }
  }
  EXPECT_EQ(count[0], 7800);
  EXPECT_EQ(count[1], 1088);
  EXPECT_EQ(count[2], 1088);
}

TEST_F(Flame, UvsAreMatchedWhateverTheOrderOfTriangles) {
  FakeFlame(head().mesh, true).write(at("flame2023.pkl"), true);
  Mesh shuffled = head().mesh;
  std::reverse(shuffled.triangles.begin(), shuffled.triangles.end());
  for (Vec3i& t : shuffled.triangles) t = Vec3i(t[1], t[2], t[0]);
  shuffled.uv_triangles = shuffled.triangles;
  write_obj(at("head_template.obj"), shuffled);
  const Rig rig = load_flame(at("flame2023.pkl"));
  for (size_t f = 0; f < 9976; ++f) EXPECT_EQ(rig.mesh.uv_triangles[f], rig.mesh.triangles[f]);
}

TEST_F(Flame, EyelidsAndLandmarksBesideTheFile) {
  FakeFlame(head().mesh, true).write(at("flame2023.pkl"), true);
  // The file named after the left lid moves the right side here: the content decides.
  std::vector<double> lid(3 * 5023, 0.0);
  for (const float side : {-1.0f, 1.0f}) {
    for (size_t v = 0; v < 5023; ++v)
      lid[3 * v + 1] = head().mesh.vertices[3 * v] * side > 0.01f ? -0.001 : 0;
    write_file(at(side < 0 ? "l_eyelid.npy" : "r_eyelid.npy"),
               test::npy_bytes("<f8", "(5023, 3)", lid.data(), 8 * lid.size()));
  }
  const std::vector<int64_t> points = {0, 477};
  const std::vector<uint32_t> faces = {7, 9975};
  const std::vector<double> weights = {0.5, 0.25, 0.25, 0, 0, 1};
  test::write_zip(at("mediapipe_landmark_embedding.npz"),
                  {{"landmark_indices.npy", test::npy_bytes("<i8", "(2,)", points.data(), 16)},
                   {"lmk_face_idx.npy", test::npy_bytes("<u4", "(2,)", faces.data(), 8)},
                   {"lmk_b_coords.npy", test::npy_bytes("<f8", "(2, 3)", weights.data(), 48)}});
  Json json;
  std::vector<int> full(70);
  std::vector<double> full_weights;
  for (int i = 0; i < 70; ++i) {
    full[static_cast<size_t>(i)] = 10 * i;
    full_weights.insert(full_weights.end(), {0.25, 0.25, 0.5});
  }
  json["full_lmk_faces_idx"] = {{"shape", {1, 70}}, {"data", full}};
  json["full_lmk_bary_coords"] = {{"shape", {1, 70, 3}}, {"data", full_weights}};
  write_json(at("landmark_embedding_with_eyes.json"), json);

  const Rig rig = load_flame(at("flame2023.pkl"));
  EXPECT_EQ(rig.expression_count, 102);
  const int left = rig.expression("eyelid_left"), right = rig.expression("eyelid_right");
  ASSERT_EQ(left, 100);
  ASSERT_EQ(right, 101);
  EXPECT_EQ(rig.expression_low[100], 0);
  EXPECT_EQ(rig.expression_high[101], 1);
  const size_t v3 = rig.mesh.vertices.size();
  for (size_t v = 0; v < 5023; ++v) {
    const float x = rig.mesh.vertices[3 * v];
    EXPECT_EQ(rig.expression_basis[100 * v3 + 3 * v + 1], x > 0.01f ? -0.001f : 0.0f);
    EXPECT_EQ(rig.expression_basis[101 * v3 + 3 * v + 1], x < -0.01f ? -0.001f : 0.0f);
  }
  EXPECT_EQ(rig.mediapipe.index, (std::vector<int>{0, 477}));
  EXPECT_EQ(rig.mediapipe.triangle, (std::vector<int>{7, 9975}));
  EXPECT_EQ(rig.mediapipe.barycentric[0], Vec3f(0.5f, 0.25f, 0.25f));
  EXPECT_EQ(rig.multipie.size(), 68u);
  EXPECT_EQ(rig.multipie.triangle[67], 670);
}

TEST_F(Flame, OtherModelsAreRefusedByName) {
  FakeFlame body(head().mesh, true);
  body.vertex_count = 6890;
  body.v_template.resize(3 * 6890);
  body.left_out = "shapedirs";
  body.write(at("generic_model.pkl"), false);
  EXPECT_NE(refusal(at("generic_model.pkl")).find("an SMPL body"), std::string::npos);

  FakeFlame fake(head().mesh, true);
  fake.left_out = "shapedirs";
  fake.write(at("flame2023_no_jaw.pkl"), true);
  EXPECT_NE(refusal(at("flame2023_no_jaw.pkl")).find("without jaw rotation"), std::string::npos);
  fake.write(at("flame2023.pkl"), true);
  EXPECT_NE(refusal(at("flame2023.pkl")).find("'shapedirs' is missing"), std::string::npos);
  fake.left_out.clear();
  for (size_t v = 0; v < 5023; ++v) {
    fake.weights[5 * v + 1] += fake.weights[5 * v + 2];
    fake.weights[5 * v + 2] = 0;
  }
  fake.write(at("flame2023.pkl"), true);
  EXPECT_NE(refusal(at("flame2023.pkl")).find("jaw joint moves nothing"), std::string::npos);
}

TEST_F(Flame, AVersionThatItsContentContradictsIsRefused) {
  FakeFlame fake(head().mesh, true);
  fake.shapedirs.assign(15069 * 400, 0.0);  // as chumpy
  fake.write(at("flame2023_Open.pkl"), false);
  EXPECT_NE(refusal(at("flame2023_Open.pkl")).find("FLAME 2020"), std::string::npos);
  // Without a telling name the content decides.
  std::filesystem::rename(at("flame2023_Open.pkl"), at("model.pkl"));
  EXPECT_EQ(load_flame(at("model.pkl")).kind, "flame-2020");
}

TEST_F(Flame, DamagedModelsAreRefused) {
  const FakeFlame good(head().mesh, true);
  const Path path = at("flame2023.pkl");
  const auto with = [&](const std::function<void(FakeFlame&)>& damage) {
    FakeFlame bad = good;
    damage(bad);
    bad.write(path, true);
    return refusal(path);
  };
  EXPECT_NE(with([](auto& f) { f.faces[5] = 5023; }).find("triangles"), std::string::npos);
  EXPECT_NE(with([](auto& f) { f.faces.resize(300); }).find("'f' is 100 x 3"), std::string::npos);
  EXPECT_NE(with([](auto& f) { f.parents[2] = 0; }).find("joints"), std::string::npos);
  EXPECT_NE(with([](auto& f) { f.regressor_rows[9] = 5; }).find("sparse"), std::string::npos);
  EXPECT_NE(with([](auto& f) { f.weights[9] = NAN; }).find("weights"), std::string::npos);
  EXPECT_NE(with([&](auto& f) { f.shapedirs.assign(15069 * 400, NAN); }).find("identity_basis"),
            std::string::npos);
  EXPECT_NE(with([](auto& f) { std::swap(f.faces[0], f.faces[3000]); }).find("lacks triangles"),
            std::string::npos);
  write_text(path, "cos\nsystem\n(S'true'\ntR.");
  EXPECT_NE(refusal(path).find("os.system"), std::string::npos);
  write_text(path, "I5\n.");
  EXPECT_NE(refusal(path).find("no dictionary"), std::string::npos);
}

TEST_F(Flame, TheUvLayoutIsNeededAndChecked) {
  FakeFlame(head().mesh, true).write(at("flame2023.pkl"), true);
  Mesh other = head().mesh;
  for (Vec2f& uv : other.uvs) uv.y() += 0.05f;  // into the band of the mouth
  write_obj(at("head_template.obj"), other);
  EXPECT_NE(refusal(at("flame2023.pkl")).find("band kept for the mouth"), std::string::npos);
  other.uv_triangles.clear();
  write_obj(at("head_template.obj"), other);
  EXPECT_NE(refusal(at("flame2023.pkl")).find("UV layout does not belong"), std::string::npos);
  std::filesystem::remove(at("head_template.obj"));
  EXPECT_NE(refusal(at("flame2023.pkl")).find("head_template.obj was not found"),
            std::string::npos);
  // Another place to look.
  make_folder(folder_ / "assets");
  write_obj(folder_ / "assets/head_template_mesh.obj", head().mesh);
  EXPECT_EQ(load_flame(at("flame2023.pkl"), {folder_ / "assets"}).kind, "flame-2023");
}

}  // namespace
}  // namespace effigy
