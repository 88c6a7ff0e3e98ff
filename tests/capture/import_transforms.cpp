// Folders with transforms_*.json, made by the test, become stage captures.

#include "capture/import_parts.h"
#include "full_disk.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;
using test::contains;
using test::error_of;

constexpr int kSize = 20;

class TransformsLayout : public ::testing::Test {
 protected:
  void SetUp() override { write(); }
  Path at(const std::string& name) const { return scratch_ / name; }

  // Blender: z up, cameras look along -z.
  static Json matrix(const Camera& camera) {
    Mat3d upright;  // to Blender's world
    upright << 1, 0, 0, 0, 0, -1, 0, 1, 0;
    const Mat3d turn =
        upright * camera.camera_from_world_rotation.transpose() * Vec3d(1, -1, -1).asDiagonal();
    const Vec3d t = upright * camera.center();
    Json rows = Json::array();
    for (int row = 0; row < 3; ++row)
      rows.push_back({turn(row, 0), turn(row, 1), turn(row, 2), t[row]});
    rows.push_back({0, 0, 0, 1});
    return rows;
  }
  // y up to Blender's z up.
  static Json position(const Vec3d& p) { return {p.x(), -p.z(), p.y()}; }

  void write_picture(const std::string& name, int value) const {
    Image8 image(kSize, kSize, 4);
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x) {
        uint8_t* p = image.at(x, y);
        p[0] = static_cast<uint8_t>(value);
        p[1] = 200;
        p[2] = 50;
        p[3] = x < 10 ? 255 : x < 15 ? 128 : 0;
      }
    write_png8(at("source/" + name + ".png"), image);
  }
  static Json entry(const std::string& name, int camera, const Vec3d& light) {
    return {{"file_path", "./" + name},
            {"transform_matrix", matrix(test::circle_camera(camera, kSize, kSize))},
            {"pl_pos", position(light)},
            {"pl_intensity", {10.0, 20.0, 30.0}}};
  }

  void write() const {
    Json train = {{"camera_angle_x", 2 * std::atan(0.5 * kSize / 77.0)}, {"frames", Json::array()}};
    Json test = train;
    for (int k = 0; k < 6; ++k) {
      // Each its own light, and the fifth the camera of the first.
      train["frames"].push_back(
          entry("r_" + std::to_string(k), k == 4 ? 0 : k, Vec3d(k - 3, 2, 1)));
      write_picture("r_" + std::to_string(k), 10 * k);
    }
    // Both lights of the first camera, and a camera and a light of its own.
    train["frames"].push_back(entry("r_6", 0, Vec3d(-2, 2, 1)));
    write_picture("r_6", 60);
    test["frames"].push_back(entry("t_0", 9, Vec3d(0.5, 2, 1)));
    write_picture("t_0", 70);
    write_json(at("source/transforms_train.json"), train);
    write_json(at("source/transforms_test.json"), test);
    write_scene();
  }
  // The mesh in the source's world.
  void write_scene() const {
    Mesh mesh = test::ball_mesh(1, Vec3d(0, 0.05, 0));
    for (size_t i = 0; i < mesh.vertices.size(); i += 3) {
      std::swap(mesh.vertices[i + 1], mesh.vertices[i + 2]);
      mesh.vertices[i + 1] = -mesh.vertices[i + 1];
    }
    write_obj(at("scene.obj"), mesh);
  }

  StageImportReport import(StageImportOptions options = {}) const {
    if (options.mesh.empty()) options.mesh = at("scene.obj");
    return import_stage("transforms", at("source"), options, at("out"));
  }

  test::ScratchFolder scratch_;
};

TEST_F(TransformsLayout, BecomesACapture) {
  StageImportOptions options;
  options.light_scale = 1;
  const StageImportReport report = import(options);
  // Cameras 0 1 2 3 5 and 9; lights -3 .. 2 and 0.5.
  EXPECT_EQ(report.cameras, 6);
  EXPECT_EQ(report.frames, 7);
  EXPECT_EQ(report.views, 8u);
  EXPECT_EQ(report.views_left_out, 0u);
  const StageCapture c = read_stage_capture(at("out"));
  EXPECT_EQ(c.test_cameras(), std::vector<int>{5});
  EXPECT_EQ(c.frames_of(StageSplit::kLights), std::vector<int>{6});
  EXPECT_EQ(c.frames[1].cameras, (std::vector<int>{0, 1}));
  EXPECT_EQ(c.frames[4].cameras, std::vector<int>{0});
  EXPECT_EQ(c.lights_of(6).size(), 1u);
  EXPECT_LT((c.lights_of(6)[0].position - Vec3f(0.5f, 2, 1)).norm(), 1e-6f);
  EXPECT_EQ(c.lights_of(6)[0].intensity, Vec3f(10, 20, 30));
  Camera want = test::circle_camera(3, kSize, kSize);
  want.fx = want.fy = 77;
  const Vec3d point(0.1, 0.2, -0.1);
  EXPECT_LT((c.cameras[3].camera.project(point) - want.project(point)).norm(), 1e-6);
  EXPECT_NEAR(load_frame_arrays(c, 0).tracked[1], 0.15, 1e-6);
  // Straight alpha, on black.
  const Image8 image = c.load_image(0, 4), mask = c.load_mask(0, 4);
  EXPECT_EQ(image.at(2, 2)[0], 40);
  EXPECT_EQ(image.at(12, 2)[1], 100);
  EXPECT_EQ(image.at(17, 2)[1], 0);
  EXPECT_EQ(mask.at(12, 2)[0], 128);
}

