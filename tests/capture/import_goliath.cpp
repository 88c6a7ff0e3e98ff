// Folders of the Goliath layout, made by the test, become stage captures.

#include <set>

#include "capture/import_parts.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;
using test::bytes_of;
using test::contains;
using test::error_of;

constexpr int kWidth = 16, kHeight = 12, kCameras = 3, kLights = 4, kVertexScale = 1000;
// Of 100 .. 107: every third has all lights and tracking.
constexpr int kFirst = 100, kFrames = 8;

Vec3d shift(int frame) {
  return {0.001 * (frame - kFirst), 0, 0.3};
}

std::string six(int number) {
  return "000" + std::to_string(number);
}

class GoliathLayout : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::can_write_avif()) GTEST_SKIP() << "libavif was built without an encoder";
    write();
  }

  Path at(const std::string& name) const { return scratch_ / name; }
  Path source() const { return scratch_ / "m--1--2--X--pilot--ProjectGoliath--Head"; }

  // Both written column by column, in millimetres, for twice the pictures' size.
  static Json krt(int number) {
    const Camera camera = test::circle_camera(number, kWidth, kHeight);
    const Mat3d r = camera.camera_from_world_rotation;
    const Vec3d t = 1000 * camera.camera_from_world_translation;
    Json k = Json::array(), transform = Json::array();
    k.push_back({2 * camera.fx, 0.0, 0.0});
    k.push_back({0.0, 2 * camera.fy, 0.0});
    k.push_back({2 * camera.cx - 0.5, 2 * camera.cy - 0.5, 1.0});
    for (int column = 0; column < 3; ++column)
      transform.push_back({r(0, column), r(1, column), r(2, column), 0.0});
    transform.push_back({t.x(), t.y(), t.z(), 1.0});
    return {{"cameraId", std::to_string(400000 + number)}, {"K", k}, {"T", transform}};
  }
  static std::string camera_name(int number) { return "cam" + std::to_string(400000 + number); }

  void write_pictures(int camera, const std::set<int>& broken = {}) const {
    const std::string name = camera_name(camera);
    test::ZipEntries images, mattes;
    for (int f = kFirst; f < kFirst + kFrames; ++f) {
      auto picture = test::avif_bytes(test::plain(kWidth, kHeight, 52, 101, 12 + camera), 8, true);
      if (broken.count(f)) picture.resize(picture.size() / 2);
      images.emplace_back(name + "/" + six(f) + ".avif", picture);
      // Half the size, and only of fully lit frames.
      if ((f - kFirst) % 3 == 0)
        mattes.emplace_back(name + "/" + six(f) + ".png",
                            encode_png8(test::left_half(kWidth / 2, kHeight / 2, 7)));
    }
    test::write_zip(source() / "image" / (name + ".zip"), images);
    test::write_zip(source() / "segmentation_parts" / (name + ".zip"), mattes);
  }

  void write_lights(const Json& patterns, const Json& per_frame) const {
    Json positions = Json::array();
    for (int k = 0; k < kLights; ++k)
      positions.push_back({1000.0 * (k - 1.5), 2000.0, 300.0 + 500.0 * k});
    write_json(source() / "lights/light_pattern_metadata.json",
               {{"light_positions", positions}, {"light_patterns", patterns}});
    write_json(source() / "lights/light_pattern_per_frame.json", per_frame);
  }
  static Json pattern(const std::vector<std::pair<int, int>>& lights) {
    return {{"light_index_durations", lights}};
  }
  static Json patterns() {
    return {pattern({{0, 5555}, {1, 5555}, {2, 11110}, {3, 5555}}), pattern({{1, 5555}, {2, 5555}}),
            pattern({{3, 2777}})};
  }
  static Json per_frame() {
    Json list = Json::array();
    for (int f = 0; f < kFrames; ++f) list.push_back({kFirst + f, f % 3});
    return list;
  }

  void write_tracking(const std::string& keypoint = "[1.0, 2.0, 3.0, 0.9]") const {
    test::ZipEntries meshes, keypoints, poses;
    for (int f = kFirst; f < kFirst + kFrames; ++f) {
      const Vec3d by = shift(f);
      const Mesh mesh = test::ball_mesh(kVertexScale, by);
      if ((f - kFirst) % 3 == 0 || f == kFirst + kFrames - 1) {
        meshes.emplace_back("registration_vertices/" + six(f) + ".ply",
                            test::ply_bytes(mesh.vertices));
        keypoints.emplace_back(
            six(f) + ".json",
            bytes_of("{\"nose\": [" + std::to_string(1000 * by.x()) +
                     ", 5.0, 300.0], \"chin\": " + keypoint + ", \"odd\": \"text\"}"));
      }
      poses.emplace_back(six(f) + ".txt", bytes_of("0 0 1 " + std::to_string(1000 * by.x()) +
                                                   "\n0 1 0 0\n-1 0 0 300\n"));
    }
    test::write_zip(source() / "kinematic_tracking/registration_vertices.zip", meshes);
    test::write_zip(source() / "keypoints_3d/keypoints_3d.zip", keypoints);
    test::write_zip(source() / "head_pose/head_pose.zip", poses);
  }

  void write_splits(const std::string& extra = "") const {
    std::string csv = "frame,split\n";
    for (int f = 0; f < kFrames; ++f)
      csv += std::to_string(kFirst + f) + (f >= 6 ? ",test\n" : ",train\n");
    write_text(source() / "frame_splits_list.csv", csv + extra);
  }

  void write() const {
    Json cameras = Json::array();
    for (int c = 0; c < kCameras + 1; ++c) cameras.push_back(krt(c));  // the last has no pictures
    write_json(source() / "camera_calibration.json", {{"KRT", cameras}});
    for (int c = 0; c < kCameras; ++c) write_pictures(c);
    write_lights(patterns(), per_frame());
    write_tracking();
    write_splits();
    write_obj(at("topology.obj"), test::ball_mesh(1));
  }

  StageImportReport import(StageImportOptions options = {}) const {
    if (options.mesh.empty()) options.mesh = at("topology.obj");
    return import_stage("goliath", source(), options, at("out"));
  }
  std::string problem(StageImportOptions options = {}) const {
    const std::string sentence = error_of([&] { import(options); });
    EXPECT_FALSE(fs::exists(at("out")));
    return sentence;
  }

  test::ScratchFolder scratch_;
};

