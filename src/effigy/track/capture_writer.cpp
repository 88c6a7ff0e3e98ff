#include "effigy/track/capture_writer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/image/files.h"
#include "effigy/image/resample.h"
#include "effigy/track/frame_source.h"
#include "effigy/track/matte.h"

namespace effigy {
namespace {

constexpr int kBatch = 8;             // frames matted and written together
constexpr double kMatteSide = 256;    // of the segmentation network's output
constexpr double kCropMargin = 0.12;  // of the head's box, for hair and movement of the matte

// Everything about one frame between decoding and writing.
struct PendingFrame {
  int number = 0;
  double seconds = 0;
  Image8 picture;              // cropped
  Image coarse;                // segmentation
  std::vector<double> points;  // projected landmarks of the rig, pixels of the crop, x y pairs
  HeadRegion region;
};

class FrameWriter {
 public:
  FrameWriter(const ModelSet& models, const TrackOptions& options, const FitResult& fit,
              const CropBox& crop, const Path& folder, Capture& capture)
      : fit_(fit),
        crop_(crop),
        folder_(folder),
        capture_(capture),
        shape_(shape_rig(capture.rig, capture.identity)) {
    if (options.matte) {
      mattes_ = list_own_mattes(*options.matte, fit.poses.size());
    } else {
      for (int slot = 0; slot < thread_count(); ++slot) segmenters_.emplace_back(models);
    }
    make_folder(folder / "images/cam0");
    make_folder(folder / "masks/cam0");
  }

  void add(FrameSource::Frame frame, bool tracked) {
    PendingFrame pending;
    pending.number = frame.number;
    pending.seconds = frame.seconds;
    pending.picture = std::move(frame.picture);
    CaptureFrame entry;
    entry.number = frame.number;
    entry.seconds = frame.seconds;
    const std::string name = format("{:06}.png", frame.number);
    entry.image = "images/cam0/" + name;
    entry.mask = "masks/cam0/" + name;
    entry.tracked = tracked;
    capture_.frames.push_back(entry);
    window_.push_back(std::move(pending));
    if (window_.size() >= prepared_ + kBatch) flush(false);
  }

  void finish() { flush(true); }

 private:
  // The crop, the segmentation and where the head is; one thread a slot.
  void prepare(PendingFrame& frame, int slot) {
    const bool whole = crop_.x == 0 && crop_.y == 0 && crop_.width == frame.picture.width &&
                       crop_.height == frame.picture.height &&
                       crop_.out_width == frame.picture.width &&
                       crop_.out_height == frame.picture.height;
    if (!whole)
      frame.picture = crop_resize(frame.picture, crop_.x, crop_.y, crop_.width, crop_.height,
                                  crop_.out_width, crop_.out_height);
    if (!segmenters_.empty()) frame.coarse = segmenters_[slot].segment(frame.picture);
    project(frame);
  }

  // Landmarks and neck ring of the fitted rig in the crop.
  void project(PendingFrame& frame) const {
    std::vector<float> vertices;
    pose_vertices(shape_, fit_.poses[frame.number], vertices);
    const auto landmarks =
        landmark_positions(capture_.rig.mediapipe, capture_.rig.mesh.triangles, vertices);
    Vec2d sum = Vec2d::Zero();
    for (size_t l = 0; l < landmarks.size(); l += 3) {
      const Vec2d p = capture_.camera.project(Vec3f(&landmarks[l]).cast<double>());
      frame.points.push_back(p.x());
      frame.points.push_back(p.y());
      sum += p;
    }
    sum /= static_cast<double>(std::max<size_t>(1, landmarks.size() / 3));
    frame.region.head_x = sum.x();
    frame.region.head_y = sum.y();
    frame.region.softness = crop_.out_height * 0.02;
    for (int v : capture_.rig.neck_ring) {
      const Vec2d p =
          capture_.camera.project(Vec3f(&vertices[3 * static_cast<size_t>(v)]).cast<double>());
      frame.region.neck_ring.push_back(p.x());
      frame.region.neck_ring.push_back(p.y());
    }
  }

