// Stage captures of the built-in body: what is written can be read, and shows what it says.

#include "effigy/synth/body_capture.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "effigy/base/json.h"
#include "effigy/capture/stage_capture.h"
#include "small_bvh.h"
#include "support.h"
#include "tiny_gltf.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;

SynthBodyOptions tiny() {
  SynthBodyOptions options;
  options.stage.cameras = 3;
  options.stage.lights = 12;
  options.stage.width = options.stage.height_pixels = 48;
  options.stage.frames = 4;
  options.stage.unseen_frames = 1;
  options.samples = 4;
  options.bounces = 2;
  options.texture_size = 256;
  options.relight = {"sunset"};
  options.relight_frames = 1;
  return options;
}

// One capture for all tests that only read.
const StageCapture& capture() {
  static const test::ScratchFolder scratch;
  static const StageCapture made = [] {
    synth_body_capture(tiny(), scratch / "stage");
    return read_stage_capture(scratch / "stage");
  }();
  return made;
}

TEST(SynthBody, TinyStageReadsBack) {
  const StageCapture& c = capture();
  ASSERT_EQ(c.cameras.size(), 3u);
  ASSERT_EQ(c.frames.size(), 5u);
  EXPECT_EQ(c.test_cameras().size(), 1u);
  EXPECT_EQ(c.frames_of(StageSplit::kMotion), std::vector<int>{3});
  EXPECT_EQ(c.frames_of(StageSplit::kEnvironment), std::vector<int>{4});
  EXPECT_TRUE(c.frames[0].fully_lit);
  EXPECT_EQ(c.lights_of(0).size(), 12u);
  EXPECT_LT(c.lights_of(1).size(), 5u);
  EXPECT_TRUE(c.lights_of(4).empty());
  EXPECT_TRUE(fs::exists(c.folder / c.frames[4].environment));
  EXPECT_FALSE(fs::exists(c.folder / "plan.json"));
  for (int camera = 0; camera < 3; ++camera)
    for (int f = 0; f < 5; ++f) {
      const Image8 image = c.load_image(camera, f), mask = c.load_mask(camera, f);
      double covered = 0, bright = 0, outside = 0;
      for (int y = 0; y < 48; ++y)
        for (int x = 0; x < 48; ++x) {
          covered += mask.at(x, y)[0] / 255.0;
          bright += image.at(x, y)[1];
          if (mask.at(x, y)[0] == 0) outside = std::max<double>(outside, image.at(x, y)[1]);
        }
      EXPECT_GT(covered, 0.04 * 48 * 48);
      EXPECT_LT(covered, 0.5 * 48 * 48);
      EXPECT_EQ(outside, 0);
      EXPECT_GT(bright / covered, 12) << camera << " " << f;
    }
}

TEST(SynthBody, TrackedMeshIsSkinnedAndTheTruthHasWrinkles) {
  const StageCapture& c = capture();
  const RigShape shape = shape_rig(c.rig, {});
  double largest = 0;
  for (int f = 0; f < 5; ++f) {
    const StageFrameArrays arrays = load_frame_arrays(c, f);
    std::vector<float> vertices;
    pose_vertices(shape, c.poses[static_cast<size_t>(f)], vertices);
    ASSERT_EQ(arrays.tracked.size(), vertices.size());
    for (size_t i = 0; i < vertices.size(); ++i) {
      ASSERT_NEAR(arrays.tracked[i], vertices[i], 1e-5);
      largest = std::max(largest, std::abs(static_cast<double>(arrays.truth[i] - vertices[i])));
    }
    for (const float share : arrays.irradiance) ASSERT_TRUE(share >= 0 && share <= 1);
  }
  EXPECT_GT(largest, 1e-3);
  EXPECT_LT(largest, 0.05);
  // A moment and the same one under an environment.
  EXPECT_EQ(load_frame_arrays(c, 3).truth, load_frame_arrays(c, 4).truth);
  EXPECT_NE(load_frame_arrays(c, 3).irradiance, load_frame_arrays(c, 4).irradiance);
}

// Over all frames the person fills 85 to 90 % of each picture, cloth included.
TEST(SynthBody, PicturesAreFilled) {
  const StageCapture& c = capture();
  for (const StageCamera& camera : c.cameras) {
    Vec2d low = Vec2d::Constant(1e9), high = -low;
    for (int f = 0; f < 5; ++f) {
      const std::vector<float> truth = load_frame_arrays(c, f).truth;
      for (size_t v = 0; v < truth.size(); v += 3) {
        const Vec2d at = camera.camera.project(Vec3f(&truth[v]).cast<double>());
        low = low.cwiseMin(at);
        high = high.cwiseMax(at);
      }
    }
    EXPECT_GT((high - low).maxCoeff() / 48, 0.85) << camera.name;
    EXPECT_LT((high - low).maxCoeff() / 48, 0.90) << camera.name;
    EXPECT_GT(low.minCoeff(), 1);
    EXPECT_LT(high.maxCoeff(), 47);
  }
}