TEST_F(GoliathLayout, BecomesACapture) {
  StageImportOptions options;
  options.light_scale = 1;
  const StageImportReport report = import(options);
  EXPECT_EQ(report.cameras, kCameras);
  EXPECT_EQ(report.frames, kFrames);
  EXPECT_EQ(report.views, static_cast<size_t>(kCameras * kFrames));
  EXPECT_EQ(report.frames_left_out, 0);
  EXPECT_EQ(report.views_left_out, 0u);
  const StageCapture c = read_stage_capture(at("out"));
  ASSERT_EQ(c.cameras.size(), 3u);
  for (int k = 0; k < kCameras; ++k) {
    const Camera want = test::circle_camera(k, kWidth, kHeight);
    const Camera& got = c.cameras[static_cast<size_t>(k)].camera;
    EXPECT_EQ(c.cameras[static_cast<size_t>(k)].name, camera_name(k));
    EXPECT_NEAR(got.fx, want.fx, 1e-9);
    EXPECT_NEAR(got.cx, want.cx, 1e-9);
    EXPECT_NEAR(got.cy, want.cy, 1e-9);
    EXPECT_LT((got.center() - want.center()).norm(), 1e-9);
    EXPECT_LT((got.project(Vec3d(.1, .2, .3)) - want.project(Vec3d(.1, .2, .3))).norm(), 1e-7);
  }
  EXPECT_EQ(c.test_cameras(), std::vector<int>{2});
  // Frames: split list and light patterns.
  ASSERT_EQ(c.frames.size(), static_cast<size_t>(kFrames));
  EXPECT_EQ(c.frames_of(StageSplit::kMotion), (std::vector<int>{6, 7}));
  EXPECT_TRUE(c.frames[0].fully_lit && c.frames[3].fully_lit && !c.frames[1].fully_lit);
  ASSERT_EQ(c.lights.size(), 4u);
  EXPECT_LT((c.lights[0].position - Vec3f(-1.5f, 2, 0.3f)).norm(), 1e-5f);
  // Intensities hold at the stage's centre; amount 1 is what all lights together have.
  Vec3f center = Vec3f::Zero();
  for (size_t i = 0; i < c.body_keypoints.size(); i += 3)
    center += Vec3f(&c.body_keypoints[i]) / static_cast<float>(c.body_keypoints.size() / 3);
  for (const auto& [light, strength] : std::vector<std::pair<size_t, float>>{{0, 1}, {2, 2}})
    EXPECT_NEAR(c.lights[light].intensity.x(),
                strength * (c.lights[light].position - center).squaredNorm(), 1e-4);
  ASSERT_EQ(c.frames[1].lights.size(), 2u);
  EXPECT_EQ(c.frames[1].lights[0], (std::pair<int, float>(1, 1.0f)));
  EXPECT_EQ(c.frames[1].lights[1], (std::pair<int, float>(2, 0.5f)));
  EXPECT_NEAR(c.frames[2].lights[0].second, 2777.0 / 5555, 1e-6);
}

