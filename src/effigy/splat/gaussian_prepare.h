// From Gaussians to what the kernels read, and back for derivatives. Internal to splat/.
//
// With C = [[xx, xy], [xy, yy]], slope = xy / yy and k = det C / yy (the variance of x when y is
// known), d^T C^-1 d = u^2 + v^2 with u = (dx - slope dy) / sqrt(k), v = dy / sqrt(yy). Unlike the
// three numbers of C^-1 these lose nothing when the ellipse is long and thin; the backward kernel
// sums moments of (u, v), so neither do the derivatives.
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/splat/depth_sort.h"
#include "effigy/splat/gaussian_raster.h"
#include "effigy/splat/tile_bins.h"

namespace effigy {

// One visible Gaussian, as the kernels read it: alpha = min(0.99, 2^(log2_opacity - u^2 - v^2)),
// u = a dx + b dy, v = c dy, (dx, dy) = pixel - anchor - (outline.x, outline.y).
struct alignas(64) GaussianRecord {
  float anchor_x, anchor_y;  // the mean rounded to whole pixels
  EllipseOutline outline;    // its centre is the mean
  float a, b, c;
  float log2_opacity;
};

// The tiles that a small Gaussian reaches, found when it is projected.
struct TileCover {
  static constexpr int kRows = 2;        // rows of tiles that fit
  static constexpr uint16_t kMore = ~0;  // `rows` of a Gaussian that reaches further
  uint16_t row, rows;                    // first and number
  uint16_t first[kRows], last[kRows];    // columns; none in a row where last < first

  // Calls emit as find of bin_splats does; rows != kMore.
  template <class Emit>
  void for_each_span(const Emit& emit) const {
    for (int r = 0; r < kRows; ++r) {
      const int really = static_cast<int>(r < rows) & static_cast<int>(first[r] <= last[r]);
      emit(really * (row + r), really * first[r], really * last[r], really != 0);
    }
  }
};

struct GaussianList {
  std::vector<GaussianRecord> records;  // per Gaussian of the view; only of those seen
  std::vector<TileCover> covers;        // likewise
  std::vector<uint8_t> seen;
  std::vector<double> depth;
  std::vector<uint32_t> order;  // of those seen, by depth, ties by index
  DepthSort sort;
};

// Which Gaussians can be seen, and their order.
void prepare_gaussians(const Camera& camera, const GaussianView& gaussians,
                       const GaussianRasterOptions& options, GaussianList& list);

// What the backward kernel finds of one Gaussian in one tile: derivatives of the loss with respect
// to ln alpha, summed over pixels, times moments of (u, v) as the kernels scale them; behind them
// those with respect to the features.
struct GaussianSums {
  enum : int { kOne = 0, kU, kV, kUU, kUV, kVV, kCount };
};

// The sums of every entry, `stride` floats each, at the entry's place in `bins`.
struct EntrySums {
  const TileBins& bins;
  const float* values;
  size_t stride;

  // Adds those of Gaussian k in order of depth, tile by tile.
  void add(size_t k, double* total) const {
    const float* end = values + bins.first_place[k + 1] * stride;
    for (const float* entry = values + bins.first_place[k] * stride; entry < end; entry += stride)
      for (size_t i = 0; i < stride; ++i) total[i] += static_cast<double>(entry[i]);
  }
  // Fetches the first of them into the cache.
  void prefetch(size_t k) const {
    const auto* at = reinterpret_cast<const char*>(values + bins.first_place[k] * stride);
    __builtin_prefetch(at);
    __builtin_prefetch(at + 64);
  }
};

// Adds the derivatives of all Gaussians to `gradients`.
void gaussians_backward(const Camera& camera, const GaussianView& gaussians,
                        const GaussianRasterOptions& options, const GaussianList& list,
                        const EntrySums& entries, const GaussianGradients& gradients);

}  // namespace effigy
