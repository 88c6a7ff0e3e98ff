#include "effigy/image/resample.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/image/filter.h"

namespace effigy {
namespace {

// One output sample along one axis: weights of source samples first..first+weights-1, and the
// weight of whatever lies outside the picture. Weights and outside sum to 1.
struct Tap {
  int first = 0;
  std::vector<float> weights;
  float outside = 0.0f;
};

// Weights of the `out` samples that cover the source interval [begin, begin + length): overlap with
// each source sample when shrinking, bilinear at the centre when growing. `clamp` repeats the edge
// instead of counting it as outside.
std::vector<Tap> make_taps(int size, double begin, double length, int out, bool clamp) {
  EFFIGY_CHECK(size > 0 && out > 0 && std::isfinite(begin) && std::isfinite(length) &&
               length > 0.0);
  std::vector<Tap> taps(static_cast<size_t>(out));
  const double scale = length / out;
  for (int i = 0; i < out; ++i) {
    Tap& tap = taps[static_cast<size_t>(i)];
    double low = 0.0, high = 0.0;  // source interval, or the two bilinear neighbours
    std::vector<double> weights;
    if (scale > 1.0) {
      low = begin + i * scale;
      high = low + scale;
      const double from = std::clamp(low, 0.0, static_cast<double>(size));
      const double to = std::clamp(high, 0.0, static_cast<double>(size));
      tap.first = std::min(static_cast<int>(from), size - 1);
      const int last = std::max(static_cast<int>(std::ceil(to)), tap.first + 1);
      for (int s = tap.first; s < last; ++s)
        weights.push_back(std::max(0.0, std::min<double>(to, s + 1) - std::max<double>(from, s)) /
                          scale);
      if (clamp) {  // only rounding of begin + i * scale can leave the picture
        weights.front() += std::max(0.0, from - low) / scale;
        weights.back() += std::max(0.0, high - to) / scale;
      }
    } else {
      const double centre = begin + (i + 0.5) * scale - 0.5;
      const double floor = std::floor(centre);
      const double right = centre - floor;
      if (floor < -1.0 || floor > size - 1) {
        tap.first = floor < 0.0 ? 0 : size - 1;
        weights = {clamp ? 1.0 : 0.0};
      } else if (floor < 0.0) {
        tap.first = 0;
        weights = {clamp ? 1.0 : right};
      } else if (floor >= size - 1) {
        tap.first = size - 1;
        weights = {clamp ? 1.0 : 1.0 - right};
      } else {
        tap.first = static_cast<int>(floor);
        weights = {1.0 - right, right};
      }
    }
    double sum = 0.0;
    for (double weight : weights) sum += weight;
    tap.outside = static_cast<float>(std::max(0.0, 1.0 - sum));
    for (double weight : weights) tap.weights.push_back(static_cast<float>(weight));
  }
  return taps;
}

EFFIGY_CLONES void add_row(const uint8_t* row, float weight, size_t count, float* sum) {
  for (size_t i = 0; i < count; ++i) sum[i] += weight * static_cast<float>(row[i]);
}
EFFIGY_CLONES void add_row(const float* row, float weight, size_t count, float* sum) {
  for (size_t i = 0; i < count; ++i) sum[i] += weight * row[i];
}

template <int kChannels>
void gather_row(const float* row, const std::vector<Tap>& taps, int channels, float outside,
                float* out) {
  const int step = kChannels > 0 ? kChannels : channels;
  for (const Tap& tap : taps) {
    const float* from = row + static_cast<size_t>(tap.first) * static_cast<size_t>(step);
    for (int c = 0; c < step; ++c) out[c] = tap.outside * outside;
    for (const float weight : tap.weights) {
      for (int c = 0; c < step; ++c) out[c] += weight * from[c];
      from += step;
    }
    out += step;
  }
}

void store(const float* row, size_t count, float* out) {
  std::copy_n(row, count, out);
}
EFFIGY_CLONES void store(const float* row, size_t count, uint8_t* out) {
  for (size_t i = 0; i < count; ++i) {
    const int rounded = static_cast<int>(row[i] + 0.5f);  // a mean of bytes
    out[i] = static_cast<uint8_t>(std::clamp(rounded, 0, 255));
  }
}

// Columns first (contiguous rows vectorise), then along the row.
template <typename Picture>
Picture resample(const Picture& image, const std::vector<Tap>& taps_x,
                 const std::vector<Tap>& taps_y, float outside) {
  const int channels = image.channels;
  const auto pixel = static_cast<size_t>(channels);
  Picture result(static_cast<int>(taps_x.size()), static_cast<int>(taps_y.size()), channels);
  int first = image.width, last = 0;
  for (const Tap& tap : taps_x) {
    first = std::min(first, tap.first);
    last = std::max(last, tap.first + static_cast<int>(tap.weights.size()));
  }
  const size_t skip = static_cast<size_t>(first) * pixel;
  const size_t used = static_cast<size_t>(last - first) * pixel;
  const size_t line = taps_x.size() * pixel;
  parallel_for(taps_y.size(), 16, [&](size_t begin, size_t end, int) {
    std::vector<float> sum(static_cast<size_t>(image.width) * pixel), row(line);
    for (size_t y = begin; y < end; ++y) {
      const Tap& tap = taps_y[y];
      std::fill_n(sum.begin() + static_cast<std::ptrdiff_t>(skip), used, tap.outside * outside);
      for (size_t k = 0; k < tap.weights.size(); ++k)
        add_row(image.at(0, tap.first + static_cast<int>(k)) + skip, tap.weights[k], used,
                sum.data() + skip);
      switch (channels) {
        case 1:
          gather_row<1>(sum.data(), taps_x, channels, outside, row.data());
          break;
        case 3:
          gather_row<3>(sum.data(), taps_x, channels, outside, row.data());
          break;
        case 4:
          gather_row<4>(sum.data(), taps_x, channels, outside, row.data());
          break;
        default:
          gather_row<0>(sum.data(), taps_x, channels, outside, row.data());
      }
      store(row.data(), line, result.at(0, static_cast<int>(y)));
    }
  });
  return result;
}

template <typename Picture>
Picture resize_picture(const Picture& image, int width, int height) {
  EFFIGY_CHECK(!image.empty() && width > 0 && height > 0);
  if (width == image.width && height == image.height) return image;
  return resample(image, make_taps(image.width, 0.0, image.width, width, true),
                  make_taps(image.height, 0.0, image.height, height, true), 0.0f);
}

}  // namespace

Image resize(const Image& image, int width, int height) {
  return resize_picture(image, width, height);
}
Image8 resize(const Image8& image, int width, int height) {
  return resize_picture(image, width, height);
}

Image8 crop_resize(const Image8& image, double x, double y, double w, double h, int out_w,
                   int out_h, uint8_t outside) {
  EFFIGY_CHECK(!image.empty());
  return resample(image, make_taps(image.width, x, w, out_w, false),
                  make_taps(image.height, y, h, out_h, false), static_cast<float>(outside));
}

void sample_bilinear(const Image& image, double x, double y, float* out) {
  const double u = std::clamp(x - 0.5, 0.0, static_cast<double>(image.width - 1));
  const double v = std::clamp(y - 0.5, 0.0, static_cast<double>(image.height - 1));
  const int x0 = static_cast<int>(u), y0 = static_cast<int>(v);
  const int x1 = std::min(x0 + 1, image.width - 1), y1 = std::min(y0 + 1, image.height - 1);
  const auto fx = static_cast<float>(u - x0), fy = static_cast<float>(v - y0);
  const float *a = image.at(x0, y0), *b = image.at(x1, y0), *c = image.at(x0, y1),
              *d = image.at(x1, y1);
  for (int i = 0; i < image.channels; ++i) {
    const float top = a[i] + fx * (b[i] - a[i]);
    const float bottom = c[i] + fx * (d[i] - c[i]);
    out[i] = top + fy * (bottom - top);
  }
}

Image gaussian_blur(const Image& image, double sigma) {
  EFFIGY_CHECK(std::isfinite(sigma) && sigma >= 0.0);
  Image result = image;
  if (sigma == 0.0 || image.empty()) return result;
  const auto kernel = gaussian_kernel(sigma, static_cast<int>(std::ceil(4.0 * sigma)));
  filter_separable(image.data.data(), image.width, image.height, image.channels, kernel, kernel,
                   result.data.data());
  return result;
}

}  // namespace effigy
