// The light stage's plan: geometry, units and the paper's shares.

#include "effigy/synth/light_stage.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "effigy/base/log.h"
#include "effigy/base/random.h"
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
  EXPECT_EQ(options.framing, StageFraming::kDome);
  const LightStage stage = make_light_stage(options);
  EXPECT_EQ(stage.cameras.size(), 512u);
  EXPECT_EQ(stage.lights.size(), 1024u);
  EXPECT_EQ(options.radius, 2.75);
  EXPECT_EQ(std::count_if(stage.cameras.begin(), stage.cameras.end(),
                          [](const StageCamera& c) { return c.test; }),
            102);
  EXPECT_THROW(stage_preset("large"), Error);
}

// Whatever the person covers fills 88 % of the fuller side of every picture, in its middle.
TEST(LightStage, FramesWhereThePersonMoves) {
  Random random(4);
  std::vector<Vec3f> points;
  for (int i = 0; i < 2000; ++i)
    points.push_back(
        Vec3d(1.2 * random.uniform() - 0.3, 1.9 * random.uniform(), 0.8 * random.uniform() - 0.5)
            .cast<float>());
  for (const auto& [width, height] : {std::pair{512, 512}, {200, 512}, {512, 200}}) {
    StageOptions options;
    options.width = width;
    options.height_pixels = height;
    LightStage stage = make_light_stage(options);
    const LightStage before = stage;
    frame_cameras(points, stage.cameras);
    for (size_t c = 0; c < stage.cameras.size(); ++c) {
      const Camera& camera = stage.cameras[c].camera;
      EXPECT_LT((camera.center() - before.cameras[c].camera.center()).norm(), 1e-9);
      EXPECT_EQ(camera.fx, camera.fy);
      EXPECT_EQ(stage.cameras[c].test, before.cameras[c].test);
      Vec2d low = Vec2d::Constant(1e9), high = -low;
      for (const Vec3f& p : points) {
        const Vec2d at = camera.project(p.cast<double>());
        low = low.cwiseMin(at);
        high = high.cwiseMax(at);
      }
      const double filled = std::max((high - low).x() / width, (high - low).y() / height);
      EXPECT_GT(filled, 0.87) << c;
      EXPECT_LT(filled, 0.8801) << c;
      EXPECT_NEAR((low + high).x() / width, 1, 0.02);
      EXPECT_NEAR((low + high).y() / height, 1, 0.02);
    }
  }
  // A camera among the points stays.
  StageOptions options;
  options.radius = 0.3;
  LightStage stage = make_light_stage(options);
  const LightStage before = stage;
  frame_cameras(points, stage.cameras);
  EXPECT_EQ(stage.cameras[0].camera.fx, before.cameras[0].camera.fx);
  EXPECT_EQ(stage.cameras[0].camera.camera_from_world_rotation,
            before.cameras[0].camera.camera_from_world_rotation);
  EXPECT_EQ(stage_framing_from_name("dome"), StageFraming::kDome);
  EXPECT_THROW(stage_framing_from_name("tight"), Error);
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

// A dome of lights around `centre` with an opening at +y, y down.
std::string open_dome(double opening, const Vec3d& centre) {
  std::string text;
  for (const Vec3d& d : dome_directions(150, -1, std::cos(opening), 0))
    text += format("{} {} {}\n", 3 * d.x() + centre.x(), 3 * d.y() + centre.y(),
                   3 * d.z() + centre.z());
  return text;
}

TEST(LightStage, KnowsWhichWayIsUp) {
  const test::ScratchFolder scratch;
  const Path file = scratch / "lights.txt";
  const auto read = [&](UpAxis up) { return read_light_positions(file, 2, Vec3d(0, 1, 0), up); };
  // Off the origin, on a sphere: its centre counts. The opening is the floor.
  const Vec3d off(0.1, -0.2, 0.05);
  write_text(file, open_dome(0.6, off));
  const std::vector<Vec3d> turned = read(UpAxis::kAuto), kept = read(UpAxis::kPlusY);
  for (size_t i = 0; i < turned.size(); ++i) {
    EXPECT_NEAR((turned[i] - Vec3d(0, 1, 0)).norm(), 2, 1e-6);
    EXPECT_LT(turned[i].y(), 3.01);
    EXPECT_GT(turned[i].y(), 1 - 2 * std::cos(0.6) - 1e-6);
    EXPECT_LT((Vec3d(kept[i].x(), 2 - kept[i].y(), -kept[i].z()) - turned[i]).norm(), 1e-6);
  }
  EXPECT_EQ(read(UpAxis::kMinusY), turned);
  // Without an opening, with one below, and with lights before the person only, y is up.
  for (const std::string& text :
       {open_dome(0.0, off), std::string("0 0 1\n0.1 0.2 1\n-0.1 0.2 1\n0 -0.6 1\n"),
        std::string("0 -1 0\n1 0 0\n")}) {
    write_text(file, text);
    EXPECT_EQ(read(UpAxis::kAuto), read(UpAxis::kPlusY));
  }
  std::string below;
  for (const Vec3d& d : dome_directions(150, -0.8, 1, 0))
    below += format("{} {} {}\n", d.x(), d.y(), d.z());
  write_text(file, below);
  EXPECT_EQ(read(UpAxis::kAuto), read(UpAxis::kPlusY));
  // Every named axis becomes y, by a turn and no mirror.
  write_text(file, "1 0 0\n0 1 0\n0 0 1\n");
  const std::vector<std::pair<const char*, Vec3d>> axes = {{"+x", {1, 0, 0}}, {"-x", {-1, 0, 0}},
                                                           {"+y", {0, 1, 0}}, {"-y", {0, -1, 0}},
                                                           {"+z", {0, 0, 1}}, {"-z", {0, 0, -1}}};
  for (const auto& [name, axis] : axes) {
    const std::vector<Vec3d> p =
        read_light_positions(file, 1, Vec3d::Zero(), up_axis_from_name(name));
    Mat3d r;
    r << p[0], p[1], p[2];
    EXPECT_NEAR(r.determinant(), 1, 1e-12);
    EXPECT_LT((r * axis - Vec3d::UnitY()).norm(), 1e-12) << name;
  }
  EXPECT_THROW(up_axis_from_name("up"), Error);
}

// 142 lights of a real stage: y points down there, where the floor is no light stands, and the
// dome's centre lies 4 cm beside the origin.
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
  std::vector<Vec3d> directions;
  for (const StageLight& light : stage.lights) {
    directions.push_back((light.position.cast<double>() - stage.centre) / 2.75);
    EXPECT_NEAR(directions.back().norm(), 1, 1e-6);
  }
  EXPECT_GT(directions[0].y(), 0.97);
  EXPECT_GT(opening_towards(directions, -Vec3d::UnitY()), 0.5);
  for (const Vec3d& d : {Vec3d(0, 1, 0), Vec3d(1, 0, 0), Vec3d(0, 0, 1), Vec3d(0, 0, -1)})
    EXPECT_LT(opening_towards(directions, d), 0.35);
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
