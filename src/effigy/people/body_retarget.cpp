// Other skeletons' motions on the built-in body.

#include <algorithm>
#include <cmath>
#include <map>

#include "effigy/base/error.h"
#include "effigy/people/body_motion.h"

namespace effigy {
namespace {

// Lower case without separators and without the prefixes that exporters add.
std::string plain_name(const std::string& name) {
  std::string out;
  for (const char c : name) {
    if (c == ':') out.clear();  // "mixamorig:Hips"
    if (std::isalnum(static_cast<unsigned char>(c)))
      out += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  return out;
}

struct Names {
  const char* joint;
  std::vector<const char*> sources;  // first found wins; "L" stands for the side
};

// {L} is "left" or "l", as "lefthand", "lhand", "handl" or "handleft".
const std::vector<Names>& name_table() {
  static const std::vector<Names> table = {
      {"hips", {"hips", "pelvis", "hip", "root"}},
      {"spine", {"lowerback", "spine", "spine05", "abdomen"}},
      {"chest", {"spine", "spine1", "spine03", "chest"}},
      {"upper_chest", {"spine1", "spine2", "spine01", "upperchest", "chest"}},
      {"neck", {"neck", "neck01"}},
      {"head", {"head"}},
      {"shoulder", {"{L}shoulder", "{L}collar", "{L}clavicle", "clavicle{L}"}},
      {"upper_arm", {"{L}arm", "{L}upperarm", "upperarm01{L}", "upperarm{L}", "{L}shldr"}},
      {"lower_arm", {"{L}forearm", "{L}lowerarm", "lowerarm01{L}", "lowerarm{L}"}},
      {"hand", {"{L}hand", "wrist{L}", "hand{L}"}},
      {"upper_leg", {"{L}upleg", "{L}upperleg", "{L}thigh", "upperleg01{L}", "upperleg{L}"}},
      {"lower_leg", {"{L}leg", "{L}lowerleg", "{L}shin", "lowerleg01{L}", "lowerleg{L}"}},
      {"foot", {"{L}foot", "foot{L}"}},
      {"toes", {"{L}toebase", "{L}toes", "{L}toe", "toe11{L}", "toes{L}"}}};
  return table;
}

int find_source(const std::map<std::string, int>& by_name, const Names& names, int side,
                const std::vector<int>& used) {
  for (const std::string source : names.sources) {
    std::vector<std::string> spelled;
    const size_t mark = source.find("{L}");
    if (mark == std::string::npos)
      spelled = {source};
    else
      for (const char* s : {side > 0 ? "left" : "right", side > 0 ? "l" : "r"})
        spelled.push_back(std::string(source).replace(mark, 3, s));
    for (const std::string& name : spelled) {
      const auto found = by_name.find(name);
      if (found != by_name.end() &&
          std::find(used.begin(), used.end(), found->second) == used.end())
        return found->second;
    }
  }
  return -1;
}

Vec3d rest_joint(const RigShape& shape, int j) {
  return Vec3d(Vec3f(shape.joints.data() + 3 * static_cast<size_t>(j)).cast<double>());
}

// Turns about `from` x `to` that takes one direction to the other.
Mat3d turn_between(const Vec3d& from, const Vec3d& to) {
  return Eigen::Quaterniond::FromTwoVectors(from, to).toRotationMatrix();
}

}  // namespace

std::vector<BvhMatch> match_bvh(const Rig& rig, const Bvh& bvh) {
  std::map<std::string, int> by_name;
  for (size_t j = 0; j < bvh.joints.size(); ++j)
    if (!bvh.joints[j].end) by_name.emplace(plain_name(bvh.joints[j].name), static_cast<int>(j));
  std::vector<BvhMatch> matches;
  std::map<std::string, int> source_of;
  std::vector<int> used;
  for (const Names& names : name_table()) {
    const std::string joint = names.joint;
    const bool middle = rig.joint(joint) >= 0;
    for (const int side : {1, -1}) {
      if (middle && side < 0) continue;
      const int source = find_source(by_name, names, side, used);
      if (source < 0) continue;
      const std::string full = middle ? joint : joint + (side > 0 ? "_left" : "_right");
      used.push_back(source);
      source_of[full] = source;
    }
  }
  static const std::map<std::string, std::string> kNext = {
      {"upper_arm", "lower_arm"}, {"lower_arm", "hand"}, {"upper_leg", "lower_leg"},
      {"lower_leg", "foot"},      {"foot", "toes"},      {"shoulder", "upper_arm"}};
  for (int j = 0; j < rig.joint_count(); ++j) {
    const std::string& name = rig.joint_names[static_cast<size_t>(j)];
    const auto found = source_of.find(name);
    if (found == source_of.end()) continue;
    BvhMatch match{j, found->second, -1, -1};
    for (const char* side : {"_left", "_right"})
      if (name.ends_with(side)) {
        const auto next = kNext.find(name.substr(0, name.size() - std::string(side).size()));
        if (next == kNext.end()) continue;
        const auto child = source_of.find(next->second + side);
        if (child == source_of.end()) continue;
        match.source_child = child->second;
        match.child = rig.joint(next->second + side);
      }
    matches.push_back(match);
  }
  return matches;
}

namespace {

class Retargeter {
 public:
  Retargeter(const BuiltinBody& body, const Bvh& bvh, const std::string& name)
      : body_(body),
        bvh_(bvh),
        matches_(match_bvh(body.rig, bvh)),
        match_(body.rig.parents.size(), -1) {
    for (size_t m = 0; m < matches_.size(); ++m)
      match_[static_cast<size_t>(matches_[m].joint)] = static_cast<int>(m);
    for (const char* needed :
         {"hips", "upper_leg_left", "upper_leg_right", "lower_leg_left", "lower_leg_right",
          "upper_arm_left", "upper_arm_right", "lower_arm_left", "lower_arm_right"})
      if (match_[static_cast<size_t>(body.rig.joint(needed))] < 0)
        throw Error(name + ": no joint of the BVH skeleton is known as '" + needed +
                    "'; rename its joints to the usual names (Hips, LeftUpLeg, LeftArm ...).");
    bvh.pose(-1, rotations_, rest_);
    orient(name);
    align();
  }

