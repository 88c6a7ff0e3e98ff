// effigy render: frames or a video of an avatar.

#include <cmath>
#include <numbers>

#include "effigy/avatar/renderer.h"
#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/family.h"
#include "effigy/cli/program.h"
#include "effigy/cli/render_frames.h"
#include "effigy/cli/render_settings.h"

namespace effigy {
namespace {

constexpr double kRadians = std::numbers::pi / 180;

struct RenderOptions {
  RenderFrames frames;
  std::string avatar, drive = "train", light, exposure = "auto";
  double rotation = 0, turn = 0;
};

void declare(CLI::App& app, RenderOptions& o) {
  app.add_option("AVATAR", o.avatar, "Avatar folder")->required();
  declare_frames(app, o.frames, buffer_names());
  app.add_option("--drive", o.drive,
                 "Poses: a track of the avatar (default train), a track file, or a capture folder");
  app.add_option("--light", o.light,
                 "HDR/EXR environment, or studio, overcast, sunset (default: the training light)");
  app.add_option("--rotate-light", o.rotation, "Turn the light about y, degrees");
  app.add_option("--turn-light", o.turn, "Turn the light by this many degrees over the frames");
  app.add_option("--exposure", o.exposure,
                 "auto (default: as bright as the training light) or a factor");
}

void render_head(const RenderOptions& o) {
  const HeadAvatar avatar = read_head_avatar(o.avatar);
  const Track track = load_drive(o.drive, avatar);
  const int total = static_cast<int>(track.poses.size());
  const std::vector<int> frames = frames_to_render(o.frames, total);
  const int count = o.frames.count > 0 ? std::min(o.frames.count, total - o.frames.first)
                                       : total - o.frames.first;
  const std::array<float, 3> background = background_of(o.frames);
  const Camera base = sized_camera(o.frames, avatar.camera);
  HeadRenderer renderer(avatar);
  if (!o.light.empty() && o.turn == 0)
    renderer.set_light(load_light(o.light, o.rotation * kRadians, o.exposure, avatar.environment));
  renderer.set_pose(track.poses[static_cast<size_t>(o.frames.first)]);
  const Vec3d center = head_center(renderer.vertices());
  FrameSink sink(o.frames, base, track.frames_per_second);
  Progress progress("rendering", "frames", static_cast<int64_t>(frames.size()));
  int64_t done = 0;
  for (const int frame : frames) {
    const int i = frame - o.frames.first;
    renderer.set_pose(track.poses[static_cast<size_t>(frame)]);
    if (!o.light.empty() && o.turn != 0)
      renderer.set_light(load_light(o.light, (o.rotation + o.turn * i / count) * kRadians,
                                    o.exposure, avatar.environment));
    sink.add(frame, renderer.draw(camera_of_frame(o.frames, base, center, i, count), background));
    for (const std::string& buffer : o.frames.buffers)
      sink.add_buffer(frame, buffer, buffer_values(renderer.gbuffer(), buffer),
                      view_buffer(renderer.gbuffer(), buffer));
    progress.update(++done);
  }
  sink.finish();
}

}  // namespace

int run_render(int argc, char** argv) {
  if (names_avatar(argc, argv, "body")) return hand_over(argc, argv);
  CLI::App app(
      "Renders an avatar: its own performance, another's, from new views, in any light. Bodies "
      "have\n"
      "more options: effigy render BODY --help.\n\n"
      "example: effigy render anna -o anna.mp4 --light sunset --camera orbit\n"
      "         effigy render anna -o frames --drive other-capture --buffers albedo,normal",
      "render");
  RenderOptions options;
  CommonOptions common;
  declare(app, options);
  add_common(app, common, false, false);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  render_head(options);
  log_info("wrote " + options.frames.output);
  return 0;
}

}  // namespace effigy
