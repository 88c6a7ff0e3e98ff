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
  int width = 0, height = 0;  // after the rotation flag
  // Width / height of one pixel as players show it. Frames keep the pixels of the file; a camera
  // fitted to them has fx * pixel_aspect = fy.
  double pixel_aspect = 1.0;
  double frames_per_second = 0;  // average
  int64_t frames = 0;            // estimate from the header; 0 when unknown
  std::string codec, pixel_format;
  ImageMetadata metadata;  // the file's tags: comment, title, creation_time, ...
};

// Decodes the first video stream frame by frame to 8-bit sRGB, honouring edit lists (frames that a
// player would not show are dropped), rotation flags, variable frame rate (each decoded frame once)
// and the stream's matrix and range (BT.601/709/2020, limited/full; unspecified: 709 from 720 lines
// on). Frames of a stream that changes size are scaled to the first one's. A file that is cut short
// gives the frames it has and a logged warning.
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

// H.264 (yuv420p, BT.709, CRF 16) in MP4; written beside and renamed by finish(). Odd sizes are
// padded to even ones by repeating the last column and row. `metadata`: MP4's own tags (title,
// comment, artist, copyright, description, date) as they are, others as lines of the comment.
class VideoWriter {
 public:
  VideoWriter(const Path& path, int width, int height, double frames_per_second,
              const ImageMetadata& metadata = {});
  ~VideoWriter();  // without finish() nothing stays under the final name
  // width x height with 1, 3 or 4 channels (a fourth is left out).
  void add(const Image8& frame);
  void finish();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace effigy
