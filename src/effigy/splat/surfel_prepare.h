// From posed surfels to what the kernels read: per surfel the ray-splat intersection as three
// affine functions of the pixel, and the exact outline of the region where it can be seen. Internal
// to splat/.
//
// The intersection of the ray through pixel (x, y), r = ((x - cx)/fx, (y - cy)/fy, 1), with the
// plane p + u s + v t (camera space) is
//   u = A / C,  v = B / C,  z = D / C   with  A = (t x p).r,  B = (p x s).r,  C = (s x t).r,
//   D = p.(s x t):
// the homogeneous intersection of 2DGS (Huang et al. 2024) written out. A, B, C are affine in (x,
// y). They are expanded about an anchor pixel near the projected centre, where A = B = 0, so single
// precision loses nothing, and scaled by 1/|s x t|, which cancels in the quotients.
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/splat/bind.h"
#include "effigy/splat/depth_sort.h"
#include "effigy/splat/tile_bins.h"

namespace effigy {

// One visible surfel, as the kernels read it.
struct SurfelRecord {
  float anchor_x, anchor_y;  // pixels
  float a[3], b[3], c[3];    // value at the anchor, change per pixel in x, change per pixel in y
  float depth;               // D
  float log2_opacity;
  float rho_max;  // a >= 1/255 exactly where rho <= this
  // Low-pass: rho = 2 |pixel - (anchor + low_pass)|^2 and z = center_z. Far away when it is off.
  float low_pass_x, low_pass_y, center_z;
  int32_t filtered;  // 0: rho of the plane is never above that of the low-pass
  float uv[2], uv_per_st[4];
  float normal[3], frame[9];  // world, already flipped to face the camera
};

// The region where a >= 1/255 can hold, in pixels relative to the anchor: the ellipse and the
// low-pass disc.
struct SurfelOutline : EllipseOutline {
  float disc_x, disc_y, disc_squared;
};

struct SurfelView {
  std::vector<SurfelRecord> records;    // by depth, ties by index
  std::vector<SurfelOutline> outlines;  // same order
  std::vector<uint32_t> source;         // index into PosedSurfels

  // Scratch of prepare_surfels, kept to keep its memory; per surfel of PosedSurfels.
  std::vector<SurfelRecord> all_records;
  std::vector<SurfelOutline> all_outlines;
  std::vector<uint8_t> seen;
  std::vector<double> depth;
  DepthSort sort;
};

// Surfels that can be seen, sorted by camera z of the centre. Left out: values that are not finite,
// opacity below 1/255, no area, wholly behind `near` or outside the image.
void prepare_surfels(const Camera& camera, const PosedSurfels& surfels, float near, bool low_pass,
                     SurfelView& view);

// Derivatives of the loss with respect to what the kernel reads of one surfel, as sums over pixels
// of (dx, dy) = pixel - anchor.
struct SurfelSums {
  enum : int {
    kA = 0,  // 3: sum g_A, sum g_A dx, sum g_A dy
    kB = 3,  // 3
    kC = 6,  // 3
    kDepth = 9,
    kScreen = 10,   // 2: projected centre (low-pass)
    kCenterZ = 12,  // depth of the centre (low-pass)
    kOpacity = 13,  // times the opacity
    kUv = 14,       // 2
    kUvPerSt = 16,  // 4
    kNormal = 20,   // 3, of the flipped normal
    kFrame = 23,    // 9, of the flipped frame
    kCount = 32,
  };
};

// Adds the derivatives of surfel `i` to `d_surfels`, from the sums of SurfelSums::kCount numbers.
void surfel_backward(const Camera& camera, const PosedSurfels& surfels, const SurfelRecord& record,
                     size_t i, const double* sums, PosedSurfels& d_surfels);

}  // namespace effigy
