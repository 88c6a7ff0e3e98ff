#include "effigy/track/matte.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/image/resample.h"
#include "effigy/track/guided_filter.h"

namespace effigy {
namespace {

constexpr int kSide = 256;

// Levels of the refined matte: the filter leaves a haze around the edge and a little transparency
// within.
constexpr float kHaze = 0.12f, kOpaque = 0.9f;

}  // namespace

PersonSegmenter::PersonSegmenter(const ModelSet& models)
    : network_(
          Network::from_tflite(models.matte, "the matte network " + models.matte_path.string())),
      input_({1, kSide, kSide, 3}) {
  if (network_.input_shapes() != std::vector<std::vector<int64_t>>{{1, kSide, kSide, 3}} ||
      network_.output_shapes()[0] != std::vector<int64_t>{1, kSide, kSide, 1})
    throw Error(network_.name() +
                ": not the expected network (its input or output has another shape); replace it by "
                "the published file.");
}

Image PersonSegmenter::segment(const Image8& picture) {
  EFFIGY_CHECK_EQ(picture.channels, 3);
  const Image8 small =
      picture.width == kSide && picture.height == kSide
          ? picture
          : crop_resize(picture, 0, 0, picture.width, picture.height, kSide, kSide);
  for (size_t i = 0; i < small.data.size(); ++i)
    input_.data[i] = static_cast<float>(small.data[i]) * (1.0f / 255.0f);
  Image matte(kSide, kSide, 1);
  matte.data = network_.run({input_})[0].data;
  for (float& value : matte.data)
    value = std::isfinite(value) ? std::clamp(value, 0.0f, 1.0f) : 0.0f;
  return matte;
}

PlaneSimilarity fit_similarity(const std::vector<double>& from, const std::vector<double>& to) {
  EFFIGY_CHECK_EQ(from.size(), to.size());
  const size_t n = from.size() / 2;
  double fx = 0, fy = 0, tx = 0, ty = 0;
  for (size_t i = 0; i < n; ++i) {
    fx += from[2 * i];
    fy += from[2 * i + 1];
    tx += to[2 * i];
    ty += to[2 * i + 1];
  }
  PlaneSimilarity result;
  if (n == 0) return result;
  const double count = static_cast<double>(n);
  fx /= count;
  fy /= count;
  tx /= count;
  ty /= count;
  double dot = 0, cross = 0, square = 0;
  for (size_t i = 0; i < n; ++i) {
    const double x = from[2 * i] - fx, y = from[2 * i + 1] - fy;
    const double s = to[2 * i] - tx, t = to[2 * i + 1] - ty;
    dot += x * s + y * t;
    cross += x * t - y * s;
    square += x * x + y * y;
  }
  if (square > 0) {
    result.a = dot / square;
    result.b = cross / square;
  }
  result.u = tx - (result.a * fx - result.b * fy);
  result.v = ty - (result.b * fx + result.a * fy);
  return result;
}

namespace {

// Adds pixels [begin, end) of row y, taken from where `map` leads, to `sum`.
EFFIGY_CLONES void add_moved(const float* other, int width, const PlaneSimilarity& map, int y,
                             int begin, int end, float* sum, float* weight) {
  const double column = -map.b * (y + 0.5) + map.u - 0.5, row = map.a * (y + 0.5) + map.v - 0.5;
  for (int x = begin; x < end; ++x) {
    const double sx = map.a * (x + 0.5) + column, sy = map.b * (x + 0.5) + row;
    const int x0 = static_cast<int>(sx), y0 = static_cast<int>(sy);
    const float fx = static_cast<float>(sx - x0), fy = static_cast<float>(sy - y0);
    const float *p = other + (y0 * width + x0), *q = p + width;
    sum[x] += (p[0] + fx * (p[1] - p[0])) * (1 - fy) + (q[0] + fx * (q[1] - q[0])) * fy;
    weight[x] += 1.0f;
  }
}

}  // namespace

Image steady_matte(const Image& here, const Image* before, const PlaneSimilarity& before_from_here,
                   const Image* after, const PlaneSimilarity& after_from_here) {
  const int width = here.width, height = here.height;
  Image out = here;
  for (float& value : out.data) value *= 2.0f;
  std::vector<float> weight(here.data.size(), 2.0f);
  const auto add = [&](const Image* other, const PlaneSimilarity& map) {
    if (other == nullptr) return;
    EFFIGY_CHECK(other->width == width && other->height == height);
    for (int y = 0; y < height; ++y) {
      const auto inside = [&](int x) {
        const double sx = map.a * (x + 0.5) - map.b * (y + 0.5) + map.u - 0.5;
        const double sy = map.b * (x + 0.5) + map.a * (y + 0.5) + map.v - 0.5;
        // Far enough from the edges that rounding another way does not leave the picture.
        constexpr double kEdge = 1e-6;
        return sx >= kEdge && sy >= kEdge && sx < width - 1 - kEdge && sy < height - 1 - kEdge;
      };
      // A line meets the picture in one stretch.
      int begin = 0, end = width;
      while (begin < end && !inside(begin)) ++begin;
      while (end > begin && !inside(end - 1)) --end;
      const size_t row = static_cast<size_t>(y) * width;
      add_moved(other->data.data(), width, map, y, begin, end, &out.data[row], &weight[row]);
    }
  };
  add(before, before_from_here);
  add(after, after_from_here);
  for (size_t i = 0; i < out.data.size(); ++i) out.data[i] /= weight[i];
  return out;
}

Image refine_matte(const Image8& picture, const Image& coarse, int working_side, double radius,
                   double epsilon) {
  EFFIGY_CHECK(picture.channels == 3 && coarse.channels == 1);
  const int longer = std::max(picture.width, picture.height);
  const double shrink = std::min(1.0, static_cast<double>(working_side) / longer);
  const int width = std::max(1, static_cast<int>(std::lround(picture.width * shrink)));
  const int height = std::max(1, static_cast<int>(std::lround(picture.height * shrink)));
  const Image8 guide =
      width == picture.width && height == picture.height
          ? picture
          : crop_resize(picture, 0, 0, picture.width, picture.height, width, height);
  const Image matte =
      coarse.width == width && coarse.height == height ? coarse : resize(coarse, width, height);
  const int reach = std::max(1, static_cast<int>(std::lround(radius * std::max(width, height))));
  const std::vector<float> coefficients =
      guided_coefficients(guide, matte, reach, static_cast<float>(epsilon));
  return apply_guided(picture, coefficients, width, height, kHaze, kOpaque);
}

namespace {

// For each column the lowest point of the projected ring (its front), held at the ends.
std::vector<double> neck_line(const std::vector<double>& ring, int width) {
  std::vector<double> line(width, -1e30);
  const size_t n = ring.size() / 2;
  size_t leftmost = 0, rightmost = 0;
  for (size_t i = 0; i < n; ++i) {
    if (ring[2 * i] < ring[2 * leftmost]) leftmost = i;
    if (ring[2 * i] > ring[2 * rightmost]) rightmost = i;
    const size_t k = (i + 1) % n;
    double x0 = ring[2 * i], y0 = ring[2 * i + 1], x1 = ring[2 * k], y1 = ring[2 * k + 1];
    if (x1 < x0) {
      std::swap(x0, x1);
      std::swap(y0, y1);
    }
    const int first = std::max(0, static_cast<int>(std::ceil(x0 - 0.5)));
    const int last = std::min(width - 1, static_cast<int>(std::floor(x1 - 0.5)));
    for (int x = first; x <= last; ++x) {
      const double t = x1 > x0 ? std::clamp((x + 0.5 - x0) / (x1 - x0), 0.0, 1.0) : 0.0;
      line[x] = std::max(line[x], y0 + t * (y1 - y0));
    }
  }
  for (int x = 0; x < width; ++x) {
    if (x + 0.5 <= ring[2 * leftmost]) line[x] = ring[2 * leftmost + 1];
    if (x + 0.5 >= ring[2 * rightmost]) line[x] = ring[2 * rightmost + 1];
  }
  return line;
}

// Marks what is connected with (x, y) through pixels of at least half coverage, row by row.
std::vector<uint8_t> connected(const Image& matte, int x, int y) {
  std::vector<uint8_t> inside(matte.data.size(), 0);
  const int width = matte.width, height = matte.height;
  std::vector<int> stack;
  const auto open = [&](int i) { return inside[i] == 0 && matte.data[i] >= 0.5f; };
  if (x >= 0 && y >= 0 && x < width && y < height && open(y * width + x))
    stack.push_back(y * width + x);
  while (!stack.empty()) {
    const int seed = stack.back(), row = seed / width * width;
    stack.pop_back();
    if (!open(seed)) continue;
    int first = seed, end = seed + 1;
    while (first > row && open(first - 1)) --first;
    while (end < row + width && open(end)) ++end;
    std::fill(&inside[first], &inside[first] + (end - first), uint8_t{1});
    for (const int step : {-width, width}) {
      if (row + step < 0 || row + step >= width * height) continue;
      // One seed for each stretch beside this one.
      for (int i = first + step; i < end + step; ++i)
        if (open(i) && (i == first + step || !open(i - 1))) stack.push_back(i);
    }
  }
  return inside;
}

}  // namespace

// Shoulders that stick out sideways above the ring belong to no head: from a little above the ring
// downwards only what lies between its left and right ends stays.
static void cut_shoulders(const HeadRegion& region, Image& cut) {
  double left = 1e9, right = -1e9, top = 1e9;
  for (size_t k = 0; k + 1 < region.neck_ring.size(); k += 2) {
    left = std::min(left, region.neck_ring[k]);
    right = std::max(right, region.neck_ring[k]);
    top = std::min(top, region.neck_ring[k + 1]);
  }
  const double start = top - 0.3 * (right - left);
  const auto rise = [&](double distance) {
    const double t = std::clamp(distance / region.softness + 0.5, 0.0, 1.0);
    return t * t * (3 - 2 * t);
  };
  std::vector<double> beside(cut.width);
  for (int x = 0; x < cut.width; ++x)
    beside[x] = 1 - rise(x + 0.5 - left) * rise(right - (x + 0.5));
  for (int y = 0; y < cut.height; ++y) {
    const double below = rise(y + 0.5 - start);
    if (below <= 0) continue;
    float* row = cut.at(0, y);
    for (int x = 0; x < cut.width; ++x) row[x] *= static_cast<float>(1 - below * beside[x]);
  }
}

Image8 head_matte(const Image& matte, const HeadRegion& region) {
  EFFIGY_CHECK_EQ(matte.channels, 1);
  Image cut = matte;
  if (!region.neck_ring.empty()) {
    const std::vector<double> line = neck_line(region.neck_ring, matte.width);
    const double highest = *std::min_element(line.begin(), line.end());
    for (int y = 0; y < matte.height; ++y) {
      if (highest - (y + 0.5) >= region.softness) continue;  // nothing is cut so far up
      float* row = cut.at(0, y);
      for (int x = 0; x < matte.width; ++x) {
        const double t = std::clamp((line[x] - (y + 0.5)) / region.softness + 0.5, 0.0, 1.0);
        row[x] *= static_cast<float>(t * t * (3 - 2 * t));
      }
    }
    cut_shoulders(region, cut);
  }
  const int x = static_cast<int>(region.head_x), y = static_cast<int>(region.head_y);
  const std::vector<uint8_t> inside = connected(cut, x, y);
  // Soft pixels belong to what they border on: keep those within reach of a connected one.
  const bool any = std::find(inside.begin(), inside.end(), 1) != inside.end();
  const int reach = std::max(2, std::max(matte.width, matte.height) / 64);
  std::vector<float> near(inside.begin(), inside.end()), spread(near.size());
  if (any) box_mean(near, matte.width, matte.height, reach, spread);
  for (size_t i = 0; any && i < cut.data.size(); ++i)
    if (!(spread[i] > 1e-6f)) cut.data[i] = 0;
  return to_8bit(cut);
}

}  // namespace effigy
