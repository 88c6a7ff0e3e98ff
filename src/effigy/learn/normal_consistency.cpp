#include "effigy/learn/normal_consistency.h"

#include <cmath>
#include <cstdint>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {
namespace {

// Rotation (row-major) and the rays' coefficients: ray x = (column + .5 - cx) / fx.
struct View {
  float rotation[9];
  float inverse_fx, inverse_fy, offset_x, offset_y;
};

// Rows of one pixel row; depth rows hold expected depths, 0 where alpha is too small. Each pointer
// is at column 1 and `count` interior columns are processed.
struct PixelRow {
  size_t count;
  float y;  // row index
  const float *depth, *up, *down, *alpha;
  const float *nx, *ny, *nz;
  float* value;                         // alpha - n . N where the pixel counts
  float *right, *left, *below, *above;  // gradient with respect to the four neighbours' depths
  float *d_nx, *d_ny, *d_nz;
  float scale;  // weight / number of pixels that count
};

EFFIGY_CLONES void expected_depth_row(const float* __restrict depth, const float* __restrict alpha,
                                      float* __restrict out, size_t count, float min_alpha) {
  for (size_t i = 0; i < count; ++i) {
    const float a = alpha[i] > min_alpha ? alpha[i] : 1.0f;
    const float z = depth[i] / a;
    out[i] = alpha[i] > min_alpha ? z : 0.0f;
  }
}

// Pixels of a row whose own and four neighbours' depths are there.
EFFIGY_CLONES uint32_t count_row(const float* __restrict depth, const float* __restrict up,
                                 const float* __restrict down, size_t count) {
  uint32_t total = 0;
  for (size_t i = 0; i < count; ++i) {
    const uint32_t counts = (depth[i] > 0.0f ? 1u : 0u) & (depth[i - 1] > 0.0f ? 1u : 0u) &
                            (depth[i + 1] > 0.0f ? 1u : 0u) & (up[i] > 0.0f ? 1u : 0u) &
                            (down[i] > 0.0f ? 1u : 0u);
    total += counts;
  }
  return total;
}

template <bool kBackward>
__attribute__((always_inline)) inline void consistency_row(const PixelRow& row, const View& view) {
  const float* __restrict depth = row.depth;
  const float* __restrict up = row.up;
  const float* __restrict down = row.down;
  const float* __restrict alpha = row.alpha;
  const float* __restrict world_x = row.nx;
  const float* __restrict world_y = row.ny;
  const float* __restrict world_z = row.nz;
  float* __restrict value = row.value;
  float* __restrict right = row.right;
  float* __restrict left = row.left;
  float* __restrict below = row.below;
  float* __restrict above = row.above;
  float* __restrict d_x = row.d_nx;
  float* __restrict d_y = row.d_ny;
  float* __restrict d_z = row.d_nz;
  const float* r = view.rotation;
  const float r00 = r[0], r01 = r[1], r02 = r[2], r10 = r[3], r11 = r[4], r12 = r[5];
  const float r20 = r[6], r21 = r[7], r22 = r[8];
  const float ray_y = (row.y + view.offset_y) * view.inverse_fy;
  const float ray_up = (row.y - 1.0f + view.offset_y) * view.inverse_fy;
  const float ray_down = (row.y + 1.0f + view.offset_y) * view.inverse_fy;
  const float inverse_fx = view.inverse_fx, offset_x = view.offset_x, scale = row.scale;
  for (int32_t i = 0; i < static_cast<int32_t>(row.count); ++i) {
    const float ray_x = (static_cast<float>(i + 1) + offset_x) * inverse_fx;
    const float ray_left = ray_x - inverse_fx, ray_right = ray_x + inverse_fx;
    const float zl = depth[i - 1], zr = depth[i + 1], zu = up[i], zd = down[i];
    const float ax = zr * ray_right - zl * ray_left, ay = (zr - zl) * ray_y, az = zr - zl;
    const float bx = (zd - zu) * ray_x, by = zd * ray_down - zu * ray_up, bz = zd - zu;
    const float cx = by * az - bz * ay, cy = bz * ax - bx * az, cz = bx * ay - by * ax;
    const float squares = cx * cx + cy * cy + cz * cz;
    // A vanishing cross product (pixels closer than a micrometre) has no direction: flat towards
    // the camera, without gradient.
    const bool counts = (depth[i] > 0.0f) & (zl > 0.0f) & (zr > 0.0f) & (zu > 0.0f) & (zd > 0.0f);
    const bool solid = counts & (squares > 1e-30f);
    const float inverse = 1.0f / std::sqrt(solid ? squares : 1.0f);
    const float nx = solid ? cx * inverse : 0.0f, ny = solid ? cy * inverse : 0.0f;
    const float nz = solid ? cz * inverse : -1.0f;
    const float wx = world_x[i], wy = world_y[i], wz = world_z[i];
    const float mx = r00 * wx + r01 * wy + r02 * wz;
    const float my = r10 * wx + r11 * wy + r12 * wz;
    const float mz = r20 * wx + r21 * wy + r22 * wz;
    const float along = mx * nx + my * ny + mz * nz;
    value[i] = counts ? alpha[i] - along : 0.0f;
    if constexpr (kBackward) {
      const float s = counts ? -scale : 0.0f;
      d_x[i] += s * (r00 * nx + r10 * ny + r20 * nz);
      d_y[i] += s * (r01 * nx + r11 * ny + r21 * nz);
      d_z[i] += s * (r02 * nx + r12 * ny + r22 * nz);
      // Through the normalisation to the cross product c = b x a: db = a x dc, da = dc x b.
      const float t = solid ? -scale * inverse : 0.0f;
      const float gx = t * (mx - along * nx), gy = t * (my - along * ny);
      const float gz = t * (mz - along * nz);
      const float dbx = ay * gz - az * gy, dby = az * gx - ax * gz, dbz = ax * gy - ay * gx;
      const float dax = gy * bz - gz * by, day = gz * bx - gx * bz, daz = gx * by - gy * bx;
      right[i] = dax * ray_right + day * ray_y + daz;
      left[i] = -(dax * ray_left + day * ray_y + daz);
      below[i] = dbx * ray_x + dby * ray_down + dbz;
      above[i] = -(dbx * ray_x + dby * ray_up + dbz);
    }
  }
}

EFFIGY_CLONES void consistency_backward(const PixelRow& row, const View& view) {
  consistency_row<true>(row, view);
}
EFFIGY_CLONES void consistency_value(const PixelRow& row, const View& view) {
  consistency_row<false>(row, view);
}

// What a pixel's four neighbours want of its depth; z = D / alpha.
struct DepthRow {
  size_t count;
  const float *right, *left;   // of this row
  const float *below, *above;  // `below` of the row above, `above` of the row below
  const float *depth, *alpha;
  float *d_depth, *d_alpha;
};

EFFIGY_CLONES void depth_gradient_row(const DepthRow& row) {
  const float* __restrict right = row.right;
  const float* __restrict left = row.left;
  const float* __restrict below = row.below;
  const float* __restrict above = row.above;
  const float* __restrict depth = row.depth;
  const float* __restrict alpha = row.alpha;
  float* __restrict d_depth = row.d_depth;
  float* __restrict d_alpha = row.d_alpha;
  for (size_t i = 0; i < row.count; ++i) {
    const float gradient = right[i - 1] + left[i + 1] + below[i] + above[i];
    const float a = depth[i] > 0.0f ? alpha[i] : 1.0f;
    const float g = depth[i] > 0.0f ? gradient / a : 0.0f;
    d_depth[i] += g;
    d_alpha[i] -= g * depth[i];
  }
}

}  // namespace

