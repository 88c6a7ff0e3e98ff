#include "effigy/head/frames.h"

#include "effigy/image/files.h"

namespace effigy {
namespace {

void to_planes_masked(const Image8& image, const Image8* mask, Planes& out) {
  if (out.width != image.width || out.height != image.height || out.count != image.channels)
    out = Planes(image.width, image.height, image.channels);
  const size_t n = out.pixels();
  for (int c = 0; c < image.channels; ++c) {
    float* plane = out.plane(c);
    for (size_t i = 0; i < n; ++i) {
      const float value = image.data[i * image.channels + c] * (1.0f / 255);
      plane[i] = mask ? value * mask->data[i] * (1.0f / 255) : value;
    }
  }
}

}  // namespace

std::vector<int> spread_frames(const std::vector<int>& frames, size_t most) {
  std::vector<int> picked;
  const size_t count = std::min(frames.size(), most);
  for (size_t i = 0; i < count; ++i) picked.push_back(frames[i * frames.size() / count]);
  return picked;
}

FrameStore::FrameStore(const Capture& capture, size_t budget_bytes)
    : capture_(capture), budget_(budget_bytes) {}

FrameStore::Entry FrameStore::decode(int frame) const {
  Entry entry{capture_.load_image(frame), capture_.load_mask(frame), {}};
  const Path& albedo = capture_.frames[frame].albedo;
  if (!albedo.empty()) {
    entry.albedo = read_image8(capture_.folder / albedo);
    if (entry.albedo.channels != 3 || entry.albedo.width != entry.image.width ||
        entry.albedo.height != entry.image.height)
      throw Error((capture_.folder / albedo).string() +
                  ": an albedo prior must be an RGB image of the frame's size; write it again.");
  }
  return entry;
}

void FrameStore::load(int frame, TargetFrame& target) {
  Entry decoded;
  const Entry* entry = nullptr;
  const auto found = entries_.find(frame);
  if (found != entries_.end()) {
    entry = &found->second;
  } else {
    decoded = decode(frame);
    const size_t bytes =
        decoded.image.data.size() + decoded.mask.data.size() + decoded.albedo.data.size();
    if (used_ + bytes <= budget_) {
      used_ += bytes;
      entry = &(entries_[frame] = std::move(decoded));
    } else {
      entry = &decoded;
    }
  }
  to_planes_masked(entry->image, &entry->mask, target.image);
  to_planes_masked(entry->mask, nullptr, target.mask);
  if (entry->albedo.empty()) {
    target.albedo = Planes();
  } else {
    to_planes_masked(entry->albedo, nullptr, target.albedo);
  }
}

}  // namespace effigy
