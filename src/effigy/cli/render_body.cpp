// effigy render for bodies (in effigy-learn).

#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/body/keypoint_fit.h"
#include "effigy/body/renderer.h"
#include "effigy/capture/stage_capture.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/render_frames.h"
#include "effigy/cli/render_settings.h"
#include "effigy/people/body_motion.h"

namespace effigy {
namespace {

constexpr double kRadians = std::numbers::pi / 180;
constexpr int kEnvironmentSize = 64;

struct BodyRenderOptions {
  RenderFrames frames;
  std::string avatar, drive = "train", light = "studio", exposure = "auto", ground;
  std::vector<std::string> point_lights;
  double rotation = 0, turn = 0;
  int shadow_samples = 0;
  bool in_place = false;
};

void declare(CLI::App& app, BodyRenderOptions& o) {
  app.add_option("AVATAR", o.avatar, "Avatar folder")->required();
  declare_frames(app, o.frames, body_buffer_names());
  app.add_option(
      "--drive", o.drive,
      "Poses: a track of the avatar (default train), a track or keypoint file (.safetensors), a "
      "capture folder, or a BVH file");
  app.add_flag("--in-place", o.in_place, "The body stays where it is; only its pose moves");
  app.add_option("--light", o.light,
                 "HDR/EXR environment, or studio (default), overcast, sunset, window");
  app.add_option("--point-light", o.point_lights,
                 "x,y,z,r,g,b: a lamp at this place (metres) that gives this irradiance at the "
                 "body's middle; instead of --light, repeatable")
      ->expected(1)
      ->take_all();
  app.add_option("--rotate-light", o.rotation, "Turn the light about y, degrees");
  app.add_option("--turn-light", o.turn, "Turn the light by this many degrees over the frames");
  app.add_option("--exposure", o.exposure,
                 "Of --light: auto (default: as bright as the stage) or a factor");
  app.add_option("--shadow-samples", o.shadow_samples,
                 "Rays a texel for the shadow network (default: as in training)")
      ->check(CLI::Range(1, 65536));
  app.add_option("--ground", o.ground,
                 "A floor that catches the shadow: its height in metres, or 'feet' for below the "
                 "body; wants a --background");
}

Track keypoint_drive(const KeypointTrack& keypoints, const BodyAvatar& avatar) {
  Track track;
  track.frames_per_second = keypoints.frames_per_second;
  for (size_t f = 0; f < keypoints.frames; ++f) track.numbers.push_back(static_cast<int64_t>(f));
  Progress progress("fitting poses to keypoints", "frames", static_cast<int64_t>(keypoints.frames));
  double left = 0;
  track.poses = fit_keypoints(avatar.driver, avatar.rig, keypoints, left,
                              [&](size_t done) { progress.update(static_cast<int64_t>(done)); });
  progress.finish();
  log_info(format("keypoints are met to {:.1f} mm on average", 1e3 * left));
  return track;
}

Track body_drive(const std::string& what, const BodyAvatar& avatar) {
  const auto own = avatar.tracks.find(what);
  if (own != avatar.tracks.end()) return own->second;
  if (std::filesystem::exists(Path(what) / "capture.json")) {
    const StageCapture capture = read_stage_capture(what);
    Track track;
    track.frames_per_second = capture.frames_per_second;
    for (size_t f = 0; f < capture.frames.size(); ++f) {
      track.numbers.push_back(capture.frames[f].number);
      track.poses.push_back(retarget(capture.poses[f], capture.rig, avatar.rig));
    }
    return track;
  }
  const std::string extension = Path(what).extension().string();
  if (extension == ".safetensors") {
    const auto keypoints = read_keypoint_track(what, avatar.driver);
    return keypoints ? keypoint_drive(*keypoints, avatar) : read_track(what, avatar.rig);
  }
  if (extension == ".bvh" || extension == ".BVH") {
    const Bvh bvh = read_bvh(what);
    Track track;
    track.frames_per_second = bvh.frame_seconds > 0 ? 1 / bvh.frame_seconds : 30;
    track.poses = retarget_bvh(avatar.rig, shape_rig(avatar.rig, {}), bvh, what, bvh.frames(),
                               track.frames_per_second)
                      .poses;
    for (size_t f = 0; f < track.poses.size(); ++f)
      track.numbers.push_back(static_cast<int64_t>(f));
    return track;
  }
  throw Error("--drive " + what +
              ": neither a track of this avatar, nor a capture folder, a .bvh file or a "
              ".safetensors file of poses or keypoints.");
}

PointLights point_lights(const std::vector<std::string>& texts, const Vec3f& center, double angle) {
  PointLights points;
  points.falloff = true;
  points.center = center;
  const Mat3f turn =
      Eigen::AngleAxisf(static_cast<float>(angle), Vec3f::UnitY()).toRotationMatrix();
  for (const std::string& text : texts) {
    const std::vector<double> v = parse_numbers(text, 6, "--point-light");
    if (v[3] < 0 || v[4] < 0 || v[5] < 0)
      throw Error("--point-light " + text + ": a light cannot be negative.");
    const Vec3f position = Vec3d(v[0], v[1], v[2]).cast<float>();
    points.lights.push_back(
        {center + turn * (position - center), Vec3d(v[3], v[4], v[5]).cast<float>(), false});
  }
  return points;
}

class BodyRenderRun {
 public:
  explicit BodyRenderRun(const BodyRenderOptions& o)
      : o_(o), avatar_(read_body_avatar(o.avatar)), renderer_(avatar_) {
    if (o.shadow_samples > 0) renderer_.set_shadow_samples(o.shadow_samples);
  }

