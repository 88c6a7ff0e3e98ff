// effigy bench of bodies: their networks and their playback, in effigy-learn.

#include <cmath>
#include <numbers>

#include "bench/networks.h"
#include "effigy/base/log.h"
#include "effigy/body/renderer.h"
#include "effigy/cli/bench_figures.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/render_settings.h"

namespace effigy {
namespace {

// Fifteen lamps around the body, turned by `angle`.
PointLights bench_lamps(const Vec3f& center, double angle) {
  constexpr int kLamps = 15;
  PointLights lamps;
  lamps.falloff = true;
  lamps.center = center;
  for (int k = 0; k < kLamps; ++k) {
    const double turn = angle + 2 * std::numbers::pi * k / kLamps;
    const Vec3d way(std::sin(turn), 0.2 + 0.05 * k, std::cos(turn));
    lamps.lights.push_back(
        {center + 2.5f * way.normalized().cast<float>(), Vec3f::Constant(0.3f), false});
  }
  return lamps;
}

// A body 512 pixels high under fifteen lamps: its pose, the camera, or the lamps moving.
std::vector<BenchResult> bench_body(const Path& path, int repeats) {
  BodyAvatar avatar = read_body_avatar(path);
  const Camera base = avatar.camera.resized(512 * avatar.camera.width / avatar.camera.height, 512);
  const Track& track = avatar.tracks.begin()->second;
  BodyRenderer renderer(avatar);
  renderer.set_pose(track.poses.front());
  const Vec3d center = head_center(renderer.vertices());
  renderer.set_points(bench_lamps(center.cast<float>(), 0));
  std::vector<BenchResult> figures;
  figures.push_back(frames_per_second("body.playback.posed_fps", repeats, [&](int i) {
    renderer.set_pose(track.poses[static_cast<size_t>(i) % track.poses.size()]);
    renderer.draw(base);
  }));
  figures.push_back(frames_per_second("body.playback.camera_fps", repeats, [&](int i) {
    renderer.draw(orbit_camera(base, center, 0.02 * i, 0));
  }));
  figures.push_back(frames_per_second("body.playback.lights_fps", repeats, [&](int i) {
    renderer.set_points(bench_lamps(center.cast<float>(), 0.02 * i));
    renderer.draw(base);
  }));
  figures.push_back(
      summarise("body.playback.gaussians", {static_cast<double>(avatar.model.texels().count())}));
  return figures;
}

}  // namespace

int run_bench_learn(int argc, char** argv) {
  CLI::App app(
      "Measures the networks of body avatars: milliseconds for one frame, and the time of a bare\n"
      "loop of oneDNN's convolutions over the same layers as a share of it. Medians with their "
      "spread. With --avatar BODY its playback: pose, camera or lamps moving.\n\n"
      "example: effigy bench --only networks --json\n"
      "         effigy bench --avatar body",
      "bench");
  std::string only = "networks", size = "small", avatar;
  int repeats = 9;
  CommonOptions common;
  app.add_option("--only", only, "networks")->check(CLI::IsMember({"networks"}));
  app.add_option("--avatar", avatar, "Measure playback of this body avatar");
  app.add_option("--size", size, "tiny, small or full (default small)")
      ->check(CLI::IsMember({"tiny", "small", "full"}));
  app.add_option("--repeats", repeats, "Timed runs of each figure (default 9)")
      ->check(CLI::Range(1, 1000));
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  if (!avatar.empty()) {
    log_info("measuring playback");
    print_figures(bench_body(avatar, repeats), common.json);
    return 0;
  }
  log_info("measuring the body's networks");
  print_figures(bench_networks(size, repeats), common.json);
  return 0;
}

}  // namespace effigy
