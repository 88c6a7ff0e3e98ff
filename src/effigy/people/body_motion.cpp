#include "effigy/people/body_motion.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/people/body_model.h"
#include "effigy/people/smooth.h"

namespace effigy {
namespace {

using people::BodyJoints;
using people::mix;
using people::smooth_step;
constexpr double kPi = std::numbers::pi;

// Band-limited noise in about [-1, 1]: five sines of 0.05 .. 0.35 Hz.
class SlowNoise {
 public:
  SlowNoise(uint64_t seed, uint64_t stream, double pace) {
    Random random(seed, stream);
    for (Wave& w : waves_) {
      w.frequency = 2 * kPi * pace * random.uniform(0.05, 0.35);
      w.phase = random.uniform(0, 2 * kPi);
    }
  }
  double at(double seconds) const {
    double sum = 0;
    for (const Wave& w : waves_) sum += std::sin(w.frequency * seconds + w.phase);
    return std::clamp(sum / 2.6, -1.0, 1.0) * (1 - 0.12 * std::abs(sum / 5));
  }

 private:
  struct Wave {
    double frequency = 0, phase = 0;
  };
  std::array<Wave, 5> waves_;
};

// One way a joint turns: about an axis (of the left side), between two angles.
struct Freedom {
  std::string joint;  // without _left; "*" prefix: in the middle
  Vec3d axis;
  double low, high;
  double pace = 1;
};

std::vector<Freedom> freedoms(const BodyJoints& j) {
  const Vec3d x = Vec3d::UnitX(), y = Vec3d::UnitY(), z = Vec3d::UnitZ();
  const Vec3d arm = (j.lower_arm - j.upper_arm).normalized();
  const Vec3d fore = (j.hand - j.lower_arm).normalized();
  const Vec3d hinge = arm.cross(z).normalized(), curl = fore.cross(j.palm_normal).normalized();
  return {{"*hips", y, -0.5, 0.5},          {"*hips", x, -0.08, 0.10},
          {"*spine", x, -0.12, 0.35},       {"*spine", y, -0.25, 0.25},
          {"*spine", z, -0.20, 0.20},       {"*chest", x, -0.10, 0.25},
          {"*chest", y, -0.22, 0.22},       {"*chest", z, -0.12, 0.12},
          {"*upper_chest", y, -0.12, 0.12}, {"*neck", x, -0.18, 0.22},
          {"*neck", y, -0.25, 0.25},        {"*head", x, -0.30, 0.30},
          {"*head", y, -0.55, 0.55},        {"*head", z, -0.22, 0.22},
          {"*eyes", y, -0.35, 0.35, 2},     {"*eyes", x, -0.15, 0.15, 2},
          {"shoulder", z, -0.04, 0.22},     {"shoulder", y, -0.15, 0.12},
          {"upper_arm", z, -0.55, 1.55},    {"upper_arm", y, -1.15, 0.30},
          {"upper_arm", arm, -0.70, 0.70},  {"lower_arm", hinge, -0.9, 2.2},
          {"hand", curl, -0.80, 0.90, 1.5}, {"hand", j.palm_normal, -0.25, 0.25},
          {"hand", fore, -1.10, 1.10},      {"upper_leg", z, -0.08, 0.35},
          {"upper_leg", y, -0.25, 0.25},    {"upper_leg", x, -0.55, 0.15},
          {"lower_leg", x, -0.5, 0.7},      {"foot", x, -0.30, 0.35},
          {"toes", x, -0.35, 0.05}};
}

// Collects rotations of one frame; turns about several axes of a joint are summed as vectors.
class Poser {
 public:
  explicit Poser(const BuiltinBody& body)
      : body_(body), j_(body.model->form.joints()), pose_(RigPose::rest(body.rig)) {
    curl_ = (j_.hand - j_.lower_arm).normalized().cross(j_.palm_normal).normalized();
  }

