// effigy render: frames or a video of an avatar.

#include <cmath>
#include <numbers>

#include "effigy/avatar/renderer.h"
#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/render_settings.h"
#include "effigy/image/files.h"
#include "effigy/image/video.h"

namespace effigy {
namespace {

struct RenderOptions {
  std::string avatar, output, drive = "train", light, exposure = "auto", camera = "capture";
  std::string background = "0,0,0", shard;
  std::vector<std::string> buffers;
  double rotation = 0, turn = 0;
  int first = 0, count = 0, size = 0;
  bool exr = false;
};

const ImageMetadata kSynthetic = {
    {"Comment", "Synthetic image of a person, rendered by Effigy " EFFIGY_VERSION},
    {"Software", "Effigy " EFFIGY_VERSION}};

// Frames go to a folder of PNG/EXR files, or into one MP4.
class FrameSink {
 public:
  FrameSink(const RenderOptions& options, const Camera& camera, double rate)
      : video_(Path(options.output).extension() == ".mp4"),
        exr_(options.exr),
        path_(options.output) {
    if (video_ && !options.buffers.empty())
      throw Error("--buffers needs a folder: give -o DIR instead of an .mp4 file.");
    if (video_)
      writer_ = std::make_unique<VideoWriter>(path_, camera.width, camera.height, rate, kSynthetic);
  }
  void add(int index, const Planes& colour) {
    const Image image = to_image(colour);
    if (video_) {
      writer_->add(to_8bit(image));
    } else if (exr_) {
      write_exr(path_ / "rgb" / name(index, ".exr"), image, true, kSynthetic);
    } else {
      write_png8(path_ / "rgb" / name(index, ".png"), to_8bit(image), kSynthetic);
    }
  }
  void add_buffer(int index, const std::string& buffer, const Planes& gbuffer) {
    if (exr_) {
      Image values = buffer_values(gbuffer, buffer);
      if (values.channels == 2) values = three_channels(values);
      write_exr(path_ / buffer / name(index, ".exr"), values, true, kSynthetic);
    } else {
      write_png8(path_ / buffer / name(index, ".png"), view_buffer(gbuffer, buffer), kSynthetic);
    }
  }
  void finish() {
    if (video_) writer_->finish();
  }

