// The frames of a capture as training and evaluation use them.
#pragma once

#include <map>
#include <vector>

#include "effigy/capture/capture.h"
#include "effigy/image/image.h"

namespace effigy {

// One frame: the image on black (image * mask / 255, in the capture's encoding) and the mask.
struct TargetFrame {
  Planes image;   // 3 planes, [0, 1]
  Planes mask;    // 1 plane, [0, 1]
  Planes albedo;  // 3 planes, sRGB, empty when the frame has no prior
};

// At most `most` of `frames`, evenly spread.
std::vector<int> spread_frames(const std::vector<int>& frames, size_t most);

// Keeps decoded 8-bit frames up to a memory budget; others are decoded each time.
class FrameStore {
 public:
  explicit FrameStore(const Capture& capture, size_t budget_bytes = size_t{1} << 30);
  void load(int frame, TargetFrame& target);

 private:
  struct Entry {
    Image8 image, mask, albedo;
  };
  Entry decode(int frame) const;
  const Capture& capture_;
  size_t budget_, used_ = 0;
  std::map<int, Entry> entries_;
};

}  // namespace effigy