  void turn(const std::string& joint, const Vec3d& axis, double angle) {
    const int i = body_.rig.joint(joint);
    EFFIGY_CHECK(i >= 0);
    for (int c = 0; c < 3; ++c)
      pose_.joint_rotation[3 * static_cast<size_t>(i) + static_cast<size_t>(c)] +=
          static_cast<float>(angle * axis[c]);
  }
  // `axis` as on the left side; mirrored for the right.
  void turn_side(const std::string& joint, int side, const Vec3d& axis, double angle) {
    turn(joint + (side > 0 ? "_left" : "_right"),
         side > 0 ? axis : Vec3d(axis.x(), -axis.y(), -axis.z()), angle);
  }
  // Finger `f` (0 thumb), 0 straight .. 1 closed; spread in radians.
  void finger(int side, int f, double closed, double spread) {
    static constexpr const char* kNames[5] = {"thumb", "index", "middle", "ring", "little"};
    const std::string n = kNames[f];
    if (f == 0) {
      const Vec3d fore = (j_.hand - j_.lower_arm).normalized();
      const auto& thumb = j_.fingers[0];
      const Vec3d bend = (thumb[2] - thumb[1])
                             .normalized()
                             .cross((-0.75 * j_.thumb_side + 0.66 * j_.palm_normal).normalized())
                             .normalized();
      turn_side(n + "_metacarpal", side,
                fore.cross(j_.thumb_side).dot(j_.palm_normal) > 0 ? fore : Vec3d(-fore),
                0.55 * closed);
      turn_side(n + "_proximal", side, bend, 0.45 * closed);
      turn_side(n + "_distal", side, bend, 0.75 * closed);
      return;
    }
    turn_side(n + "_proximal", side, curl_, 1.35 * closed);
    turn_side(n + "_proximal", side, j_.palm_normal, spread * (2.5 - f));
    turn_side(n + "_intermediate", side, curl_, 1.55 * closed);
    turn_side(n + "_distal", side, curl_, 0.95 * closed);
  }
  void expression(const std::string& name, double amount) {
    for (const char* suffix : {"", "_L", "_R"}) {
      const int e = body_.rig.expression(name + suffix);
      if (e < 0) continue;
      float& x = pose_.expression[static_cast<size_t>(e)];
      x = std::clamp(x + static_cast<float>(amount),
                     body_.rig.expression_low[static_cast<size_t>(e)],
                     body_.rig.expression_high[static_cast<size_t>(e)]);
    }
  }
  const BodyJoints& joints() const { return j_; }

  // Lets the lower foot stand on the floor and closes the pose.
  RigPose finish() {
    drive_body_helpers(body_, pose_);
    const std::vector<float> transforms = joint_transforms(body_.shape, pose_);
    double lowest = 1e9;
    for (const int side : {1, -1})
      for (const auto& [name, rest] :
           {std::pair<std::string, Vec3d>{"foot", {j_.foot.x(), 0, j_.foot.z() - 50}},
            {"foot", {j_.toes.x(), 0, j_.toes.z() - 20}},
            {"toes", {j_.toe_tip.x(), 0, j_.toe_tip.z() + 8}}}) {
        const size_t i =
            static_cast<size_t>(body_.rig.joint(name + (side > 0 ? "_left" : "_right")));
        const float* m = transforms.data() + 12 * i;
        const Vec3d p = 1e-3 * Vec3d(side * rest.x(), rest.y(), rest.z());
        lowest = std::min(lowest, m[4] * p.x() + m[5] * p.y() + m[6] * p.z() + m[7]);
      }
    pose_.translation[1] -= static_cast<float>(lowest);
    return pose_;
  }