  // Writes the frames of the window whose neighbours are known: all but the last unless `all`.
  // window_[0] is the frame before them once done_ > 0; the first prepared_ are cropped and
  // segmented.
  void flush(bool all) {
    parallel_for(window_.size() - prepared_, 1, [&](size_t begin, size_t stop, int slot) {
      for (size_t i = begin; i < stop; ++i) prepare(window_[prepared_ + i], slot);
    });
    const size_t first = done_ > 0 ? 1 : 0;
    const size_t end = all ? window_.size() : window_.size() - 1;
    parallel_for(end - first, 1, [&](size_t begin, size_t stop, int) {
      for (size_t i = first + begin; i < first + stop; ++i) write(i);
    });
    done_ += end - first;
    if (end > 0)
      window_.erase(window_.begin(), window_.begin() + static_cast<std::ptrdiff_t>(end - 1));
    prepared_ = window_.size();
  }

  void write(size_t i) const {
    const PendingFrame& here = window_[i];
    const CaptureFrame& entry = capture_.frames[here.number];
    write_png8(folder_ / entry.image, here.picture, {}, true);
    write_png8(folder_ / entry.mask, mattes_.empty() ? network_matte(i) : user_matte(here), {},
               true);
  }

  Image8 network_matte(size_t i) const {
    const PendingFrame& here = window_[i];
    const PendingFrame* before = i > 0 ? &window_[i - 1] : nullptr;
    const PendingFrame* after = i + 1 < window_.size() ? &window_[i + 1] : nullptr;
    const Image steady = steady_matte(here.coarse, before ? &before->coarse : nullptr,
                                      before ? motion(here, *before) : PlaneSimilarity{},
                                      after ? &after->coarse : nullptr,
                                      after ? motion(here, *after) : PlaneSimilarity{});
    Image8 matte = head_matte(refine_matte(here.picture, steady), here.region);
    clear_outside(matte);
    return matte;
  }

  // Where the crop leaves the video's picture there is no head.
  void clear_outside(Image8& matte) const {
    const auto [left, right] = shown(crop_.x, crop_.width, matte.width, frame_width_);
    const auto [top, bottom] = shown(crop_.y, crop_.height, matte.height, frame_height_);
    for (int y = 0; y < matte.height; ++y) {
      uint8_t* row = matte.at(0, y);
      const bool any = y >= top && y < bottom;
      std::fill(row, row + (any ? left : matte.width), uint8_t{0});
      if (any) std::fill(row + right, row + matte.width, uint8_t{0});
    }
  }

  // The pixels [first, end) of a crop from `start`, `size` long, which lie in a picture `whole`
  // long, with half a pixel to spare.
  static std::pair<int, int> shown(double start, double size, int pixels, double whole) {
    const double step = size / pixels;
    const auto inside = [&](int i) {
      const double at = start + (i + 0.5) * step;
      return at >= 0.5 * step && at <= whole - 0.5 * step;
    };
    int first = 0, end = pixels;
    while (first < end && !inside(first)) ++first;
    while (end > first && !inside(end - 1)) --end;
    return {first, end};
  }

  // Maps the coarse matte's pixels of `from` to those of `to`.
  PlaneSimilarity motion(const PendingFrame& from, const PendingFrame& to) const {
    const auto in_matte = [&](std::vector<double> points) {
      for (size_t k = 0; k < points.size(); k += 2) {
        points[k] *= kMatteSide / crop_.out_width;
        points[k + 1] *= kMatteSide / crop_.out_height;
      }
      return points;
    };
    return fit_similarity(in_matte(from.points), in_matte(to.points));
  }

  Image8 user_matte(const PendingFrame& here) const {
    const Path& path = mattes_[here.number];
    const Image8 whole = read_image8(path);
    Image8 grey(whole.width, whole.height, 1);
    const int channel = whole.channels == 4 ? 3 : 0;
    for (size_t k = 0; k < grey.data.size(); ++k)
      grey.data[k] = whole.data[k * whole.channels + channel];
    const double sx = whole.width / frame_width_, sy = whole.height / frame_height_;
    return crop_resize(grey, crop_.x * sx, crop_.y * sy, crop_.width * sx, crop_.height * sy,
                       crop_.out_width, crop_.out_height);
  }

 public:
  void set_frame_size(int width, int height) {
    frame_width_ = width;
    frame_height_ = height;
  }