  void run() {
    Track track = body_drive(o_.drive, avatar_);
    if (o_.in_place)
      for (RigPose& pose : track.poses) pose.translation[0] = pose.translation[2] = 0;
    const int total = static_cast<int>(track.poses.size());
    const std::vector<int> frames = frames_to_render(o_.frames, total);
    const int count = o_.frames.count > 0 ? std::min(o_.frames.count, total - o_.frames.first)
                                          : total - o_.frames.first;
    const std::array<float, 3> background = background_of(o_.frames);
    const Camera base = sized_camera(o_.frames, avatar_.camera);
    renderer_.set_pose(track.poses[static_cast<size_t>(o_.frames.first)]);
    center_ = head_center(renderer_.vertices());
    place_ground();
    if (o_.turn == 0) light(o_.rotation);
    FrameSink sink(o_.frames, base, track.frames_per_second);
    Progress progress("rendering", "frames", static_cast<int64_t>(frames.size()));
    int64_t done = 0;
    const RigPose* last = nullptr;
    for (const int frame : frames) {
      const int i = frame - o_.frames.first;
      const RigPose& pose = track.poses[static_cast<size_t>(frame)];
      if (last == nullptr || !same(*last, pose)) renderer_.set_pose(pose);
      last = &pose;
      if (o_.turn != 0) light(o_.rotation + o_.turn * i / count);
      const Camera camera = camera_of_frame(o_.frames, base, center_, i, count);
      sink.add(frame, renderer_.draw(camera, background));
      for (const std::string& name : o_.frames.buffers) {
        const BodyBuffer buffer = renderer_.buffer(name, camera);
        sink.add_buffer(frame, name, buffer.values, buffer.picture);
      }
      progress.update(++done);
    }
    sink.finish();
  }

 private:
  static bool same(const RigPose& a, const RigPose& b) {
    return a.expression == b.expression && a.joint_rotation == b.joint_rotation &&
           a.translation == b.translation;
  }

  void place_ground() {
    if (o_.ground.empty()) return;
    float height = std::numeric_limits<float>::max();
    if (o_.ground == "feet") {
      for (size_t v = 1; v < renderer_.vertices().size(); v += 3)
        height = std::min(height, renderer_.vertices()[v]);
    } else {
      height = static_cast<float>(parse_numbers(o_.ground, 1, "--ground")[0]);
    }
    renderer_.set_ground(height);
  }

  void light(double degrees) {
    if (!o_.point_lights.empty())
      return renderer_.set_points(
          point_lights(o_.point_lights, center_.cast<float>(), degrees * kRadians));
    const Image image = light_image(o_.light);
    Cubemap radiance = cubemap_from_equirectangular(image, kEnvironmentSize, degrees * kRadians);
    const double level = avatar_.info.value("light_level", 1.0);
    const double scale = o_.exposure == "auto" ? level / std::max(mean_radiance(radiance), 1e-9)
                                               : exposure_factor(o_.exposure);
    for (float& texel : radiance.texels) texel *= static_cast<float>(scale);
    renderer_.set_environment(radiance);
  }

  const BodyRenderOptions& o_;
  BodyAvatar avatar_;
  BodyRenderer renderer_;
  Vec3d center_ = Vec3d::Zero();
};

}  // namespace

int run_render_body(int argc, char** argv) {
  CLI::App app(
      "Renders a body avatar: posed by a track, from any view, lit by an environment or by lamps,\n"
      "with its own shadows.\n\n"
      "example: effigy render body -o body.mp4 --light sunset --camera orbit\n"
      "         effigy render body -o turn.mp4 --point-light 1,2,2,1,1,1 --turn-light 360\n"
      "         effigy render body -o frames --background 0.5,0.5,0.5 --ground feet",
      "render");
  BodyRenderOptions options;
  CommonOptions common;
  declare(app, options);
  add_common(app, common, false, false);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  BodyRenderRun(options).run();
  log_info("wrote " + options.frames.output);
  return 0;
}

}  // namespace effigy
