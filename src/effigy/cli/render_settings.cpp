#include "effigy/cli/render_settings.h"

#include <algorithm>
#include <cmath>

#include "effigy/avatar/renderer.h"
#include "effigy/base/error.h"
#include "effigy/capture/capture.h"
#include "effigy/light/builtin_lights.h"

namespace effigy {

Image light_image(const std::string& name) {
  const auto names = builtin_light_names();
  const bool builtin = std::find(names.begin(), names.end(), name) != names.end();
  return builtin ? builtin_light(name) : read_environment(name);
}

double exposure_factor(const std::string& text) {
  char* end = nullptr;
  const double scale = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || !(scale > 0) || !std::isfinite(scale))
    throw Error("--exposure must be auto or a positive factor, not '" + text + "'.");
  return scale;
}

PrefilteredEnvironment load_light(const std::string& name, double rotation,
                                  const std::string& exposure, const Cubemap& reference) {
  const Image image = light_image(name);
  const double scale = exposure == "auto"
                           ? exposure_to_match(cubemap_from_equirectangular(image, 32), reference)
                           : exposure_factor(exposure);
  return prefilter_environment(image, rotation, scale);
}

Track load_drive(const std::string& what, const HeadAvatar& avatar) {
  const auto own = avatar.tracks.find(what);
  if (own != avatar.tracks.end()) return own->second;
  if (std::filesystem::exists(Path(what) / "capture.json")) {
    const Capture capture = read_capture(what);
    Track track;
    track.frames_per_second = capture.frames_per_second;
    std::vector<int> frames;
    for (const CaptureFrame& frame : capture.frames) {
      frames.push_back(static_cast<int>(frames.size()));
      track.numbers.push_back(frame.number);
    }
    if (avatar.encoder && capture.rig.expression_names == avatar.rig.expression_names &&
        capture.rig.joint_names == avatar.rig.joint_names) {
      track.poses = encoded_poses(*avatar.encoder, capture, frames);
    } else {
      for (const RigPose& pose : capture.poses)
        track.poses.push_back(retarget(pose, capture.rig, avatar.rig));
    }
    return track;
  }
  if (Path(what).extension() == ".safetensors") return read_track(what, avatar.rig);
  throw Error("--drive " + what +
              ": neither a track of this avatar, nor a capture folder, nor a .safetensors track.");
}

Camera orbit_camera(const Camera& base, const Vec3d& center, double angle, double elevation) {
  const Vec3d offset = base.center() - center;
  const double distance = offset.norm();
  const double azimuth = std::atan2(offset.x(), offset.z()) + angle;
  const double height = std::asin(std::clamp(offset.y() / distance, -1.0, 1.0)) + elevation;
  const Vec3d eye =
      center + distance * Vec3d(std::sin(azimuth) * std::cos(height), std::sin(height),
                                std::cos(azimuth) * std::cos(height));
  Camera camera = look_at(eye, center, 1.0, base.width, base.height);
  camera.fx = base.fx;
  camera.fy = base.fy;
  camera.cx = 0.5 * base.width;
  camera.cy = 0.5 * base.height;
  return camera;
}

Vec3d head_center(const std::vector<float>& vertices) {
  Vec3d sum = Vec3d::Zero();
  for (size_t i = 0; i + 2 < vertices.size(); i += 3)
    sum += Vec3d(vertices[i], vertices[i + 1], vertices[i + 2]);
  return sum / std::max<size_t>(1, vertices.size() / 3);
}

}  // namespace effigy