 private:
  static std::string name(int index, const char* extension) {
    return format("{:06}{}", index, extension);
  }
  static Image three_channels(const Image& two) {
    Image out(two.width, two.height, 3);
    for (size_t i = 0; i < static_cast<size_t>(two.width) * two.height; ++i) {
      out.data[3 * i] = two.data[2 * i];
      out.data[3 * i + 1] = two.data[2 * i + 1];
    }
    return out;
  }
  bool video_, exr_;
  Path path_;
  std::unique_ptr<VideoWriter> writer_;
};

void declare(CLI::App& app, RenderOptions& o) {
  app.add_option("AVATAR", o.avatar, "Avatar folder")->required();
  app.add_option("-o,--output", o.output, "Folder for frames, or a file ending in .mp4")
      ->required();
  app.add_option("--drive", o.drive,
                 "Poses: a track of the avatar (default train), a track file, or a capture folder");
  app.add_option("--camera", o.camera,
                 "capture (default), orbit (once around over all frames), or azimuth,elevation in "
                 "degrees");
  app.add_option("--light", o.light,
                 "HDR/EXR environment, or studio, overcast, sunset (default: the training light)");
  app.add_option("--rotate-light", o.rotation, "Turn the light about y, degrees");
  app.add_option("--turn-light", o.turn, "Turn the light by this many degrees over the frames");
  app.add_option("--exposure", o.exposure,
                 "auto (default: as bright as the training light) or a factor");
  app.add_option("--buffers", o.buffers, "G-buffers to write as well")
      ->delimiter(',')
      ->check(CLI::IsMember(buffer_names()));
  app.add_option("--background", o.background, "r,g,b display-encoded (default 0,0,0)");
  app.add_option("--first", o.first, "First frame of the track")->check(CLI::NonNegativeNumber);
  app.add_option("--count", o.count, "Number of frames (default: to the end)")
      ->check(CLI::PositiveNumber);
  app.add_option("--size", o.size, "Height in pixels (default: the capture's)")
      ->check(CLI::Range(16, 8192));
  app.add_option("--shard", o.shard,
                 "i/n: render only every n-th frame, starting with the i-th (0-based)");
  app.add_flag("--exr", o.exr, "Write EXR instead of PNG");
}

struct Shard {
  int index = 0, count = 1;
};
Shard parse_shard(const std::string& text) {
  Shard shard;
  if (text.empty()) return shard;
  char rest = 0;
  if (std::sscanf(text.c_str(), "%d/%d%c", &shard.index, &shard.count, &rest) != 2 ||
      shard.count < 1 || shard.index < 0 || shard.index >= shard.count)
    throw Error("--shard must be i/n with 0 <= i < n, not '" + text + "'.");
  return shard;
}

Camera camera_of_frame(const RenderOptions& o, const Camera& base, const Vec3d& center, int i,
                       int count) {
  if (o.camera == "capture") return base;
  if (o.camera == "orbit")
    return orbit_camera(base, center, 2 * std::numbers::pi * i / std::max(1, count), 0);
  const auto angles = parse_numbers(o.camera, 2, "--camera");
  constexpr double kRadians = std::numbers::pi / 180;
  return orbit_camera(base, center, angles[0] * kRadians, angles[1] * kRadians);
}

void render_frames(const RenderOptions& o) {
  const HeadAvatar avatar = read_head_avatar(o.avatar);
  const Track track = load_drive(o.drive, avatar);
  const int total = static_cast<int>(track.poses.size());
  if (o.first >= total) throw Error(format("--first {}: the track has {} frames.", o.first, total));
  const int count = o.count > 0 ? std::min(o.count, total - o.first) : total - o.first;
  const Shard shard = parse_shard(o.shard);
  if (shard.count > 1 && Path(o.output).extension() == ".mp4")
    throw Error("--shard needs a folder of frames: give -o DIR instead of an .mp4 file.");
  const auto back = parse_numbers(o.background, 3, "--background");
  const std::array<float, 3> background = {static_cast<float>(back[0]), static_cast<float>(back[1]),
                                           static_cast<float>(back[2])};
  Camera base = avatar.camera;
  if (o.size > 0)
    base = base.resized(static_cast<int>(std::lround(1.0 * o.size * base.width / base.height)),
                        o.size);
  HeadRenderer renderer(avatar);
  constexpr double kRadians = std::numbers::pi / 180;
  if (!o.light.empty() && o.turn == 0)
    renderer.set_light(load_light(o.light, o.rotation * kRadians, o.exposure, avatar.environment));
  renderer.set_pose(track.poses[o.first]);
  const Vec3d center = head_center(renderer.vertices());
  FrameSink sink(o, base, track.frames_per_second);
  Progress progress("rendering", "frames", (count + shard.count - 1 - shard.index) / shard.count);
  int done = 0;
  for (int i = shard.index; i < count; i += shard.count) {
    renderer.set_pose(track.poses[o.first + i]);
    if (!o.light.empty() && o.turn != 0)
      renderer.set_light(load_light(o.light, (o.rotation + o.turn * i / count) * kRadians,
                                    o.exposure, avatar.environment));
    const Planes& colour = renderer.draw(camera_of_frame(o, base, center, i, count), background);
    sink.add(o.first + i, colour);
    for (const std::string& buffer : o.buffers)
      sink.add_buffer(o.first + i, buffer, renderer.gbuffer());
    progress.update(++done);
  }
  sink.finish();
}

}  // namespace

int run_render(int argc, char** argv) {
  CLI::App app(
      "Renders an avatar: its own performance, another's, from new views, in any light.\n\n"
      "example: effigy render anna -o anna.mp4 --light sunset --camera orbit\n"
      "         effigy render anna -o frames --drive other-capture --buffers albedo,normal",
      "render");
  RenderOptions options;
  CommonOptions common;
  declare(app, options);
  add_common(app, common, false, false);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  render_frames(options);
  log_info("wrote " + options.output);
  return 0;
}

}  // namespace effigy
