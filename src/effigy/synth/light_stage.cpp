#include "effigy/synth/light_stage.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "effigy/base/log.h"
#include "effigy/base/random.h"
#include "effigy/synth/option_range.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kReach = 1.1;  // metres around the dome's centre that cameras see
constexpr double kFilled = 0.88;
constexpr double kHeldOutCameras = 0.2, kHeldOutFrames = 0.1, kGroupPower = 0.5,
                 kSinglePower = 0.25;
constexpr int kMostCameras = 10000, kMostLights = 100000;

void check_options(const StageOptions& o) {
  if (o.light_file.empty()) {
    if (o.lights < 1)
      throw Error("A light stage needs at least one light; give --lights a number from 1 on.");
    check_range("--lights", o.lights, 1, kMostLights);
  }
  check_range("--cameras", o.cameras, 1, kMostCameras);
  check_range("--radius", o.radius, 0.1, 100.0);
  check_range("the height of a light stage", o.height, 0.0, 10.0);
  check_range("--size", o.width, 16, kMostPixels);
  check_range("--size", o.height_pixels, 16, kMostPixels);
  check_range("--frames", o.frames, 2, kMostFrames);
  if (o.unseen_frames >= o.frames)
    throw Error(
        "At least one frame of a stage capture is of the training motion; lower --unseen-frames.");
  check_range("--fps", o.frames_per_second, 1.0, 240.0);
}

// `count` of `all` numbers, evenly spread.
std::vector<int> spread(int count, int all) {
  std::vector<int> out;
  out.reserve(static_cast<size_t>(std::max(count, 0)));
  for (int k = 0; k < count; ++k)
    out.push_back(static_cast<int>((k + 0.5) * static_cast<double>(all) / count));
  return out;
}

int share_of(double share, int all) {
  return all < 2 ? 0 : std::max(1, static_cast<int>(std::lround(share * all)));
}

std::vector<std::pair<int, float>> random_group(int lights, Random& random) {
  const int low = std::min(10, std::max(1, lights / 6));
  const int high = std::min(20, std::max(low, lights / 3));
  const int size = low + static_cast<int>(random.below(static_cast<uint64_t>(high - low) + 1));
  std::vector<int> order(static_cast<size_t>(lights));
  std::iota(order.begin(), order.end(), 0);
  for (int i = 0; i < size; ++i) {
    const int j = i + static_cast<int>(random.below(static_cast<uint64_t>(lights - i)));
    std::swap(order[static_cast<size_t>(i)], order[static_cast<size_t>(j)]);
  }
  order.resize(static_cast<size_t>(size));
  std::sort(order.begin(), order.end());
  std::vector<std::pair<int, float>> group;
  group.reserve(order.size());
  for (const int light : order)
    group.emplace_back(light, static_cast<float>(kGroupPower * lights / size));
  return group;
}

// What points cover of a camera's picture, on the plane at distance 1.
struct ViewBox {
  Vec2d low = Vec2d::Constant(1e30), high = Vec2d::Constant(-1e30);
  // False when a point is not well before the camera.
  bool hold(std::span<const Vec3f> points, const Camera& camera) {
    constexpr double kSteepest = 0.2;  // of the way to a point, along the optical axis
    for (const Vec3f& point : points) {
      const Vec3d p = camera.to_camera(point.cast<double>());
      if (!(p.z() > kSteepest * p.norm())) return false;
      const Vec2d at = p.head<2>() / p.z();
      low = low.cwiseMin(at);
      high = high.cwiseMax(at);
    }
    return true;
  }
};

std::string number_name(const char* prefix, size_t i) {
  return format("{}{:03}", prefix, i);
}

}  // namespace

StageLighting stage_lighting_from_name(const std::string& name) {
  static const std::vector<std::pair<const char*, StageLighting>> names = {
      {"mixed", StageLighting::kMixed},
      {"full", StageLighting::kFull},
      {"groups", StageLighting::kGroups},
      {"single", StageLighting::kSingle},
      {"environment", StageLighting::kEnvironment}};
  for (const auto& [known, lighting] : names)
    if (name == known) return lighting;
  throw Error("There is no lighting '" + name +
              "'; choose mixed, full, groups, single or environment.");
}

StageFraming stage_framing_from_name(const std::string& name) {
  if (name == "person") return StageFraming::kPerson;
  if (name == "dome") return StageFraming::kDome;
  throw Error("There is no framing '" + name + "'; choose person or dome.");
}

StageOptions stage_preset(const std::string& name) {
  StageOptions o;
  if (name == "small") return o;
  if (name == "tiny") {
    o.cameras = 8;
    o.lights = 64;
    o.width = o.height_pixels = 256;
    o.frames = 40;
    return o;
  }
  if (name == "paper") {
    o.cameras = 512;
    o.lights = 1024;
    o.width = 1152;
    o.height_pixels = 1332;
    o.frames = 5500;
    o.frames_per_second = 90;
    o.framing = StageFraming::kDome;
    return o;
  }
  throw Error("There is no stage '" + name + "'; choose tiny, small or paper.");
}