TEST(SynthBody, KeypointsMoveWithTheirRoots) {
  const StageCapture& c = capture();
  const RigShape shape = shape_rig(c.rig, {});
  const auto find = [](const std::vector<std::string>& names, const char* name) {
    return static_cast<size_t>(std::find(names.begin(), names.end(), name) - names.begin());
  };
  const size_t count = c.body_keypoint_names.size(), hips = find(c.body_keypoint_names, "hips");
  ASSERT_LT(hips, count);
  EXPECT_LT(find(c.body_keypoint_names, "little_tip_right"), count);
  EXPECT_EQ(c.face_keypoint_names.size(), 70u);
  for (size_t f = 0; f < 5; ++f) {
    // The hips' keypoint is the image of their rest position.
    const auto& m = c.body_from_rest[f];
    for (size_t r = 0; r < 3; ++r) {
      double p = m[4 * r + 3];
      for (size_t k = 0; k < 3; ++k) p += static_cast<double>(m[4 * r + k] * shape.joints[k]);
      EXPECT_NEAR(p, c.body_keypoints[3 * (f * count + hips) + r], 1e-5);
    }
  }
}

TEST(SynthBody, LayersAgreeWithTheTrueSurface) {
  const StageCapture& c = capture();
  EXPECT_EQ(c.layers.size(), 7u);
  std::map<int, int> labels;
  for (const int f : {0, 3})
    for (int camera = 0; camera < 3; ++camera) {
      const Camera& view = c.cameras[static_cast<size_t>(camera)].camera;
      const Image depth = c.load_layer("depth", camera, f), part = c.load_layer("part", camera, f),
                  uv = c.load_layer("uv", camera, f), albedo = c.load_layer("albedo", camera, f),
                  normal = c.load_layer("normal", camera, f),
                  radiance = c.load_layer("radiance", camera, f);
      const std::vector<float> truth = load_frame_arrays(c, f).truth;
      for (int y = 0; y < 48; ++y)
        for (int x = 0; x < 48; ++x) {
          ++labels[static_cast<int>(part.at(x, y)[0])];
          if (part.at(x, y)[0] == 0) {
            EXPECT_EQ(depth.at(x, y)[0], 0);
            continue;
          }
          EXPECT_GT(albedo.at(x, y)[1], 0);
          EXPECT_NEAR(Vec3f(normal.at(x, y)).norm(), 1, 1e-2);
          EXPECT_TRUE(uv.at(x, y)[0] > 0 && uv.at(x, y)[0] < 1);
          EXPECT_GT(radiance.at(x, y)[3], 0);
          if ((x + y) % 7 != 0) continue;
          // The point at this depth lies on the true surface.
          const double z = static_cast<double>(depth.at(x, y)[0]);
          const Vec3d q((x + 0.5 - view.cx) / view.fx * z, (y + 0.5 - view.cy) / view.fy * z, z);
          const Vec3f p = (view.camera_from_world_rotation.transpose() *
                           (q - view.camera_from_world_translation))
                              .cast<float>();
          float nearest = 9;
          for (size_t v = 0; v < truth.size(); v += 3)
            nearest = std::min(nearest, (Vec3f(&truth[v]) - p).squaredNorm());
          EXPECT_LT(std::sqrt(nearest), 0.012f);
        }
    }
  // skin, hair, cloth and shoes are to be seen: labels 1, 2, 7, 8.
  for (const int label : {1, 2, 7, 8}) EXPECT_GT(labels[label], 3) << label;
}

TEST(SynthBody, InterruptedCapturesGoOn) {
  const test::ScratchFolder scratch;
  // The capture as it was before its last images.
  fs::copy(capture().folder, scratch / "again.partial", fs::copy_options::recursive);
  write_json(scratch / "again.partial/plan.json", capture().extra["made"]);
  fs::remove(scratch / "again.partial/capture.json");
  int missing = 0;
  for (const auto& [camera, frame] : {std::pair{1, 2}, {0, 4}, {2, 4}}) {
    fs::remove(scratch / "again.partial" /
               stage_image_path(capture().cameras[static_cast<size_t>(camera)].name, frame));
    ++missing;
  }
  // Other options do not mix with it.
  SynthBodyOptions other = tiny();
  other.samples = 8;
  EXPECT_THROW(synth_body_capture(other, scratch / "again"), Error);
  const SynthBodyResult result = synth_body_capture(tiny(), scratch / "again");
  EXPECT_EQ(result.images, 15);
  EXPECT_EQ(result.kept, 15 - missing);
  EXPECT_FALSE(fs::exists(scratch / "again.partial"));
  const StageCapture again = read_stage_capture(scratch / "again");
  for (int camera = 0; camera < 3; ++camera)
    for (int f = 0; f < 5; ++f)
      EXPECT_EQ(again.load_image(camera, f).data, capture().load_image(camera, f).data);
  EXPECT_EQ(load_frame_arrays(again, 4).irradiance, load_frame_arrays(capture(), 4).irradiance);
}

