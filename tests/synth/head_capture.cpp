// Captures of the built-in head: what is written can be read, and shows what it says.

#include "effigy/synth/head_capture.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/capture/truth.h"
#include "effigy/image/files.h"
#include "effigy/image/metrics.h"
#include "effigy/splat/surfel_raster.h"
#include "effigy/synth/head_scene.h"
#include "effigy/synth/prior_image.h"
#include "effigy/synth/tracking_error.h"
#include "effigy/synth/truth_image.h"
#include "support.h"
#include "tiny_head_gltf.h"

namespace effigy {
namespace {

SynthHeadOptions tiny() {
  SynthHeadOptions options;
  options.frames = 4;
  options.size = 64;
  options.samples = 4;
  options.texture_size = 256;
  options.relight = {"overcast", "sunset"};
  options.relight_frames = 1;
  return options;
}

TEST(SynthHead, TinyCaptureReadsBackWithItsTruth) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.albedo_prior = "truth";
  synth_head_capture(options, scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  ASSERT_EQ(capture.frames.size(), 4u);
  EXPECT_EQ(capture.rig.kind, "builtin");
  EXPECT_EQ(capture.test_frames().size(), 1u);
  for (int f = 0; f < 4; ++f) {
    const Image8 image = capture.load_image(f), mask = capture.load_mask(f);
    double covered = 0, soft = 0, outside = 0;
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) {
        const int m = mask.at(x, y)[0];
        covered += m / 255.0;
        soft += m > 0 && m < 255 ? 1 : 0;
        if (m == 0) outside = std::max<double>(outside, image.at(x, y)[1]);
      }
    // A head fills a quarter to three quarters of the frame; its rim is anti-aliased; the rest is
    // black.
    EXPECT_GT(covered / (64 * 64), 0.2);
    EXPECT_LT(covered / (64 * 64), 0.75);
    EXPECT_GT(soft, 20);
    EXPECT_EQ(outside, 0);
    EXPECT_FALSE(capture.frames[f].albedo.empty());
    EXPECT_EQ(read_image8(capture.folder / capture.frames[f].albedo).width, 64);
  }
}

TEST(SynthHead, SubjectsDiffer) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.relight.clear();
  synth_head_capture(options, scratch / "one");
  options.subject = 3;
  synth_head_capture(options, scratch / "three");
  const Image8 one = read_capture(scratch / "one").load_image(0),
               three = read_capture(scratch / "three").load_image(0);
  EXPECT_LT(psnr(to_float(one), to_float(three)), 25);
}

TEST(PriorImage, DegradedAsDocumented) {
  // Half of the disc red, half blue; black outside.
  const int size = 96;
  Image albedo(size, size, 3), alpha(size, size, 1);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      if (std::hypot(x - 47.5, y - 47.5) > 40) continue;
      alpha.at(x, y)[0] = 1;
      albedo.at(x, y)[x < 48 ? 0 : 2] = 0.6f;
    }
  const Image8 truth = albedo_prior_image(albedo, alpha, "truth");
  const Image8 degraded = albedo_prior_image(albedo, alpha, "degraded");
  const auto linear = [](const Image8& image, int x, int y, int c) {
    return linear_from_srgb(image.at(x, y)[c] / 255.0f);
  };
  EXPECT_NEAR(linear(truth, 20, 48, 0), 0.6, 0.005);
  // Far from the seam: two thirds of itself and a third of the mean, darker and tinted; no dark
  // rim.
  for (const int x : {12, 20, 30}) {
    EXPECT_NEAR(linear(degraded, x, 48, 0), 0.75 * 1.1 * (0.6 * 2 / 3 + 0.3 / 3), 0.01) << x;
    EXPECT_NEAR(linear(degraded, x, 48, 2), 0.75 * 0.85 * 0.3 / 3, 0.01) << x;
  }
  EXPECT_NEAR(linear(degraded, 47, 48, 0), 0.75 * 1.1 * 0.3, 0.05);  // blurred at the seam
  EXPECT_EQ(degraded.at(2, 2)[0], 0);
  EXPECT_THROW(albedo_prior_image(albedo, alpha, "guess"), Error);
}