  RigPose at(int frame) {
    bvh_.pose(frame, rotations_, positions_);
    RigPose pose = RigPose::rest(body_.rig);
    std::vector<Mat3d> world(body_.rig.parents.size(), Mat3d::Identity());
    for (size_t j = 0; j < world.size(); ++j) {
      const int parent = body_.rig.parents[j];
      const Mat3d above = parent < 0 ? Mat3d::Identity() : world[static_cast<size_t>(parent)];
      world[j] = above;
      if (match_[j] < 0) continue;
      const BvhMatch& m = matches_[static_cast<size_t>(match_[j])];
      world[j] = upright_ * rotations_[static_cast<size_t>(m.source)] * upright_.transpose() *
                 align_[static_cast<size_t>(match_[j])];
      const Eigen::AngleAxisd local(Mat3d(above.transpose() * world[j]));
      for (int c = 0; c < 3; ++c)
        pose.joint_rotation[3 * j + static_cast<size_t>(c)] =
            static_cast<float>(local.angle() * local.axis()[c]);
    }
    const int hips = matches_[static_cast<size_t>(match_[0])].source;
    const Vec3d p = scale_ * (upright_ * positions_[static_cast<size_t>(hips)]);
    const Vec3d rest = rest_joint(body_.shape, 0);
    // The file's own floor is its height 0 along its up axis.
    pose.translation = {static_cast<float>(p.x() - rest.x()),
                        static_cast<float>(p.y() - floor_ - rest.y()),
                        static_cast<float>(p.z() - rest.z())};
    drive_body_helpers(body_, pose);
    return pose;
  }
  // Height of the lower foot at a frame without the shift of the floor.
  double foot_height(int frame) {
    bvh_.pose(frame, rotations_, positions_);
    double low = 1e300;
    for (const char* name : {"foot_left", "foot_right", "toes_left", "toes_right"}) {
      const int m = match_[static_cast<size_t>(body_.rig.joint(name))];
      if (m < 0) continue;
      const int source = matches_[static_cast<size_t>(m)].source;
      low = std::min(low, scale_ * (upright_ * positions_[static_cast<size_t>(source)]).y() -
                              rest_joint(body_.shape, body_.rig.joint(name)).y());
    }
    return low < 1e300 ? low : 0.0;
  }
  void set_floor(double height) { floor_ = height; }

 private:
  Vec3d source(const char* joint) const {
    const int m = match_[static_cast<size_t>(body_.rig.joint(joint))];
    return rest_[static_cast<size_t>(matches_[static_cast<size_t>(m)].source)];
  }

