// Owners of FFmpeg's objects, shared by the video reader and writer.
#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/display.h>
#include <libavutil/imgutils.h>
#include <libavutil/opt.h>
#include <libavutil/pixdesc.h>
#include <libswscale/swscale.h>
}

#include <memory>
#include <string>

namespace effigy::detail {

struct FreeFfmpeg {
  void operator()(AVCodecContext* context) const { avcodec_free_context(&context); }
  void operator()(AVFrame* frame) const { av_frame_free(&frame); }
  void operator()(AVPacket* packet) const { av_packet_free(&packet); }
  void operator()(SwsContext* context) const { sws_freeContext(context); }
};
using CodecPointer = std::unique_ptr<AVCodecContext, FreeFfmpeg>;
using FramePointer = std::unique_ptr<AVFrame, FreeFfmpeg>;
using PacketPointer = std::unique_ptr<AVPacket, FreeFfmpeg>;
using ScalerPointer = std::unique_ptr<SwsContext, FreeFfmpeg>;

inline std::string ffmpeg_message(int code) {
  char text[AV_ERROR_MAX_STRING_SIZE] = "";
  av_strerror(code, text, sizeof(text));
  return text;
}

// FFmpeg prints to standard error by itself; Effigy reports errors as Error.
inline void silence_ffmpeg() {
  av_log_set_level(AV_LOG_QUIET);
}

}  // namespace effigy::detail
