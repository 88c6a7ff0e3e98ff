#include "effigy/synth/body_scene.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/people/humanoid.h"
#include "effigy/people/user_body.h"
#include "effigy/synth/subsurface.h"
#include "effigy/synth/tracking_error.h"
#include "effigy/synth/user_material.h"

namespace effigy {
namespace {

constexpr double kClothRate = 30;                   // steps a second, at least
constexpr double kSway = 0.2;                       // radians, of the joints of the user's own body
constexpr float kSmallest = 0.3f, kTallest = 2.4f;  // metres

}  // namespace

BodyScene::BodyScene(const BodySceneOptions& options)
    : options_(options),
      substeps_(std::max(1, static_cast<int>(std::ceil(kClothRate / options.frames_per_second)))) {
  if (options.body.empty())
    load_builtin();
  else
    load_users_own();
  add_motion(motion_of(options.motion, false, options.frames), options.frames);
  if (options.unseen_frames > 0)
    add_motion(motion_of(options.unseen_motion, true, options.unseen_frames),
               options.unseen_frames);
  tracked_ = with_tracking_error(rig_, poses_, options.frames_per_second, options.tracking_error,
                                 options.seed);
  if (options.tracking_error > 0 && builtin_ != nullptr)
    for (RigPose& pose : tracked_) drive_body_helpers(*builtin_, pose);
}

void BodyScene::load_builtin() {
  builtin_ = &builtin_body(options_.subject);
  rig_ = builtin_->rig;
  shape_ = builtin_->shape;
  cloth_.emplace(*builtin_);
  BodyMaterials maps = builtin_body_materials(*builtin_, options_.texture_size);
  labels_ = std::move(maps.labels);
  label_size_ = options_.texture_size;
  SurfaceMaterial material;
  material.albedo = std::move(maps.albedo);
  material.roughness = std::move(maps.roughness);
  material.specular = std::move(maps.specular);
  material.normal = std::move(maps.normal);
  if (options_.subsurface) {
    material.scatter = std::move(maps.scatter);
    material.scatter_radius = kSkinScatter;
  }
  scene_.add_mesh(rig_.mesh, scene_.add_material(material, "the body"), "the body");
}

void BodyScene::load_users_own() {
  const std::string& name = options_.body;
  UserBody own = std::filesystem::is_directory(name)
                     ? read_makehuman_body(name, {}, options_.texture_size)
                     : read_gltf_body(name, options_.texture_size);
  rig_ = std::move(own.rig);
  shape_ = shape_rig(rig_, {});
  Vec3f low = Vec3f::Constant(1e9f), high = -low;
  for (size_t v = 0; v < shape_.rest.size(); v += 3) {
    low = low.cwiseMin(Vec3f(&shape_.rest[v]));
    high = high.cwiseMax(Vec3f(&shape_.rest[v]));
  }
  const float height = high.y() - low.y();
  if (!(height > kSmallest && height < kTallest))
    throw Error(name + ": the body is " + std::to_string(height) +
                " metres tall; scale it to a person's size (glTF counts in metres, y up).");
  place_ = {-0.5f * (low.x() + high.x()), -low.y(), -0.5f * (low.z() + high.z())};
  const int material = scene_.add_material(user_material(std::move(own)), name);
  scene_.add_mesh(rig_.mesh, material, name);
}

std::vector<RigPose> BodyScene::motion_of(const std::string& file, bool unseen, int frames) const {
  const int steps = (frames - 1) * substeps_ + 1;
  const double rate = options_.frames_per_second * substeps_;
  if (file.empty() && builtin_ == nullptr) {
    std::vector<RigPose> poses =
        swaying_motion(rig_, steps, rate, kSway, options_.seed + (unseen ? 0x756e : 0));
    for (RigPose& pose : poses) pose.translation = place_;
    return poses;
  }
  if (file.empty())
    return (unseen ? unseen_motion(*builtin_, steps, rate, options_.seed)
                   : range_of_motion(*builtin_, steps, rate, options_.seed))
        .poses;
  const Bvh bvh = read_bvh(file);
  BodyMotion motion = builtin_ != nullptr ? retarget_bvh(*builtin_, bvh, file, steps, rate)
                                          : retarget_bvh(rig_, shape_, bvh, file, steps, rate);
  const int found = static_cast<int>(motion.poses.size());
  if (found < steps)
    throw Error(file + ": the motion has " + std::to_string((found - 1) / substeps_ + 1) +
                " frames at this rate, " + std::to_string(frames) +
                " are asked for; ask for fewer or raise the rate.");
  for (RigPose& pose : motion.poses) {
    pose.translation[0] = place_[0];
    pose.translation[2] = place_[2];
  }
  return motion.poses;
}

void BodyScene::add_motion(const std::vector<RigPose>& motion, int frames) {
  for (size_t s = 0; s < motion.size(); ++s) {
    steps_.push_back(motion[s]);
    starts_.push_back(s == 0);
  }
  for (int f = 0; f < frames; ++f)
    poses_.push_back(motion[static_cast<size_t>(f) * static_cast<size_t>(substeps_)]);
}

std::vector<Vec3f> BodyScene::reach() const {
  constexpr float kCell = 0.01f, kFurthest = 1e5f;
  std::vector<std::array<int, 3>> cells, more;
  std::vector<float> vertices;
  for (const RigPose& pose : poses_) {
    pose_vertices(shape_, pose, vertices);
    more = cells;
    for (size_t i = 0; i < vertices.size(); i += 3) {
      const auto cell = [&](size_t c) {
        return static_cast<int>(
            std::lround(std::clamp(vertices[i + c], -kFurthest, kFurthest) / kCell));
      };
      more.push_back({cell(0), cell(1), cell(2)});
    }
    std::sort(more.begin(), more.end());
    more.erase(std::unique(more.begin(), more.end()), more.end());
    cells.swap(more);
  }
  std::vector<Vec3f> points;
  points.reserve(cells.size());
  for (const std::array<int, 3>& cell : cells)
    points.push_back(kCell * Eigen::Map<const Vec3i>(cell.data()).cast<float>());
  return points;
}

void BodyScene::check_outside(const std::vector<StageCamera>& cameras) {
  std::vector<float> vertices;
  for (size_t f = 0; f < poses_.size(); ++f) {
    pose_vertices(shape_, poses_[f], vertices);
    const Eigen::Map<const Eigen::Matrix3Xf> points(vertices.data(), 3,
                                                    static_cast<Eigen::Index>(vertices.size() / 3));
    const Vec3d low = points.rowwise().minCoeff().cast<double>(),
                high = points.rowwise().maxCoeff().cast<double>();
    bool posed = false;
    for (const StageCamera& camera : cameras) {
      const Vec3d eye = camera.camera.center();
      // Nobody is inside a body who is outside its box: most stages end here.
      if ((eye.array() < low.array()).any() || (eye.array() > high.array()).any()) continue;
      try {
        if (!posed) {
          scene_.pose(0, vertices);
          scene_.commit();
          posed = true;
        }
        scene_.check_outside(eye);
      } catch (const Error& error) {
        throw Error(format("Frame {}, camera {}: {}", f, camera.name, error.what()), error.blame());
      }
    }
  }
}

void BodyScene::advance() {
  ++frame_;
  EFFIGY_CHECK(frame_ < static_cast<int>(poses_.size()));
  // The step of this frame: whole frames of the first motion, then those of the second.
  const bool second = frame_ >= options_.frames;
  const size_t begin = second ? static_cast<size_t>((options_.frames - 1) * substeps_ + 1) : 0;
  const size_t step =
      begin + static_cast<size_t>((second ? frame_ - options_.frames : frame_) * substeps_);
  if (!cloth_) {
    pose_vertices(shape_, steps_[step], truth_);
  } else if (starts_[step]) {
    cloth_->settle(steps_[step]);
  } else {
    for (size_t s = step - static_cast<size_t>(substeps_) + 1; s <= step; ++s)
      cloth_->advance(steps_[s], 1 / (options_.frames_per_second * substeps_));
  }
  pose_vertices(shape_, tracked_[static_cast<size_t>(frame_)], tracked_vertices_);
}

void BodyScene::show(const std::vector<float>& vertices) {
  try {
    scene_.pose(0, vertices);
    scene_.commit();
  } catch (const Error& error) {
    throw Error("Frame " + std::to_string(frame_) + ": " + error.what(), error.blame());
  }
}

std::vector<std::string> BodyScene::body_keypoint_names() const {
  return builtin_ != nullptr ? effigy::body_keypoint_names(*builtin_) : rig_.joint_names;
}

std::vector<std::string> BodyScene::face_keypoint_names() const {
  std::vector<std::string> names;
  if (builtin_ == nullptr) return names;
  for (int i = 0; i < 68; ++i) names.push_back("landmark_" + std::to_string(i));
  names.push_back("eye_left");
  names.push_back("eye_right");
  return names;
}

BodyKeypoints BodyScene::keypoints() const {
  const RigPose& pose = tracked_.at(static_cast<size_t>(frame_));
  if (builtin_ != nullptr) return body_keypoints(*builtin_, pose);
  const std::vector<float> transforms = joint_transforms(shape_, pose);
  BodyKeypoints out;
  for (size_t j = 0; j < rig_.parents.size(); ++j)
    for (size_t r = 0; r < 3; ++r) {
      const float* m = &transforms[12 * j + 4 * r];
      const float* rest = &shape_.joints[3 * j];
      out.body.push_back(m[0] * rest[0] + m[1] * rest[1] + m[2] * rest[2] + m[3]);
    }
  return out;
}

std::array<std::array<float, 12>, 2> BodyScene::root_frames() const {
  const std::vector<float> transforms =
      joint_transforms(shape_, tracked_.at(static_cast<size_t>(frame_)));
  BodyFrames joints;
  if (builtin_ != nullptr) {
    joints = body_frames(*builtin_);
  } else {
    const std::map<std::string, int> known = humanoid_joints(rig_.joint_names, rig_.parents);
    const auto joint = [&](const char* name) {
      return known.count(name) != 0 ? known.at(name) : 0;
    };
    joints = {joint("hips"), joint("head")};
  }
  std::array<std::array<float, 12>, 2> out{};
  std::copy_n(&transforms[12 * static_cast<size_t>(joints.body)], 12, out[0].begin());
  std::copy_n(&transforms[12 * static_cast<size_t>(joints.face)], 12, out[1].begin());
  return out;
}

std::vector<std::string> BodyScene::label_names() const {
  if (builtin_ == nullptr) return rig_.mesh.parts;
  return {"skin", "hair", "eyes", "teeth", "mouth", "hands", "cloth", "shoes"};
}

uint8_t BodyScene::label(const Vec2f& uv, int part) const {
  if (builtin_ == nullptr) return static_cast<uint8_t>(std::min(part + 1, 255));
  const auto texel = [&](float x) {
    return std::clamp(static_cast<int>(x * static_cast<float>(label_size_)), 0, label_size_ - 1);
  };
  const size_t i = static_cast<size_t>(texel(1 - uv.y())) * static_cast<size_t>(label_size_) +
                   static_cast<size_t>(texel(uv.x()));
  if (labels_[i] != 0) return labels_[i];
  return static_cast<uint8_t>(body_part_label(rig_.mesh.parts[static_cast<size_t>(part)]));
}

}  // namespace effigy