// The stored parameters and camera put the vertices where the mask is.
TEST(SynthHead, TrueParametersProjectOntoTheMask) {
  const test::ScratchFolder scratch;
  synth_head_capture(tiny(), scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  const RigShape shape = shape_rig(capture.rig, capture.identity);
  for (int f = 0; f < 4; ++f) {
    std::vector<float> vertices;
    pose_vertices(shape, capture.poses[f], vertices);
    const Image8 mask = capture.load_mask(f);
    int inside = 0, all = 0;
    double left = 64, right = 0;
    for (size_t v = 0; v + 2 < vertices.size(); v += 3) {
      const Vec2d p = capture.camera.project(Vec3d(vertices[v], vertices[v + 1], vertices[v + 2]));
      left = std::min(left, p.x());
      right = std::max(right, p.x());
      const int x = static_cast<int>(std::floor(p.x())), y = static_cast<int>(std::floor(p.y()));
      if (x < 1 || y < 1 || x >= 63 || y >= 63) continue;
      ++all;
      // On the silhouette a pixel may round to nothing; its neighbour then shows the head.
      bool covered = false;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) covered |= mask.at(x + dx, y + dy)[0] > 0;
      inside += covered ? 1 : 0;
    }
    ASSERT_GT(all, 3000);
    EXPECT_EQ(inside, all);
    double first = 64, last = 0;
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x)
        if (mask.at(x, y)[0] > 127) {
          first = std::min<double>(first, x);
          last = std::max<double>(last, x + 1);
        }
    EXPECT_NEAR(first, std::max(left, 0.0), 1.2);
    EXPECT_NEAR(last, std::min(right, 64.0), 1.2);
  }
}

