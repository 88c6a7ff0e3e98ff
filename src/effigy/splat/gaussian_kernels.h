// The inner loops of the Gaussian rasterizer, one tile at a time. Internal to splat/; the code is
// in gaussian_kernels-inl.h, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "effigy/splat/aligned_floats.h"
#include "effigy/splat/gaussian_prepare.h"
#include "effigy/splat/tile_bins.h"

namespace effigy {

// What every tile of a frame shares. Plane p of pixel (x, y) is at p * plane_size + y * row_size +
// x; plane 0 is alpha, plane 1 + c channel c.
struct GaussianTarget {
  const GaussianRecord* records = nullptr;
  const float* features = nullptr;    // channels of every Gaussian
  const float* background = nullptr;  // channels
  size_t channels = 0;
  float* image = nullptr;          // forward writes, backward reads
  const float* d_image = nullptr;  // backward: derivative of the loss
  size_t plane_size = 0, row_size = 0;
};

// Memory of one thread.
struct alignas(64) GaussianWorkspace {
  // Planes of the tile's pixels: for every vector of pixels its planes one after the other, so that
  // a visit touches one stretch of memory. Each pass has its own planes.
  AlignedFloats block;
  // Backward: one vector for each sum.
  AlignedFloats sums;
  int64_t pairs = 0;  // blended in the last tile
  size_t used = 0;    // entries walked before every pixel was finished
};

struct GaussianKernels {
  // Draws the tile; sets pairs and used.
  void (*forward)(const GaussianTarget&, const SplatTile&, GaussianWorkspace&);
  // Writes GaussianSums::kCount + channels floats for every entry of the tile, at the place that
  // `places` gives it, and the derivative with respect to the background, channels floats, unless
  // that is null.
  void (*backward)(const GaussianTarget&, const SplatTile&, GaussianWorkspace&,
                   const uint32_t* places, float* entry_sums, float* d_background);
  const char* target;  // name of the instruction set
};

// The best this machine has (respects hwy::SetSupportedTargetsForTest).
GaussianKernels best_gaussian_kernels();
// Highway's target bits that are compiled in and that this machine has.
std::vector<int64_t> gaussian_kernel_targets();
// The same source compiled for one lane.
GaussianKernels scalar_gaussian_kernels();

}  // namespace effigy
