// Videos of any pixel format, timing and tags, through FFmpeg directly: what VideoWriter does not
// write but VideoReader must read.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <functional>
#include <vector>

#include "effigy/image/ffmpeg.h"

namespace effigy::test {

struct VideoRecipe {
  int width = 64, height = 48;
  AVPixelFormat pixels = AV_PIX_FMT_YUV444P;
  AVColorSpace space = AVCOL_SPC_UNSPECIFIED;
  AVColorRange range = AVCOL_RANGE_UNSPECIFIED;
  std::vector<int64_t> times = {0, 1, 2, 3, 4};  // in frames
  std::vector<int32_t> display_matrix;           // 9 entries or none
  AVRational aspect = {0, 1};
  const char* container = "mp4";
  const char* codec = "libx264";
  int group = 12;
  // RGB in 0..255 at (x, y) of frame t.
  std::function<std::array<double, 3>(int, int, int)> colour = [](int x, int y, int t) {
    return std::array<double, 3>{x < 32 ? 220.0 : 30.0, y < 24 ? 200.0 : 60.0, 20.0 + 10.0 * t};
  };
};

// Writes one pixel of a planar YUV picture; chroma planes keep the last pixel of each block.
inline void put_yuv(AVFrame* frame, const VideoRecipe& recipe, int x, int y,
                    const std::array<double, 3>& rgb) {
  const bool bt709 = recipe.space == AVCOL_SPC_BT709 ||
                     (recipe.space == AVCOL_SPC_UNSPECIFIED && recipe.height >= 720);
  const double kr = bt709 ? 0.2126 : 0.299, kb = bt709 ? 0.0722 : 0.114;
  const double luma = kr * rgb[0] + (1 - kr - kb) * rgb[1] + kb * rgb[2];
  const double u = (rgb[2] - luma) / (2 * (1 - kb)), v = (rgb[0] - luma) / (2 * (1 - kr));
  const bool full = recipe.range == AVCOL_RANGE_JPEG || recipe.pixels == AV_PIX_FMT_YUVJ444P;
  const double scale[3] = {full ? 1.0 : 219.0 / 255, full ? 1.0 : 224.0 / 255, 0};
  const auto byte = [](double value) {
    return static_cast<uint8_t>(std::lround(std::clamp(value, 0.0, 255.0)));
  };
  int shift_x = 0, shift_y = 0;
  av_pix_fmt_get_chroma_sub_sample(recipe.pixels, &shift_x, &shift_y);
  frame->data[0][y * frame->linesize[0] + x] = byte((full ? 0 : 16) + scale[0] * luma);
  const int cx = x >> shift_x, cy = y >> shift_y;
  frame->data[1][cy * frame->linesize[1] + cx] = byte(128 + scale[1] * u);
  frame->data[2][cy * frame->linesize[2] + cx] = byte(128 + scale[1] * v);
}

inline void make_video(const std::filesystem::path& path, const VideoRecipe& recipe) {
  av_log_set_level(AV_LOG_QUIET);
  AVFormatContext* format = nullptr;
  ASSERT_GE(avformat_alloc_output_context2(&format, nullptr, recipe.container, nullptr), 0);
  const AVCodec* encoder = avcodec_find_encoder_by_name(recipe.codec);
  ASSERT_NE(encoder, nullptr);
  detail::CodecPointer codec(avcodec_alloc_context3(encoder));
  codec->width = recipe.width;
  codec->height = recipe.height;
  codec->pix_fmt = recipe.pixels;
  codec->colorspace = recipe.space;
  codec->color_range = recipe.range;
  codec->time_base = {1, 25};
  codec->gop_size = recipe.group;
  codec->thread_count = 1;
  codec->sample_aspect_ratio = recipe.aspect;
  if (format->oformat->flags & AVFMT_GLOBALHEADER) codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  av_opt_set(codec->priv_data, "crf", "2", 0);
  ASSERT_GE(avcodec_open2(codec.get(), encoder, nullptr), 0);
  AVStream* stream = avformat_new_stream(format, nullptr);
  avcodec_parameters_from_context(stream->codecpar, codec.get());
  stream->time_base = codec->time_base;
  stream->sample_aspect_ratio = recipe.aspect;
  if (!recipe.display_matrix.empty()) {
    uint8_t* matrix = av_stream_new_side_data(stream, AV_PKT_DATA_DISPLAYMATRIX, 36);
    std::memcpy(matrix, recipe.display_matrix.data(), 36);
  }
  ASSERT_GE(avio_open(&format->pb, path.c_str(), AVIO_FLAG_WRITE), 0);
  ASSERT_GE(avformat_write_header(format, nullptr), 0);
  detail::PacketPointer packet(av_packet_alloc());
  const auto drain = [&] {
    while (avcodec_receive_packet(codec.get(), packet.get()) >= 0) {
      if (packet->duration == 0) packet->duration = 1;
      av_packet_rescale_ts(packet.get(), codec->time_base, stream->time_base);
      packet->stream_index = 0;
      ASSERT_GE(av_interleaved_write_frame(format, packet.get()), 0);
    }
  };
  for (size_t t = 0; t < recipe.times.size(); ++t) {
    detail::FramePointer frame(av_frame_alloc());
    frame->width = recipe.width;
    frame->height = recipe.height;
    frame->format = recipe.pixels;
    ASSERT_GE(av_frame_get_buffer(frame.get(), 0), 0);
    for (int y = 0; y < recipe.height; ++y)
      for (int x = 0; x < recipe.width; ++x)
        put_yuv(frame.get(), recipe, x, y, recipe.colour(x, y, static_cast<int>(t)));
    frame->pts = recipe.times[t];
    ASSERT_GE(avcodec_send_frame(codec.get(), frame.get()), 0);
    drain();
  }
  avcodec_send_frame(codec.get(), nullptr);
  drain();
  ASSERT_GE(av_write_trailer(format), 0);
  avio_closep(&format->pb);
  avformat_free_context(format);
}

// Sound without pictures: one second of silence in a Matroska file.
inline void make_sound(const std::filesystem::path& path) {
  av_log_set_level(AV_LOG_QUIET);
  AVFormatContext* format = nullptr;
  ASSERT_GE(avformat_alloc_output_context2(&format, nullptr, "matroska", nullptr), 0);
  AVStream* stream = avformat_new_stream(format, nullptr);
  stream->codecpar->codec_type = AVMEDIA_TYPE_AUDIO;
  stream->codecpar->codec_id = AV_CODEC_ID_PCM_S16LE;
  stream->codecpar->sample_rate = 8000;
  stream->codecpar->bits_per_coded_sample = 16;
  stream->codecpar->ch_layout = AV_CHANNEL_LAYOUT_MONO;
  ASSERT_GE(avio_open(&format->pb, path.c_str(), AVIO_FLAG_WRITE), 0);
  ASSERT_GE(avformat_write_header(format, nullptr), 0);
  detail::PacketPointer packet(av_packet_alloc());
  av_new_packet(packet.get(), 16000);
  std::memset(packet->data, 0, 16000);
  packet->pts = packet->dts = 0;
  packet->duration = 1000;
  ASSERT_GE(av_interleaved_write_frame(format, packet.get()), 0);
  ASSERT_GE(av_write_trailer(format), 0);
  avio_closep(&format->pb);
  avformat_free_context(format);
}

}  // namespace effigy::test
