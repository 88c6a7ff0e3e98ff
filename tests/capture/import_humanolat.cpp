// Folders of the HumanOLAT layout, made by the test, become stage captures.

#include <fstream>

#include "capture/import_parts.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;
using test::contains;
using test::error_of;

constexpr int kWidth = 18, kHeight = 24, kCameras = 3, kLights = 24;

// The recording: number 14 shows all lights, then one after the other, in which every 21st shows
// all again.
int number_of(int position) {
  return 14 + 1 + position + (position + 1) / 20;
}
// Which light is the n-th (from 0): backwards.
int light_at(int position) {
  return kLights - 1 - position;
}

class HumanOlatLayout : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::can_write_avif()) GTEST_SKIP() << "libavif was built without an encoder";
    write();
  }

  Path at(const std::string& name) const { return scratch_ / name; }
  Path pose() const { return scratch_ / "SUBJECT_X/POSE_00"; }

  static std::string camera_name(int number) { return "Cam0" + std::to_string(number + 1); }
  Path picture(int camera, int number) const {
    std::string digits = std::to_string(number);
    digits.insert(0, 6 - digits.size(), '0');
    return pose() / "images_processed" / camera_name(camera) / ("A001_C002." + digits + ".avif");
  }

  void write_calibration(double spoil = 1) const {
    std::string text = "CAMERAS 3\n";
    for (int c = 0; c < kCameras; ++c) {
      const Camera camera = test::circle_camera(c, kWidth, kHeight);
      const Mat3d r = spoil * camera.camera_from_world_rotation.transpose();
      const Vec3d t = 1000 * camera.center();
      text += "name Cam" + std::to_string(c) + "\n  pixelAspect 1\n  distortionModel none\n";
      text += "extrinsic\n";
      const auto line = [&](std::initializer_list<double> values) {
        text += "#";
        for (const double v : values) text += format(" {:.9f}", v);
        text += "\n";
      };
      for (int row = 0; row < 3; ++row) line({r(row, 0), r(row, 1), r(row, 2), t[row]});
      text += "intrinsic\n";
      line({camera.fx / kWidth, 0, camera.cx / kWidth});
      line({0, camera.fy / kWidth, camera.cy / kWidth});
      line({0, 0, 1});
      text += "time 0\n";
    }
    write_text(shared() / "cameras.calib", text);
  }
  Path shared() const { return scratch_ / "SUBJECT_X/shared"; }

  void write_lights(int count = kLights) const {
    std::string places = "# lights\n", order;
    for (int k = 0; k < count; ++k)
      places += format("v {} {} {}\n", 0.1 * k - 1, 2.0, 0.5 + 0.01 * k);
    for (int k = 0; k < kLights; ++k) order += std::to_string(light_at(k) + 1) + "\n";
    write_text(shared() / "LSX_light_positions_aligned.pc", places);
    write_text(shared() / "LSX3_light_z_spiral.txt", order);
  }

  void write() const {
    write_calibration();
    write_lights();
    const auto write_one = [&](int camera, int number, int value) {
      write_file(picture(camera, number),
                 test::avif_bytes(test::plain(kWidth, kHeight, value, 90, 10 + camera), 8, true));
    };
    for (int c = 0; c < kCameras; ++c) {
      for (int n = 0; n < 15; ++n) write_one(c, n, 255);
      for (int k = 0; k < kLights; ++k) write_one(c, number_of(k), 2 * light_at(k));
      write_one(c, 34, 255);  // all lights again
      write_png8(pose() / "segmentations/masks/000" / (camera_name(c) + ".png"),
                 test::left_half(kWidth, kHeight, 1));
    }
    fs::create_directories(pose() / "model");
    write_obj(pose() / "model/model.obj", test::ball_mesh(1000));
  }

  StageImportReport import(const StageImportOptions& options = {}) const {
    return import_stage("humanolat", pose(), options, at("out"));
  }

  test::ScratchFolder scratch_;
};

