// Other skeletons' motions on a body.

#include <algorithm>
#include <cmath>
#include <map>

#include "effigy/base/error.h"
#include "effigy/people/body_motion.h"
#include "effigy/people/humanoid.h"

namespace effigy {
namespace {

Vec3d rest_joint(const RigShape& shape, int j) {
  return Vec3d(Vec3f(shape.joints.data() + 3 * static_cast<size_t>(j)).cast<double>());
}

// Turns about `from` x `to` that takes one direction to the other.
Mat3d turn_between(const Vec3d& from, const Vec3d& to) {
  return Eigen::Quaterniond::FromTwoVectors(from, to).toRotationMatrix();
}

std::map<std::string, int> file_joints(const Bvh& bvh) {
  std::vector<std::string> names;
  std::vector<int> parents;
  for (const BvhJoint& joint : bvh.joints) {
    names.push_back(joint.end ? "" : joint.name);
    parents.push_back(joint.parent);
  }
  return humanoid_joints(names, parents);
}

}  // namespace

std::vector<BvhMatch> match_bvh(const Rig& rig, const Bvh& bvh) {
  static const std::map<std::string, std::string> kNext = {
      {"upper_arm", "lower_arm"}, {"lower_arm", "hand"}, {"upper_leg", "lower_leg"},
      {"lower_leg", "foot"},      {"foot", "toes"},      {"shoulder", "upper_arm"}};
  const std::map<std::string, int> ours = humanoid_joints(rig.joint_names, rig.parents),
                                   theirs = file_joints(bvh);
  std::vector<BvhMatch> matches;
  for (const auto& [name, joint] : ours) {
    const auto source = theirs.find(name);
    if (source == theirs.end()) continue;
    BvhMatch match{name, joint, source->second};
    const size_t side = name.find_last_of('_');
    const auto next = kNext.find(name.substr(0, side));
    if (next != kNext.end()) {
      const std::string child = next->second + name.substr(side);
      const auto our_child = ours.find(child), their_child = theirs.find(child);
      if (our_child != ours.end() && their_child != theirs.end()) {
        match.child = our_child->second;
        match.source_child = their_child->second;
      }
    }
    matches.push_back(match);
  }
  std::sort(matches.begin(), matches.end(),
            [](const BvhMatch& a, const BvhMatch& b) { return a.joint < b.joint; });
  return matches;
}

namespace {

// Where the joints that tell how a skeleton stands are at rest.
struct Stance {
  Vec3d legs[2], knees[2];  // left, right

  double thigh() const { return (legs[0] - knees[0]).norm(); }
  // Rows: left, up and forward, the nearest axes of the skeleton's own.
  Mat3d upright(const std::string& name) const {
    const Vec3d up = (legs[0] + legs[1] - knees[0] - knees[1]).normalized();
    Vec3d left = legs[0] - legs[1];
    left -= up * up.dot(left);
    if (!(thigh() > 1e-9) || !(left.norm() > 1e-9))
      throw Error(name +
                  ": the skeleton's rest pose has legs of no length; export it with its offsets.");
    const auto nearest_axis = [](const Vec3d& v) {
      int c = 0;
      v.cwiseAbs().maxCoeff(&c);
      return Vec3d(Vec3d::Unit(c) * (v[c] < 0 ? -1.0 : 1.0));
    };
    const Vec3d y = nearest_axis(up), x = nearest_axis(Vec3d(left - y * y.dot(left)));
    Mat3d r;
    r.row(0) = x;
    r.row(1) = y;
    r.row(2) = x.cross(y);
    return r;
  }
};

class Retargeter {
 public:
  Retargeter(const Rig& rig, const RigShape& shape, const Bvh& bvh, const std::string& name)
      : rig_(rig),
        shape_(shape),
        bvh_(bvh),
        matches_(match_bvh(rig, bvh)),
        match_(rig.parents.size(), -1) {
    for (size_t m = 0; m < matches_.size(); ++m)
      match_[static_cast<size_t>(matches_[m].joint)] = static_cast<int>(m);
    for (const char* needed :
         {"hips", "upper_leg_left", "upper_leg_right", "lower_leg_left", "lower_leg_right",
          "upper_arm_left", "upper_arm_right", "lower_arm_left", "lower_arm_right"})
      if (find(needed) == nullptr)
        throw Error(name + ": no joint of " +
                    (file_joints(bvh).count(needed) == 0 ? "the BVH skeleton" : "the body") +
                    " is known as '" + needed +
                    "'; rename its joints to the usual names (Hips, LeftUpLeg, LeftArm ...).");
    bvh.pose(-1, rotations_, rest_);
    const Stance theirs = stance([&](const BvhMatch&m) { return at(rest_, m.source); }),
                 ours = stance([&](const BvhMatch&m) { return rest_joint(shape, m.joint); });
    ours_from_file_ = ours.upright(name).transpose() * theirs.upright(name);
    scale_ = ours.thigh() / theirs.thigh();
    ground_ = 1e300;
    for (size_t i = 1; i < shape.rest.size(); i += 3)
      ground_ = std::min(ground_, static_cast<double>(shape.rest[i]));
    align();
  }

