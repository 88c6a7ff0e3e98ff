// The light stage's plan: geometry, units and the paper's shares.

#include "effigy/synth/light_stage.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "effigy/capture/stage_capture.h"
#include "support.h"

namespace effigy {
namespace {

TEST(LightStage, DomeDirectionsAreEven) {
  const std::vector<Vec3d> dome = dome_directions(200, -0.3, 1, 0.2);
  ASSERT_EQ(dome.size(), 200u);
  // Caps of equal area hold equal shares, and neighbours keep about one distance: that of a
  // hexagonal packing is the best there can be.
  int upper = 0;
  double nearest_sum = 0, nearest_least = 9;
  for (const Vec3d& d : dome) {
    EXPECT_NEAR(d.norm(), 1, 1e-12);
    EXPECT_GT(d.y(), -0.3);
    upper += d.y() > 0.35;
    double nearest = 9;
    for (const Vec3d& e : dome)
      if (&e != &d) nearest = std::min(nearest, (d - e).norm());
    nearest_sum += nearest / 200;
    nearest_least = std::min(nearest_least, nearest);
  }
  EXPECT_EQ(upper, 100);
  const double best = std::sqrt(2 / std::sqrt(3.0) * 2 * std::numbers::pi * 1.3 / 200);
  EXPECT_GT(nearest_sum, 0.8 * best);
  EXPECT_GT(nearest_least, 0.55 * best);
}

TEST(LightStage, CamerasAndLightsStandOnTheDome) {
  const StageOptions options = stage_preset("small");
  const LightStage stage = make_light_stage(options);
  ASSERT_EQ(stage.cameras.size(), 16u);
  ASSERT_EQ(stage.lights.size(), 128u);
  double power = 0;
  for (const StageLight& light : stage.lights) {
    const double d = (light.position.cast<double>() - stage.centre).norm();
    EXPECT_NEAR(d, 2.75, 1e-5);
    EXPECT_GT(light.position.y(), 0);
    power += static_cast<double>(light.intensity.x()) / (d * d);
  }
  // As much light as from an environment of radiance 1: 4 pi.
  EXPECT_NEAR(power, 4 * std::numbers::pi, 1e-4);
  int held_out = 0;
  for (const StageCamera& camera : stage.cameras) {
    EXPECT_NEAR((camera.camera.center() - stage.centre).norm(), 2.75, 1e-9);
    const Vec2d middle = camera.camera.project(stage.centre);
    EXPECT_NEAR(middle.x(), 256, 1e-6);
    EXPECT_NEAR(middle.y(), 256, 1e-6);
    // Head and feet are in the picture.
    for (const double y : {0.0, 1.75}) {
      const Vec2d p = camera.camera.project(Vec3d(0, y, 0));
      EXPECT_GT(p.y(), 0);
      EXPECT_LT(p.y(), 512);
    }
    held_out += camera.test;
  }
  EXPECT_EQ(held_out, 3);  // 20 %
}

TEST(LightStage, PaperStage) {
  const StageOptions options = stage_preset("paper");
  const LightStage stage = make_light_stage(options);
  EXPECT_EQ(stage.cameras.size(), 512u);
  EXPECT_EQ(stage.lights.size(), 1024u);
  EXPECT_EQ(options.radius, 2.75);
  EXPECT_EQ(std::count_if(stage.cameras.begin(), stage.cameras.end(),
                          [](const StageCamera& c) { return c.test; }),
            102);
  EXPECT_THROW(stage_preset("large"), Error);
}

TEST(LightStage, ProtocolHoldsOutCamerasLightsAndMotion) {
  StageOptions options;
  options.frames = 240;
  const std::vector<StageFrame> frames = plan_stage_frames(options, 128);
  ASSERT_EQ(frames.size(), 240u);
  int full = 0, partial = 0, held_out = 0, unseen = 0;
  std::set<std::vector<std::pair<int, float>>> different;
  for (const StageFrame& frame : frames) {
    full += frame.fully_lit;
    unseen += frame.split == StageSplit::kMotion;
    held_out += frame.split == StageSplit::kLights;
    if (frame.fully_lit) {
      EXPECT_TRUE(frame.lights.empty());
      EXPECT_EQ(frame.split, StageSplit::kTrain);
      continue;
    }
    partial += frame.split != StageSplit::kMotion;
    // 10 to 20 different lights of equal amounts with half the power of all.
    EXPECT_GE(frame.lights.size(), 10u);
    EXPECT_LE(frame.lights.size(), 20u);
    std::set<int> lights;
    double power = 0;
    for (const auto& [light, amount] : frame.lights) {
      EXPECT_TRUE(light >= 0 && light < 128 && lights.insert(light).second);
      power += static_cast<double>(amount) / 128;
    }
    EXPECT_NEAR(power, 0.5, 1e-5);
    different.insert(frame.lights);
  }
  EXPECT_EQ(unseen, 30);
  EXPECT_EQ(full, 70);
  EXPECT_EQ(partial, 140);
  EXPECT_EQ(held_out, 14);  // 10 % of the partially lit ones
  EXPECT_EQ(different.size(), 170u);
  // The same seed, the same frames.
  const std::vector<StageFrame> again = plan_stage_frames(options, 128);
  options.seed = 2;
  const std::vector<StageFrame> other = plan_stage_frames(options, 128);
  EXPECT_EQ(again[7].lights, frames[7].lights);
  EXPECT_NE(other[7].lights, frames[7].lights);
}

TEST(LightStage, SingleLightsComeInTurn) {
  StageOptions options;
  options.frames = 32;
  options.unseen_frames = 0;
  options.lighting = StageLighting::kSingle;
  std::set<int> seen;
  for (const StageFrame& frame : plan_stage_frames(options, 32)) {
    ASSERT_EQ(frame.lights.size(), 1u);
    EXPECT_NEAR(frame.lights[0].second, 8, 1e-5);
    seen.insert(frame.lights[0].first);
  }
  EXPECT_EQ(seen.size(), 32u);
}

TEST(LightStage, ReadsPositionsAndRefusesBrokenOnes) {
  const test::ScratchFolder scratch;
  const auto error_of = [&](const std::string& text) -> std::string {
    write_text(scratch / "lights.txt", text);
    try {
      read_light_positions(scratch / "lights.txt", 2, Vec3d::Zero());
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(error_of("1 0 0 # one\n\n0 3 0\n"), "");
  const std::vector<Vec3d> lamps = read_light_positions(scratch / "lights.txt", 2, Vec3d(0, 1, 0));
  ASSERT_EQ(lamps.size(), 2u);
  EXPECT_LT((lamps[0] - Vec3d(1, 1, 0)).norm(), 1e-12);  // mean distance 2
  EXPECT_LT((lamps[1] - Vec3d(0, 4, 0)).norm(), 1e-12);
  EXPECT_NE(error_of("1 0\n").find("line 1"), std::string::npos);
  EXPECT_NE(error_of("1 0 0\n1 0 x\n").find("line 2"), std::string::npos);
  EXPECT_NE(error_of("0 0 0\n").find("position 0"), std::string::npos);
  EXPECT_NE(error_of("nan 0 1\n"), "");
  EXPECT_NE(error_of("").find("no light"), std::string::npos);
  EXPECT_THROW(read_light_positions(scratch / "absent.npy", 2, Vec3d::Zero()), Error);
}

TEST(LightStage, ReadsTheMeasuredStage) {
  const Path data = test::outside_data("EFFIGY_DATA");
  const Path file = data / "lightstage/openillumination_light_pos_142.npy";
  if (data.empty() || !std::filesystem::exists(file))
    GTEST_SKIP() << "needs EFFIGY_DATA/lightstage";
  StageOptions options;
  options.light_file = file.string();
  options.lights = 0;
  const LightStage stage = make_light_stage(options);
  ASSERT_EQ(stage.lights.size(), 142u);
  for (const StageLight& light : stage.lights)
    EXPECT_NEAR((light.position.cast<double>() - stage.centre).norm(), 2.75, 0.15);
}

TEST(LightStage, RefusesImpossibleStages) {
  const auto fails = [](auto change) {
    StageOptions options;
    change(options);
    EXPECT_THROW(make_light_stage(options), Error);
  };
  fails([](StageOptions& o) { o.lights = 0; });
  fails([](StageOptions& o) { o.cameras = 0; });
  fails([](StageOptions& o) { o.radius = NAN; });
  fails([](StageOptions& o) { o.width = 0; });
  fails([](StageOptions& o) { o.frames = 0; });
  fails([](StageOptions& o) { o.unseen_frames = o.frames; });
  fails([](StageOptions& o) { o.frames_per_second = NAN; });
}

}  // namespace
}  // namespace effigy
