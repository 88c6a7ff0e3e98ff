#include "effigy/image/yuv.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "effigy/base/random.h"

namespace effigy::detail {
namespace {

struct Planar {
  std::vector<uint16_t> samples[3];
  int widths[3], heights[3];

  Planar(int width, int height, int shift_x, int shift_y, int bits) {
    Random random(static_cast<uint64_t>(width * 100 + height));
    for (int p = 0; p < 3; ++p) {
      widths[p] = p == 0 ? width : (width + shift_x) >> shift_x;
      heights[p] = p == 0 ? height : (height + shift_y) >> shift_y;
      for (int i = 0; i < widths[p] * heights[p]; ++i)
        samples[p].push_back(static_cast<uint16_t>(random.below(uint64_t{1} << bits)));
    }
  }
  // Linear interpolation at a continuous sample position, repeating the edge.
  double at(int plane, double x, double y) const {
    const auto value = [&](double i, double j) {
      const int u = std::clamp(static_cast<int>(i), 0, widths[plane] - 1);
      const int v = std::clamp(static_cast<int>(j), 0, heights[plane] - 1);
      return static_cast<double>(samples[plane][static_cast<size_t>(v * widths[plane] + u)]);
    };
    const double i = std::floor(x), j = std::floor(y), fx = x - i, fy = y - j;
    return (1 - fy) * ((1 - fx) * value(i, j) + fx * value(i + 1, j)) +
           fy * ((1 - fx) * value(i, j + 1) + fx * value(i + 1, j + 1));
  }
};

TEST(Yuv, MatchesTheStandardInDoublePrecision) {
  for (const auto& [width, height] : {std::pair{1, 1}, {2, 3}, {17, 9}, {64, 6}})
    for (const int shift_x : {0, 1})
      for (const int shift_y : {0, 1})
        for (const int bits : {8, 10})
          for (int variant = 0; variant < 4; ++variant) {
            const Planar planar(width, height, shift_x, shift_y, bits);
            YuvPicture picture;
            picture.width = width;
            picture.height = height;
            picture.bits = bits;
            picture.shift_x = shift_x;
            picture.shift_y = shift_y;
            picture.left = (variant & 1) == 0;
            picture.top = (variant & 2) != 0;
            picture.full_range = variant == 3;
            picture.weights = variant < 2 ? LumaWeights{0.299, 0.114} : LumaWeights{0.2126, 0.0722};
            std::vector<uint8_t> bytes[3];
            for (int p = 0; p < 3; ++p) {
              const size_t size = bits == 8 ? 1 : 2, row = static_cast<size_t>(planar.widths[p]);
              bytes[p].resize(planar.samples[p].size() * size);
              for (size_t i = 0; i < planar.samples[p].size(); ++i)
                std::memcpy(bytes[p].data() + i * size, &planar.samples[p][i], size);
              picture.planes[p] = bytes[p].data();
              picture.strides[p] = static_cast<std::ptrdiff_t>(row * size);
            }
            const std::ptrdiff_t stride = 3 * width + 5;
            std::vector<uint8_t> rgb(static_cast<size_t>(stride * height), 77);
            rgb_from_yuv(picture, rgb.data(), stride);
            const double unit = bits == 8 ? 1 : 4, kr = picture.weights.red,
                         kb = picture.weights.blue;
            for (int y = 0; y < height; ++y) {
              for (int x = 0; x < width; ++x) {
                const double cx =
                    shift_x == 0 ? x : (picture.left ? 0.5 * x : 0.5 * (x + 0.5) - 0.5);
                const double cy =
                    shift_y == 0 ? y : (picture.top ? 0.5 * y : 0.5 * (y + 0.5) - 0.5);
                double luma = planar.at(0, x, y) / unit;
                double cb = planar.at(1, cx, cy) / unit - 128,
                       cr = planar.at(2, cx, cy) / unit - 128;
                if (!picture.full_range) {
                  luma = (luma - 16) * 255 / 219;
                  cb *= 255.0 / 224, cr *= 255.0 / 224;
                }
                const double r = luma + 2 * (1 - kr) * cr, b = luma + 2 * (1 - kb) * cb;
                const double g = (luma - kr * r - kb * b) / (1 - kr - kb);
                const uint8_t* p = rgb.data() + stride * y + 3 * x;
                EXPECT_NEAR(p[0], std::clamp(r, 0.0, 255.0), 0.51);
                EXPECT_NEAR(p[1], std::clamp(g, 0.0, 255.0), 0.51);
                EXPECT_NEAR(p[2], std::clamp(b, 0.0, 255.0), 0.51);
              }
              for (int i = 0; i < 5; ++i)  // nothing behind the row
                EXPECT_EQ(rgb[static_cast<size_t>(stride * y + 3 * width + i)], 77);
            }
          }
}

}  // namespace
}  // namespace effigy::detail
