// The inner loops of the surfel rasterizer, one tile at a time. Internal to splat/; the code is in
// surfel_kernels-inl.h, compiled once per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "effigy/splat/aligned_floats.h"
#include "effigy/splat/surfel_prepare.h"
#include "effigy/splat/surfel_raster.h"
#include "effigy/splat/tile_bins.h"

namespace effigy {

inline constexpr size_t kMostPlanes = 32;

// What every tile of a frame shares.
struct SurfelScene {
  const SurfelRecord* records = nullptr;
  const SurfelOutline* outlines = nullptr;
  const float* texels = nullptr;          // 8 floats each, row 0 = v 0
  const uint16_t* half_texels = nullptr;  // playback: 8 half floats each
  int texture_width = 0, texture_height = 0;
  float near = 0.0f;
  bool low_pass = false;
  UvDistortion uv_distortion = UvDistortion::kOff;
  float uv_threshold = 0.0f;
  float spread = 0.0f;        // playback: texels
  float opaque = 0.0f;        // playback: transmittance below which a pixel is done
  bool own_normals = false;   // playback: some frame's normal is not the surfel's own
  bool only_shading = false;  // playback: draw only the planes that shading reads
  // Forward and playback write, backward reads: plane c of pixel (x, y) is at
  // gbuffer[c * plane_size + y * row_size + x].
  float* gbuffer = nullptr;
  const float* d_gbuffer = nullptr;  // backward: derivative of the loss
  size_t plane_size = 0, row_size = 0;
};

// Memory of one thread.
struct alignas(64) SurfelWorkspace {
  // Planes of the tile's pixels: for every vector of pixels its planes one after the other, so that
  // a visit touches one stretch of memory. Each pass has its own planes.
  float block[kTilePixels * kMostPlanes];
  int64_t pairs = 0;  // blended in the last tile
  size_t used = 0;    // entries walked before every pixel was finished

  // UV distortion: the lists of every vector of pixels, see uv_distortion-inl.h.
  AlignedFloats list, d_list;
  size_t list_stride = 0;
  size_t listed[kTilePixels];  // entries of each vector
  size_t cursor[kTilePixels];  // entries that backward has taken
  bool list_ended[kTilePixels];
  alignas(64) float list_state[4 * kTilePixels];
};

// Gradient buffers of one thread.
struct SurfelGradientBuffers {
  float* texels = nullptr;     // 8 floats a texel
  uint8_t* touched = nullptr;  // one byte per kTexelBlock texels whose upper-left tap is inside
  float* sums = nullptr;       // SurfelSums::kCount floats a record
};
inline constexpr int kTexelBlock = 64;

struct SurfelKernels {
  // Draws the tile into the G-buffer; sets pairs and used.
  void (*forward)(const SurfelScene&, const SplatTile&, SurfelWorkspace&);
  // Adds to the buffers.
  void (*backward)(const SurfelScene&, const SplatTile&, SurfelWorkspace&,
                   const SurfelGradientBuffers&);
  // Like forward, without the UV distortion and with shared lookups.
  void (*playback)(const SurfelScene&, const SplatTile&, SurfelWorkspace&);
  // Rounds `count` floats, a multiple of 8, to half precision.
  void (*halve)(const float*, size_t count, uint16_t*);
  const char* target;  // name of the instruction set
};

// The best this machine has (respects hwy::SetSupportedTargetsForTest).
SurfelKernels best_surfel_kernels();
// Highway's target bits that are compiled in and that this machine has.
std::vector<int64_t> surfel_kernel_targets();
// The same source compiled for one lane.
SurfelKernels scalar_surfel_kernels();

}  // namespace effigy
