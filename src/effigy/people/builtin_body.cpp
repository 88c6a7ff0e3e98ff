#include "effigy/people/builtin_body.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>

#include "effigy/base/error.h"
#include "effigy/people/body_model.h"
#include "effigy/people/body_rig.h"
#include "effigy/people/builtin_head.h"

namespace effigy {
namespace {

using people::BodyBone;
using people::BodyModel;

// The head's rows, then zeros for the body's vertices.
void extend_row(const float* row, size_t head3, size_t all3, std::vector<float>& basis) {
  basis.insert(basis.end(), row, row + head3);
  basis.insert(basis.end(), all3 - head3, 0.0f);
}

void add_expressions(const Rig& head, Rig& rig, BodyModel& model) {
  const size_t head3 = head.mesh.vertices.size(), all3 = rig.mesh.vertices.size();
  for (int e = 0; e < head.expression_count; ++e)
    extend_row(head.expression_basis.data() + static_cast<size_t>(e) * head3, head3, all3,
               rig.expression_basis);
  rig.expression_names = head.expression_names;
  rig.expression_low = head.expression_low;
  rig.expression_high = head.expression_high;
  // The head's pose shapes become expressions that drive_body_helpers() sets.
  if (head.pose_basis.empty()) return;
  for (size_t j = 1; j < head.parents.size(); ++j)
    for (int e = 0; e < 9; ++e) {
      const float* row = head.pose_basis.data() + (9 * (j - 1) + static_cast<size_t>(e)) * head3;
      if (std::all_of(row, row + head3, [](float x) { return x == 0; })) continue;
      const std::string& name = head.joint_names[j];
      model.head_shapes.push_back({static_cast<int>(rig.expression_names.size()),
                                   rig.joint(name == "neck" ? "head" : name), e / 3, e % 3});
      extend_row(row, head3, all3, rig.expression_basis);
      rig.expression_names.push_back("pose_" + name + "_" + std::to_string(e));
      rig.expression_low.push_back(-2);
      rig.expression_high.push_back(2);
    }
}

void add_twists(const Rig& rig, const std::vector<BodyBone>& bones, BodyModel& model) {
  const auto joint = [&](const std::string& name) { return rig.joint(name); };
  for (const char* side : {"_left", "_right"}) {
    const std::string s = side;
    const auto axis = [&](const std::string& from, const std::string& to) {
      return Vec3d((bones[static_cast<size_t>(joint(to))].joint -
                    bones[static_cast<size_t>(joint(from))].joint)
                       .normalized());
    };
    model.twists.push_back({joint("upper_arm_twist" + s), joint("upper_arm" + s),
                            axis("upper_arm" + s, "lower_arm" + s), -0.8});
    model.twists.push_back({joint("upper_leg_twist" + s), joint("upper_leg" + s),
                            axis("upper_leg" + s, "lower_leg" + s), -0.7});
    model.twists.push_back(
        {joint("lower_arm_twist" + s), joint("hand" + s), axis("lower_arm" + s, "hand" + s), 0.6});
  }
}

BuiltinBody make_body(uint64_t subject) {
  Rig head = builtin_head_rig(subject);
  const people::BodyStyle style = people::body_style(subject);
  const Vec3d offset = people::head_offset(style.build);
  people::raise_neck(head, offset,
                     people::BodyForm(style.build, style.outfit, people::neck_ring(head, offset)));
  people::BodyForm form(style.build, style.outfit, people::neck_ring(head, offset));
  people::BodyMesh mesh = people::build_body_mesh(form, head, offset);
  const std::vector<BodyBone> bones = people::body_bones(form, head, offset);

  BuiltinBody body;
  body.subject = subject;
  Rig& rig = body.rig;
  rig.kind = "builtin-body";
  rig.licence = "Apache-2.0";
  rig.mesh = mesh.mesh;
  for (const BodyBone& bone : bones) {
    rig.joint_names.push_back(bone.name);
    rig.parents.push_back(bone.parent);
  }
  rig.joint_regressor = people::body_regressor(mesh, head, bones);
  rig.weights = people::body_weights(mesh, head, bones);
  rig.multipie = head.multipie;  // the head's triangles come first
  rig.mediapipe = head.mediapipe;
  auto model =
      std::make_shared<BodyModel>(BodyModel{style, std::move(form), std::move(mesh), {}, {}, {}});
  add_expressions(head, rig, *model);
  rig.expression_count = static_cast<int>(rig.expression_names.size());
  add_twists(rig, bones, *model);
  body.head_vertices = head.mesh.vertex_count();
  body.face_expressions = head.expression_count;
  check_rig(rig, "built-in body");
  body.shape = shape_rig(rig, {});
  model->cloth = people::make_cloth_field(*model, rig);
  body.model = std::move(model);
  return body;
}

// The turn about a unit axis in a rotation: its twist (swing-twist decomposition).
double twist_angle(const Eigen::Quaterniond& q, const Vec3d& axis) {
  double angle = 2 * std::atan2(q.vec().dot(axis), q.w());
  if (angle > M_PI) angle -= 2 * M_PI;
  if (angle < -M_PI) angle += 2 * M_PI;
  return angle;
}

Eigen::Quaterniond joint_turn(const RigPose& pose, int joint) {
  const float* w = pose.joint_rotation.data() + 3 * static_cast<size_t>(joint);
  const Vec3d v(w[0], w[1], w[2]);
  const double angle = v.norm();
  return angle < 1e-12 ? Eigen::Quaterniond::Identity()
                       : Eigen::Quaterniond(Eigen::AngleAxisd(angle, v / angle));
}

}  // namespace

const BuiltinBody& builtin_body(uint64_t subject) {
  static std::mutex mutex;
  static std::map<uint64_t, std::unique_ptr<BuiltinBody>> made;
  const std::lock_guard lock(mutex);
  auto& body = made[subject];
  if (!body) body = std::make_unique<BuiltinBody>(make_body(subject));
  return *body;
}

BodyLabel body_part_label(const std::string& part) {
  if (part == "face" || part == "skin") return BodyLabel::kSkin;
  if (part == "hair") return BodyLabel::kHair;
  if (part == "eye_left" || part == "eye_right") return BodyLabel::kEyes;
  if (part == "teeth") return BodyLabel::kTeeth;
  if (part == "mouth") return BodyLabel::kMouth;
  if (part == "hands") return BodyLabel::kHands;
  if (part == "top" || part == "bottom") return BodyLabel::kCloth;
  return part == "shoes" ? BodyLabel::kShoes : BodyLabel::kNone;
}

void drive_body_helpers(const BuiltinBody& body, RigPose& pose) {
  EFFIGY_CHECK_EQ(pose.joint_rotation.size(), 3 * body.rig.parents.size());
  EFFIGY_CHECK_EQ(pose.expression.size(), static_cast<size_t>(body.rig.expression_count));
  const BodyModel& model = *body.model;
  for (const BodyModel::Twist& t : model.twists) {
    const double turn = t.share * twist_angle(joint_turn(pose, t.driver), t.axis);
    for (int c = 0; c < 3; ++c)
      pose.joint_rotation[3 * static_cast<size_t>(t.helper) + static_cast<size_t>(c)] =
          static_cast<float>(turn * t.axis[c]);
  }
  for (const BodyModel::HeadShape& h : model.head_shapes) {
    const Mat3d r = joint_turn(pose, h.joint).toRotationMatrix();
    pose.expression[static_cast<size_t>(h.expression)] =
        static_cast<float>(r(h.row, h.column) - (h.row == h.column ? 1 : 0));
  }
}

BodyFrames body_frames(const BuiltinBody& body) {
  return {0, body.rig.joint("head")};
}

namespace {

// Joints that are keypoints: not the twist joints, not those of the face.
std::vector<int> keypoint_joints(const Rig& rig) {
  std::vector<int> out;
  for (int j = 0; j < rig.joint_count(); ++j) {
    const std::string& name = rig.joint_names[static_cast<size_t>(j)];
    if (name.find("twist") == std::string::npos && name != "jaw" && !name.starts_with("eye_"))
      out.push_back(j);
  }
  return out;
}

struct Extremity {
  std::string name;
  int joint;
  Vec3d place;  // metres, at rest
};
std::vector<Extremity> extremities(const BuiltinBody& body) {
  std::vector<Extremity> out;
  const people::BodyJoints& j = body.model->form.joints();
  static constexpr const char* kFingers[5] = {"thumb", "index", "middle", "ring", "little"};
  for (const int side : {1, -1}) {
    const std::string s = side > 0 ? "_left" : "_right";
    const auto at = [&](const Vec3d& p) {
      return Vec3d(1e-3 * side * p.x(), 1e-3 * p.y(), 1e-3 * p.z());
    };
    for (size_t f = 0; f < 5; ++f)
      out.push_back({std::string(kFingers[f]) + "_tip" + s,
                     body.rig.joint(std::string(kFingers[f]) + "_distal" + s),
                     at(j.fingers[f][3])});
    out.push_back({"toe_tip" + s, body.rig.joint("toes" + s), at(j.toe_tip)});
    out.push_back(
        {"heel" + s, body.rig.joint("foot" + s), at(Vec3d(j.foot.x(), 20, j.foot.z() - 40))});
  }
  return out;
}

}  // namespace

std::vector<std::string> body_keypoint_names(const BuiltinBody& body) {
  std::vector<std::string> names;
  for (const int j : keypoint_joints(body.rig))
    names.push_back(body.rig.joint_names[static_cast<size_t>(j)]);
  for (const Extremity& e : extremities(body)) names.push_back(e.name);
  return names;
}

BodyKeypoints body_keypoints(const BuiltinBody& body, const RigPose& pose) {
  const std::vector<float> transforms = joint_transforms(body.shape, pose);
  BodyKeypoints out;
  const auto put = [&](int joint, const Vec3d& rest, std::vector<float>& list) {
    const float* m = transforms.data() + 12 * static_cast<size_t>(joint);
    for (int r = 0; r < 3; ++r)
      list.push_back(static_cast<float>(m[4 * r] * rest.x() + m[4 * r + 1] * rest.y() +
                                        m[4 * r + 2] * rest.z() + m[4 * r + 3]));
  };
  const auto rest = [&](int joint) {
    const float* p = body.shape.joints.data() + 3 * static_cast<size_t>(joint);
    return Vec3d(p[0], p[1], p[2]);
  };
  for (const int j : keypoint_joints(body.rig)) put(j, rest(j), out.body);
  for (const Extremity& e : extremities(body)) put(e.joint, e.place, out.body);
  std::vector<float> vertices;
  pose_vertices(body.shape, pose, vertices);
  out.face = landmark_positions(body.rig.multipie, body.rig.mesh.triangles, vertices);
  for (const char* eye : {"eye_left", "eye_right"})
    put(body.rig.joint(eye), rest(body.rig.joint(eye)), out.face);
  return out;
}

}  // namespace effigy
