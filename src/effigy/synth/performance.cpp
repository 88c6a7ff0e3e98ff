// What a head does in front of the camera.

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

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
  bool express(const std::string& name, double value) {
    const int e = rig_.expression(name);
    if (e >= 0) pose_.expression[e] += static_cast<float>(value);
    return e >= 0;
  }
  // Both sides of a symmetric expression, or the one that is of both.
  void both(const std::string& name, double value) {
    const bool left = express(name + "_L", value), right = express(name + "_R", value);
    if (!left && !right) express(name, value);
  }
  void open_jaw(double value) {
    constexpr double kOpen = 0.35;  // radians of a joint, as far as the shape opens at 1
    if (!express("jawOpen", value)) rotate("jaw", kOpen * value, 0, 0);
  }
  // Radians, down and to the person's left. Shapes reach about half a radian.
  void look(double down, double left) {
    if (rig_.joint("eye_left") >= 0) {
      for (const char* eye : {"eye_left", "eye_right"}) rotate(eye, down, left, 0);
      return;
    }
    constexpr double kReach = 2;
    both("eyeLookDown", kReach * std::max(0.0, down));
    both("eyeLookUp", kReach * std::max(0.0, -down));
    for (const auto& [side, out] : {std::pair{"_L", left}, {"_R", -left}}) {
      express(std::string("eyeLookOut") + side, kReach * std::max(0.0, out));
      express(std::string("eyeLookIn") + side, kReach * std::max(0.0, -out));
    }
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

// Mouth shapes of speech, by the sounds they stand for (mouth shapes as animators group them).
struct Shape {
  const char* name;  // of an expression, or of a pair of them
  double value;
};
using Viseme = std::vector<Shape>;
const std::vector<Viseme>& visemes() {
  static const std::vector<Viseme> all = {
      {{"jawOpen", 0.55}, {"mouthLowerDown", 0.25}, {"mouthUpperUp", 0.1}},     // ah
      {{"jawOpen", 0.22}, {"mouthStretch", 0.35}, {"mouthSmile", 0.2}},         // ee
      {{"jawOpen", 0.3}, {"mouthFunnel", 0.55}, {"mouthPucker", 0.25}},         // oh
      {{"jawOpen", 0.12}, {"mouthPucker", 0.8}},                                // oo
      {{"mouthPress", 0.5}, {"mouthRollLower", 0.3}, {"mouthRollUpper", 0.3}},  // m b p
      {{"jawOpen", 0.1}, {"mouthRollLower", 0.45}, {"mouthUpperUp", 0.3}},      // f v
      {{"jawOpen", 0.28}, {"mouthLowerDown", 0.2}},                             // l th
      {{"jawOpen", 0.14}, {"mouthFunnel", 0.45}, {"mouthShrugUpper", 0.2}},     // ch sh
      {{"jawOpen", 0.16}, {"mouthStretch", 0.2}, {"mouthDimple", 0.15}},        // s z
      {{"jawOpen", 0.35}, {"mouthLowerDown", 0.15}, {"mouthStretch", 0.15}},    // eh
  };
  return all;
}

// Speech: a viseme about every 0.13 seconds, each melting into the next.
void speak(Performer& p, double t, double loudness, uint64_t seed) {
  constexpr double kStep = 0.13;
  const auto now = static_cast<int64_t>(std::floor(t / kStep));
  for (int64_t k = now - 1; k <= now + 2; ++k) {
    if (k < 0) continue;
    Random random(seed ^ 0x766973656d65ULL, static_cast<uint64_t>(k));
    const Viseme& viseme = visemes()[random.below(visemes().size())];
    const double center = kStep * (static_cast<double>(k) + random.uniform(-0.2, 0.2));
    const double weight =
        loudness * random.uniform(0.7, 1.0) * pulse(t, center, 1.25 * kStep) / 1.25;
    for (const Shape& shape : viseme)
      if (std::string(shape.name) == "jawOpen")
        p.open_jaw(weight * shape.value);
      else
        p.both(shape.name, weight * shape.value);
  }
}

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
  // Speech in phrases: louder and softer, with pauses; a smile that comes and goes.
  const double speaking = std::clamp(0.75 + 0.9 * wander(t, 2.6, random), 0.0, 1.0);
  speak(p, t, speaking, seed);
  p.both("mouthSmile", 0.6 * std::max(0.0, wander(t, 2.9, random)));
  p.both("browInnerUp", 0.5 * std::max(0.0, wander(t, 2.2, random)));
  wander(t, 2.2, random);  // unused; what follows keeps its random numbers, so seeds their meaning
  p.both("browDown", 0.5 * std::max(0.0, wander(t, 2.7, random)));
  p.both("browOuterUp", 0.35 * std::max(0.0, wander(t, 3.4, random)));
  p.both("cheekSquint", 0.3 * std::max(0.0, wander(t, 3.9, random)));
  p.both("noseSneer", 0.25 * std::max(0.0, wander(t, 4.3, random)));
  // Gaze, and a blink about every 1.4 seconds.
  const double look_x = 0.2 * wander(t, 1.9, random), look_y = 0.1 * wander(t, 2.6, random);
  p.look(look_y, look_x);
  const double period = 1.4, phase = random.uniform(0, period);
  const double since = std::fmod(t + phase, period);
  p.both("eyeBlink", pulse(since, 0.2, 0.14));
  pose.translation = {static_cast<float>(0.004 * wander(t, 2.4, random)),
                      static_cast<float>(0.003 * wander(t, 3.3, random)), 0};
  return pose;
}

}  // namespace effigy
