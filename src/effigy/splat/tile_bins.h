// Which surfels reach which tile. Internal to splat/.
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/splat/surfel_prepare.h"

namespace effigy {

inline constexpr int kTileSize = 16;  // pixels, both ways

// Tiles first..last of a tile row that a surfel (index into SurfelView) reaches.
struct TileSpan {
  uint32_t surfel;
  uint16_t row, first, last;
};

// Lists of surfels (indices into SurfelView, nearest first) of every tile, row by row.
struct TileBins {
  int columns = 0, rows = 0;
  std::vector<uint32_t> begin;    // columns * rows + 1
  std::vector<uint32_t> entries;  // indices into SurfelView::records
  // Scratch of bin_surfels, kept to keep its memory: spans of runs of surfels, in order.
  std::vector<std::vector<TileSpan>> spans;
  std::vector<uint32_t> next;
  int count() const { return columns * rows; }
};

// A surfel is in a tile's list exactly when its outline contains, within a fraction of a pixel, a
// pixel centre of the tile's rows and columns.
void bin_surfels(const SurfelView& view, int width, int height, TileBins& bins);

}  // namespace effigy
