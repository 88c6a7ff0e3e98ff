#include "effigy/learn/pyramid_loss.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

// A linear map along one axis with up to five taps for each output.
struct Taps {
  std::vector<std::array<int, 5>> index;
  std::vector<std::array<float, 5>> weight;
  int in = 0;
  int out() const { return static_cast<int>(index.size()); }
};

Taps reduce_taps(int in) {
  Taps taps;
  taps.in = in;
  for (int i = 0; i < (in + 1) / 2; ++i) {
    std::array<int, 5> index{};
    for (int k = 0; k < 5; ++k)
      index[static_cast<size_t>(k)] = std::clamp(2 * i + k - 2, 0, in - 1);
    taps.index.push_back(index);
    taps.weight.push_back({1 / 16.0f, 4 / 16.0f, 6 / 16.0f, 4 / 16.0f, 1 / 16.0f});
  }
  return taps;
}

// From (out + 1) / 2 to `out`.
Taps expand_taps(int out) {
  Taps taps;
  taps.in = (out + 1) / 2;
  const int last = taps.in - 1;
  for (int i = 0; i < out; ++i) {
    const int at = i / 2, before = std::max(at - 1, 0), after = std::min(at + 1, last);
    taps.index.push_back({before, at, after, 0, 0});
    if (i % 2 == 0)
      taps.weight.push_back({1 / 8.0f, 6 / 8.0f, 1 / 8.0f, 0, 0});
    else
      taps.weight.push_back({0, 0.5f, 0.5f, 0, 0});
  }
  return taps;
}

struct Resample {
  Taps x, y;
};

// out = Y in X^T; `add` times that is added to `out`, which has the right size.
void apply(const Resample& map, const float* in, float* out, float add,
           std::vector<float>& scratch) {
  const auto in_w = static_cast<size_t>(map.x.in), out_w = static_cast<size_t>(map.x.out());
  const size_t in_h = static_cast<size_t>(map.y.in);
  scratch.resize(in_h * out_w);
  for (size_t r = 0; r < in_h; ++r)
    for (size_t c = 0; c < out_w; ++c) {
      float sum = 0;
      for (size_t k = 0; k < 5; ++k)
        sum += map.x.weight[c][k] * in[r * in_w + static_cast<size_t>(map.x.index[c][k])];
      scratch[r * out_w + c] = sum;
    }
  for (size_t r = 0; r < map.y.index.size(); ++r)
    for (size_t k = 0; k < 5; ++k) {
      const float w = add * map.y.weight[r][k];
      const float* row = &scratch[static_cast<size_t>(map.y.index[r][k]) * out_w];
      if (w != 0)
        for (size_t c = 0; c < out_w; ++c) out[r * out_w + c] += w * row[c];
    }
}

// The transpose of apply().
void apply_transposed(const Resample& map, const float* d_out, float* d_in, float add,
                      std::vector<float>& scratch) {
  const auto in_w = static_cast<size_t>(map.x.in), out_w = static_cast<size_t>(map.x.out());
  const size_t in_h = static_cast<size_t>(map.y.in);
  scratch.assign(in_h * out_w, 0.0f);
  for (size_t r = 0; r < map.y.index.size(); ++r)
    for (size_t k = 0; k < 5; ++k) {
      const float w = add * map.y.weight[r][k];
      float* row = &scratch[static_cast<size_t>(map.y.index[r][k]) * out_w];
      if (w != 0)
        for (size_t c = 0; c < out_w; ++c) row[c] += w * d_out[r * out_w + c];
    }
  for (size_t r = 0; r < in_h; ++r)
    for (size_t c = 0; c < out_w; ++c)
      for (size_t k = 0; k < 5; ++k)
        d_in[r * in_w + static_cast<size_t>(map.x.index[c][k])] +=
            map.x.weight[c][k] * scratch[r * out_w + c];
}

struct Level {
  int width = 0, height = 0;
  std::vector<float> low, band, d;
  size_t size() const { return low.size(); }
};

}  // namespace

double pyramid_loss(const Planes& colour, const Planes& target, int channels, int levels,
                    float weight, Planes* d_colour) {
  EFFIGY_CHECK(colour.width == target.width && colour.height == target.height && levels >= 1);
  EFFIGY_CHECK(colour.count >= channels && target.count >= channels);
  std::vector<int> widths{colour.width}, heights{colour.height};
  while (static_cast<int>(widths.size()) < levels && std::min(widths.back(), heights.back()) > 4) {
    widths.push_back((widths.back() + 1) / 2);
    heights.push_back((heights.back() + 1) / 2);
  }
  const size_t count = widths.size();
  std::vector<Resample> reduce, expand;
  for (size_t k = 0; k + 1 < count; ++k) {
    reduce.push_back({reduce_taps(widths[k]), reduce_taps(heights[k])});
    expand.push_back({expand_taps(widths[k]), expand_taps(heights[k])});
  }
  std::vector<double> sums(static_cast<size_t>(channels), 0.0);
  parallel_for(static_cast<size_t>(channels), 1, [&](size_t begin, size_t end, int) {
    std::vector<Level> pyramid(count);
    std::vector<float> scratch;
    for (size_t channel = begin; channel < end; ++channel) {
      const int c = static_cast<int>(channel);
      for (size_t k = 0; k < count; ++k) {
        Level& level = pyramid[k];
        level.low.assign(static_cast<size_t>(widths[k]) * static_cast<size_t>(heights[k]), 0.0f);
        if (k > 0) {
          apply(reduce[k - 1], pyramid[k - 1].low.data(), level.low.data(), 1, scratch);
          continue;
        }
        const float *a = colour.plane(c), *b = target.plane(c);
        for (size_t i = 0; i < level.size(); ++i) level.low[i] = a[i] - b[i];
      }
      for (size_t k = 0; k < count; ++k) {
        Level& level = pyramid[k];
        level.band = level.low;
        if (k + 1 < count)
          apply(expand[k], pyramid[k + 1].low.data(), level.band.data(), -1, scratch);
        const double samples =
            static_cast<double>(level.size()) * static_cast<double>(count) * channels;
        const auto step = static_cast<float>(weight / samples);
        level.d.resize(level.size());
        double sum = 0;
        for (size_t i = 0; i < level.size(); ++i) {
          const float v = level.band[i];
          sum += static_cast<double>(std::abs(v));
          level.d[i] = v > 0 ? step : (v < 0 ? -step : 0.0f);
        }
        sums[channel] += sum / samples;
        level.band = level.d;  // the bands' own derivatives: coarser ones are added to `d`
      }
      if (d_colour == nullptr) continue;
      for (size_t k = count - 1; k > 0; --k) {
        apply_transposed(expand[k - 1], pyramid[k - 1].band.data(), pyramid[k].d.data(), -1,
                         scratch);
        apply_transposed(reduce[k - 1], pyramid[k].d.data(), pyramid[k - 1].d.data(), 1, scratch);
      }
      float* out = d_colour->plane(c);
      for (size_t i = 0; i < pyramid[0].size(); ++i) out[i] += pyramid[0].d[i];
    }
  });
  double total = 0;
  for (const double sum : sums) total += sum;
  return total;
}

}  // namespace effigy