// Where there is a photograph of what is behind, fully lit pictures keep it; others are on black.
TEST_F(GoliathLayout, BackgroundsOfFullyLitFrames) {
  Image8 behind(kWidth, kHeight, 3);
  std::fill(behind.data.begin(), behind.data.end(), uint8_t{52});
  test::write_zip(source() / "per_view_background" / "per_view_background.zip",
                  {{camera_name(0) + ".png", encode_png8(behind)}});
  import();
  const StageCapture c = read_stage_capture(at("out"));
  EXPECT_TRUE(c.cameras[0].background);
  EXPECT_FALSE(c.cameras[1].background);
  const Image8 background = c.load_background(0);
  EXPECT_GT(background.data[0], 100);  // sRGB of linear 52
  const int right = kWidth - 2, y = kHeight / 2;
  ASSERT_EQ(*c.load_mask(0, 0).at(right, y), 0);
  EXPECT_NEAR(c.load_image(0, 0).at(right, y)[0], background.at(right, y)[0], 4);
  EXPECT_EQ(c.load_image(0, 1).at(right, y)[0], 0);
  EXPECT_EQ(c.load_image(1, 0).at(right, y)[0], 0);
  const std::string missing = error_of([&] { c.load_background(1); });
  EXPECT_TRUE(contains(missing, "backgrounds")) << missing;
}

TEST_F(GoliathLayout, TrackingFillsPartiallyLitFrames) {
  import();
  const StageCapture c = read_stage_capture(at("out"));
  EXPECT_EQ(c.body_keypoint_names, (std::vector<std::string>{"chin", "nose"}));
  for (int f = 0; f < kFrames; ++f) {
    const std::vector<float> want = test::ball_mesh(1, shift(kFirst + f)).vertices;
    const std::vector<float> got = load_frame_arrays(c, f).tracked;
    ASSERT_EQ(got.size(), want.size());
    for (size_t i = 0; i < got.size(); ++i) ASSERT_NEAR(got[i], want[i], 2e-6) << f;
    EXPECT_NEAR(c.face_keypoints[static_cast<size_t>(6 * f + 3)], shift(kFirst + f).x(), 1e-6);
    EXPECT_NEAR(c.face_keypoints[static_cast<size_t>(6 * f)], 0.001, 1e-7);
    // The head's pose: a quarter turn, in metres.
    const auto& m = c.face_from_rest[static_cast<size_t>(f)];
    EXPECT_NEAR(m[2], 1, 1e-6);
    EXPECT_NEAR(m[8], -1, 1e-6);
    EXPECT_NEAR(m[3], shift(kFirst + f).x(), 1e-6);
    EXPECT_NEAR(m[11], 0.3, 1e-6);
  }
}

TEST_F(GoliathLayout, PicturesAreDevelopedAndMasked) {
  import();
  const StageCapture c = read_stage_capture(at("out"));
  const auto developed = [](double value, double black, double white) {
    return std::lround(
        255 * srgb_from_linear(static_cast<float>(std::min(1.0, (value - black) * white / 255))));
  };
  for (const int frame : {0, 1}) {  // the second has its neighbour's matte
    const Image8 image = c.load_image(1, frame), mask = c.load_mask(1, frame);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const bool body = x < kWidth / 2;
        ASSERT_EQ(mask.at(x, y)[0], body ? 255 : 0);
        EXPECT_EQ(image.at(x, y)[0], body ? developed(52, 2, 1.4) : 0);
        EXPECT_EQ(image.at(x, y)[1], body ? developed(101, 1, 1.1) : 0);
        EXPECT_EQ(image.at(x, y)[2], body ? developed(13, 2, 1.6) : 0);
      }
  }
}

