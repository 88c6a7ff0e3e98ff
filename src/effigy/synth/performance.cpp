// What the built-in head does in front of the camera.

#include <cmath>
#include <numbers>

#include "effigy/base/random.h"
#include "effigy/synth/head_capture.h"

namespace effigy {
namespace {

constexpr double kTau = 2 * std::numbers::pi;

// Smooth pulse of width 2 around `center`: 1 at the centre, 0 outside.
double pulse(double t, double center, double half_width) {
  const double d = std::abs(t - center) / half_width;
  return d < 1 ? 0.5 + 0.5 * std::cos(std::numbers::pi * d) : 0.0;
}

// Sum of two slow waves in [-1, 1] with phases of the seed.
double wander(double t, double period, Random& random) {
  const double a = random.uniform(0, kTau), b = random.uniform(0, kTau);
  return 0.7 * std::sin(kTau * t / period + a) + 0.3 * std::sin(kTau * t / (0.43 * period) + b);
}

class Performer {
 public:
  Performer(const Rig& rig, RigPose& pose) : rig_(rig), pose_(pose) {}
  void express(const std::string& name, double value) {
    const int e = rig_.expression(name);
    if (e >= 0) pose_.expression[e] += static_cast<float>(value);
  }
  // Both sides of a symmetric expression.
  void both(const std::string& name, double value) {
    express(name + "_L", value);
    express(name + "_R", value);
  }
  void rotate(const std::string& joint, double x, double y, double z) {
    const int j = rig_.joint(joint);
    if (j < 0) return;
    pose_.joint_rotation[3 * j] += static_cast<float>(x);
    pose_.joint_rotation[3 * j + 1] += static_cast<float>(y);
    pose_.joint_rotation[3 * j + 2] += static_cast<float>(z);
  }

 private:
  const Rig& rig_;
  RigPose& pose_;
};

}  // namespace

RigPose performance_pose(const Rig& rig, double t, uint64_t seed) {
  RigPose pose = RigPose::rest(rig);
  Performer p(rig, pose);
  Random random(seed, 7);
  // Head: turns up to about 30 degrees, nods and tilts less; a little drift.
  const double yaw = 0.5 * wander(t, 3.1, random), pitch = 0.16 * wander(t, 2.3, random),
               roll = 0.09 * wander(t, 3.7, random);
  p.rotate("root", 0.75 * pitch, 0.8 * yaw, roll);
  p.rotate("neck", 0.25 * pitch, 0.2 * yaw, 0);
  // Speech: syllables at about 4 a second, shaped by slower waves.
  const double speaking = 0.5 + 0.5 * wander(t, 1.7, random);
  const double syllable = std::max(0.0, std::sin(kTau * 3.1 * t + random.uniform(0, kTau)));
  const double open = std::max(0.0, speaking) * (0.15 + 0.5 * syllable);
  p.express("jawOpen", open);
  p.rotate("jaw", rig.expression("jawOpen") < 0 ? 0.3 * open : 0.0, 0, 0);
  const double smile = std::max(0.0, wander(t, 2.9, random));
  p.both("mouthSmile", 0.7 * smile);
  p.express("mouthPucker", 0.6 * std::max(0.0, wander(t, 1.3, random)) * (1 - smile));
  p.express("mouthFunnel", 0.3 * std::max(0.0, wander(t, 1.1, random)) * (1 - smile));
  p.both("browInnerUp", 0.5 * std::max(0.0, wander(t, 2.2, random)));
  p.express("browInnerUp", 0.5 * std::max(0.0, wander(t, 2.2, random)));
  p.both("browDown", 0.5 * std::max(0.0, wander(t, 2.7, random)));
  p.both("cheekPuff", 0.3 * std::max(0.0, wander(t, 3.9, random)));
  // Gaze, and a blink about every 1.4 seconds.
  const double look_x = 0.2 * wander(t, 1.9, random), look_y = 0.1 * wander(t, 2.6, random);
  for (const char* eye : {"eye_left", "eye_right"}) p.rotate(eye, look_y, look_x, 0);
  const double period = 1.4, phase = random.uniform(0, period);
  const double since = std::fmod(t + phase, period);
  p.both("eyeBlink", pulse(since, 0.2, 0.14));
  pose.translation = {static_cast<float>(0.004 * wander(t, 2.4, random)),
                      static_cast<float>(0.003 * wander(t, 3.3, random)), 0};
  return pose;
}

}  // namespace effigy
