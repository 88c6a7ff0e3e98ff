// Stage captures as files: everything comes back, and damage is named.

#include "effigy/capture/stage_capture.h"

#include "effigy/base/safetensors.h"
#include "support.h"
#include "tiny_stage.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;

TEST(StageCapture, RoundTripKeepsEverything) {
  const test::ScratchFolder scratch;
  test::write_tiny_stage(scratch.path());
  EXPECT_EQ(capture_kind(scratch.path()), "body");
  const StageCapture c = read_stage_capture(scratch.path()), written = test::tiny_stage();
  EXPECT_EQ(c.source, "a test");
  EXPECT_EQ(c.frames_per_second, 12);
  EXPECT_EQ(c.train_cameras(), std::vector<int>{0});
  EXPECT_EQ(c.test_cameras(), std::vector<int>{1});
  EXPECT_EQ(c.cameras[1].name, "right");
  EXPECT_EQ(c.frames_of(StageSplit::kLights), std::vector<int>{1});
  EXPECT_EQ(c.frames_of(StageSplit::kEnvironment), std::vector<int>{2});
  EXPECT_EQ(c.frames[2].number, 20);
  EXPECT_EQ(c.frames[2].environment, Path("lights/studio.exr"));
  EXPECT_EQ(c.frames[1].lights, written.frames[1].lights);
  EXPECT_EQ(c.frames[1].cameras, std::vector<int>{1});
  EXPECT_EQ(c.cameras_of(1, {0, 1}), std::vector<int>{1});
  EXPECT_EQ(c.cameras_of(0, {0, 1}), (std::vector<int>{0, 1}));
  EXPECT_EQ(c.lights[0].intensity, Vec3f(1, 2, 3));
  EXPECT_EQ(c.body_keypoints, written.body_keypoints);
  EXPECT_EQ(c.face_keypoint_names, written.face_keypoint_names);
  EXPECT_EQ(c.body_from_rest, written.body_from_rest);
  EXPECT_EQ(c.face_from_rest, written.face_from_rest);
  EXPECT_EQ(c.poses[2].translation, written.poses[2].translation);
  EXPECT_EQ(c.true_poses.size(), 3u);
  // Lights at their amounts.
  EXPECT_EQ(c.lights_of(0).size(), 3u);
  ASSERT_EQ(c.lights_of(1).size(), 2u);
  EXPECT_EQ(c.lights_of(1)[0].intensity, Vec3f(0.5f, 1, 1.5f));
  EXPECT_TRUE(c.lights_of(2).empty());
  EXPECT_EQ(c.load_layer("part", 0, 1).data[3], 2);
  EXPECT_EQ(load_frame_arrays(c, 1).tracked, c.rig.mesh.vertices);
  EXPECT_TRUE(load_frame_arrays(c, 1).truth.empty());
}

TEST(StageCapture, EachDamageIsNamed) {
  const test::ScratchFolder scratch;
  EXPECT_TRUE(
      contains(error_of([&] { read_stage_capture(scratch.path()); }), "capture.json is missing"));
  test::write_tiny_stage(scratch.path());
  const Json good = read_json(scratch / "capture.json");
  const auto broken = [&](auto&& change) {
    Json json = good;
    change(json);
    write_json(scratch / "capture.json", json);
    return error_of([&] { read_stage_capture(scratch.path()); });
  };
  const auto names = [&](auto&& change, const char* part) {
    const std::string sentence = broken(change);
    EXPECT_TRUE(contains(sentence, part)) << sentence;
    EXPECT_TRUE(contains(sentence, "capture.json")) << sentence;
  };
  names([](Json& j) { j["kind"] = "head"; }, "'kind'");
  names([](Json& j) { j["version"] = 9; }, "'version'");
  names([](Json& j) { j["cameras"][0]["name"] = "../left"; }, "../left");
  names([](Json& j) { j["cameras"][0]["name"] = "right"; }, "right");
  names([](Json& j) { j["cameras"][0]["fx"] = 0; }, "'cameras'");
  names([](Json& j) { j["cameras"] = Json::array(); }, "no cameras");
  names([](Json& j) { j["lights"][0]["intensity"] = {-1, 0, 0}; }, "'intensity'");
  names([](Json& j) { j["lights"][0]["position"] = {1, 0}; }, "'position'");
  names([](Json& j) { j["lights"] = Json::array(); }, "no lights");
  names([](Json& j) { j["frames"][1]["lights"][0][0] = 3; }, "light");
  names([](Json& j) { j["frames"][1]["lights"][0][1] = -1; }, "light");
  names([](Json& j) { j["frames"][1]["lights"] = "all"; }, "'lights'");
  names([](Json& j) { j["frames"][0].erase("fully_lit"); }, "one way");
  names([](Json& j) { j["frames"][0]["environment"] = "lights/a.exr"; }, "one way");
  names([](Json& j) { j["frames"][2]["environment"] = "/etc/passwd"; }, "inside");
  names([](Json& j) { j["frames"][1]["split"] = "val"; }, "'split'");
  names([](Json& j) { j["frames"][1]["number"] = 0; }, "twice");
  names([](Json& j) { j["frames"][1]["cameras"] = {2}; }, "'cameras'");
  names([](Json& j) { j["frames"][1]["cameras"] = {1, 1}; }, "'cameras'");
  names([](Json& j) { j["truth"]["layers"] = {"smell"}; }, "smell");
  // More names than keypoints: tracking does not fit.
  EXPECT_TRUE(
      contains(broken([](Json& j) { j["body_keypoints"].push_back("tail"); }), "body_keypoints"));
}

TEST(StageCapture, DamagedFilesOfAFrameAreNamed) {
  const test::ScratchFolder scratch;
  test::write_tiny_stage(scratch.path());
  const StageCapture c = read_stage_capture(scratch.path());
  write_png8(scratch / "images/left/000010.png", Image8(9, 9, 3));
  EXPECT_TRUE(contains(error_of([&] { c.load_image(0, 1); }), "9x9"));
  std::filesystem::remove(scratch / "masks/right/000000.png");
  EXPECT_TRUE(contains(error_of([&] { c.load_mask(1, 0); }), "000000.png"));
  Image8 part(16, 16, 1);
  part.data[0] = 3;
  write_png8(scratch / "layers/part/left/000000.png", part);
  EXPECT_TRUE(contains(error_of([&] { c.load_layer("part", 0, 0); }), "label"));
  EXPECT_TRUE(contains(error_of([&] { c.load_layer("depth", 0, 0); }), "no layer"));
  write_frame_arrays({{1, 2, 3}, {}, {}}, scratch.path(), 20);
  EXPECT_TRUE(contains(error_of([&] { load_frame_arrays(c, 2); }), "tracked"));
}

}  // namespace
}  // namespace effigy