TEST_F(HumanOlatLayout, BecomesACapture) {
  StageImportOptions options;
  options.light_scale = 2;
  const StageImportReport report = import(options);
  EXPECT_EQ(report.frames, kLights);
  EXPECT_EQ(report.views, static_cast<size_t>(kLights * kCameras));
  EXPECT_EQ(report.frames_left_out, 0);
  const StageCapture c = read_stage_capture(at("out"));
  EXPECT_EQ(c.source, "SUBJECT_X/POSE_00");
  for (int k = 0; k < kCameras; ++k) {
    const Camera want = test::circle_camera(k, kWidth, kHeight);
    const Camera& got = c.cameras[static_cast<size_t>(k)].camera;
    EXPECT_EQ(c.cameras[static_cast<size_t>(k)].name, camera_name(k));
    EXPECT_LT((got.project(Vec3d(.1, .2, .3)) - want.project(Vec3d(.1, .2, .3))).norm(), 1e-5);
    EXPECT_LT((got.center() - want.center()).norm(), 1e-7);
  }
  // Every frame shows its own light, which its red tells.
  int held = 0;
  for (size_t f = 0; f < c.frames.size(); ++f) {
    ASSERT_EQ(c.frames[f].lights.size(), 1u);
    const int light = c.frames[f].lights[0].first;
    const Image8 image = c.load_image(1, static_cast<int>(f));
    EXPECT_EQ(image.at(2, 2)[0], 2 * light) << f;
    EXPECT_EQ(image.at(2, 2)[2], 11);
    EXPECT_EQ(image.at(kWidth - 2, 2)[1], 0);
    EXPECT_EQ(c.load_mask(1, static_cast<int>(f)).at(2, 2)[0], 255);
    held += c.frames[f].split == StageSplit::kLights;
  }
  EXPECT_EQ(held, 2);
  EXPECT_LT((c.lights[3].position - Vec3f(-0.7f, 2, 0.53f)).norm(), 1e-6f);
  // Nobody moves.
  EXPECT_EQ(load_frame_arrays(c, 0).tracked, load_frame_arrays(c, 9).tracked);
  EXPECT_NEAR(load_frame_arrays(c, 0).tracked[1], 0.1, 1e-6);
  EXPECT_EQ(c.rig.mesh.uvs.size(), test::ball_mesh(1).uvs.size());
  Vec3f center = Vec3f::Zero();
  for (size_t i = 0; i < c.body_keypoints.size(); i += 3)
    center += Vec3f(&c.body_keypoints[i]) / static_cast<float>(c.body_keypoints.size() / 3);
  EXPECT_NEAR(c.lights[3].intensity.y(), 2 * (c.lights[3].position - center).squaredNorm(), 1e-4);
}

TEST_F(HumanOlatLayout, DamageIsLeftOutAndCounted) {
  write_text(picture(0, 20), "not a picture");
  fs::remove(picture(2, 22));
  for (int c = 0; c < kCameras; ++c) fs::remove(picture(c, 25));
  const StageImportReport report = import();
  EXPECT_EQ(report.views_left_out, 2u);
  EXPECT_EQ(report.frames_left_out, 1);
  EXPECT_TRUE(contains(report.first_problem, "picture 25 is missing")) << report.first_problem;
  EXPECT_EQ(read_stage_capture(at("out")).frames.size(), static_cast<size_t>(kLights - 1));
}

TEST_F(HumanOlatLayout, EachLackIsOneSentence) {
  const auto problem = [&] { return error_of([&] { import(); }); };
  EXPECT_TRUE(
      contains(error_of([&] { import_stage("humanolat", scratch_ / "SUBJECT_X", {}, at("out")); }),
               "folder of one pose (POSE_00)"));
  write_lights(kLights - 1);
  EXPECT_TRUE(contains(problem(), "orders 24 lights"));
  write_lights();
  write_text(shared() / "LSX3_light_z_spiral.txt",
             read_text(shared() / "LSX3_light_z_spiral.txt").replace(0, 2, "99"));
  EXPECT_TRUE(contains(problem(), "does not exist"));
  write_lights();
  write_calibration(1.5);
  EXPECT_TRUE(contains(problem(), "no rotation"));
  write_text(shared() / "cameras.calib", "extrinsic\n1 2 3\n");
  EXPECT_TRUE(contains(problem(), "cameras.calib"));
  write_calibration();
  fs::remove(pose() / "model/model.obj");
  EXPECT_TRUE(contains(problem(), "--mesh FILE.obj"));
  fs::remove_all(pose() / "segmentations");
  write_obj(pose() / "model/model.obj", test::ball_mesh(1000));
  EXPECT_TRUE(contains(problem(), "Cam01.png"));
  EXPECT_FALSE(fs::exists(at("out")));
}

}  // namespace
}  // namespace effigy