  RigPose at_frame(int frame) {
    bvh_.pose(frame, rotations_, positions_);
    RigPose pose = RigPose::rest(rig_);
    std::vector<Mat3d> world(rig_.parents.size(), Mat3d::Identity());
    for (size_t j = 0; j < world.size(); ++j) {
      const int parent = rig_.parents[j];
      const Mat3d above = parent < 0 ? Mat3d::Identity() : world[static_cast<size_t>(parent)];
      world[j] = above;
      if (match_[j] < 0) continue;
      const BvhMatch& m = matches_[static_cast<size_t>(match_[j])];
      world[j] = ours_from_file_ * rotations_[static_cast<size_t>(m.source)] *
                 ours_from_file_.transpose() * align_[static_cast<size_t>(match_[j])];
      const Eigen::AngleAxisd local(Mat3d(above.transpose() * world[j]));
      for (int c = 0; c < 3; ++c)
        pose.joint_rotation[3 * j + static_cast<size_t>(c)] =
            static_cast<float>(local.angle() * local.axis()[c]);
    }
    const BvhMatch& hips = *find("hips");
    const Vec3d moved =
        scale_ * (ours_from_file_ * at(positions_, hips.source)) - rest_joint(shape_, hips.joint);
    for (size_t c = 0; c < 3; ++c)
      pose.translation[c] = static_cast<float>(moved[static_cast<int>(c)]);
    return pose;
  }
  // Height of the lower foot above where it is when the body stands on the ground.
  double foot_height(const RigPose& pose) const {
    const std::vector<float> transforms = joint_transforms(shape_, pose);
    double low = 1e300;
    for (const char* name : {"foot_left", "foot_right", "toes_left", "toes_right"})
      if (const BvhMatch* m = find(name)) {
        const float* row = transforms.data() + 12 * static_cast<size_t>(m->joint) + 4;
        const Vec3d rest = rest_joint(shape_, m->joint);
        const double height = Vec3f(row).cast<double>().dot(rest) + static_cast<double>(row[3]);
        low = std::min(low, height - (rest.y() - ground_));
      }
    return low < 1e300 ? low : 0.0;
  }

 private:
  static Vec3d at(const std::vector<Vec3d>& places, int joint) {
    return places[static_cast<size_t>(joint)];
  }
  const BvhMatch* find(const std::string& name) const {
    for (const BvhMatch& m : matches_)
      if (m.name == name) return &m;
    return nullptr;
  }
  template <typename Place>
  Stance stance(const Place& place) const {
    return {{place(*find("upper_leg_left")), place(*find("upper_leg_right"))},
            {place(*find("lower_leg_left")), place(*find("lower_leg_right"))}};
  }

  // What turns our rest direction of each bone to the file's.
  void align() {
    for (const BvhMatch& m : matches_) {
      Mat3d a = Mat3d::Identity();
      if (m.child >= 0) {
        const Vec3d ours = rest_joint(shape_, m.child) - rest_joint(shape_, m.joint);
        const Vec3d theirs = ours_from_file_ * (at(rest_, m.source_child) - at(rest_, m.source));
        if (ours.norm() > 1e-9 && theirs.norm() > 1e-9) a = turn_between(ours, theirs);
      }
      align_.push_back(a);
    }
    // Hands and toes go on as what they hang on does.
    for (size_t m = 0; m < matches_.size(); ++m) {
      const std::string& name = matches_[m].name;
      if (matches_[m].child >= 0 || !(name.starts_with("hand") || name.starts_with("toes")))
        continue;
      int above = rig_.parents[static_cast<size_t>(matches_[m].joint)];
      while (above >= 0 && match_[static_cast<size_t>(above)] < 0)
        above = rig_.parents[static_cast<size_t>(above)];
      if (above >= 0) align_[m] = align_[static_cast<size_t>(match_[static_cast<size_t>(above)])];
    }
  }

  const Rig& rig_;
  const RigShape& shape_;
  const Bvh& bvh_;
  std::vector<BvhMatch> matches_;
  std::vector<int> match_;  // per joint of ours
  std::vector<Mat3d> rotations_, align_;
  std::vector<Vec3d> positions_, rest_;
  Mat3d ours_from_file_ = Mat3d::Identity();
  double scale_ = 1, ground_ = 0;  // ground: the body's lowest point at rest
};

}  // namespace

BodyMotion retarget_bvh(const Rig& rig, const RigShape& shape, const Bvh& bvh,
                        const std::string& name, int frames, double frames_per_second,
                        double first) {
  if (frames < 1 || !(frames_per_second >= 1 && frames_per_second <= 1000) || !(first >= 0))
    throw Error(
        name +
        ": a motion needs at least one frame, 1 to 1000 a second, from a time of 0 or later.");
  Retargeter retargeter(rig, shape, bvh, name);
  const double length = bvh.frames() * bvh.frame_seconds;
  if (first >= length)
    throw Error(name + ": the motion is " + std::to_string(length) +
                " seconds long and ends before the first second asked for.");
  BodyMotion motion;
  motion.frames_per_second = frames_per_second;
  double floor = 1e300;
  for (int f = 0; f < frames; ++f) {
    const auto source =
        static_cast<int>(std::lround((first + f / frames_per_second) / bvh.frame_seconds));
    if (source >= bvh.frames()) break;
    motion.poses.push_back(retargeter.at_frame(source));
    floor = std::min(floor, retargeter.foot_height(motion.poses.back()));
  }
  for (RigPose& pose : motion.poses) pose.translation[1] -= static_cast<float>(floor);
  return motion;
}

BodyMotion retarget_bvh(const BuiltinBody& body, const Bvh& bvh, const std::string& name,
                        int frames, double frames_per_second, double first) {
  BodyMotion motion =
      retarget_bvh(body.rig, body.shape, bvh, name, frames, frames_per_second, first);
  for (RigPose& pose : motion.poses) drive_body_helpers(body, pose);
  return motion;
}

}  // namespace effigy
