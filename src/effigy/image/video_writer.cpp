#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/image/ffmpeg.h"
#include "effigy/image/video.h"

namespace effigy {
namespace {

using detail::FramePointer;
using detail::PacketPointer;

Path temporary_for(const Path& path) {
  static std::atomic<unsigned> counter{0};
  return path.parent_path() / ("." + path.stem().string() + "." + std::to_string(getpid()) + "-v" +
                               std::to_string(counter++) + ".part.mp4");
}

// 29.97 and its relatives exactly, other rates as a fraction.
AVRational rate_from(double frames_per_second) {
  const double whole = std::round(frames_per_second * 1.001);
  if (std::fabs(frames_per_second - whole / 1.001) < 0.004 &&
      std::fabs(frames_per_second - std::round(frames_per_second)) > 1e-4)
    return {static_cast<int>(whole) * 1000, 1001};
  return av_d2q(frames_per_second, 100000);
}

// Tags that MP4 has a place for; others become lines of the comment.
bool is_mp4_tag(const std::string& key) {
  static constexpr const char* known[] = {"title",     "artist", "comment", "description",
                                          "copyright", "date",   "genre",   "album"};
  return std::any_of(std::begin(known), std::end(known),
                     [&](const char* name) { return key == name; });
}

}  // namespace

struct VideoWriter::State {
  Path path, temporary;
  int width = 0, height = 0;
  AVFormatContext* format = nullptr;
  AVStream* stream = nullptr;
  detail::CodecPointer codec;
  detail::ScalerPointer scaler;
  FramePointer rgb{av_frame_alloc()}, yuv{av_frame_alloc()};
  PacketPointer packet{av_packet_alloc()};
  int64_t frames = 0;
  bool finished = false;

  ~State() {
    if (format != nullptr) {
      if (format->pb != nullptr) avio_closep(&format->pb);
      avformat_free_context(format);
    }
    std::error_code ignored;
    if (!finished && !temporary.empty()) std::filesystem::remove(temporary, ignored);
  }