TEST(SynthHead, RelightingTruthIsListedAndDiffers) {
  const test::ScratchFolder scratch;
  synth_head_capture(tiny(), scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  const Json relight = capture.extra.at("relight");
  ASSERT_EQ(relight.size(), 2u);
  const int held_out = capture.test_frames().front();
  const Image8 original = capture.load_image(held_out);
  for (const auto& [name, entry] : relight.items()) {
    const Image light = read_image(capture.folder / entry.at("light").get<std::string>());
    EXPECT_EQ(light.width, 2 * light.height) << name;
    const auto& images = entry.at("images");
    const auto number = std::to_string(capture.frames[held_out].number);
    ASSERT_TRUE(images.contains(number)) << name;
    const Image8 relit = read_image8(capture.folder / images.at(number).get<std::string>());
    ASSERT_EQ(relit.data.size(), original.data.size());
    double difference = 0;
    for (size_t i = 0; i < relit.data.size(); ++i)
      difference += std::abs(relit.data[i] - original.data[i]);
    EXPECT_GT(difference / static_cast<double>(relit.data.size()), 1.0) << name;
  }
}

// Every layer reads back and fits the others: depth and UV lie where the matte is, the posed
// vertices are those of the true parameters, the image is its radiance encoded.
TEST(SynthHead, LayersAgreeWithEachOther) {
  const test::ScratchFolder scratch;
  synth_head_capture(tiny(), scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  const auto truth = read_truth(capture);
  ASSERT_TRUE(truth.has_value());
  EXPECT_EQ(truth->transport, "path-traced");
  const RigShape shape = shape_rig(capture.rig, truth->identity);
  const size_t floats = 3 * static_cast<size_t>(capture.rig.mesh.vertex_count());
  ASSERT_EQ(truth->irradiance.size(), 4 * floats);
  ASSERT_EQ(truth->keypoints.size(), size_t{4 * 68 * 3});
  for (int f = 0; f < 4; ++f) {
    std::vector<float> vertices;
    pose_vertices(shape, truth->poses[f], vertices);
    for (size_t i = 0; i < floats; ++i)
      ASSERT_NEAR(vertices[i], truth->vertices[f * floats + i], 1e-6);
    const Image radiance = load_layer(capture, *truth, "radiance", f),
                depth = load_layer(capture, *truth, "depth", f),
                normal = load_layer(capture, *truth, "normal", f),
                uv = load_layer(capture, *truth, "uv", f),
                part = load_layer(capture, *truth, "part", f),
                material = load_layer(capture, *truth, "material", f),
                albedo = load_layer(capture, *truth, "albedo", f);
    const Image8 image = capture.load_image(f);
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) {
        const float alpha = radiance.at(x, y)[3];
        const bool centre = depth.at(x, y)[0] > 0;
        EXPECT_EQ(centre, part.at(x, y)[0] > 0);
        if (alpha == 1) {
          EXPECT_TRUE(centre);
          EXPECT_NEAR(depth.at(x, y)[0], 1, 0.25);
          EXPECT_GT(albedo.at(x, y)[0], 0);
          EXPECT_GT(material.at(x, y)[0], 0);
          EXPECT_LE(material.at(x, y)[2], 1);
          const float encoded = srgb_from_linear(std::min(radiance.at(x, y)[1], 1.0f));
          EXPECT_NEAR(image.at(x, y)[1], 255 * encoded, 0.7);
        }
        if (alpha == 0) {
          EXPECT_FALSE(centre);
        }
        if (centre) {
          EXPECT_NEAR(Vec3f(normal.at(x, y)).norm(), 1, 2e-3);
          EXPECT_TRUE(uv.at(x, y)[0] > 0 && uv.at(x, y)[0] < 1);
        }
      }
  }
  for (const float value : truth->irradiance) ASSERT_TRUE(value >= 0 && value <= 1);
  // A damaged layer is named.
  const Path broken = capture.folder / "layers/depth/000001.exr";
  write_exr(broken, Image(32, 32, 1, 1.0f));
  EXPECT_TRUE(test::contains(test::error_of([&] { load_layer(capture, *truth, "depth", 1); }),
                             "000001.exr"));
  EXPECT_TRUE(
      test::contains(test::error_of([&] { load_layer(capture, *truth, "sound", 1); }), "sound"));
}

// Where nothing shadows and the light is smooth, the three truths are close; shadows only darken.
TEST(SynthHead, TheThreeTruthsDifferAsTheyShould) {
  SynthHeadOptions options = tiny();
  options.samples = 64;
  HeadScene head(options);
  head.pose(head.performance(0), 0);
  const Image light = synth_light("overcast");
  head.scene().set_environment(std::make_shared<EnvironmentSampler>(light));
  TraceOptions trace;
  trace.samples = 64;
  const Image global = trace_image(head.scene(), head.camera(), trace);
  trace.bounces = 1;
  const Image direct = trace_image(head.scene(), head.camera(), trace);
  trace.transport = Transport::kUnshadowed;
  const Image unshadowed = trace_image(head.scene(), head.camera(), trace);
  const Image split = split_sum_image(head.scene(), head.camera(), prefilter_environment(light), 4);
  const auto total = [](const Image& image) {
    double sum = 0;
    for (size_t i = 0; i < image.data.size(); ++i) sum += i % 4 == 3 ? 0.0 : image.data[i];
    return sum;
  };
  EXPECT_NEAR(total(split) / total(unshadowed), 1, 0.05);
  EXPECT_GT(psnr(display_image(split), display_image(unshadowed)), 30);
  EXPECT_LT(total(direct), 0.95 * total(unshadowed));
  EXPECT_GT(total(global), 1.01 * total(direct));
  EXPECT_LT(total(global), total(unshadowed));
}

// Defects touch the training frames and what a tracker found, never the truth.
TEST(SynthHead, DefectsLeaveTheTruthAlone) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.relight.clear();
  synth_head_capture(options, scratch / "clean");
  options.noise = 0.03;
  options.compression = 50;
  options.tracking_error = 2;
  synth_head_capture(options, scratch / "bad");
  const Capture clean = read_capture(scratch / "clean"), bad = read_capture(scratch / "bad");
  const auto clean_truth = read_truth(clean), bad_truth = read_truth(bad);
  EXPECT_EQ(clean_truth->vertices, bad_truth->vertices);
  EXPECT_EQ(clean.poses[1].translation, clean_truth->poses[1].translation);
  EXPECT_NE(bad.poses[1].translation, bad_truth->poses[1].translation);
  for (int f = 0; f < 4; ++f) {
    const double difference = psnr(to_float(clean.load_image(f)), to_float(bad.load_image(f)));
    if (clean.frames[f].test) {
      EXPECT_EQ(difference, 100);
    } else {
      EXPECT_GT(difference, 25);
      EXPECT_LT(difference, 40);
    }
  }
}