  // The file's up and left become ours; its legs' length gives the scale.
  void orient(const std::string& name) {
    const Vec3d legs = 0.5 * (source("upper_leg_left") + source("upper_leg_right"));
    const Vec3d knees = 0.5 * (source("lower_leg_left") + source("lower_leg_right"));
    const Vec3d up = (legs - knees).normalized();
    Vec3d left = source("upper_leg_left") - source("upper_leg_right");
    left -= up * up.dot(left);
    const auto length = [&](const auto& at) {
      return (at("upper_leg_left") - at("lower_leg_left")).norm();
    };
    const double theirs = length([&](const char* j) { return source(j); });
    const double ours =
        length([&](const char* j) { return rest_joint(body_.shape, body_.rig.joint(j)); });
    if (!(theirs > 1e-9) || !(left.norm() > 1e-9))
      throw Error(
          name +
          ": the BVH skeleton's rest pose has legs of no length; export it with its offsets.");
    left.normalize();
    // Only the axes' directions matter: the nearest ones of the file's own.
    const auto nearest_axis = [](const Vec3d& v) {
      int c = 0;
      v.cwiseAbs().maxCoeff(&c);
      return Vec3d(Vec3d::Unit(c) * (v[c] < 0 ? -1.0 : 1.0));
    };
    const Vec3d y = nearest_axis(up);
    Vec3d x = nearest_axis(Vec3d(left - y * y.dot(left)));
    upright_.row(0) = x;
    upright_.row(1) = y;
    upright_.row(2) = x.cross(y);
    scale_ = ours / theirs;
  }

  // What turns our rest direction of each bone to the file's.
  void align() {
    for (const BvhMatch& m : matches_) {
      Mat3d a = Mat3d::Identity();
      if (m.child >= 0) {
        const Vec3d ours = rest_joint(body_.shape, m.child) - rest_joint(body_.shape, m.joint);
        const Vec3d theirs = upright_ * (rest_[static_cast<size_t>(m.source_child)] -
                                         rest_[static_cast<size_t>(m.source)]);
        if (ours.norm() > 1e-9 && theirs.norm() > 1e-9) a = turn_between(ours, theirs);
      }
      align_.push_back(a);
    }
    // Hands and toes go on as their parents do.
    for (size_t m = 0; m < matches_.size(); ++m) {
      if (matches_[m].child >= 0) continue;
      const int parent = body_.rig.parents[static_cast<size_t>(matches_[m].joint)];
      const int above = parent < 0 ? -1 : match_[static_cast<size_t>(parent)];
      const std::string& name = body_.rig.joint_names[static_cast<size_t>(matches_[m].joint)];
      if (above >= 0 && (name.starts_with("hand") || name.starts_with("toes")))
        align_[m] = align_[static_cast<size_t>(above)];
    }
  }

  const BuiltinBody& body_;
  const Bvh& bvh_;
  std::vector<BvhMatch> matches_;
  std::vector<int> match_;  // per joint of ours
  std::vector<Mat3d> rotations_, align_;
  std::vector<Vec3d> positions_, rest_;
  Mat3d upright_ = Mat3d::Identity();
  double scale_ = 1, floor_ = 0;
};

}  // namespace

BodyMotion retarget_bvh(const BuiltinBody& body, const Bvh& bvh, const std::string& name,
                        int frames, double frames_per_second, double first) {
  if (frames < 1 || !(frames_per_second >= 1 && frames_per_second <= 1000) || !(first >= 0))
    throw Error(
        name +
        ": a motion needs at least one frame, 1 to 1000 a second, from a time of 0 or later.");
  Retargeter retargeter(body, bvh, name);
  const double length = bvh.frames() * bvh.frame_seconds;
  if (first >= length)
    throw Error(name + ": the motion is " + std::to_string(length) +
                " seconds long and ends before the first second asked for.");
  std::vector<int> sources;
  for (int f = 0; f < frames; ++f) {
    const int source = static_cast<int>((first + f / frames_per_second) / bvh.frame_seconds + 0.5);
    if (source >= bvh.frames()) break;
    sources.push_back(source);
  }
  double floor = 1e300;
  for (const int s : sources) floor = std::min(floor, retargeter.foot_height(s));
  retargeter.set_floor(floor);
  BodyMotion motion;
  motion.frames_per_second = frames_per_second;
  for (const int s : sources) motion.poses.push_back(retargeter.at(s));
  return motion;
}

}  // namespace effigy
