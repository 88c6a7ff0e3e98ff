#include "effigy/capture/capture.h"

#include "effigy/base/safetensors.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;

TEST(Capture, RoundTripKeepsEverything) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path(), 8);
  const Capture capture = read_capture(scratch.path());
  EXPECT_EQ(capture.frames.size(), 8u);
  EXPECT_EQ(capture.train_frames().size(), 6u);
  EXPECT_EQ(capture.test_frames(), (std::vector<int>{6, 7}));
  EXPECT_FLOAT_EQ(capture.poses[3].joint_rotation[1], 0.06f);
  EXPECT_FLOAT_EQ(capture.poses[3].translation[2], -1.0f);
  EXPECT_EQ(capture.rig.expression_names, (std::vector<std::string>{"widen"}));
  EXPECT_DOUBLE_EQ(capture.camera.fx, 2.8 * 64);
  EXPECT_EQ(capture.load_image(0).channels, 3);
  EXPECT_EQ(*capture.load_mask(0).at(32, 32), 255);
}

TEST(Capture, LandmarksAndScoresAreKept) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path(), 4);
  Capture capture = read_capture(scratch.path());
  EXPECT_EQ(capture.landmark_count, 0);
  EXPECT_EQ(capture.score_count, 0);
  capture.landmark_count = 2;
  capture.score_count = 3;
  for (int i = 0; i < 16; ++i) capture.landmarks.push_back(static_cast<float>(i));
  for (int i = 0; i < 12; ++i) capture.scores.push_back(0.05f * static_cast<float>(i));
  write_capture(capture, scratch.path());
  const Capture again = read_capture(scratch.path());
  EXPECT_EQ(again.landmark_count, 2);
  EXPECT_EQ(again.landmarks, capture.landmarks);
  EXPECT_EQ(again.score_count, 3);
  EXPECT_EQ(again.scores, capture.scores);
  TensorFile file = read_safetensors(scratch / "tracking.safetensors");
  file.tensors["scores"].shape = {3, 4};
  write_safetensors(scratch / "tracking.safetensors", file);
  EXPECT_TRUE(contains(error_of([&] { read_capture(scratch.path()); }), "'scores'"));
}

TEST(Capture, SplitIsTheLastQuarterAtMost350) {
  Capture capture;
  capture.frames.resize(2000);
  split_test_frames(capture);
  EXPECT_EQ(capture.test_frames().size(), 350u);
  EXPECT_TRUE(capture.frames.back().test);
  split_test_frames(capture, 10);
  EXPECT_EQ(capture.test_frames().size(), 10u);
  EXPECT_TRUE(contains(error_of([&] { split_test_frames(capture, 2000); }), "no training frame"));
}

TEST(Capture, EachDamageIsNamed) {
  test::ScratchFolder scratch;
  EXPECT_TRUE(contains(error_of([&] { read_capture(scratch / "none"); }), "no such folder"));
  EXPECT_TRUE(contains(error_of([&] { read_capture(scratch.path()); }), "capture.json is missing"));
  test::write_tiny_capture(scratch.path(), 4);
  const Json good = read_json(scratch / "capture.json");
  const auto broken = [&](auto&& change) {
    Json json = good;
    change(json);
    write_json(scratch / "capture.json", json);
    return error_of([&] { read_capture(scratch.path()); });
  };
  EXPECT_TRUE(contains(broken([](Json& j) { j["version"] = 7; }), "'version'"));
  EXPECT_TRUE(contains(broken([](Json& j) { j["frames"][0]["image"] = "../x.png"; }), "inside"));
  EXPECT_TRUE(contains(broken([](Json& j) { j["frames"][0]["image"] = "/etc/x"; }), "inside"));
  EXPECT_TRUE(contains(broken([](Json& j) { j["cameras"][0]["fx"] = -1; }), "'cameras'"));
  EXPECT_TRUE(contains(broken([](Json& j) { j["cameras"][0]["width"] = 1 << 30; }), "'cameras'"));
  EXPECT_TRUE(contains(broken([](Json& j) { j["frames"][0]["split"] = "val"; }), "'split'"));
  EXPECT_TRUE(contains(broken([](Json& j) { j["frames"] = Json::array(); }), "'frames'"));
  EXPECT_TRUE(contains(broken([](Json& j) { j["display"] = "gamma"; }), "gamma"));
  write_text(scratch / "capture.json", "{\"version\": 1,");
  EXPECT_TRUE(contains(error_of([&] { read_capture(scratch.path()); }), "not valid JSON"));
}

TEST(Capture, NanInTrackingIsRefused) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path(), 4);
  TensorFile file = read_safetensors(scratch / "tracking.safetensors");
  std::vector<float> translation = file.floats("translation", {4, 3});
  translation[5] = std::numeric_limits<float>::quiet_NaN();
  file.tensors["translation"] = Tensor::from(std::span<const float>(translation), {4, 3});
  write_safetensors(scratch / "tracking.safetensors", file);
  const std::string sentence = error_of([&] { read_capture(scratch.path()); });
  EXPECT_TRUE(contains(sentence, "translation") && contains(sentence, "not finite")) << sentence;
}

TEST(Capture, ImageOfAnotherSizeIsRefused) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path(), 4);
  write_png8(scratch / "images/cam0/0.png", Image8(10, 10, 3));
  const Capture capture = read_capture(scratch.path());
  EXPECT_TRUE(contains(error_of([&] { capture.load_image(0); }), "10x10"));
}

}  // namespace
}  // namespace effigy
