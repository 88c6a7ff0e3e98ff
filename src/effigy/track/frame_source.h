// Video frames decoded ahead on another thread, with square pixels: others are stretched in width.
#pragma once

#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>

#include "effigy/image/video.h"

namespace effigy {

class FrameSource {
 public:
  struct Frame {
    int number = 0;
    double seconds = 0;
    Image8 picture;  // 3 channels
  };

  // Opens the video (throws Error) and decodes at most `most` frames (0: all), keeping no more than
  // `ahead` decoded ones.
  FrameSource(const Path& path, int most, int ahead = 4);
  ~FrameSource();
  FrameSource(const FrameSource&) = delete;
  FrameSource& operator=(const FrameSource&) = delete;

  const VideoInfo& info() const { return reader_.info(); }
  // The next frame; false at the end. Throws what the decoder threw, after the frames before it.
  bool next(Frame& frame);

 private:
  void decode();

  VideoReader reader_;
  int most_, ahead_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Frame> ready_;
  bool ended_ = false, stop_ = false;
  std::exception_ptr problem_;
  std::thread thread_;
};

}  // namespace effigy
