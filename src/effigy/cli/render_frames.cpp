#include "effigy/cli/render_frames.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/render_settings.h"
#include "effigy/cli/shard.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

const ImageMetadata kSynthetic = {
    {"Comment", "Synthetic image of a person, rendered by Effigy " EFFIGY_VERSION},
    {"Software", "Effigy " EFFIGY_VERSION}};

std::string file_name(int index, const char* extension) {
  return format("{:06}{}", index, extension);
}

Image three_channels(const Image& two) {
  Image out(two.width, two.height, 3);
  for (size_t i = 0; i < static_cast<size_t>(two.width) * two.height; ++i) {
    out.data[3 * i] = two.data[2 * i];
    out.data[3 * i + 1] = two.data[2 * i + 1];
  }
  return out;
}

}  // namespace

void declare_frames(CLI::App& app, RenderFrames& o, const std::vector<std::string>& buffer_names) {
  app.add_option("-o,--output", o.output, "Folder for frames, or a file ending in .mp4")
      ->required();
  app.add_option("--camera", o.camera,
                 "capture (default), orbit (once around over all frames), or azimuth,elevation in "
                 "degrees");
  app.add_option("--buffers", o.buffers, "G-buffers to write as well")
      ->delimiter(',')
      ->check(CLI::IsMember(buffer_names));
  app.add_option("--background", o.background, "r,g,b display-encoded (default 0,0,0)");
  app.add_option("--first", o.first, "First frame of the track")->check(at_least(0));
  app.add_option("--count", o.count, "Number of frames (default: to the end)")->check(at_least(1));
  app.add_option("--size", o.size, "Height in pixels (default: the capture's)")
      ->check(CLI::Range(16, 8192));
  app.add_option("--shard", o.shard,
                 "i/n: render only every n-th frame, starting with the i-th (0-based)");
  app.add_flag("--exr", o.exr, "Write EXR instead of PNG");
}

std::vector<int> frames_to_render(const RenderFrames& o, int total) {
  if (o.first >= total) throw Error(format("--first {}: the track has {} frames.", o.first, total));
  const int count = o.count > 0 ? std::min(o.count, total - o.first) : total - o.first;
  const Shard shard = parse_shard(o.shard);
  if (!shard.whole() && Path(o.output).extension() == ".mp4")
    throw Error("--shard needs a folder of frames: give -o DIR instead of an .mp4 file.");
  std::vector<int> frames;
  for (int i = shard.index; i < count; i += shard.count) frames.push_back(o.first + i);
  return frames;
}

std::array<float, 3> background_of(const RenderFrames& o) {
  const auto back = parse_numbers(o.background, 3, "--background");
  return {static_cast<float>(back[0]), static_cast<float>(back[1]), static_cast<float>(back[2])};
}

Camera sized_camera(const RenderFrames& o, Camera base) {
  if (o.size <= 0) return base;
  return base.resized(static_cast<int>(std::lround(1.0 * o.size * base.width / base.height)),
                      o.size);
}

Camera camera_of_frame(const RenderFrames& o, const Camera& base, const Vec3d& center, int i,
                       int count) {
  if (o.camera == "capture") return base;
  if (o.camera == "orbit")
    return orbit_camera(base, center, 2 * std::numbers::pi * i / std::max(1, count), 0);
  const auto angles = parse_numbers(o.camera, 2, "--camera");
  constexpr double kRadians = std::numbers::pi / 180;
  return orbit_camera(base, center, angles[0] * kRadians, angles[1] * kRadians);
}

FrameSink::FrameSink(const RenderFrames& options, const Camera& camera, double rate)
    : video_(Path(options.output).extension() == ".mp4"), exr_(options.exr), path_(options.output) {
  if (video_ && !options.buffers.empty())
    throw Error("--buffers needs a folder: give -o DIR instead of an .mp4 file.");
  if (video_)
    writer_ = std::make_unique<VideoWriter>(path_, camera.width, camera.height, rate, kSynthetic);
}

void FrameSink::add(int index, const Planes& colour) {
  const Image image = to_image(colour);
  if (video_) {
    writer_->add(to_8bit(image));
  } else if (exr_) {
    write_exr(Path(path_) / "rgb" / file_name(index, ".exr"), image, true, kSynthetic);
  } else {
    write_png8(Path(path_) / "rgb" / file_name(index, ".png"), to_8bit(image), kSynthetic);
  }
}

void FrameSink::add_buffer(int index, const std::string& buffer, const Image& values,
                           const Image8& view) {
  if (exr_)
    write_exr(Path(path_) / buffer / file_name(index, ".exr"),
              values.channels == 2 ? three_channels(values) : values, true, kSynthetic);
  else
    write_png8(Path(path_) / buffer / file_name(index, ".png"), view, kSynthetic);
}

void FrameSink::finish() {
  if (video_) writer_->finish();
}

}  // namespace effigy
