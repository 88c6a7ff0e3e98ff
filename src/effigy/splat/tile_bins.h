// Which splats reach which tile: shared by the surfel and the Gaussian rasterizer. Internal to
// splat/.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "effigy/base/threads.h"
#include "effigy/geometry/types.h"

namespace effigy {

inline constexpr int kTileSize = 16;  // pixels, both ways
inline constexpr size_t kTilePixels = kTileSize * kTileSize;

// The region where a splat's alpha can reach 1/255, in pixels relative to its anchor: an ellipse
// with centre (x, y), rows y + dy spanning x + slope dy -+ sqrt(k (1 - dy^2 inverse_yy)).
struct EllipseOutline {
  float x, y, slope, k, inverse_yy;
  float extreme_dy;      // dy of the rightmost point
  float half_x, half_y;  // of the box around it
  bool everywhere;       // no outline is known
};

// Tiles first..last of a tile row that a splat (index in order of depth) reaches.
struct TileSpan {
  uint32_t splat;
  uint16_t row, first, last;
};

// Spans in the order in which they were found.
struct TileSpans {
  std::vector<TileSpan> memory;
  size_t count = 0;  // those in use

  // Adds the span if `really`: no branch asks, since the answer often cannot be foreseen.
  void add(const TileSpan& span, bool really) {
    if (count == memory.size()) memory.resize(2 * count + 1024);
    memory[count] = span;
    count += really;
  }
};

// Lists of splats, nearest first, of every tile, row by row.
struct TileBins {
  int columns = 0, rows = 0;
  std::vector<uint32_t> begin;    // columns * rows + 1
  std::vector<uint32_t> entries;  // ids of splats
  // After place_entries: every entry has a place, those of splat k in order of depth are
  // first_place[k] .. first_place[k + 1].
  std::vector<uint32_t> places, first_place;
  // Of every slot: what it found, and scratch of bin_splats; kept for place_entries and to keep
  // their memory.
  std::vector<TileSpans> spans;
  std::vector<std::vector<uint32_t>> next;
  int count() const { return columns * rows; }
};

// A tile of an image and the splats that reach it.
struct SplatTile {
  int x = 0, y = 0, width = 0, height = 0;  // pixels; width and height <= kTileSize
  const uint32_t* entries = nullptr;
  size_t count = 0;
};
SplatTile make_tile(const Camera& camera, const TileBins& bins, int tile);

// Throws Error for an image that is empty or too large, or a camera that cannot draw.
void check_camera(const Camera& camera);

namespace detail {

// Sizes the lists of `slots` slots.
void begin_bins(int width, int height, size_t slots, TileBins& bins);
// From each slot's spans and counts (next) to the lists.
void finish_bins(const uint32_t* ids, TileBins& bins);

}  // namespace detail

// Fills the lists of `splats` splats. find(k, emit) calls emit(tile row, first column, last column,
// true) for every row of tiles that splat k in order of depth reaches, and may call emit(row,
// column, column, false), which does nothing but must name a tile of the image. It is called from
// several threads. `ids`: what the lists hold for each splat; null: k itself.
template <class Find>
void bin_splats(size_t splats, const uint32_t* ids, int width, int height, TileBins& bins,
                const Find& find) {
  constexpr size_t kGrain = 2048;
  const size_t slots = std::clamp<size_t>(splats / kGrain, 1, static_cast<size_t>(thread_count()));
  detail::begin_bins(width, height, slots, bins);
  const int columns = bins.columns;
  run_slots(static_cast<int>(slots), [&](int slot) {
    const auto s = static_cast<size_t>(slot);
    TileSpans spans = std::move(bins.spans[s]);  // a copy that nothing else can write to
    uint32_t* const counts = bins.next[s].data();
    const size_t end = splats * (s + 1) / slots;
    for (size_t i = splats * s / slots; i < end; ++i)
      find(i, [&](int row, int first, int last, bool really) {
        spans.add({static_cast<uint32_t>(i), static_cast<uint16_t>(row),
                   static_cast<uint16_t>(first), static_cast<uint16_t>(last)},
                  really);
        // Nor whether there is a second column.
        uint32_t* const tiles = counts + row * columns;
        tiles[first] += really;
        for (int tx = first + 1; tx < last; ++tx) ++tiles[tx];
        tiles[last] += last != first;
      });
    bins.spans[s] = std::move(spans);
  });
  detail::finish_bins(ids, bins);
}

// Gives each entry of bin_splats' lists its place, unless that has been done. `splats`: as there.
void place_entries(size_t splats, TileBins& bins);

// Pixels first..last whose centres lie in [low, high], cut to the image; none when last < first.
struct PixelRange {
  int first, last;
};
inline PixelRange pixels_between(float low, float high, int size) {
  const float limit = static_cast<float>(size);
  // Comparisons with NaN are false, so it becomes the lower limit. The compiler makes vectors of
  // these, and not of std::clamp.
  low = low > 0.0f ? low : 0.0f;
  high = high > -0.5f ? high : -0.5f;
  // Rounding up and down by truncation, of numbers that are not negative; a centre within a
  // thousandth of a pixel of the end counts as inside.
  return {static_cast<int>((low < limit ? low : limit) + 0.499f),
          static_cast<int>((high < limit ? high : limit) + 0.501f) - 1};
}

// The x-range of the ellipse in rows [top, bottom]; left > right: none.
struct EllipseBand {
  float left, right;
};
inline EllipseBand ellipse_in_band(const EllipseOutline& o, float top, float bottom) {
  const float low = top - o.y, high = bottom - o.y;
  const float d0 = low > -o.half_y ? low : -o.half_y, d1 = high < o.half_y ? high : o.half_y;
  const auto half = [&](float dy) {
    const float rest = 1.0f - dy * dy * o.inverse_yy;
    return std::sqrt(o.k * (rest > 0.0f ? rest : 0.0f));
  };
  const auto clamped = [&](float dy) {
    dy = dy > d0 ? dy : d0;
    return dy < d1 ? dy : d1;
  };
  // x + slope dy + half(dy) is concave with its maximum at extreme_dy; the left side mirrors it.
  const float at_right = clamped(o.extreme_dy), at_left = clamped(-o.extreme_dy);
  const float right = o.x + o.slope * at_right + half(at_right);
  const float left = o.x + o.slope * at_left - half(at_left);
  return {d0 <= d1 ? left : 1e30f, d0 <= d1 ? right : -1e30f};
}

// Calls emit(tile row, first tile column, last tile column, true) for every row of tiles in which
// the outline contains, within a fraction of a pixel, a pixel centre. Outline: an EllipseOutline,
// which may also have a disc (disc_x, disc_y, disc_squared).
template <class Outline, class Emit>
void for_each_span(float anchor_x, float anchor_y, const Outline& o, int width, int height,
                   const Emit& emit) {
  constexpr bool kDisc = requires {
    o.disc_squared;
  };
  PixelRange rows{0, height - 1}, columns{0, width - 1};
  if (!o.everywhere) {
    float top = o.y - o.half_y, bottom = o.y + o.half_y;
    float left = o.x - o.half_x, right = o.x + o.half_x;
    if constexpr (kDisc) {
      if (o.disc_squared > 0.0f) {
        const float radius = std::sqrt(o.disc_squared);
        top = std::min(top, o.disc_y - radius);
        bottom = std::max(bottom, o.disc_y + radius);
        left = std::min(left, o.disc_x - radius);
        right = std::max(right, o.disc_x + radius);
      }
    }
    rows = pixels_between(anchor_y + top, anchor_y + bottom, height);
    columns = pixels_between(anchor_x + left, anchor_x + right, width);
  }
  if (rows.last < rows.first || columns.last < columns.first) return;
  const int first_row = rows.first / kTileSize, last_row = rows.last / kTileSize;
  const int first_column = columns.first / kTileSize, last_column = columns.last / kTileSize;
  if (o.everywhere || first_row == last_row || first_column == last_column) {
    for (int ty = first_row; ty <= last_row; ++ty) emit(ty, first_column, last_column, true);
    return;
  }
  for (int ty = first_row; ty <= last_row; ++ty) {
    const float base = static_cast<float>(ty * kTileSize) - anchor_y;
    const float top = base + 0.5f, bottom = base + kTileSize - 0.5f;
    auto [left, right] = ellipse_in_band(o, top, bottom);
    if constexpr (kDisc) {
      const float dy = std::clamp(0.0f, top - o.disc_y, bottom - o.disc_y);
      const float rest = o.disc_squared - dy * dy;
      if (o.disc_squared > 0.0f && rest >= 0.0f) {
        left = std::min(left, o.disc_x - std::sqrt(rest));
        right = std::max(right, o.disc_x + std::sqrt(rest));
      }
    }
    if (right < left) continue;
    columns = pixels_between(anchor_x + left, anchor_x + right, width);
    if (columns.last < columns.first) continue;
    emit(ty, columns.first / kTileSize, columns.last / kTileSize, true);
  }
}

}  // namespace effigy
