// Planar Y'CbCr pictures to 8-bit R'G'B': what nearly every video frame needs, several times faster
// than swscale at its exact settings.
#pragma once

#include <cstddef>
#include <cstdint>

namespace effigy::detail {

// Weights of red and blue in luma, ITU-R BT.601 / 709 / 2020.
struct LumaWeights {
  double red, blue;
};

struct YuvPicture {
  int width = 0, height = 0;
  const uint8_t* planes[3] = {};   // Y, Cb, Cr; 2 bytes (native order) a sample above 8 bits
  std::ptrdiff_t strides[3] = {};  // bytes from row to row
  int bits = 8;                    // 8..16
  int shift_x = 0, shift_y = 0;    // chroma has (size + 1) >> shift samples; 0 or 1
  bool left = true, top = false;   // chroma sits on the left column / top row of its block, else
                                   // in the middle
  bool full_range = false;         // 0..255, else 16..235 and 16..240
  LumaWeights weights{0.299, 0.114};
};

// Writes width x height RGB pixels; rows are `stride` bytes apart. Chroma is interpolated linearly.
void rgb_from_yuv(const YuvPicture& picture, uint8_t* rgb, std::ptrdiff_t stride);

}  // namespace effigy::detail