// A body of mean albedo 0.4 under the imported lights, at the scale that is found.
TEST_F(GoliathLayout, LightIsScaledToAnAlbedo) {
  const StageImportReport report = import();
  const StageCapture c = read_stage_capture(at("out"));
  Vec3f center = Vec3f::Zero();
  for (size_t i = 0; i < c.body_keypoints.size(); i += 3)
    center += Vec3f(&c.body_keypoints[i]) / static_cast<float>(c.body_keypoints.size() / 3);
  std::vector<double> albedos;
  for (int f = 0; f < kFrames; ++f) {
    double luminance_sum = 0, irradiance = 0;
    int pixels = 0;
    for (int k = 0; k < kCameras; ++k) {
      const Image8 image = c.load_image(k, f), mask = c.load_mask(k, f);
      for (size_t i = 0; i < mask.data.size(); ++i) {
        if (mask.data[i] == 0) continue;
        const auto linear = [&](size_t b) {
          return linear_from_srgb(static_cast<float>(image.data[3 * i + b]) / 255);
        };
        luminance_sum += static_cast<double>(luminance(linear(0), linear(1), linear(2)));
        ++pixels;
      }
    }
    for (const StageLight& light : c.lights_of(f))
      irradiance +=
          static_cast<double>(light.intensity.x() / (light.position - center).squaredNorm());
    albedos.push_back(M_PI * luminance_sum / pixels / (irradiance / 4));
  }
  std::nth_element(albedos.begin(), albedos.begin() + kFrames / 2, albedos.end());
  EXPECT_NEAR(albedos[kFrames / 2], kImportedAlbedo, 1e-4);
  EXPECT_NEAR(c.extra["import"]["light_scale"].get<double>(), report.light_scale, 1e-12);
}

TEST_F(GoliathLayout, OptionsChooseAndShrink) {
  StageImportOptions options;
  options.cameras = {camera_name(2), camera_name(0)};
  options.every = 2;
  options.frames = 3;
  options.scale = 0.5;
  options.up = "-y";
  options.consent = "yes";
  const StageImportReport report = import(options);
  EXPECT_EQ(report.cameras, 2);
  EXPECT_EQ(report.frames, 3);
  const StageCapture c = read_stage_capture(at("out"));
  EXPECT_EQ(c.cameras[1].name, camera_name(2));
  EXPECT_EQ(c.load_image(1, 2).width, kWidth / 2);
  EXPECT_EQ(c.consent, "yes");
  // Upside down: the world turns, pictures stay.
  const Camera want = test::circle_camera(2, kWidth, kHeight);
  const Vec3d point(0.05, 0.1, 0.3);
  EXPECT_LT((2 * c.cameras[1].camera.project(Vec3d(0.05, -0.1, -0.3)) - want.project(point)).norm(),
            1e-6);
  EXPECT_LT((c.lights[0].position - Vec3f(-1.5f, -2, -0.3f)).norm(), 1e-5f);
  EXPECT_NEAR(load_frame_arrays(c, 0).tracked[2], -0.3 - test::ball_mesh(1).vertices[2], 1e-5);
}

TEST_F(GoliathLayout, DamageIsLeftOutAndCounted) {
  write_pictures(1, {kFirst + 2, kFirst + 5});
  write_splits("109,train\n");
  const StageImportReport report = import();
  EXPECT_EQ(report.views_left_out, 2u);
  EXPECT_EQ(report.frames_left_out, 1);  // 109 has no light pattern
  EXPECT_TRUE(contains(report.first_problem, "109")) << report.first_problem;
  EXPECT_TRUE(contains(report.first_problem, "light pattern")) << report.first_problem;
  const StageCapture c = read_stage_capture(at("out"));
  EXPECT_EQ(c.frames[2].cameras, (std::vector<int>{0, 2}));
  EXPECT_TRUE(c.frames[3].cameras.empty());
  // A frame that was tracked nowhere near.
  write_splits("200,train\n");
  Json list = per_frame();
  list.push_back({200, 1});
  write_lights(patterns(), list);
  fs::remove_all(at("out"));
  EXPECT_TRUE(contains(import().first_problem, "frame 200 has no registration"));
}

