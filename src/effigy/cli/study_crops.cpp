#include "effigy/cli/study_crops.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>

#include "effigy/base/log.h"

namespace effigy {
namespace {

constexpr size_t kMostFrames = 24;   // looked at
constexpr double kLeastPixels = 10;  // side of a crop
constexpr double kBehind = -0.1;     // cosine of the angle beyond which a part is not seen

// Keypoints of one frame by name, world.
class Points {
 public:
  Points(const StageCapture& capture, int frame) : capture_(capture), frame_(frame) {}
  std::optional<Vec3d> find(const std::string& name) const {
    if (const auto body = find_in(capture_.body_keypoint_names, capture_.body_keypoints, name))
      return body;
    return find_in(capture_.face_keypoint_names, capture_.face_keypoints, name);
  }
  Vec3d at(const std::string& name) const { return *find(name); }

 private:
  std::optional<Vec3d> find_in(const std::vector<std::string>& names,
                               const std::vector<float>& values, const std::string& name) const {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) return {};
    const size_t k =
        names.size() * static_cast<size_t>(frame_) + static_cast<size_t>(found - names.begin());
    return Vec3f(&values[3 * k]).cast<double>();
  }
  const StageCapture& capture_;
  int frame_;
};

// A square of the world: where it is, how large, and from where it is seen.
struct Place {
  Vec3d center = Vec3d::Zero();
  double side = 0;                // metres
  Vec3d outward = Vec3d::Zero();  // unit, or zero: seen from everywhere
  double worth = 1;               // of this frame among others
};
using PlaceOf = std::function<Place(const Points& points, int choice)>;

// One kind of crop.
struct Kind {
  const char* name;
  const char* other;
  std::vector<const char*> needs;  // keypoints
  int choices;                     // left and right, or 1
  PlaceOf place;                   // empty: all of the body
  bool normals = false, environment = false;
};

// iBUG's landmarks: 0 and 16 are the ends of the jaw at the ears, 30 the tip of the nose.
Vec3d forward_of(const Points& p) {
  return (p.at("landmark_30") - 0.5 * (p.at("landmark_0") + p.at("landmark_16"))).normalized();
}
Vec3d side_of(const Points& p, int choice) {
  const Vec3d across = (p.at("landmark_16") - p.at("landmark_0")).normalized();
  return choice == 0 ? Vec3d(-across) : across;
}
const char* side_name(int choice) {
  return choice == 0 ? "right" : "left";
}

Place face(const Points& p, int) {
  return {p.at("landmark_30"), 0.26, forward_of(p)};
}
Place ear(const Points& p, int choice) {
  const Vec3d out = side_of(p, choice);
  return {p.at(choice == 0 ? "landmark_0" : "landmark_16") + 0.02 * out, 0.12, out};
}
Place hair(const Points& p, int) {
  const Vec3d up = (p.at("landmark_27") - p.at("landmark_8")).normalized();
  return {p.at("landmark_27") + 0.09 * up - 0.06 * forward_of(p), 0.24, Vec3d::Zero()};
}
Place eyes(const Points& p, int) {
  return {0.5 * (p.at("eye_left") + p.at("eye_right")), 0.13, forward_of(p)};
}
Place arm(const Points& p, int choice) {
  const std::string end = std::string("_") + side_name(choice);
  const Vec3d shoulder = p.at("upper_arm" + end), hand = p.at("hand" + end);
  const double raised = hand.y() - shoulder.y();
  return {0.5 * (shoulder + hand), 1.15 * (hand - shoulder).norm(), Vec3d::Zero(),
          std::exp(4 * raised)};
}
// The torso with a hand near it.
Place torso(const Points& p, int choice) {
  const Vec3d middle = 0.5 * (p.at("spine") + p.at("upper_chest"));
  const Vec3d hand = p.at(std::string("hand_") + side_name(choice));
  const Vec3d across = p.at("upper_arm_left") - p.at("upper_arm_right");
  const Vec3d front = across.cross(p.at("upper_chest") - p.at("spine")).normalized();
  return {middle, 0.6, front, std::exp(-4 * (hand - middle - 0.2 * front).norm())};
}

std::vector<Kind> kinds() {
  const std::vector<const char*> head = {"landmark_0", "landmark_16", "landmark_30"};
  std::vector<const char*> tall = head;
  tall.insert(tall.end(), {"landmark_8", "landmark_27"});
  std::vector<const char*> look = head;
  look.insert(look.end(), {"eye_left", "eye_right"});
  const std::vector<const char*> arms = {"upper_arm_left", "upper_arm_right", "hand_left",
                                         "hand_right"};
  std::vector<const char*> trunk = arms;
  trunk.insert(trunk.end(), {"spine", "upper_chest"});
  const char *pbr = "PBR appearance", *none = "without shadow network";
  return {{"ear", pbr, head, 2, ear},
          {"hair", pbr, tall, 1, hair},
          {"skin", pbr, head, 1, face},
          {"raised arm", "SH, not rotated", arms, 2, arm},
          {"shadow of a limb", none, trunk, 2, torso},
          {"eyes", "without deferred shading", look, 1, eyes},
          {"normals", "mesh normals", {}, 1, {}, true},
          {"normals of the face", "mesh normals", head, 1, face, true},
          {"under lamps", pbr, {}, 1, {}},
          {"face under lamps", pbr, head, 1, face},
          {"under an environment", pbr, {}, 1, {}, false, true},
          {"face under an environment", pbr, head, 1, face, false, true}};
}

// The square's box in a camera's image, and how much it is worth; nothing when it is not all inside
// or seen from behind.
struct Sight {
  PixelBox box;
  double worth = 0;
};
std::optional<Sight> sight(const Camera& camera, const Place& place) {
  const Vec3d seen = camera.to_camera(place.center);
  if (!(seen.z() > 0)) return {};
  const Vec2d middle = camera.project(place.center);
  const double side = place.side * camera.fx / seen.z();
  if (side < kLeastPixels) return {};
  const double facing = place.outward.isZero()
                            ? 1.0
                            : place.outward.dot((camera.center() - place.center).normalized());
  if (facing < kBehind) return {};
  PixelBox box{static_cast<int>(std::floor(middle.x() - side / 2)),
               static_cast<int>(std::floor(middle.y() - side / 2)), 0, 0};
  const int pixels = static_cast<int>(std::ceil(side));
  box.x1 = box.x0 + pixels;
  box.y1 = box.y0 + pixels;
  if (box.x0 < 0 || box.y0 < 0 || box.x1 > camera.width || box.y1 > camera.height) return {};
  return Sight{box, place.worth * (0.1 + std::max(facing, 0.0)) * side};
}

// Mean brightness of the box's body in [0, 1].
double brightness(const StageCapture& capture, const StageViewKey& view, const PixelBox& box) {
  const Image8 image = capture.load_image(view.camera, view.frame);
  const Image8 mask = capture.load_mask(view.camera, view.frame);
  double sum = 0;
  size_t count = 0;
  for (int y = box.y0; y < box.y1; ++y)
    for (int x = box.x0; x < box.x1; ++x) {
      if (*mask.at(x, y) < 128) continue;
      sum += image.at(x, y)[1] / 255.0;
      ++count;
    }
  return count > 0 ? sum / static_cast<double>(count) : 0.0;
}

std::vector<int> frames_for(const StageCapture& capture, bool environment) {
  if (environment) return capture.frames_of(StageSplit::kEnvironment);
  std::vector<int> frames = capture.frames_of(StageSplit::kMotion);
  if (frames.empty()) frames = capture.frames_of(StageSplit::kLights);
  std::vector<int> partly;
  for (const int f : frames)
    if (!capture.frames[static_cast<size_t>(f)].fully_lit) partly.push_back(f);
  return partly.empty() ? frames : partly;
}

std::optional<StudyCrop> best_crop(const StageCapture& capture, const Kind& kind) {
  std::vector<int> cameras = capture.test_cameras();
  if (cameras.empty()) cameras = capture.train_cameras();
  const std::vector<int> frames = frames_for(capture, kind.environment);
  const size_t count = std::min(frames.size(), kMostFrames);
  std::optional<StudyCrop> best;
  double most = 0;
  for (size_t k = 0; k < count; ++k) {
    const int frame = frames[k * frames.size() / count];
    const Points points(capture, frame);
    for (const char* need : kind.needs)
      if (!points.find(need)) return {};
    for (const int camera : capture.cameras_of(frame, cameras)) {
      const Camera& view = capture.cameras[static_cast<size_t>(camera)].camera;
      for (int choice = 0; choice < kind.choices; ++choice) {
        Sight seen{{0, 0, view.width, view.height}, 1};
        if (kind.place) {
          const std::optional<Sight> found = sight(view, kind.place(points, choice));
          if (!found) continue;
          seen = *found;
        }
        try {
          const double light = brightness(capture, {frame, camera}, seen.box);
          const double worth = seen.worth * (0.02 + light);
          if (worth <= most) continue;
          most = worth;
          best = {kind.name,
                  kind.other,
                  {frame, camera},
                  kind.place ? seen.box : PixelBox{},
                  kind.normals};
        } catch (const Error& problem) {
          if (problem.blame() != Blame::kInput) throw;
          log_warning(std::string("left out of the crops: ") + problem.what());
        }
      }
    }
  }
  return best;
}

}  // namespace

std::vector<StudyCrop> study_crops(const StageSource& source) {
  std::vector<StudyCrop> crops;
  for (const Kind& kind : kinds())
    if (const auto crop = best_crop(source.capture(), kind)) crops.push_back(*crop);
  return crops;
}

}  // namespace effigy
