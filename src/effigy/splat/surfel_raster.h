// The surfel rasterizer: textured 2D Gaussians (2DGS ray-splat intersection, Huang et al. 2024,
// with GTAvatar's texture lookup at each intersection), forward and backward.
//
// For a pixel's ray, surfels in order of camera z of their centres (ties by index):
//   (u, v) in sigmas and depth z at the intersection; skipped when z <= near;
//   rho = u^2 + v^2, or with the low-pass min(u^2 + v^2, 2 |x - centre|^2) (pixels);
//   a = min(0.99, opacity exp(-rho / 2)); skipped when a < 1/255;
//   T (1 - a) < 1e-4: the pixel is finished before this surfel; else w = a T, T *= 1 - a;
//   uv = uv_centre + uv_per_st (u, v), bilinear lookup, clamped to the edge texels;
//   outputs are plain sums of w times the value (not divided by alpha).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/image/image.h"
#include "effigy/splat/bind.h"

namespace effigy {

// Material texture as the kernels read it: 8 floats a texel, interleaved (one 32-byte load a tap):
// albedo r g b, roughness, F0, normal x, normal y, spare. Row 0 is v = 0 (NOT image order).
struct MaterialTexture {
  int width = 0, height = 0;
  std::vector<float> texels;  // height * width * 8
  MaterialTexture() = default;
  MaterialTexture(int w, int h) : width(w), height(h), texels(static_cast<size_t>(w) * h * 8) {}
};

// Planes of a G-buffer (image/image.h Planes with kGBufferPlanes planes).
enum GBufferPlane : int {
  kAlpha = 0,
  kDepth = 1,   // sum of w z, camera-space metres
  kAlbedo = 2,  // 3, linear
  kRoughness = 5,
  kSpecular = 6,       // F0
  kNormal = 7,         // 3, world, without the normal map, facing the camera
  kMappedNormal = 10,  // 3, world, with the normal map
  kUv = 13,            // 2
  kUvDistortion = 15,
  kGBufferPlanes = 16,
};

enum class UvDistortion {
  kOff,
  kNorm,     // sum over ordered pairs of w_i w_j |uv_i - uv_j| (the paper's)
  kSquared,  // the same with the squared distance (closed form)
};

struct SurfelRasterOptions {
  bool low_pass = true;
  float near = 0.01f;
  UvDistortion uv_distortion = UvDistortion::kOff;
  // Surfels behind the first whose uv is further than this from the pixel's first uv are left out
  // of the distortion sum (so that lips, lids and ears are not pulled together); <= 0: no limit.
  float uv_distortion_threshold = 0.0f;
};

// What forward leaves for backward: bins, order, per-pixel transmittances. Reusable between frames
// (keeps its memory).
class SurfelFrame {
 public:
  SurfelFrame();
  ~SurfelFrame();
  SurfelFrame(SurfelFrame&&) noexcept;
  SurfelFrame& operator=(SurfelFrame&&) noexcept;
  // Splat-pixel pairs blended in the last forward pass.
  int64_t pairs() const;

  struct State;
  std::unique_ptr<State> state;
};

// Draws into `gbuffer` (resized to the camera, kGBufferPlanes planes). Accuracy contract: outputs
// within 1e-4 relative of the double-precision oracle (99.9th percentile).
void render_surfels(const Camera& camera, const PosedSurfels& surfels,
                    const MaterialTexture& texture, const SurfelRasterOptions& options,
                    Planes& gbuffer, SurfelFrame& frame);

// Material texture as playback reads it: half floats in the order of MaterialTexture (one 16-byte
// load a tap), which halves what the lookups fetch from memory. Values beyond +-65504 are infinite.
class PlaybackTexture {
 public:
  PlaybackTexture() = default;
  explicit PlaybackTexture(const MaterialTexture& texture);
  int width() const { return width_; }
  int height() const { return height_; }
  const uint16_t* texels() const { return texels_.get(); }  // height * width * 8

 private:
  struct Free {
    void operator()(uint16_t* p) const;
  };
  int width_ = 0, height_ = 0;
  std::unique_ptr<uint16_t[], Free> texels_;
};

// Playback: as render_surfels without kUvDistortion (that plane is 0), but surfels that follow each
// other along a ray and agree about the texture coordinate within `spread_texels` share one lookup
// at their mean. The error is of second order in the spread. 0: a lookup for every surfel.
struct PlaybackOptions {
  float near = 0.01f;
  bool low_pass = true;
  float spread_texels = 1.0f;
  // A pixel is done once less than this share of light passes what was blended; its last surfel
  // takes that share, so alpha is at most this much too large and no larger part of the pixel has
  // its last surfel's material instead of what lies behind. 0: as render_surfels.
  float opaque = 1.0f / 64.0f;
  // Draws the planes that shading reads (alpha, albedo, roughness, F0, mapped normal; where a tile
  // has no surfels only alpha) and leaves the others as they are.
  bool only_shading = false;
};
void render_surfels_playback(const Camera& camera, const PosedSurfels& surfels,
                             const PlaybackTexture& texture, const PlaybackOptions& options,
                             Planes& gbuffer, SurfelFrame& frame);

// Backward of the last render_surfels with the same arguments. `d_gbuffer`: derivative of the loss
// with respect to every plane. Adds to `d_surfels` (sized like surfels) and `d_texels` (8 floats a
// texel, sized like the texture). Bit-reproducible for a given thread count.
void render_surfels_backward(const Camera& camera, const PosedSurfels& surfels,
                             const MaterialTexture& texture, const SurfelRasterOptions& options,
                             const Planes& gbuffer, const SurfelFrame& frame,
                             const Planes& d_gbuffer, PosedSurfels& d_surfels,
                             std::vector<float>& d_texels);

}  // namespace effigy
