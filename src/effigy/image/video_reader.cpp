#include <algorithm>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/threads.h"
#include "effigy/image/codecs.h"
#include "effigy/image/ffmpeg.h"
#include "effigy/image/video.h"
#include "effigy/image/yuv.h"

namespace effigy {
namespace {

using detail::FramePointer;
using detail::PacketPointer;

// Containers of video. Everything else FFmpeg would guess (text as a terminal recording, playlists
// that open other files, single pictures) is refused.
constexpr const char* kContainers =
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,flv,ogg,asf,mxf,gif,yuv4mpegpipe,h264,"
    "hevc,m4v,mjpeg,dv,ivf,nut,wtv,rm";
// Packets in a row that decode to nothing before a stream is given up.
constexpr int kMaxBadPackets = 300;

[[noreturn]] void fail_video(const Path& path, const std::string& why, const std::string& remedy) {
  throw Error("Cannot read the video " + path.string() + ": " + why + "; " + remedy + ".");
}

// One of the 8 ways to lay a picture on its pixel grid: shown(x, y) = stored(a x + b y + ox, ...).
struct Orientation {
  int xx = 1, xy = 0, yx = 0, yy = 1;  // stored = (xx x + xy y, yx x + yy y) + offset
  bool turned() const { return xx == 0; }
};

// From the display matrix (16.16), which maps stored to shown: shown = (a p + c q, b p + d q).
// Angles between are taken to the nearest right angle.
Orientation orientation_from(const int32_t* matrix) {
  const double a = matrix[0], b = matrix[1], c = matrix[3], d = matrix[4];
  const auto sign = [](double v) { return v < 0.0 ? -1 : 1; };
  Orientation result;
  if (std::fabs(a) + std::fabs(d) >= std::fabs(b) + std::fabs(c)) {
    result.xx = sign(a);
    result.yy = sign(d);
  } else {  // p = y / b.., q = x / c: the inverse of a turned matrix is turned
    result = {0, sign(b), sign(c), 0};
  }
  return result;
}

// The stream's matrix, as swscale's number and as weights of luma.
struct Matrix {
  int swscale;
  detail::LumaWeights weights;
};

Matrix matrix_for(AVColorSpace space, int height) {
  constexpr Matrix bt601{SWS_CS_ITU601, {0.299, 0.114}}, bt709{SWS_CS_ITU709, {0.2126, 0.0722}};
  switch (space) {
    case AVCOL_SPC_BT709:
      return bt709;
    case AVCOL_SPC_BT470BG:
    case AVCOL_SPC_SMPTE170M:
      return bt601;
    case AVCOL_SPC_FCC:
      return {SWS_CS_FCC, {0.30, 0.11}};
    case AVCOL_SPC_SMPTE240M:
      return {SWS_CS_SMPTE240M, {0.212, 0.087}};
    case AVCOL_SPC_BT2020_NCL:
    case AVCOL_SPC_BT2020_CL:
      return {SWS_CS_BT2020, {0.2627, 0.0593}};
    default:
      return height >= 720 ? bt709 : bt601;
  }
}

// The yuvj formats are the plain ones with full range.
AVPixelFormat plain_format(AVPixelFormat format, bool& full) {
  full = true;
  switch (format) {
    case AV_PIX_FMT_YUVJ420P:
      return AV_PIX_FMT_YUV420P;
    case AV_PIX_FMT_YUVJ422P:
      return AV_PIX_FMT_YUV422P;
    case AV_PIX_FMT_YUVJ444P:
      return AV_PIX_FMT_YUV444P;
    case AV_PIX_FMT_YUVJ440P:
      return AV_PIX_FMT_YUV440P;
    case AV_PIX_FMT_YUVJ411P:
      return AV_PIX_FMT_YUV411P;
    default:
      full = false;
      return format;
  }
}

bool is_full_range(const AVFrame& frame) {
  bool full = false;
  plain_format(static_cast<AVPixelFormat>(frame.format), full);
  return full || frame.color_range == AVCOL_RANGE_JPEG;
}

// The frame as rgb_from_yuv takes it; false for other layouts (RGB, grey, interleaved chroma, ...).
bool as_planar_yuv(const AVFrame& frame, detail::YuvPicture& picture) {
  const AVPixFmtDescriptor* format = av_pix_fmt_desc_get(static_cast<AVPixelFormat>(frame.format));
  constexpr uint64_t others = AV_PIX_FMT_FLAG_RGB | AV_PIX_FMT_FLAG_PAL |
                              AV_PIX_FMT_FLAG_BITSTREAM | AV_PIX_FMT_FLAG_HWACCEL |
                              AV_PIX_FMT_FLAG_FLOAT | AV_PIX_FMT_FLAG_ALPHA;
  if (format == nullptr || format->nb_components != 3 || (format->flags & others) != 0 ||
      (format->flags & AV_PIX_FMT_FLAG_PLANAR) == 0 || format->log2_chroma_w > 1 ||
      format->log2_chroma_h > 1 || frame.colorspace == AVCOL_SPC_RGB ||
      frame.colorspace == AVCOL_SPC_YCGCO)
    return false;
  picture.bits = format->comp[0].depth;
  const bool big_endian = (format->flags & AV_PIX_FMT_FLAG_BE) != 0;
  if (picture.bits < 8 || (picture.bits > 8 && big_endian != (AV_HAVE_BIGENDIAN != 0)))
    return false;
  for (int i = 0; i < 3; ++i) {
    const AVComponentDescriptor& component = format->comp[i];
    if (component.plane != i || component.shift != 0 || component.depth != picture.bits ||
        component.step != (picture.bits > 8 ? 2 : 1))
      return false;
    picture.planes[i] = frame.data[i];
    picture.strides[i] = frame.linesize[i];
  }
  picture.width = frame.width;
  picture.height = frame.height;
  picture.shift_x = format->log2_chroma_w;
  picture.shift_y = format->log2_chroma_h;
  const AVChromaLocation place = frame.chroma_location;
  picture.left =
      place != AVCHROMA_LOC_CENTER && place != AVCHROMA_LOC_TOP && place != AVCHROMA_LOC_BOTTOM;
  picture.top = place == AVCHROMA_LOC_TOPLEFT || place == AVCHROMA_LOC_TOP;
  picture.full_range = is_full_range(frame);
  picture.weights = matrix_for(frame.colorspace, frame.height).weights;
  return true;
}

std::string missing_or_empty(const Path& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return "there is no such file";
  if (std::filesystem::is_directory(path, error)) return "it is a folder";
  if (std::filesystem::file_size(path, error) == 0 && !error) return "it is empty (0 bytes)";
  return {};
}

bool looks_like_mp4(const Path& path) {
  const auto stream = std::unique_ptr<FILE, int (*)(FILE*)>(std::fopen(path.c_str(), "rb"), fclose);
  char start[8] = "";
  return stream && std::fread(start, 1, 8, stream.get()) == 8 && !std::memcmp(start + 4, "ftyp", 4);
}

}  // namespace

struct VideoReader::State {
  Path path;
  VideoInfo info;
  AVFormatContext* format = nullptr;
  AVStream* stream = nullptr;
  detail::CodecPointer codec;
  detail::ScalerPointer scaler;
  FramePointer decoded{av_frame_alloc()}, rgb{av_frame_alloc()};
  PacketPointer packet{av_packet_alloc()};
  Orientation orientation;
  int stored_width = 0, stored_height = 0;  // before rotation
  bool pending = false;                     // `decoded` holds the next frame
  bool draining = false, finished = false;
  int bad_packets = 0;  // in a row
  int64_t damaged = 0, delivered = 0;
  AVPixelFormat scaler_format = AV_PIX_FMT_NONE;
  int scaler_width = 0, scaler_height = 0, scaler_matrix = -1;
  bool scaler_full = false;