std::vector<Vec3d> dome_directions(int count, double lowest, double highest, double turn) {
  static const double kGolden = kPi * (3 - std::sqrt(5.0));
  std::vector<Vec3d> out;
  for (int i = 0; i < count; ++i) {
    const double y = highest - (i + 0.5) / count * (highest - lowest);
    const double r = std::sqrt(std::max(0.0, 1 - y * y)), angle = kGolden * i + 2 * kPi * turn;
    out.emplace_back(r * std::sin(angle), y, r * std::cos(angle));
  }
  return out;
}

LightStage make_light_stage(const StageOptions& o) {
  check_options(o);
  LightStage stage;
  stage.centre = Vec3d(0, o.height, 0);
  // Everything a little above the floor; cameras neither look straight down nor straight up.
  const double floor = std::max(-0.9, (0.05 - o.height) / o.radius);
  const std::vector<Vec3d> eyes =
      dome_directions(o.cameras, std::max(floor, -0.25), 0.7, 0.5 / o.cameras);
  const double field = 2 * std::asin(std::min(0.95, kReach / o.radius));
  for (size_t c = 0; c < eyes.size(); ++c)
    stage.cameras.push_back(
        {number_name("cam", c),
         look_at(stage.centre + o.radius * eyes[c], stage.centre, field, o.width, o.height_pixels),
         false});
  for (const int c : spread(share_of(kHeldOutCameras, o.cameras), o.cameras))
    stage.cameras[static_cast<size_t>(c)].test = true;
  std::vector<Vec3d> lamps;
  if (o.light_file.empty()) {
    for (const Vec3d& d : dome_directions(o.lights, floor, 1, 0))
      lamps.push_back(stage.centre + o.radius * d);
  } else {
    lamps = read_light_positions(o.light_file, o.radius, stage.centre, o.light_up);
  }
  const double intensity = 4 * kPi * o.radius * o.radius / static_cast<double>(lamps.size());
  for (const Vec3d& lamp : lamps)
    stage.lights.push_back({lamp.cast<float>(), Vec3f::Constant(static_cast<float>(intensity))});
  return stage;
}

void frame_cameras(std::span<const Vec3f> points, std::span<StageCamera> cameras) {
  if (points.empty()) return;
  for (StageCamera& stage_camera : cameras) {
    Camera camera = stage_camera.camera;
    const Vec3d eye = camera.center();
    // Turning a camera moves the sides of a box differently; three turns settle it.
    constexpr int kTurns = 3;
    for (int turn = 0; turn <= kTurns; ++turn) {
      ViewBox box;
      if (!box.hold(points, camera)) break;
      if (turn == kTurns) {
        const Vec2d half = box.low.cwiseAbs().cwiseMax(box.high.cwiseAbs());
        camera.fx = camera.fy = 0.5 * kFilled *
                                std::min(camera.width / std::max(half.x(), 1e-3),
                                         camera.height / std::max(half.y(), 1e-3));
        stage_camera.camera = camera;
        break;
      }
      const Vec2d middle = 0.5 * (box.low + box.high);
      const Vec3d ahead =
          camera.camera_from_world_rotation.transpose() * Vec3d(middle.x(), middle.y(), 1);
      camera = look_at(eye, eye + ahead, 1, camera.width, camera.height);
    }
  }
}

std::vector<StageFrame> plan_stage_frames(const StageOptions& o, int lights) {
  check_options(o);
  const int unseen = o.unseen_frames < 0
                         ? std::max(1, static_cast<int>(std::lround(o.frames / 8.0)))
                         : o.unseen_frames;
  const int seen = o.frames - unseen;
  Random single(o.seed, 0x6f6e65);
  const int first_light = static_cast<int>(single.below(static_cast<uint64_t>(lights)));
  std::vector<StageFrame> frames;
  std::vector<int> partial;
  for (int f = 0; f < o.frames; ++f) {
    StageFrame frame;
    frame.number = f;
    frame.seconds = (f < seen ? f : f - seen) / o.frames_per_second;
    frame.split = f < seen ? StageSplit::kTrain : StageSplit::kMotion;
    const bool full = o.lighting == StageLighting::kFull ||
                      (o.lighting == StageLighting::kMixed && f < seen && f % 3 == 0);
    Random random(o.seed, 0x67726f7570 + static_cast<uint64_t>(f));
    if (o.lighting == StageLighting::kSingle) {
      // All lights in turn, far apart from frame to frame.
      int stride = std::max(1, static_cast<int>(0.381966 * lights));
      while (std::gcd(stride, lights) != 1) ++stride;
      const int light = static_cast<int>((first_light + int64_t{f} * stride) % lights);
      frame.lights = {{light, static_cast<float>(kSinglePower * lights)}};
    } else if (full) {
      frame.fully_lit = true;
    } else if (o.lighting != StageLighting::kEnvironment) {
      frame.lights = random_group(lights, random);
    }
    if (!frame.lights.empty() && f < seen) partial.push_back(f);
    frames.push_back(std::move(frame));
  }
  const int count = static_cast<int>(partial.size());
  for (const int k : spread(share_of(kHeldOutFrames, count), count))
    frames[static_cast<size_t>(partial[static_cast<size_t>(k)])].split = StageSplit::kLights;
  return frames;
}

}  // namespace effigy