double normal_consistency_loss(const Planes& gbuffer, const Camera& camera,
                               const NormalConsistencyOptions& options, float weight,
                               Planes* d_gbuffer, std::vector<float>& scratch) {
  EFFIGY_CHECK(gbuffer.count > kNormal + 2);
  EFFIGY_CHECK(gbuffer.width == camera.width && gbuffer.height == camera.height);
  EFFIGY_CHECK(options.min_alpha > 0.0f);
  if (d_gbuffer != nullptr)
    EFFIGY_CHECK(d_gbuffer->width == gbuffer.width && d_gbuffer->height == gbuffer.height &&
                 d_gbuffer->count == gbuffer.count);
  if (gbuffer.width < 3 || gbuffer.height < 3) return 0.0;
  const size_t width = static_cast<size_t>(gbuffer.width);
  const size_t height = static_cast<size_t>(gbuffer.height);
  // Padded planes: one column on each side and one row above and below stay zero.
  const size_t pitch = width + 2, plane = pitch * (height + 2);
  scratch.assign((d_gbuffer == nullptr ? 1 : 5) * plane + height * width, 0.0f);
  const auto padded = [&](size_t which, size_t y) {
    return scratch.data() + which * plane + (y + 1) * pitch + 1;
  };
  float* const values = scratch.data() + (scratch.size() - height * width);
  View view;
  for (int i = 0; i < 9; ++i)
    view.rotation[i] = static_cast<float>(camera.camera_from_world_rotation(i / 3, i % 3));
  view.inverse_fx = static_cast<float>(1.0 / camera.fx);
  view.inverse_fy = static_cast<float>(1.0 / camera.fy);
  view.offset_x = static_cast<float>(0.5 - camera.cx);
  view.offset_y = static_cast<float>(0.5 - camera.cy);

  parallel_for(height, 16, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y)
      expected_depth_row(gbuffer.plane(kDepth) + y * width, gbuffer.plane(kAlpha) + y * width,
                         padded(0, y), width, options.min_alpha);
  });
  std::vector<uint32_t> counts(height);
  parallel_for(height, 16, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y)
      counts[y] = count_row(padded(0, y), padded(0, y) - pitch, padded(0, y) + pitch, width);
  });
  size_t count = 0;
  for (const uint32_t row : counts) count += row;
  if (count == 0) return 0.0;
  const float scale = static_cast<float>(weight / static_cast<double>(count));

  std::vector<double> sums(height);
  parallel_for(height, 16, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y) {
      if (counts[y] == 0) continue;
      const size_t at = y * width + 1;
      PixelRow row{};
      row.count = width - 2;
      row.y = static_cast<float>(y);
      row.depth = padded(0, y) + 1;
      row.up = row.depth - pitch;
      row.down = row.depth + pitch;
      row.alpha = gbuffer.plane(kAlpha) + at;
      row.nx = gbuffer.plane(kNormal) + at;
      row.ny = gbuffer.plane(kNormal + 1) + at;
      row.nz = gbuffer.plane(kNormal + 2) + at;
      row.value = values + at;
      row.scale = scale;
      if (d_gbuffer == nullptr) {
        consistency_value(row, view);
      } else {
        row.right = padded(1, y) + 1;
        row.left = padded(2, y) + 1;
        row.below = padded(3, y) + 1;
        row.above = padded(4, y) + 1;
        row.d_nx = d_gbuffer->plane(kNormal) + at;
        row.d_ny = d_gbuffer->plane(kNormal + 1) + at;
        row.d_nz = d_gbuffer->plane(kNormal + 2) + at;
        consistency_backward(row, view);
      }
      double sum = 0;
      for (size_t i = 0; i < row.count; ++i) sum += static_cast<double>(row.value[i]);
      sums[y] = sum;
    }
  });
  if (d_gbuffer != nullptr)
    parallel_for(height, 16, [&](size_t begin, size_t end, int) {
      for (size_t y = begin; y < end; ++y) {
        DepthRow row;
        row.count = width;
        row.right = padded(1, y);
        row.left = padded(2, y);
        row.below = padded(3, y) - pitch;
        row.above = padded(4, y) + pitch;
        row.depth = padded(0, y);
        row.alpha = gbuffer.plane(kAlpha) + y * width;
        row.d_depth = d_gbuffer->plane(kDepth) + y * width;
        row.d_alpha = d_gbuffer->plane(kAlpha) + y * width;
        depth_gradient_row(row);
        if (options.detach_alpha || counts[y] == 0) continue;
        const float *z = row.depth, *up = z - pitch, *down = z + pitch;
        for (size_t x = 1; x + 1 < width; ++x)
          if (z[x] > 0 && z[x - 1] > 0 && z[x + 1] > 0 && up[x] > 0 && down[x] > 0)
            row.d_alpha[x] += scale;
      }
    });
  double sum = 0;
  for (const double row : sums) sum += row;
  return sum / static_cast<double>(count);
}

}  // namespace effigy
