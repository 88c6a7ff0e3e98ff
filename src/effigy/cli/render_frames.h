// What rendering a head and a body share: which frames, from where, and where they go.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/image/image.h"
#include "effigy/image/video.h"

namespace effigy {

struct RenderFrames {
  std::string output, camera = "capture", background = "0,0,0", shard;
  std::vector<std::string> buffers;
  int first = 0, count = 0, size = 0;
  bool exr = false;
};

// The options of RenderFrames but for --buffers' names.
void declare_frames(CLI::App& app, RenderFrames& options,
                    const std::vector<std::string>& buffer_names);

// Frames of the track to render, in order: from --first, at most --count, those of the shard.
// Throws Error for a track that is too short, a bad shard, or shards of one video.
std::vector<int> frames_to_render(const RenderFrames& options, int total);

// r, g, b of --background.
std::array<float, 3> background_of(const RenderFrames& options);

// The camera resized to --size.
Camera sized_camera(const RenderFrames& options, Camera base);
// Of frame `i` of `count`: --camera about `center`.
Camera camera_of_frame(const RenderFrames& options, const Camera& base, const Vec3d& center, int i,
                       int count);

// Frames go to a folder of PNG/EXR files, or into one MP4, marked as synthetic.
class FrameSink {
 public:
  FrameSink(const RenderFrames& options, const Camera& camera, double rate);
  void add(int index, const Planes& colour);
  // `values` for EXR (any number of channels up to 4), `view` for PNG.
  void add_buffer(int index, const std::string& buffer, const Image& values, const Image8& view);
  void finish();

 private:
  bool video_, exr_;
  std::string path_;
  std::unique_ptr<VideoWriter> writer_;
};

}  // namespace effigy