TEST(SynthBody, TrueMeshAndTrackingErrorAreChoices) {
  const test::ScratchFolder scratch;
  SynthBodyOptions options = tiny();
  options.stage.cameras = 1;
  options.stage.frames = 2;
  options.samples = 1;
  options.layers = false;
  options.relight.clear();
  options.true_mesh = true;
  options.tracking_error = 1;
  synth_body_capture(options, scratch / "stage");
  const StageCapture c = read_stage_capture(scratch / "stage");
  const StageFrameArrays arrays = load_frame_arrays(c, 1);
  EXPECT_EQ(arrays.tracked, arrays.truth);
  EXPECT_TRUE(arrays.irradiance.empty());
  EXPECT_NE(c.poses[1].joint_rotation, c.true_poses[1].joint_rotation);
  EXPECT_THROW(c.load_layer("depth", 0, 0), Error);
}

// Light spreads below skin, not below cloth, and little of it is lost.
TEST(SynthBody, SubsurfaceIsOfTheSkin) {
  const test::ScratchFolder scratch;
  SynthBodyOptions options = tiny();
  options.stage.frames = 2;
  options.relight.clear();
  options.samples = 64;
  options.bounces = 1;
  StageCapture captures[2];
  for (const bool subsurface : {false, true}) {
    options.subsurface = subsurface;
    const std::string name = subsurface ? "soft" : "opaque";
    synth_body_capture(options, scratch / name);
    captures[subsurface] = read_stage_capture(scratch / name);
  }
  double opaque[2] = {}, soft[2] = {}, difference[2] = {};  // of cloth, of skin
  for (int camera = 0; camera < 3; ++camera) {
    const Image a = captures[0].load_layer("radiance", camera, 1),
                b = captures[1].load_layer("radiance", camera, 1),
                part = captures[0].load_layer("part", camera, 1);
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 48; ++x) {
        const int label = static_cast<int>(part.at(x, y)[0]);
        if ((label != 1 && label != 6 && label != 7) || a.at(x, y)[3] < 1) continue;
        const int skin = label != 7;
        opaque[skin] += static_cast<double>(a.at(x, y)[0]);
        soft[skin] += static_cast<double>(b.at(x, y)[0]);
        difference[skin] += std::abs(static_cast<double>(a.at(x, y)[0] - b.at(x, y)[0]));
      }
  }
  EXPECT_NEAR(soft[0] / opaque[0], 1, 0.01);  // pixels at its edges show some skin
  EXPECT_NEAR(soft[1] / opaque[1], 1, 0.12);
  EXPECT_GT(difference[1] / opaque[1], 5 * difference[0] / opaque[0]);
}

