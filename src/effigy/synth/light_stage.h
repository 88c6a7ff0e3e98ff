// A light stage as a plan: cameras and lights on a dome, and how every frame of a capture is lit
// and split, after the protocol of Relightable Full-Body Gaussian Codec Avatars.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "effigy/capture/stage_capture.h"
#include "effigy/synth/light_positions.h"

namespace effigy {

enum class StageLighting {
  kMixed,        // every third frame fully lit, the others by groups
  kFull,         // all lights
  kGroups,       // 10 to 20 lights at random; fewer on stages of less than 60 lights
  kSingle,       // one light at a time
  kEnvironment,  // an environment instead of the lights
};
StageLighting stage_lighting_from_name(const std::string& name);  // throws Error

enum class StageFraming {
  kPerson,  // every camera's picture is filled by where the person moves: frame_cameras()
  kDome,    // all cameras look at the dome's centre and see 1.1 metres around it
};
StageFraming stage_framing_from_name(const std::string& name);  // "person", "dome"; throws Error

struct StageOptions {
  int cameras = 16, lights = 128;
  std::string light_file;           // positions instead of the even distribution; empty: none
  UpAxis light_up = UpAxis::kAuto;  // of that file
  double radius = 2.75;             // metres, of cameras and lights
  double height = 0.95;             // of the dome's centre above the floor
  int width = 512, height_pixels = 512;
  int frames = 64;
  int unseen_frames = -1;  // of them, of unseen motion; -1: an eighth, at least one
  double frames_per_second = 5;
  StageLighting lighting = StageLighting::kMixed;
  StageFraming framing = StageFraming::kPerson;
  uint64_t seed = 1;
};
// "tiny", "small" (the default) or "paper": 512 cameras, 1024 lights, 1152 x 1332 pixels, 5500
// frames at 90 a second, framing kDome. All have the paper's dome and its shares of held-out
// cameras (20 %) and partially lit frames (10 %). Throws Error for other names.
StageOptions stage_preset(const std::string& name);

// Cameras and lights. Lights have one intensity, such that all of them together are as bright at
// the dome's centre as an environment of radiance 1. Throws Error for impossible numbers and for
// files without lights.
struct LightStage {
  Vec3d centre = Vec3d::Zero();
  std::vector<StageCamera> cameras;
  std::vector<StageLight> lights;
};
LightStage make_light_stage(const StageOptions& options);

// Turns every camera to the middle of what `points` (metres, world: all places of the person's
// surface over its motions) cover in its picture, and zooms until they fill 88 % of the picture's
// height or width, whichever is full first. A camera with a point beside or behind it stays as it
// is.
void frame_cameras(std::span<const Vec3f> points, std::span<StageCamera> cameras);

// `count` even directions between two heights on the unit sphere (sine of the elevation), from the
// top down (Fibonacci lattice); `turn` in turns about the vertical.
std::vector<Vec3d> dome_directions(int count, double lowest, double highest, double turn);

// Frames in order, those of unseen motion last. Of the partially lit frames of the training motion
// a tenth is held out; unseen motion is partially lit where the lighting is mixed. A group gives
// half the light of all lights together, a single light a quarter.
std::vector<StageFrame> plan_stage_frames(const StageOptions& options, int lights);

}  // namespace effigy
