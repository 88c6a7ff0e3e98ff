// Scene folders: what is written can be read, and damaged or hostile ones get one sentence.
#include "effigy/splat/scene_file.h"
#include "effigy/splat/gaussian_scene_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>

#include "effigy/base/error.h"
#include "effigy/base/json.h"

namespace effigy {
namespace {

class SceneFile : public testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (std::filesystem::temp_directory_path() / "effigy-XXXXXX").string();
    folder = mkdtemp(pattern.data());
    json = Json::parse(R"({
      "camera": {"width": 6, "height": 5, "fx": 7, "fy": 7, "cx": 3, "cy": 2.5,
                 "camera_from_world": [[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]},
      "texture": {"width": 3, "height": 2, "file": "texture.f32"},
      "surfels": [{"center": [0,0,0], "s": [0.5,0,0], "t": [0,0.4,0], "opacity": 0.8,
                   "uv": [0.5,0.5], "uv_per_st": [[0.1,0],[0,0.1]],
                   "frame": [[1,0,0],[0,1,0],[0,0,1]]}]})");
    write_raw("texture.f32", std::vector<float>(3 * 2 * 7, 0.25f));
  }
  void TearDown() override { std::filesystem::remove_all(folder); }

  void write_raw(const std::string& name, const std::vector<float>& values) {
    write_file(folder / name, {reinterpret_cast<const uint8_t*>(values.data()), values.size() * 4});
  }
  // The sentence that reading gives, after `change`; empty when it succeeds.
  std::string sentence(const std::function<void(Json&)>& change) {
    Json changed = json;
    change(changed);
    write_json(folder / "scene.json", changed);
    try {
      read_splat_scene(folder);
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  }
  void expect_refused(const std::string& about, const std::function<void(Json&)>& change) {
    const std::string text = sentence(change);
    EXPECT_NE(text.find(about), std::string::npos) << "expected '" << about << "' in: " << text;
  }

  Path folder;
  Json json;
};

TEST_F(SceneFile, ASoundSceneIsReadAndDrawn) {
  ASSERT_EQ(sentence([](Json&) {}), "");
  const SplatScene scene = read_splat_scene(folder);
  EXPECT_EQ(scene.surfels.count(), 1u);
  EXPECT_EQ(scene.camera.width, 6);
  EXPECT_EQ(scene.texture.texels[6], 0.25f);
  EXPECT_EQ(scene.texture.texels[7], 0.0f);
  Planes gbuffer;
  SurfelFrame frame;
  render_surfels(scene.camera, scene.surfels, scene.texture, splat_scene_options(), gbuffer, frame);
  EXPECT_GT(frame.pairs(), 0);
  write_splat_outputs(folder / "out", gbuffer);
  EXPECT_EQ(std::filesystem::file_size(folder / "out" / "material.f32"), 6u * 5 * 5 * 4);
  const std::vector<uint8_t> alpha = read_file(folder / "out" / "alpha.f32");
  float center;
  std::memcpy(&center, alpha.data() + 4 * (2 * 6 + 2), 4);
  EXPECT_NEAR(center, 0.8f, 0.1f);
}

TEST_F(SceneFile, DamagedScenesAreRefusedNamingTheField) {
  expect_refused("camera", [](Json& j) { j.erase("camera"); });
  expect_refused("camera", [](Json& j) { j["camera"] = 3; });
  expect_refused("width", [](Json& j) { j["camera"]["width"] = 0; });
  expect_refused("width", [](Json& j) { j["camera"]["width"] = 1e9; });
  expect_refused("height", [](Json& j) { j["camera"]["height"] = 2.5; });
  expect_refused("width", [](Json& j) { j["camera"]["width"] = "six"; });
  expect_refused("fx", [](Json& j) { j["camera"].erase("fx"); });
  expect_refused("fx", [](Json& j) { j["camera"]["fx"] = -1; });
  expect_refused("cx", [](Json& j) { j["camera"]["cx"] = 1e40; });
  expect_refused("camera_from_world", [](Json& j) { j["camera"]["camera_from_world"] = {1, 2}; });
  expect_refused("camera_from_world",
                 [](Json& j) { j["camera"]["camera_from_world"][0][0] = 2.0; });
  expect_refused("camera_from_world",
                 [](Json& j) { j["camera"]["camera_from_world"][0][0] = -1.0; });
  expect_refused("camera_from_world", [](Json& j) { j["camera"]["camera_from_world"][3][0] = 1; });
  expect_refused("texture", [](Json& j) { j.erase("texture"); });
  expect_refused("texture.f32", [](Json& j) { j["texture"]["width"] = 4; });
  expect_refused("texture.file", [](Json& j) { j["texture"]["file"] = "../texture.f32"; });
  expect_refused("texture.file", [](Json& j) { j["texture"]["file"] = "/etc/passwd"; });
  expect_refused("file", [](Json& j) { j["texture"]["file"] = 5; });
  expect_refused("surfels", [](Json& j) { j["surfels"] = "none"; });
  expect_refused("surfels[0]", [](Json& j) { j["surfels"][0] = 1; });
  expect_refused("surfels[0].center", [](Json& j) { j["surfels"][0].erase("center"); });
  expect_refused("surfels[0].center", [](Json& j) { j["surfels"][0]["center"] = {1, 2}; });
  expect_refused("surfels[0].s", [](Json& j) { j["surfels"][0]["s"][1] = "x"; });
  expect_refused("surfels[0].t", [](Json& j) { j["surfels"][0]["t"][1] = 1e200; });
  expect_refused("surfels[0].opacity", [](Json& j) { j["surfels"][0]["opacity"] = 1.5; });
  expect_refused("surfels[0].opacity", [](Json& j) { j["surfels"][0].erase("opacity"); });
  expect_refused("surfels[0].uv_per_st", [](Json& j) {
    j["surfels"][0]["uv_per_st"] = {1, 2, 3, 4};
  });
  expect_refused("surfels[0].frame", [](Json& j) { j["surfels"][0]["frame"][2] = Json(); });
}

TEST_F(SceneFile, DamagedFilesAreRefusedNamingThem) {
  EXPECT_THROW(read_splat_scene(folder), Error);  // no scene.json yet
  write_text(folder / "scene.json", "{\"camera\": ");
  EXPECT_THROW(read_splat_scene(folder), Error);
  write_text(folder / "scene.json", "[1, 2]");
  EXPECT_THROW(read_splat_scene(folder), Error);
  write_raw("texture.f32", std::vector<float>(41, 0.25f));
  expect_refused("texture.f32", [](Json&) {});
  std::vector<float> values(42, 0.25f);
  values[17] = std::nanf("");
  write_raw("texture.f32", values);
  expect_refused("not finite", [](Json&) {});
  std::filesystem::remove(folder / "texture.f32");
  expect_refused("texture.f32", [](Json&) {});
}

TEST_F(SceneFile, UpstreamDerivativesAreChecked) {
  ASSERT_EQ(sentence([](Json&) {}), "");
  const Camera camera = read_splat_scene(folder).camera;
  EXPECT_THROW(read_splat_upstream(folder, camera), Error);  // none there
  write_raw("upstream_normal.f32", std::vector<float>(30 * 3 - 1, 1.0f));
  EXPECT_THROW(read_splat_upstream(folder, camera), Error);
  std::vector<float> values(30 * 3);
  for (size_t i = 0; i < values.size(); ++i) values[i] = static_cast<float>(i);
  write_raw("upstream_normal.f32", values);
  const Planes planes = read_splat_upstream(folder, camera);
  EXPECT_EQ(planes.plane(kNormal + 1)[4], 13.0f);
  EXPECT_EQ(planes.plane(kAlpha)[4], 0.0f);
}

TEST_F(SceneFile, TheKindIsReadFromTheFile) {
  ASSERT_EQ(sentence([](Json&) {}), "");
  EXPECT_EQ(splat_scene_kind(folder), SplatSceneKind::kSurfels);
  json["kind"] = "gaussians";
  write_json(folder / "scene.json", json);
  EXPECT_EQ(splat_scene_kind(folder), SplatSceneKind::kGaussians);
  json["kind"] = "meshes";
  write_json(folder / "scene.json", json);
  EXPECT_THROW(splat_scene_kind(folder), Error);
}

TEST_F(SceneFile, GaussianScenesAreReadDrawnAndChecked) {
  json.erase("texture");
  json.erase("surfels");
  json["kind"] = "gaussians";
  json["gaussians"] = Json::parse(R"([
      {"center": [0,0,0], "rotation": [2,0,0,0], "scale": [0.3,0.2,0.1], "opacity": 0.8,
       "features": [1, 2]},
      {"center": [0,0.2,1], "rotation": [0,1,0,1], "scale": [0.1,0.2,0.1], "opacity": 0.5,
       "features": [3, 4]}])");
  const auto refused = [&](const std::string& about, const std::function<void(Json&)>& change) {
    Json changed = json;
    change(changed);
    write_json(folder / "scene.json", changed);
    std::string text;
    try {
      read_gaussian_scene(folder);
    } catch (const Error& error) {
      text = error.what();
    }
    EXPECT_NE(text.find(about), std::string::npos) << "expected '" << about << "' in: " << text;
  };
  refused("gaussians", [](Json& j) { j.erase("gaussians"); });
  refused("gaussians[1]", [](Json& j) { j["gaussians"][1] = 5; });
  refused("gaussians[1].rotation", [](Json& j) { j["gaussians"][1]["rotation"] = {1, 2, 3}; });
  refused("gaussians[0].scale", [](Json& j) { j["gaussians"][0]["scale"][1] = "x"; });
  refused("gaussians[0].opacity", [](Json& j) { j["gaussians"][0]["opacity"] = -1; });
  refused("gaussians[0].features", [](Json& j) { j["gaussians"][0].erase("features"); });
  refused("gaussians[1].features", [](Json& j) { j["gaussians"][1]["features"] = {1, 2, 3}; });
  refused("camera", [](Json& j) { j.erase("camera"); });
  write_json(folder / "scene.json", json);
  const GaussianScene scene = read_gaussian_scene(folder);
  EXPECT_EQ(scene.gaussians.count(), 2u);
  EXPECT_EQ(scene.gaussians.channels, 2);
  EXPECT_THROW(read_gaussian_upstream(folder, scene), Error);
  std::vector<float> values(30 * 2);
  for (size_t i = 0; i < values.size(); ++i) values[i] = static_cast<float>(i);
  write_raw("upstream_features.f32", values);
  EXPECT_EQ(read_gaussian_upstream(folder, scene).plane(2)[4], 9.0f);
  Planes image;
  GaussianFrame frame;
  render_gaussians(scene.camera, scene.gaussians.view(), {}, image, frame);
  write_gaussian_outputs(folder / "out", image);
  EXPECT_EQ(std::filesystem::file_size(folder / "out" / "features.f32"), 30u * 2 * 4);
}

}  // namespace
}  // namespace effigy
