#include "effigy/splat/tile_bins.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

struct Range {
  int first, last;  // inclusive; empty when last < first
};

// Pixels whose centres lie in [low, high], cut to the image.
Range pixels_between(float low, float high, int size) {
  const float limit = static_cast<float>(size);
  return {static_cast<int>(std::ceil(std::clamp(low, 0.0f, limit) - 0.5f)),
          std::min(size - 1, static_cast<int>(std::floor(std::clamp(high, -1.0f, limit) - 0.5f)))};
}

// Extends [left, right] by the x-range of the outline's ellipse in rows [top, bottom].
void ellipse_in_band(const SurfelOutline& o, float top, float bottom, float& left, float& right) {
  const float reach = 1.0f / std::sqrt(o.inverse_yy);
  const float d0 = std::max(top - o.y, -reach), d1 = std::min(bottom - o.y, reach);
  if (d0 > d1) return;
  const auto half = [&](float dy) {
    return std::sqrt(o.k * std::max(0.0f, 1.0f - dy * dy * o.inverse_yy));
  };
  // x + slope dy + half(dy) is concave with its maximum at extreme_dy; the left side mirrors it.
  const float at_right = std::clamp(o.extreme_dy, d0, d1);
  const float at_left = std::clamp(-o.extreme_dy, d0, d1);
  right = std::max(right, o.x + o.slope * at_right + half(at_right));
  left = std::min(left, o.x + o.slope * at_left - half(at_left));
}

void disc_in_band(const SurfelOutline& o, float top, float bottom, float& left, float& right) {
  if (o.disc_squared <= 0.0f) return;
  const float dy = std::clamp(0.0f, top - o.disc_y, bottom - o.disc_y);
  const float rest = o.disc_squared - dy * dy;
  if (rest < 0.0f) return;
  left = std::min(left, o.disc_x - std::sqrt(rest));
  right = std::max(right, o.disc_x + std::sqrt(rest));
}

// Rows of pixels that the outline can reach.
Range rows_of(const SurfelRecord& r, const SurfelOutline& o, int height) {
  if (o.everywhere) return {0, height - 1};
  const float reach = 1.0f / std::sqrt(o.inverse_yy);
  float top = o.y - reach, bottom = o.y + reach;
  if (o.disc_squared > 0.0f) {
    const float radius = std::sqrt(o.disc_squared);
    top = std::min(top, o.disc_y - radius);
    bottom = std::max(bottom, o.disc_y + radius);
  }
  return pixels_between(r.anchor_y + top, r.anchor_y + bottom, height);
}

// Calls emit(tile row, first tile column, last tile column) for every tile row the surfel reaches.
template <typename Emit>
void for_each_span(const SurfelRecord& r, const SurfelOutline& o, int width, int height,
                   const Emit& emit) {
  const Range rows = rows_of(r, o, height);
  if (rows.last < rows.first) return;
  for (int ty = rows.first / kTileSize; ty <= rows.last / kTileSize; ++ty) {
    Range columns{0, width - 1};
    if (!o.everywhere) {
      const float base = static_cast<float>(ty * kTileSize) - r.anchor_y;
      float left = 1e30f, right = -1e30f;
      ellipse_in_band(o, base + 0.5f, base + kTileSize - 0.5f, left, right);
      disc_in_band(o, base + 0.5f, base + kTileSize - 0.5f, left, right);
      if (right < left) continue;
      columns = pixels_between(r.anchor_x + left, r.anchor_x + right, width);
      if (columns.last < columns.first) continue;
    }
    emit(ty, columns.first / kTileSize, columns.last / kTileSize);
  }
}

// The spans of each run of kRun surfels.
void find_spans(const SurfelView& view, int width, int height,
                std::vector<std::vector<TileSpan>>& spans) {
  constexpr size_t kRun = 512;
  const size_t n = view.records.size();
  spans.resize((n + kRun - 1) / kRun);
  parallel_for(spans.size(), 1, [&](size_t begin, size_t end, int) {
    for (size_t run = begin; run < end; ++run) {
      spans[run].clear();
      for (size_t i = run * kRun; i < std::min(n, (run + 1) * kRun); ++i)
        for_each_span(
            view.records[i], view.outlines[i], width, height, [&](int row, int first, int last) {
              spans[run].push_back({static_cast<uint32_t>(i), static_cast<uint16_t>(row),
                                    static_cast<uint16_t>(first), static_cast<uint16_t>(last)});
            });
    }
  });
}

}  // namespace

void bin_surfels(const SurfelView& view, int width, int height, TileBins& bins) {
  bins.columns = (width + kTileSize - 1) / kTileSize;
  bins.rows = (height + kTileSize - 1) / kTileSize;
  std::vector<uint64_t> count(static_cast<size_t>(bins.count()) + 1, 0);
  find_spans(view, width, height, bins.spans);
  for (const std::vector<TileSpan>& run : bins.spans)
    for (const TileSpan& span : run) {
      uint64_t* tile = count.data() + static_cast<size_t>(span.row) * bins.columns + 1;
      for (int tx = span.first; tx <= span.last; ++tx) ++tile[tx];
    }
  for (size_t t = 1; t < count.size(); ++t) count[t] += count[t - 1];
  if (count.back() > 0x7fffffffu)
    throw Error(
        "The surfels cover more than two thousand million tiles in all; they are far too "
        "large for this image.");
  bins.begin.assign(count.begin(), count.end());
  bins.entries.resize(bins.begin.back());
  bins.next.assign(bins.begin.begin(), bins.begin.end() - 1);
  for (const std::vector<TileSpan>& run : bins.spans)
    for (const TileSpan& span : run) {
      uint32_t* tile = bins.next.data() + static_cast<size_t>(span.row) * bins.columns;
      for (int tx = span.first; tx <= span.last; ++tx) bins.entries[tile[tx]++] = span.surfel;
    }
}

}  // namespace effigy
