#include "effigy/image/yuv.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"

namespace effigy::detail {
namespace {

// out = (1 - f) a + f b of two rows of samples.
EFFIGY_CLONES void blend_rows(const uint8_t* a, const uint8_t* b, float f, int count, float* out) {
  for (int i = 0; i < count; ++i) {
    const auto low = static_cast<float>(a[i]), high = static_cast<float>(b[i]);
    out[i] = low + f * (high - low);
  }
}
EFFIGY_CLONES void blend_rows(const uint16_t* a, const uint16_t* b, float f, int count,
                              float* out) {
  for (int i = 0; i < count; ++i) {
    const auto low = static_cast<float>(a[i]), high = static_cast<float>(b[i]);
    out[i] = low + f * (high - low);
  }
}

// Doubles a row: sample k sits at 2 k (left) or 2 k + 1/2. `in` has one more sample on either side.
EFFIGY_CLONES void double_row(const float* in, int count, bool left, float* out) {
  if (left) {
    for (int k = 0; k < count; ++k) {
      out[2 * k] = in[k];
      out[2 * k + 1] = 0.5f * (in[k] + in[k + 1]);
    }
  } else {
    for (int k = 0; k < count; ++k) {
      out[2 * k] = 0.25f * in[k - 1] + 0.75f * in[k];
      out[2 * k + 1] = 0.75f * in[k] + 0.25f * in[k + 1];
    }
  }
}

// Coefficients of samples as they are stored: r = scale y + offset + v_to_r v + ...
struct Coefficients {
  float scale, offset, centre, v_to_r, u_to_g, v_to_g, u_to_b;
};

EFFIGY_CLONES void rgb_row(const float* __restrict luma, const float* __restrict u,
                           const float* __restrict v, const Coefficients& k, int count,
                           uint8_t* __restrict red, uint8_t* __restrict green,
                           uint8_t* __restrict blue) {
  const Coefficients c = k;
  // Values stay within a few hundred: clamped as integers, which vectorises.
  const auto byte = [](float value) {
    const int rounded = static_cast<int>(value + 0.5f);
    return static_cast<uint8_t>(std::clamp(rounded, 0, 255));
  };
  for (int i = 0; i < count; ++i) {
    const float y = c.scale * luma[i] + c.offset;
    const float cb = u[i] - c.centre, cr = v[i] - c.centre;
    red[i] = byte(y + c.v_to_r * cr);
    green[i] = byte(y + c.u_to_g * cb + c.v_to_g * cr);
    blue[i] = byte(y + c.u_to_b * cb);
  }
}

EFFIGY_CLONES void interleave(const uint8_t* __restrict red, const uint8_t* __restrict green,
                              const uint8_t* __restrict blue, int count, uint8_t* __restrict out) {
  for (int i = 0; i < count; ++i) {
    out[3 * i] = red[i];
    out[3 * i + 1] = green[i];
    out[3 * i + 2] = blue[i];
  }
}

Coefficients coefficients_for(const YuvPicture& picture) {
  const double unit = std::ldexp(1.0, picture.bits - 8);  // stored steps of one 8-bit step
  const double scale = (picture.full_range ? 1.0 : 255.0 / 219.0) / unit;
  const double chroma = (picture.full_range ? 1.0 : 255.0 / 224.0) / unit;
  const auto [kr, kb] = picture.weights;
  const double kg = 1.0 - kr - kb;
  return {static_cast<float>(scale),
          static_cast<float>(picture.full_range ? 0.0 : -16.0 * unit * scale),
          static_cast<float>(128.0 * unit),
          static_cast<float>(chroma * 2.0 * (1.0 - kr)),
          static_cast<float>(-chroma * 2.0 * (1.0 - kb) * kb / kg),
          static_cast<float>(-chroma * 2.0 * (1.0 - kr) * kr / kg),
          static_cast<float>(chroma * 2.0 * (1.0 - kb))};
}

// One row of one plane at luma height y, as floats at full width. `small` has the chroma row with
// one sample of room on either side.
template <typename Sample>
void load_row(const YuvPicture& picture, int plane, int y, std::vector<float>& small, float* out) {
  const auto row = [&](int index) {
    return reinterpret_cast<const Sample*>(picture.planes[plane] + picture.strides[plane] * index);
  };
  if (plane == 0) return blend_rows(row(y), row(y), 0.0f, picture.width, out);
  int first = y, second = y;
  float fraction = 0.0f;
  if (picture.shift_y == 1) {
    const int rows = (picture.height + 1) / 2;
    const float at =
        picture.top ? 0.5f * static_cast<float>(y) : 0.5f * (static_cast<float>(y) + 0.5f) - 0.5f;
    const float floor = std::floor(at);
    fraction = at - floor;
    first = std::clamp(static_cast<int>(floor), 0, rows - 1);
    second = std::clamp(static_cast<int>(floor) + 1, 0, rows - 1);
  }
  if (picture.shift_x == 0)
    return blend_rows(row(first), row(second), fraction, picture.width, out);
  const int columns = (picture.width + 1) / 2;
  blend_rows(row(first), row(second), fraction, columns, small.data() + 1);
  small[0] = small[1];
  small[static_cast<size_t>(columns) + 1] = small[static_cast<size_t>(columns)];
  double_row(small.data() + 1, columns, picture.left, out);
}

template <typename Sample>
void convert(const YuvPicture& picture, uint8_t* rgb, std::ptrdiff_t stride) {
  const Coefficients coefficients = coefficients_for(picture);
  const auto width = static_cast<size_t>(picture.width);
  parallel_for(static_cast<size_t>(picture.height), 64, [&](size_t begin, size_t end, int) {
    std::vector<float> small(width / 2 + 3), rows(3 * (width + 1));
    std::vector<uint8_t> bytes(3 * width);
    for (size_t y = begin; y < end; ++y) {
      for (int plane = 0; plane < 3; ++plane)
        load_row<Sample>(picture, plane, static_cast<int>(y), small,
                         rows.data() + static_cast<size_t>(plane) * (width + 1));
      rgb_row(rows.data(), rows.data() + width + 1, rows.data() + 2 * (width + 1), coefficients,
              picture.width, bytes.data(), bytes.data() + width, bytes.data() + 2 * width);
      interleave(bytes.data(), bytes.data() + width, bytes.data() + 2 * width, picture.width,
                 rgb + stride * static_cast<std::ptrdiff_t>(y));
    }
  });
}

}  // namespace

void rgb_from_yuv(const YuvPicture& picture, uint8_t* rgb, std::ptrdiff_t stride) {
  EFFIGY_CHECK(picture.width > 0 && picture.height > 0);
  EFFIGY_CHECK(picture.bits >= 8 && picture.bits <= 16);
  EFFIGY_CHECK((picture.shift_x == 0 || picture.shift_x == 1) &&
               (picture.shift_y == 0 || picture.shift_y == 1));
  if (picture.bits == 8) {
    convert<uint8_t>(picture, rgb, stride);
  } else {
    convert<uint16_t>(picture, rgb, stride);
  }
}

}  // namespace effigy::detail
