// Video files through FFmpeg's libraries: the only place that knows them.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "effigy/base/file.h"
#include "effigy/image/files.h"
#include "effigy/image/image.h"

namespace effigy {

struct VideoInfo {
  int width = 0, height = 0;   // after the rotation flag
  double frames_per_second = 0;  // average
  int64_t frames = 0;          // estimate from the header; 0 when unknown
  std::string codec, pixel_format;
};

// Decodes the first video stream frame by frame to 8-bit sRGB, honouring edit lists (frames that a
// player would not show are dropped), rotation flags, variable frame rate (each decoded frame once)
// and the stream's matrix and range (BT.601/709, limited/full; unspecified: 709 from 720 lines on).
class VideoReader {
 public:
  // Throws Error with one sentence when the file is missing, not a video, truncated before its
  // first frame, or has no video stream.
  explicit VideoReader(const Path& path);
  ~VideoReader();
  const VideoInfo& info() const;
  // Fills `frame` (3 channels) and its time; false at the end. Throws Error on damaged data that
  // stops decoding.
  bool next(Image8& frame, double* seconds = nullptr);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// H.264 (yuv420p, BT.709, CRF 16) in MP4; written beside and renamed by finish().
class VideoWriter {
 public:
  VideoWriter(const Path& path, int width, int height, double frames_per_second,
              const ImageMetadata& metadata = {});
  ~VideoWriter();  // without finish() nothing stays under the final name
  void add(const Image8& frame);
  void finish();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace effigy