 private:
  const BuiltinBody& body_;
  const BodyJoints& j_;
  RigPose pose_;
  Vec3d curl_;
};

void check_request(int frames, double frames_per_second) {
  if (frames < 1 || frames > 1'000'000)
    throw Error("A body motion needs 1 to 1000000 frames, not " + std::to_string(frames) + ".");
  if (!(frames_per_second >= 1 && frames_per_second <= 1000))
    throw Error("A body motion needs 1 to 1000 frames a second.");
}

// Talking, blinking and looking about.
void animate_face(Poser& poser, uint64_t seed, double t) {
  const auto burst = [&](uint64_t stream, double threshold) {
    return smooth_step(threshold, 0.9, SlowNoise(seed, stream, 2.2).at(t));
  };
  poser.expression("jawOpen", 0.55 * burst(900, 0.0) * (0.6 + 0.4 * std::sin(2 * kPi * 2.3 * t)));
  poser.expression("mouthSmile", 0.9 * burst(901, 0.2));
  poser.expression("mouthPucker", 0.8 * burst(902, 0.3));
  poser.expression("browInnerUp", burst(903, 0.2));
  poser.expression("browDown", burst(904, 0.3));
  poser.expression("cheekPuff", 0.7 * burst(905, 0.5));
  poser.expression("mouthFrown", 0.7 * burst(906, 0.4));
  poser.expression("noseSneer", 0.6 * burst(907, 0.5));
  const double blink = std::fmod(t + 0.7 * std::sin(0.9 * t + static_cast<double>(seed % 7)), 3.1);
  poser.expression("eyeBlink", smooth_step(0, 0.08, blink) * smooth_step(0.24, 0.12, blink));
}

}  // namespace

BodyMotion range_of_motion(const BuiltinBody& body, int frames, double frames_per_second,
                           uint64_t seed) {
  check_request(frames, frames_per_second);
  const std::vector<Freedom> all = freedoms(body.model->form.joints());
  std::vector<std::array<SlowNoise, 2>> noise;
  for (size_t i = 0; i < all.size(); ++i)
    noise.push_back({SlowNoise(seed, 2 * i, all[i].pace), SlowNoise(seed, 2 * i + 1, all[i].pace)});
  BodyMotion motion;
  motion.frames_per_second = frames_per_second;
  for (int f = 0; f < frames; ++f) {
    const double t = f / frames_per_second;
    Poser poser(body);
    const auto angle = [](const Freedom& d, double s) { return s > 0 ? s * d.high : -s * d.low; };
    for (size_t i = 0; i < all.size(); ++i) {
      const Freedom& d = all[i];
      if (d.joint == "*eyes") {
        for (const char* eye : {"eye_left", "eye_right"})
          poser.turn(eye, d.axis, angle(d, noise[i][0].at(t)));
      } else if (d.joint[0] == '*') {
        poser.turn(d.joint.substr(1), d.axis, angle(d, noise[i][0].at(t)));
      } else if (d.joint == "lower_arm" || d.joint == "lower_leg") {
        // Hinges bend one way only: from straight (-1) to closed (1).
        for (const int side : {1, -1})
          poser.turn_side(d.joint, side, d.axis,
                          d.high * 0.5 * (1 + noise[i][side > 0 ? 0 : 1].at(t)) *
                              (d.joint == "lower_arm" ? 1.0 : 0.35));
      } else {
        for (const int side : {1, -1})
          poser.turn_side(d.joint, side, d.axis, angle(d, noise[i][side > 0 ? 0 : 1].at(t)));
      }
    }
    // Squats and lifted knees.
    const double squat = smooth_step(0.15, 1.0, SlowNoise(seed, 700, 0.9).at(t));
    for (const int side : {1, -1}) {
      const double knee = smooth_step(0.35, 1.0, side * SlowNoise(seed, 701, 1.1).at(t));
      const double bend = std::min(1.0, squat + knee);
      poser.turn_side("upper_leg", side, Vec3d::UnitX(), -1.35 * bend);
      poser.turn_side("lower_leg", side, Vec3d::UnitX(), 1.65 * bend);
      poser.turn_side("foot", side, Vec3d::UnitX(), -0.35 * squat);
      const double fist = 0.5 + 0.5 * SlowNoise(seed, static_cast<uint64_t>(710 + side), 1.3).at(t);
      const double spread = 0.10 * SlowNoise(seed, static_cast<uint64_t>(720 + side), 1.3).at(t);
      for (int finger = 0; finger < 5; ++finger) {
        const double own =
            0.35 * SlowNoise(seed, static_cast<uint64_t>(740 + 8 * finger + side), 1.6).at(t);
        poser.finger(side, finger, std::clamp(fist + own, -0.08, 1.0), spread * (1 - fist));
      }
    }
    poser.turn("spine", Vec3d::UnitX(), 0.35 * squat);
    animate_face(poser, seed, t);
    motion.poses.push_back(poser.finish());
  }
  return motion;
}

BodyMotion unseen_motion(const BuiltinBody& body, int frames, double frames_per_second,
                         uint64_t seed) {
  check_request(frames, frames_per_second);
  Random random(seed, 0x756e7365);
  const double pace = random.uniform(0.75, 0.95), start = random.uniform(0, 1);
  const Vec3d x = Vec3d::UnitX(), y = Vec3d::UnitY(), z = Vec3d::UnitZ();
  BodyMotion motion;
  motion.frames_per_second = frames_per_second;
  for (int f = 0; f < frames; ++f) {
    const double t = f / frames_per_second, stride = 2 * kPi * (pace * t + start);
    Poser poser(body);
    const BodyJoints& j = poser.joints();
    const Vec3d hinge = (j.lower_arm - j.upper_arm).normalized().cross(z).normalized();
    const double wave = smooth_step(0.2, 0.8, std::sin(2 * kPi * t / 5.0));
    poser.turn("hips", y, 0.35 * std::sin(2 * kPi * t / 7.0));
    poser.turn("spine", y, -0.10 * std::sin(stride));
    poser.turn("chest", y, -0.08 * std::sin(stride));
    poser.turn("head", y, 0.25 * std::sin(2 * kPi * t / 3.7));
    for (const int side : {1, -1}) {
      const double swing = std::sin(stride + (side > 0 ? 0 : kPi));
      const double lift = std::max(0.0, std::cos(stride + (side > 0 ? 0 : kPi)));
      poser.turn_side("upper_leg", side, x, -0.32 * swing - 0.35 * lift);
      poser.turn_side("lower_leg", side, x, 0.10 + 0.85 * lift);
      poser.turn_side("foot", side, x, 0.18 * swing - 0.10 * lift);
      const double hold = side > 0 ? wave : 0;
      poser.turn_side("upper_arm", side, z, -0.60 + 1.55 * hold);
      poser.turn_side("upper_arm", side, x, (1 - hold) * 0.35 * swing);
      poser.turn_side("lower_arm", side, hinge, 0.35 + 1.2 * hold + 0.15 * swing);
      poser.turn_side("hand", side, j.palm_normal, hold * 0.4 * std::sin(2 * kPi * 2.0 * t));
      for (int finger = 0; finger < 5; ++finger)
        poser.finger(side, finger, mix(0.30, 0.02, hold), 0.05 * hold);
    }
    animate_face(poser, seed + 77, t);
    motion.poses.push_back(poser.finish());
  }
  return motion;
}

std::vector<RigPose> swaying_motion(const Rig& rig, int frames, double frames_per_second,
                                    double reach, uint64_t seed) {
  check_request(frames, frames_per_second);
  std::vector<SlowNoise> noise;
  for (size_t i = 0; i < 3 * rig.parents.size(); ++i) noise.emplace_back(seed, i, 1.0);
  std::vector<RigPose> poses(static_cast<size_t>(frames), RigPose::rest(rig));
  for (size_t f = 0; f < poses.size(); ++f)
    for (size_t i = 3; i < noise.size(); ++i)
      poses[f].joint_rotation[i] =
          static_cast<float>(reach * noise[i].at(static_cast<double>(f) / frames_per_second));
  return poses;
}

}  // namespace effigy