 private:
  const FitResult& fit_;
  const CropBox& crop_;
  Path folder_;
  Capture& capture_;
  RigShape shape_;
  std::vector<PersonSegmenter> segmenters_;  // one a slot
  std::vector<Path> mattes_;
  std::vector<PendingFrame> window_;
  size_t done_ = 0, prepared_ = 0;
  double frame_width_ = 1, frame_height_ = 1;
};

}  // namespace

std::vector<Path> list_own_mattes(const Path& folder, size_t frames) {
  if (!std::filesystem::is_directory(folder))
    throw Error("--matte " + folder.string() +
                ": no such folder; give a folder of matte pictures, one a frame.");
  std::vector<Path> mattes;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.is_regular_file()) mattes.push_back(entry.path());
  std::sort(mattes.begin(), mattes.end());
  if (mattes.size() < frames)
    throw Error("--matte " + folder.string() + ": " + std::to_string(mattes.size()) +
                " pictures for " + std::to_string(frames) +
                " frames; give one matte a frame, in the order of their names.");
  return mattes;
}

CropBox choose_crop(const Rig& rig, const FitResult& fit, const VideoObservation& seen,
                    const TrackOptions& options) {
  if (!options.crop_head)
    return {
        0,          0,          static_cast<double>(seen.width), static_cast<double>(seen.height),
        seen.width, seen.height};
  const RigShape shape = shape_rig(rig, fit.identity);
  const Camera camera = fit_camera(fit.focal, seen.width, seen.height);
  double x0 = 1e9, y0 = 1e9, x1 = -1e9, y1 = -1e9;
  std::vector<float> vertices;
  for (size_t f = 0; f < fit.poses.size(); ++f) {
    if (!seen.frames[f].found) continue;
    pose_vertices(shape, fit.poses[f], vertices);
    for (size_t v = 0; v + 2 < vertices.size(); v += 3 * 7) {  // a sample is enough for a box
      const Vec2d p = camera.project(Vec3f(&vertices[v]).cast<double>());
      x0 = std::min(x0, p.x());
      y0 = std::min(y0, p.y());
      x1 = std::max(x1, p.x());
      y1 = std::max(y1, p.y());
    }
  }
  // Hair stands above the rig's bald head.
  y0 -= 0.1 * (y1 - y0);
  const double margin = 0.5 * kCropMargin * std::max(x1 - x0, y1 - y0);
  // What lies outside the video's picture is no reason for a larger square.
  const double width = seen.width, height = seen.height;
  x0 = std::clamp(x0 - margin, 0.0, width - 1);
  y0 = std::clamp(y0 - margin, 0.0, height - 1);
  x1 = std::clamp(x1 + margin, x0 + 1, width);
  y1 = std::clamp(y1 + margin, y0 + 1, height);
  const double side = std::max(x1 - x0, y1 - y0);
  // Centred on the head, moved into the picture where it fits.
  const auto place = [&](double low, double high, double size) {
    const double start = 0.5 * (low + high - side);
    return side <= size ? std::clamp(start, 0.0, size - side) : 0.5 * (size - side);
  };
  return {place(x0, x1, width), place(y0, y1, height), side, side, options.size, options.size};
}

void write_frames(const Path& video, const ModelSet& models, const TrackOptions& options,
                  const VideoObservation& seen, const FitResult& fit, const CropBox& crop,
                  const Path& folder, Capture& capture) {
  FrameWriter writer(models, options, fit, crop, folder, capture);
  writer.set_frame_size(seen.width, seen.height);
  FrameSource source(video, static_cast<int>(seen.frames.size()));
  Progress progress("matting", "frames", static_cast<int64_t>(seen.frames.size()));
  FrameSource::Frame frame;
  int count = 0;
  while (count < static_cast<int>(seen.frames.size()) && source.next(frame)) {
    frame.number = count;
    writer.add(std::move(frame), seen.frames[count].found);
    progress.update(++count);
  }
  writer.finish();
  if (count != static_cast<int>(seen.frames.size()))
    throw Error(video.string() + ": the second reading gave " + std::to_string(count) + " of " +
                std::to_string(seen.frames.size()) + " frames; copy the file again.");
}

}  // namespace effigy