TEST(SynthHead, TrackingErrorHasTheStatedSize) {
  const Rig rig = builtin_head_rig();
  const std::vector<RigPose> still(300, RigPose::rest(rig));
  double square = 0, expression = 0;
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    const auto tracked = with_tracking_error(rig, still, 30, 1, seed);
    for (const RigPose& pose : tracked) {
      square += std::pow(pose.translation[0], 2);
      for (size_t e = 0; e < pose.expression.size(); ++e) {
        EXPECT_GE(pose.expression[e], rig.expression_low[e]);
        expression = std::max<double>(expression, pose.expression[e]);
      }
    }
  }
  EXPECT_NEAR(std::sqrt(square / (20 * 300)), 1e-3, 4e-4);
  EXPECT_GT(expression, 0.03);
  EXPECT_LT(expression, 0.2);
}

TEST(SynthHead, SameSeedSamePicturesOtherSeedOtherPoses) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.relight.clear();
  synth_head_capture(options, scratch / "a");
  synth_head_capture(options, scratch / "b");
  const Capture a = read_capture(scratch / "a"), b = read_capture(scratch / "b");
  for (int f = 0; f < 4; ++f) {
    EXPECT_EQ(a.load_image(f).data, b.load_image(f).data);
    EXPECT_EQ(a.poses[f].expression, b.poses[f].expression);
  }
  const RigPose other = performance_pose(a.rig, 1.0, 99), same = performance_pose(a.rig, 1.0, 1);
  EXPECT_NE(other.expression, same.expression);
}

// Thirty frames a second apart by a thirtieth: no jumps beyond a blink's.
TEST(SynthHead, PerformanceIsSmoothAndLively) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.relight.clear();
  synth_head_capture(options, scratch / "a");
  const Rig rig = read_capture(scratch / "a").rig;
  const int blink = rig.expression("eyeBlink_L"), jaw = rig.expression("jawOpen");
  ASSERT_GE(blink, 0);
  ASSERT_GE(jaw, 0);
  float most_yaw = 0, most_jaw = 0, most_blink = 0, most_step = 0;
  RigPose previous = performance_pose(rig, 0, 1);
  for (int i = 1; i < 300; ++i) {
    const RigPose pose = performance_pose(rig, i / 30.0, 1);
    for (size_t k = 0; k < pose.joint_rotation.size(); ++k) {
      if (k >= 9) continue;  // gaze jumps, as it does
      most_step =
          std::max(most_step, std::abs(pose.joint_rotation[k] - previous.joint_rotation[k]));
    }
    most_yaw = std::max(most_yaw, std::abs(pose.joint_rotation[1]));
    most_jaw = std::max(most_jaw, pose.expression[jaw]);
    most_blink = std::max(most_blink, pose.expression[blink]);
    previous = pose;
  }
  EXPECT_LT(most_step, 0.12f);
  EXPECT_GT(most_yaw, 0.2f);
  EXPECT_LT(most_yaw, 0.7f);
  EXPECT_GT(most_jaw, 0.2f);
  EXPECT_GT(most_blink, 0.6f);
}