TEST_F(GoliathLayout, EachLackIsOneSentence) {
  const auto expect = [](const std::string& sentence, const char* part) {
    EXPECT_TRUE(contains(sentence, part)) << sentence;
  };
  StageImportOptions bare;
  bare.mesh.clear();
  EXPECT_TRUE(contains(error_of([&] { import_stage("goliath", source(), bare, at("out")); }),
                       "--mesh FILE.obj"));
  Mesh without = test::ball_mesh(1);
  without.uvs.clear();
  without.uv_triangles.clear();
  write_obj(at("plain.obj"), without);
  StageImportOptions options;
  options.mesh = at("plain.obj");
  expect(problem(options), "no texture coordinates");
  write_obj(at("other.obj"), test::ball_rig(6, 8).mesh);
  options.mesh = at("other.obj");
  expect(problem(options), "vertices");
  options = {};
  options.cameras = {"cam7"};
  expect(problem(options), "no camera 'cam7'");
  options = {};
  options.up = "w";
  expect(problem(options), "--up");
  // More lights than are declared.
  write_lights(Json::array({pattern({{0, 1}, {4, 1}})}), per_frame());
  expect(problem(), "names light 4");
  write_lights(patterns(), {{"no", "list"}});
  expect(problem(), "light_pattern_per_frame.json");
  write_lights(patterns(), per_frame());
  // A calibration that was not transposed is no rotation.
  Json cameras = Json::array({krt(0)});
  cameras[0]["T"][0][0] = 3.0;
  write_json(source() / "camera_calibration.json", {{"KRT", cameras}});
  expect(problem(), "no rotation");
  write_json(source() / "camera_calibration.json", {{"KRT", Json::array({krt(kCameras)})}});
  expect(problem(), "no camera of camera_calibration.json has pictures");
  write_json(source() / "camera_calibration.json", {{"KRT", Json::array({krt(0)})}});
  // NaN is no JSON: the frames without keypoints go, here all.
  write_tracking("[NaN, 0, 0]");
  const std::string sentence = problem();
  EXPECT_TRUE(contains(sentence, "keypoint")) << sentence;
  write_tracking();
  write_text(source() / "image" / (camera_name(0) + ".zip"), "no archive");
  expect(problem(), "not a readable zip archive");
  write_pictures(0, {100, 101, 102, 103, 104, 105});
  expect(problem(), "6 of 8 views");
  fs::remove(source() / "frame_splits_list.csv");
  expect(problem(), "frame_splits_list.csv");
}

TEST_F(GoliathLayout, WithoutLightsAllIsLitEvenlyAndMeshPointsStandIn) {
  fs::remove_all(source() / "lights");
  fs::remove_all(source() / "keypoints_3d");
  fs::remove_all(source() / "head_pose");
  import();
  const StageCapture c = read_stage_capture(at("out"));
  EXPECT_TRUE(c.lights.empty());
  EXPECT_EQ(c.frames[1].environment, Path("lights/even.exr"));
  const Image light = read_image(at("out") / "lights/even.exr");
  // Radiance r all around makes an albedo a show a r.
  const float linear = linear_from_srgb(static_cast<float>(c.load_image(0, 1).data[1]) / 255);
  EXPECT_NEAR(light.data[1] * kImportedAlbedo, linear, 0.3 * linear);
  EXPECT_EQ(c.body_keypoint_names.size(), 64u);
  EXPECT_EQ(std::set(c.body_keypoint_names.begin(), c.body_keypoint_names.end()).size(), 64u);
  // The root follows the mesh: it moves along x.
  EXPECT_NEAR(c.body_from_rest[4][3] - c.body_from_rest[1][3], 0.003, 1e-5);
  std::vector<float> posed;
  pose_vertices(shape_rig(c.rig, {}), c.poses[4], posed);
  const std::vector<float> tracked = load_frame_arrays(c, 4).tracked;
  for (size_t i = 0; i < posed.size(); ++i) ASSERT_NEAR(posed[i], tracked[i], 1e-5);
}

}  // namespace
}  // namespace effigy