TEST_F(TransformsLayout, IntrinsicsOfEachPictureAndLinearPictures) {
  Json json = read_json(at("source/transforms_train.json"));
  json["frames"].erase(json["frames"].begin() + 1, json["frames"].end());
  Json& entry = json["frames"][0];
  entry["camera_intrinsics"] = {9.5, 11.0, 60.0, 61.0};
  entry["file_ext"] = ".exr";
  entry["pl_intensity"] = 4.0;
  Image image(kSize, kSize, 4, 0.5f);
  write_exr(at("source/r_0.exr"), image);
  write_json(at("source/transforms_train.json"), json);
  fs::remove(at("source/transforms_test.json"));
  import();
  const StageCapture c = read_stage_capture(at("out"));
  const Camera& camera = c.cameras[0].camera;
  EXPECT_EQ(camera.cx, 9.5);
  EXPECT_EQ(camera.cy, 11.0);
  EXPECT_EQ(camera.fx, 60.0);
  EXPECT_EQ(camera.fy, 61.0);
  EXPECT_EQ(c.load_image(0, 0).data[0], std::lround(255 * srgb_from_linear(0.5f)));
}

TEST_F(TransformsLayout, EachLackIsOneSentence) {
  const auto problem = [&](StageImportOptions options = {}) {
    return error_of([&] { import(options); });
  };
  EXPECT_TRUE(contains(error_of([&] { import_stage("transforms", at("source"), {}, at("out")); }),
                       "--mesh FILE.obj"));
  const Json good = read_json(at("source/transforms_train.json"));
  Json json = good;
  json["frames"][0].erase("pl_pos");
  write_json(at("source/transforms_train.json"), json);
  const StageImportReport report = import();
  EXPECT_EQ(report.frames_left_out, 1);
  EXPECT_TRUE(contains(report.first_problem, "has no light")) << report.first_problem;
  fs::remove_all(at("out"));
  json = good;
  json["frames"][2]["transform_matrix"][0][0] = 5;
  json["frames"][3]["pl_intensity"] = {1, 2};
  write_json(at("source/transforms_train.json"), json);
  EXPECT_EQ(import().frames_left_out, 2);
  fs::remove_all(at("out"));
  write_json(at("source/transforms_train.json"), good);
  // Without alpha nothing says what is body.
  for (int k = 0; k < 7; ++k)
    write_png8(at("source/r_" + std::to_string(k) + ".png"), Image8(kSize, kSize, 3));
  EXPECT_TRUE(contains(problem(), "no alpha channel"));
  fs::remove(at("source/transforms_train.json"));
  EXPECT_TRUE(contains(problem(), "transforms_train.json"));
  EXPECT_FALSE(fs::exists(at("out")));
  EXPECT_TRUE(contains(error_of([&] { import_stage("insta", at("source"), {}, at("out")); }),
                       "no importer"));
}

// Wherever it strikes, a full disk is the machine's fault and never a view that is left out.
TEST_F(TransformsLayout, ADiskThatFillsUpEndsTheImport) {
  int failures = 0;
  for (rlim_t bytes = 16;; bytes *= 2) {
    ASSERT_LT(bytes, rlim_t{1} << 24);
    try {
      const test::FullDisk disk(bytes);
      import();
      break;
    } catch (const Error& error) {
      ++failures;
      EXPECT_EQ(error.blame(), Blame::kResource) << bytes << ": " << error.what();
      EXPECT_TRUE(contains(error.what(), at("out").filename().string())) << error.what();
    }
    EXPECT_FALSE(fs::exists(at("out"))) << bytes;
  }
  EXPECT_GT(failures, 4);
  EXPECT_EQ(read_stage_capture(at("out")).frames.size(), 7u);
}

}  // namespace
}  // namespace effigy