// The user's own head, cut from a body: framed, facing the camera, talking, with its truth.
TEST(SynthHead, FilmsTheUsersOwn) {
  const test::ScratchFolder scratch;
  test::TinyHeadGltf({}).write(scratch.path(), "me.gltf");
  SynthHeadOptions options = tiny();
  options.head = (scratch / "me.gltf").string();
  options.consent = "my own";
  options.frames_per_second = 4;
  synth_head_capture(options, scratch / "capture");
  const Capture capture = read_capture(scratch / "capture");
  EXPECT_EQ(capture.rig.kind, "user");
  EXPECT_EQ(capture.consent, "my own");
  EXPECT_EQ(capture.licence, "the user's own");
  EXPECT_TRUE(test::contains(capture.source, "me.gltf"));
  const auto truth = read_truth(capture);
  ASSERT_TRUE(truth.has_value());
  EXPECT_TRUE(truth->keypoints.empty());
  const size_t jaw = static_cast<size_t>(capture.rig.expression("jawOpen"));
  float widest = 0;
  for (int f = 0; f < 4; ++f) {
    widest = std::max(widest, capture.poses[static_cast<size_t>(f)].expression[jaw]);
    const Image8 image = capture.load_image(f), mask = capture.load_mask(f);
    double covered = 0, red = 0, green = 0;
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) {
        covered += mask.at(x, y)[0] / 255.0;
        (y < 32 ? red : green) += image.at(x, y)[0] - image.at(x, y)[1];
        const bool rim = x == 0 || y == 0 || x == 63 || y == 63;
        if (rim) {
          EXPECT_EQ(mask.at(x, y)[0], 0);
        }
      }
    EXPECT_GT(covered / (64 * 64), 0.35);  // a ball that fills most of the picture's height
    EXPECT_GT(red, 3000);                  // above
    EXPECT_LT(green, -3000);               // below
  }
  EXPECT_GT(widest, 0.02f);
  options.subsurface = true;
  EXPECT_TRUE(test::contains(test::error_of([&] { synth_head_capture(options, scratch / "x"); }),
                             "--subsurface"));
  EXPECT_FALSE(std::filesystem::exists(scratch / "x"));
}

// What a rig has not as a shape, its joints do, and the other way round.
TEST(SynthHead, PerformancesUseWhatThereIs) {
  Rig rig;
  rig.joint_names = {"root", "neck", "jaw"};
  rig.parents = {-1, 0, 1};
  rig.expression_names = {"eyeBlink", "eyeLookOut_L", "mouthSmile_L", "mouthSmile"};
  rig.expression_count = 4;
  float jaw = 0, blink = 0, gaze = 0, smile = 0, both = 0;
  for (int i = 0; i < 200; ++i) {
    const RigPose pose = performance_pose(rig, i / 30.0, 1);
    jaw = std::max(jaw, pose.joint_rotation[6]);
    blink = std::max(blink, pose.expression[0]);
    gaze = std::max(gaze, pose.expression[1]);
    smile = std::max(smile, pose.expression[2]);
    both = std::max(both, pose.expression[3]);
  }
  EXPECT_GT(jaw, 0.08f);
  EXPECT_LT(jaw, 0.35f);
  EXPECT_GT(blink, 0.6f);
  EXPECT_GT(gaze, 0.1f);
  EXPECT_GT(smile, 0.2f);
  EXPECT_EQ(both, 0);  // the side's own shape stands for it
}

TEST(SynthHead, RefusesNonsense) {
  const test::ScratchFolder scratch;
  SynthHeadOptions options = tiny();
  options.frames = 0;
  EXPECT_THROW(synth_head_capture(options, scratch / "x"), Error);
  options = tiny();
  options.light = "no-such-light";
  EXPECT_THROW(synth_head_capture(options, scratch / "x"), Error);
  options = tiny();
  options.relight = {"sunset", "sunset"};
  EXPECT_THROW(synth_head_capture(options, scratch / "x"), Error);
  options = tiny();
  options.noise = -1;
  EXPECT_THROW(synth_head_capture(options, scratch / "x"), Error);
  options = tiny();
  options.distance = 0.01;
  EXPECT_TRUE(test::contains(test::error_of([&] { synth_head_capture(options, scratch / "x"); }),
                             "camera is inside"));
  EXPECT_FALSE(std::filesystem::exists(scratch / "x"));
  // A pose that is not finite names its frame.
  HeadScene head(tiny());
  RigPose pose = head.performance(0);
  pose.joint_rotation[4] = std::nanf("");
  EXPECT_TRUE(test::contains(test::error_of([&] { head.pose(pose, 7); }), "Frame 7"));
}

}  // namespace
}  // namespace effigy