// The user's own body: it sways in the middle of the stage.
TEST(SynthBody, FilmsTheUsersOwn) {
  const test::ScratchFolder scratch;
  write_text(scratch / "body.gltf", test::sound_gltf());
  SynthBodyOptions options = tiny();
  options.body = (scratch / "body.gltf").string();
  synth_body_capture(options, scratch / "stage");
  const StageCapture c = read_stage_capture(scratch / "stage");
  EXPECT_EQ(c.rig.kind, "gltf");
  ASSERT_FALSE(c.parts.empty());
  EXPECT_EQ(c.parts[0], "red");
  EXPECT_EQ(c.body_keypoint_names, (std::vector<std::string>{"base", "tip"}));
  EXPECT_TRUE(c.face_keypoint_names.empty());
  const StageFrameArrays first = load_frame_arrays(c, 0), second = load_frame_arrays(c, 1);
  EXPECT_EQ(first.tracked, first.truth);
  EXPECT_NE(first.truth, second.truth);
  int red = 0;
  for (int camera = 0; camera < 3; ++camera) {
    const Image8 image = c.load_image(camera, 0);
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 48; ++x) red += image.at(x, y)[0] > 2 * image.at(x, y)[1] + 20;
  }
  EXPECT_GT(red, 40);

  const auto error_of = [&](const std::string& from, const std::string& to) -> std::string {
    std::string text = test::sound_gltf();
    text.replace(text.find(from), from.size(), to);
    write_text(scratch / "body.gltf", text);
    try {
      synth_body_capture(options, scratch / "other");
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_TRUE(test::contains(error_of(",\"TEXCOORD_0\":1", ""), "no UVs"));
  EXPECT_TRUE(test::contains(error_of("\"name\":\"base\"", "\"name\":\"base\",\"scale\":[9,9,9]"),
                             "metres tall"));
  EXPECT_FALSE(fs::exists(scratch / "other.partial"));
  // Two joints are no person that a BVH file could move.
  write_text(scratch / "body.gltf", test::sound_gltf());
  write_text(scratch / "motion.bvh", test::sound_file(20));
  options.motion = (scratch / "motion.bvh").string();
  options.stage.frames_per_second = 30;
  try {
    synth_body_capture(options, scratch / "other");
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_TRUE(test::contains(error.what(), "of the body is known as")) << error.what();
  }
}

TEST(SynthBody, FilmsAClothedPersonFromAFile) {
  const Path data = test::outside_data("EFFIGY_DATA");
  const Path file = data / "body/morse_human/morse_makehuman_human.glb";
  const Path motion = data / "body/mocap/cmu_01_01.bvh";
  if (data.empty() || !fs::exists(file) || !fs::exists(motion))
    GTEST_SKIP() << "needs EFFIGY_DATA/body/morse_human and EFFIGY_DATA/body/mocap";
  const test::ScratchFolder scratch;
  SynthBodyOptions options = tiny();
  options.body = file.string();
  options.motion = motion.string();
  options.stage.frames_per_second = 1;
  options.relight.clear();
  synth_body_capture(options, scratch / "stage");
  const StageCapture c = read_stage_capture(scratch / "stage");
  // From the clip's T-pose on the floor into a jump.
  const auto height = [&](size_t frame, const char* joint) {
    const auto at = std::find(c.body_keypoint_names.begin(), c.body_keypoint_names.end(), joint);
    return c.body_keypoints[3 * (frame * c.body_keypoint_names.size() +
                                 static_cast<size_t>(at - c.body_keypoint_names.begin())) +
                            1];
  };
  EXPECT_GT(height(0, "head"), 1.5f);
  EXPECT_GT(height(2, "head"), height(0, "head") + 0.1f);
  EXPECT_NEAR(height(0, "wrist_L"), height(0, "shoulder02_L"), 0.15f);
  EXPECT_NEAR(height(0, "foot_L"), 0.13f, 0.06f);
  double covered = 0;
  const Image8 mask = c.load_mask(1, 1);
  for (const uint8_t m : mask.data) covered += m / 255.0;
  EXPECT_GT(covered, 0.03 * 48 * 48);
}

TEST(SynthBody, RefusesACameraInTheBodyAndForeignFolders) {
  const test::ScratchFolder scratch;
  SynthBodyOptions options = tiny();
  options.stage.radius = 0.101;
  options.stage.height = 1.1;
  try {
    synth_body_capture(options, scratch / "stage");
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_TRUE(test::contains(error.what(), "inside")) << error.what();
    EXPECT_TRUE(test::contains(error.what(), "camera cam")) << error.what();
  }
  EXPECT_FALSE(fs::exists(scratch / "stage.partial"));
  // The first camera is outside, another is not: nothing is left that blocks corrected options.
  options.stage.radius = 0.2;
  options.stage.height = 0.95;
  options.stage.cameras = 12;
  EXPECT_TRUE(test::contains(
      test::error_of([&] { synth_body_capture(options, scratch / "stage"); }), "camera cam003"));
  EXPECT_FALSE(fs::exists(scratch / "stage.partial"));
  write_text(scratch / "mine/letter.txt", "dear");
  EXPECT_THROW(synth_body_capture(tiny(), scratch / "mine"), Error);
}

TEST(SynthBody, PlanCountsWithoutMaking) {
  SynthBodyOptions options = tiny();
  const SynthBodyPlan plan = plan_body_capture(options);
  EXPECT_EQ(plan.images, 15);
  EXPECT_EQ(plan.train + plan.held_out_lights + plan.unseen + plan.relit, 5);
  EXPECT_EQ(plan.samples, int64_t{15} * 48 * 48 * 4);
  EXPECT_GT(plan.seconds, 0);
  // The disk space of the capture as it came out, to a quarter.
  double bytes = 0;
  for (const auto& entry : fs::recursive_directory_iterator(capture().folder))
    if (entry.is_regular_file()) bytes += static_cast<double>(entry.file_size());
  EXPECT_NEAR(static_cast<double>(plan.bytes) / bytes, 1, 0.25);
}

}  // namespace
}  // namespace effigy