  void open_encoder(double frames_per_second);
  void open_file(const ImageMetadata& metadata);
  void open_scaler();
  void fill(const Image8& frame);
  void encode(const AVFrame* frame);
  void require(int code, const char* doing) const {
    if (code >= 0) return;
    throw Error("Cannot write the video " + path.string() + ": " + doing + " failed (" +
                    detail::ffmpeg_message(code) + "); check the space left or use -o elsewhere.",
                Blame::kResource);
  }
};

void VideoWriter::State::open_encoder(double frames_per_second) {
  const AVCodec* encoder = avcodec_find_encoder_by_name("libx264");
  if (encoder == nullptr) encoder = avcodec_find_encoder(AV_CODEC_ID_H264);
  if (encoder == nullptr)
    throw Error("Cannot write the video " + path.string() +
                    ": this FFmpeg has no H.264 encoder; install one with libx264 or write PNGs.",
                Blame::kResource);
  codec.reset(avcodec_alloc_context3(encoder));
  const AVRational rate = rate_from(frames_per_second);
  codec->width = (width + 1) / 2 * 2;
  codec->height = (height + 1) / 2 * 2;
  codec->pix_fmt = AV_PIX_FMT_YUV420P;
  codec->time_base = av_inv_q(rate);
  codec->framerate = rate;
  codec->color_primaries = AVCOL_PRI_BT709;
  codec->color_trc = AVCOL_TRC_BT709;
  codec->colorspace = AVCOL_SPC_BT709;
  codec->color_range = AVCOL_RANGE_MPEG;
  codec->chroma_sample_location = AVCHROMA_LOC_LEFT;
  codec->thread_count = std::min(thread_count(), 16);
  if (format->oformat->flags & AVFMT_GLOBALHEADER) codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  AVDictionary* options = nullptr;
  av_dict_set(&options, "crf", "16", 0);
  av_dict_set(&options, "preset", "fast", 0);
  const int opened = avcodec_open2(codec.get(), encoder, &options);
  av_dict_free(&options);
  require(opened, "opening the H.264 encoder");
}

void VideoWriter::State::open_file(const ImageMetadata& metadata) {
  std::string comment;
  for (const auto& [key, value] : metadata) {
    if (key == "comment") {
      comment = value + (comment.empty() ? "" : "\n") + comment;
    } else if (is_mp4_tag(key)) {
      av_dict_set(&format->metadata, key.c_str(), value.c_str(), 0);
    } else {
      comment += (comment.empty() ? "" : "\n") + key + ": " + value;
    }
  }
  if (!comment.empty()) av_dict_set(&format->metadata, "comment", comment.c_str(), 0);
  stream = avformat_new_stream(format, nullptr);
  if (stream == nullptr) require(AVERROR(ENOMEM), "making a stream");
  stream->time_base = codec->time_base;
  stream->avg_frame_rate = codec->framerate;
  require(avcodec_parameters_from_context(stream->codecpar, codec.get()), "describing the stream");
  const std::string url = "file:" + temporary.string();
  // Moving the index to the front opens the file a second time by this name.
  format->url = av_strdup(url.c_str());
  require(avio_open(&format->pb, url.c_str(), AVIO_FLAG_WRITE), "opening the file");
  AVDictionary* options = nullptr;
  av_dict_set(&options, "movflags", "+faststart", 0);
  const int written = avformat_write_header(format, &options);
  av_dict_free(&options);
  require(written, "writing the header");
}

void VideoWriter::State::open_scaler() {
  for (AVFrame* frame : {rgb.get(), yuv.get()}) {
    frame->width = codec->width;
    frame->height = codec->height;
    frame->format = frame == rgb.get() ? AV_PIX_FMT_RGB24 : AV_PIX_FMT_YUV420P;
    require(av_frame_get_buffer(frame, 64), "taking memory");
  }
  scaler.reset(sws_getContext(codec->width, codec->height, AV_PIX_FMT_RGB24, codec->width,
                              codec->height, AV_PIX_FMT_YUV420P,
                              SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INP, nullptr, nullptr,
                              nullptr));
  EFFIGY_CHECK(scaler != nullptr);
  sws_setColorspaceDetails(scaler.get(), sws_getCoefficients(SWS_CS_DEFAULT), 1,
                           sws_getCoefficients(SWS_CS_ITU709), 0, 0, 1 << 16, 1 << 16);
}

// Copies the picture into `rgb` as three channels, repeating the last column and row up to even
// sizes.
void VideoWriter::State::fill(const Image8& frame) {
  const auto line = static_cast<size_t>(rgb->linesize[0]);
  for (int y = 0; y < rgb->height; ++y) {
    uint8_t* to = rgb->data[0] + line * static_cast<size_t>(y);
    const uint8_t* from = frame.at(0, std::min(y, height - 1));
    if (frame.channels == 3) {
      std::memcpy(to, from, static_cast<size_t>(width) * 3);
    } else {
      for (int x = 0; x < width; ++x, from += frame.channels)
        for (int c = 0; c < 3; ++c) to[3 * x + c] = from[frame.channels == 1 ? 0 : c];
    }
    if (rgb->width > width) std::memcpy(to + 3 * width, to + 3 * (width - 1), 3);
  }
}

void VideoWriter::State::encode(const AVFrame* frame) {
  require(avcodec_send_frame(codec.get(), frame), "encoding");
  for (;;) {
    const int received = avcodec_receive_packet(codec.get(), packet.get());
    if (received == AVERROR(EAGAIN) || received == AVERROR_EOF) return;
    require(received, "encoding");
    if (packet->duration == 0) packet->duration = 1;
    av_packet_rescale_ts(packet.get(), codec->time_base, stream->time_base);
    packet->stream_index = stream->index;
    require(av_interleaved_write_frame(format, packet.get()), "writing");
  }
}

VideoWriter::VideoWriter(const Path& path, int width, int height, double frames_per_second,
                         const ImageMetadata& metadata)
    : state_(std::make_unique<State>()) {
  EFFIGY_CHECK(width > 0 && height > 0);
  EFFIGY_CHECK(frames_per_second > 0.0 && frames_per_second <= 1000.0);
  State& state = *state_;
  detail::silence_ffmpeg();
  make_folder(path.parent_path());
  state.path = path;
  state.temporary = temporary_for(path);
  state.width = width;
  state.height = height;
  state.require(avformat_alloc_output_context2(&state.format, nullptr, "mp4", nullptr),
                "choosing MP4");
  state.open_encoder(frames_per_second);
  state.open_file(metadata);
  state.open_scaler();
}

VideoWriter::~VideoWriter() = default;

void VideoWriter::add(const Image8& frame) {
  State& state = *state_;
  EFFIGY_CHECK_EQ(frame.width, state.width);
  EFFIGY_CHECK_EQ(frame.height, state.height);
  EFFIGY_CHECK(frame.channels == 1 || frame.channels == 3 || frame.channels == 4);
  EFFIGY_CHECK(!state.finished);
  state.fill(frame);
  state.require(av_frame_make_writable(state.yuv.get()), "taking memory");
  sws_scale(state.scaler.get(), state.rgb->data, state.rgb->linesize, 0, state.rgb->height,
            state.yuv->data, state.yuv->linesize);
  state.yuv->pts = state.frames++;
  state.encode(state.yuv.get());
}

void VideoWriter::finish() {
  State& state = *state_;
  EFFIGY_CHECK(!state.finished);
  if (state.frames == 0)
    throw Error("Cannot write the video " + state.path.string() + ": it would have no frames.",
                Blame::kInternal);
  state.encode(nullptr);
  state.require(av_write_trailer(state.format), "writing the index");
  state.require(avio_closep(&state.format->pb), "closing the file");
  std::error_code error;
  std::filesystem::rename(state.temporary, state.path, error);
  if (error)
    throw Error("Cannot write " + state.path.string() + ": " + error.message() +
                    "; choose another place with -o.",
                Blame::kResource);
  state.finished = true;
}

}  // namespace effigy