  ~State() { avformat_close_input(&format); }

  void open();
  void open_decoder();
  void describe();
  bool decode();
  void prepare_scaler(const AVFrame& frame);
  void convert(Image8& out);
  bool cut_short() const;
};

void VideoReader::State::open() {
  if (const std::string why = missing_or_empty(path); !why.empty())
    fail_video(path, why, "check the path");
  detail::silence_ffmpeg();
  AVDictionary* options = nullptr;
  av_dict_set(&options, "protocol_whitelist", "file", 0);
  av_dict_set(&options, "format_whitelist", kContainers, 0);
  const std::string url = "file:" + path.string();
  const int opened = avformat_open_input(&format, url.c_str(), nullptr, &options);
  av_dict_free(&options);
  if (opened < 0) {
    if (opened == AVERROR(EACCES))
      fail_video(path, "permission is denied", "check its permissions");
    if (looks_like_mp4(path))
      fail_video(path, "it is damaged or cut short (its index is missing)",
                 "copy or record it again");
    fail_video(path, "it is not a video file", "give an MP4, MOV, WebM, MKV or AVI file");
  }
  if (const int found = avformat_find_stream_info(format, nullptr); found < 0)
    fail_video(path, "it is damaged (" + detail::ffmpeg_message(found) + ")", "copy it again");
  bool audio = false;
  for (unsigned i = 0; i < format->nb_streams; ++i) {
    AVStream* candidate = format->streams[i];
    candidate->discard = AVDISCARD_ALL;
    audio = audio || candidate->codecpar->codec_type == AVMEDIA_TYPE_AUDIO;
    // A cover picture is not a video.
    const bool cover = (candidate->disposition & AV_DISPOSITION_ATTACHED_PIC) != 0;
    if (candidate->codecpar->codec_type == AVMEDIA_TYPE_VIDEO && !cover && stream == nullptr)
      stream = candidate;
  }
  if (stream == nullptr)
    fail_video(path, audio ? "it has sound only, no pictures" : "it has no video stream",
               "give a video of a person");
  stream->discard = AVDISCARD_DEFAULT;
}

void VideoReader::State::open_decoder() {
  const AVCodec* decoder = avcodec_find_decoder(stream->codecpar->codec_id);
  const std::string codec_name = avcodec_get_name(stream->codecpar->codec_id);
  if (decoder == nullptr)
    fail_video(path, "there is no decoder for " + codec_name, "convert it to H.264");
  codec.reset(avcodec_alloc_context3(decoder));
  avcodec_parameters_to_context(codec.get(), stream->codecpar);
  codec->pkt_timebase = stream->time_base;
  codec->thread_count = std::min(thread_count(), 16);
  codec->max_pixels = detail::kMaxPixels;
  if (const int result = avcodec_open2(codec.get(), decoder, nullptr); result < 0)
    fail_video(
        path,
        "its " + codec_name + " stream cannot be decoded (" + detail::ffmpeg_message(result) + ")",
        "convert it to H.264");
  info.codec = codec_name;
}

// Fills `info` from the first decoded frame and the container.
void VideoReader::State::describe() {
  const AVFrame& frame = *decoded;
  detail::check_picture_size(path.string(), frame.width, frame.height);
  if (const auto* matrix = reinterpret_cast<const int32_t*>(
          av_stream_get_side_data(stream, AV_PKT_DATA_DISPLAYMATRIX, nullptr)))
    orientation = orientation_from(matrix);
  stored_width = frame.width;
  stored_height = frame.height;
  const AVRational aspect = av_guess_sample_aspect_ratio(format, stream, decoded.get());
  const double ratio = aspect.num > 0 && aspect.den > 0 ? av_q2d(aspect) : 1.0;
  if (ratio > 0.1 && ratio < 10.0) info.pixel_aspect = orientation.turned() ? 1.0 / ratio : ratio;
  rgb->format = AV_PIX_FMT_RGB24;
  rgb->width = stored_width;
  rgb->height = stored_height;
  // swscale writes whole vectors: rows need room behind them.
  if (av_frame_get_buffer(rgb.get(), 64) < 0)
    throw Error("Out of memory while reading " + path.string() + ".", Blame::kResource);
  info.width = orientation.turned() ? stored_height : stored_width;
  info.height = orientation.turned() ? stored_width : stored_height;
  const char* pixel_format = av_get_pix_fmt_name(static_cast<AVPixelFormat>(frame.format));
  info.pixel_format = pixel_format != nullptr ? pixel_format : "unknown";
  const AVRational rate = stream->avg_frame_rate.num > 0 && stream->avg_frame_rate.den > 0
                              ? stream->avg_frame_rate
                              : av_guess_frame_rate(format, stream, nullptr);
  info.frames_per_second = rate.num > 0 && rate.den > 0 ? av_q2d(rate) : 0.0;
  // The index knows which frames the edit list hides; the header's count does not.
  const int entries = avformat_index_get_entries_count(stream);
  const std::string container = format->iformat->name;
  if (entries > 0 && container.find("mov") != std::string::npos) {
    for (int i = 0; i < entries; ++i)
      if (!(avformat_index_get_entry(stream, i)->flags & AVINDEX_DISCARD_FRAME)) ++info.frames;
  } else if (stream->nb_frames > 0) {
    info.frames = stream->nb_frames;
  } else {
    const double seconds = stream->duration > 0
                               ? static_cast<double>(stream->duration) * av_q2d(stream->time_base)
                               : static_cast<double>(format->duration) / AV_TIME_BASE;
    if (seconds > 0.0 && seconds * info.frames_per_second < 1e9)
      info.frames = std::llround(seconds * info.frames_per_second);
  }
  for (const AVDictionary* tags : {format->metadata, stream->metadata}) {
    const AVDictionaryEntry* tag = nullptr;
    while ((tag = av_dict_get(tags, "", tag, AV_DICT_IGNORE_SUFFIX)) != nullptr)
      info.metadata.emplace(tag->key, tag->value);
  }
  if (frame.color_trc == AVCOL_TRC_SMPTE2084 || frame.color_trc == AVCOL_TRC_ARIB_STD_B67)
    log_warning(path.string() +
                " is a high dynamic range video: its colours are read as if they were not; record "
                "with HDR switched off for true colours.");
}

// Decodes one frame into `decoded`; false at the end of the stream.
bool VideoReader::State::decode() {
  for (;;) {
    const int received = avcodec_receive_frame(codec.get(), decoded.get());
    if (received >= 0) {
      bad_packets = 0;
      // Hidden by the edit list (decoders drop most of these themselves).
      if (decoded->flags & AV_FRAME_FLAG_DISCARD) continue;
      return true;
    }
    const bool hungry = received == AVERROR(EAGAIN);
    if (received == AVERROR_EOF || (hungry && draining)) return false;
    if (!hungry) ++damaged, ++bad_packets;
    if (bad_packets > kMaxBadPackets)
      fail_video(path, "its pictures are damaged from frame " + std::to_string(delivered) + " on",
                 "copy it again or cut it there");
    if (!hungry) continue;
    const int read = av_read_frame(format, packet.get());
    if (read < 0) {
      if (read == AVERROR(EIO)) fail_video(path, "the disk reports an error", "copy it again");
      draining = true;
      avcodec_send_packet(codec.get(), nullptr);
      continue;
    }
    if (packet->stream_index == stream->index) {
      const int sent = avcodec_send_packet(codec.get(), packet.get());
      if (sent < 0 && sent != AVERROR(EAGAIN)) ++damaged, ++bad_packets;
    }
    av_packet_unref(packet.get());
  }
}

void VideoReader::State::prepare_scaler(const AVFrame& frame) {
  bool unused = false;
  const AVPixelFormat pixels = plain_format(static_cast<AVPixelFormat>(frame.format), unused);
  const bool full = is_full_range(frame);
  const int matrix = matrix_for(frame.colorspace, frame.height).swscale;
  if (scaler && scaler_format == pixels && scaler_width == frame.width &&
      scaler_height == frame.height && scaler_matrix == matrix && scaler_full == full)
    return;
  scaler.reset(sws_getContext(
      frame.width, frame.height, pixels, stored_width, stored_height, AV_PIX_FMT_RGB24,
      SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT | SWS_FULL_CHR_H_INP, nullptr, nullptr,
      nullptr));
  if (!scaler)
    fail_video(path, "its pixel format " + info.pixel_format + " cannot be converted",
               "convert it to H.264");
  // Ignored (and not needed) for pixel formats that are RGB already.
  sws_setColorspaceDetails(scaler.get(), sws_getCoefficients(matrix), full ? 1 : 0,
                           sws_getCoefficients(SWS_CS_DEFAULT), 1, 0, 1 << 16, 1 << 16);
  scaler_format = pixels;
  scaler_width = frame.width;
  scaler_height = frame.height;
  scaler_matrix = matrix;
  scaler_full = full;
}

// Converts `decoded` to upright sRGB.
void VideoReader::State::convert(Image8& out) {
  detail::YuvPicture picture;
  if (decoded->width == stored_width && decoded->height == stored_height &&
      as_planar_yuv(*decoded, picture)) {
    detail::rgb_from_yuv(picture, rgb->data[0], rgb->linesize[0]);
  } else {
    prepare_scaler(*decoded);
    sws_scale(scaler.get(), decoded->data, decoded->linesize, 0, decoded->height, rgb->data,
              rgb->linesize);
  }
  if (out.width != info.width || out.height != info.height || out.channels != 3)
    out = Image8(info.width, info.height, 3);
  const Orientation& o = orientation;
  const std::ptrdiff_t line = rgb->linesize[0];
  const uint8_t* origin = rgb->data[0];
  if (o.xx + o.xy < 0) origin += 3 * (stored_width - 1);
  if (o.yx + o.yy < 0) origin += line * (stored_height - 1);
  const std::ptrdiff_t step_x = 3 * o.xx + line * o.yx, step_y = 3 * o.xy + line * o.yy;
  for (int y = 0; y < info.height; ++y) {
    const uint8_t* from = origin + step_y * y;
    uint8_t* to = out.at(0, y);
    if (step_x == 3) {
      std::memcpy(to, from, static_cast<size_t>(info.width) * 3);
      continue;
    }
    for (int x = 0; x < info.width; ++x, from += step_x, to += 3) std::memcpy(to, from, 3);
  }
}

// True when the index points behind the end of the file.
bool VideoReader::State::cut_short() const {
  const int64_t size = format->pb != nullptr ? avio_size(format->pb) : -1;
  for (int i = avformat_index_get_entries_count(stream) - 1; i >= 0 && size > 0; --i) {
    const AVIndexEntry* entry = avformat_index_get_entry(stream, i);
    if (entry->pos + entry->size > size) return true;
  }
  return false;
}

VideoReader::VideoReader(const Path& path) : state_(std::make_unique<State>()) {
  state_->path = path;
  state_->open();
  state_->open_decoder();
  if (!state_->decode())
    fail_video(path,
               state_->cut_short() ? "it is cut short before its first frame"
                                   : "none of its frames can be decoded",
               "copy or record it again");
  state_->pending = true;
  state_->describe();
}

VideoReader::~VideoReader() = default;

const VideoInfo& VideoReader::info() const {
  return state_->info;
}

bool VideoReader::next(Image8& frame, double* seconds) {
  State& state = *state_;
  if (state.finished) return false;
  if (!state.pending && !state.decode()) {
    state.finished = true;
    if (state.cut_short())
      log_warning(state.path.string() + " is cut short: " + std::to_string(state.delivered) +
                  " frames could be read.");
    else if (state.damaged > 0)
      log_warning(state.path.string() + " has damaged frames: " + std::to_string(state.delivered) +
                  " frames could be read.");
    return false;
  }
  state.pending = false;
  state.convert(frame);
  if (seconds != nullptr) {
    const int64_t time = state.decoded->best_effort_timestamp;
    const int64_t start = state.stream->start_time != AV_NOPTS_VALUE ? state.stream->start_time : 0;
    *seconds = time != AV_NOPTS_VALUE
                   ? static_cast<double>(time - start) * av_q2d(state.stream->time_base)
                   : (state.info.frames_per_second > 0
                          ? static_cast<double>(state.delivered) / state.info.frames_per_second
                          : 0.0);
  }
  ++state.delivered;
  av_frame_unref(state.decoded.get());
  return true;
}

}  // namespace effigy
