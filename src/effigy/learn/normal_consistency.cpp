#include "effigy/learn/normal_consistency.h"

#include <cmath>
#include <cstdint>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_raster.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/learn/normal_consistency.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef EFFIGY_LEARN_NORMAL_CONSISTENCY_ONCE
#define EFFIGY_LEARN_NORMAL_CONSISTENCY_ONCE
namespace effigy {

// Rotation (row-major) and the rays' coefficients: ray x = (column + offset_x) / fx.
struct ConsistencyView {
  float rotation[9];
  float inverse_fx, inverse_fy, offset_x, offset_y;
};

// One row of pixels. Each pointer is at column 1, and `count` interior columns are processed.
// Depths are expected depths, 0 where alpha is too small.
struct ConsistencyRow {
  size_t count;
  float y;  // row index
  const float *depth, *up, *down, *alpha;
  const float *nx, *ny, *nz;
  // Of the backward pass (right null: values only): the gradient with respect to the depths of the
  // four neighbours (written), and to the normals (added).
  float *right, *left, *below, *above;
  float *d_nx, *d_ny, *d_nz;
  float scale;  // weight / number of pixels that count
};

// What a pixel's four neighbours want of its depth; z = D / alpha.
struct DepthRow {
  size_t count;
  const float *right, *left;   // of this row
  const float *below, *above;  // `below` of the row above, `above` of the row below
  const float *depth, *alpha;
  float *d_depth, *d_alpha;
};

}  // namespace effigy
#endif  // EFFIGY_LEARN_NORMAL_CONSISTENCY_ONCE

HWY_BEFORE_NAMESPACE();
namespace effigy::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Calls body(tag, i) for whole vectors and then for single columns.
template <typename Body>
HWY_INLINE void for_columns(size_t count, const Body& body) {
  const hn::ScalableTag<float> full;
  const hn::CappedTag<float, 1> single;
  size_t i = 0;
  for (; i + hn::Lanes(full) <= count; i += hn::Lanes(full)) body(full, i);
  for (; i < count; ++i) body(single, i);
}

void expected_depth_row(const float* depth, const float* alpha, float* out, size_t count,
                        float min_alpha) {
  for_columns(count, [&](auto d, size_t i) HWY_ATTR {
    const auto a = hn::LoadU(d, alpha + i);
    const auto z = hn::Div(hn::LoadU(d, depth + i), a);
    hn::StoreU(hn::IfThenElseZero(hn::Gt(a, hn::Set(d, min_alpha)), z), d, out + i);
  });
}

template <typename D>
HWY_INLINE hn::Mask<D> pixel_counts(D d, const float* depth, const float* up, const float* down) {
  const auto zero = hn::Zero(d);
  // The smallest of the five depths is positive.
  const auto sides = hn::Min(hn::LoadU(d, depth - 1), hn::LoadU(d, depth + 1));
  const auto ends = hn::Min(hn::LoadU(d, up), hn::LoadU(d, down));
  return hn::Gt(hn::Min(hn::Min(sides, ends), hn::LoadU(d, depth)), zero);
}

size_t count_row(const float* depth, const float* up, const float* down, size_t count) {
  size_t total = 0;
  for_columns(count, [&](auto d, size_t i) HWY_ATTR {
    total += hn::CountTrue(d, pixel_counts(d, depth + i, up + i, down + i));
  });
  return total;
}

template <bool kBackward, typename D>
HWY_INLINE hn::Vec<D> consistency(D d, const ConsistencyRow& row, const ConsistencyView& view,
                                  size_t i) {
  using V = hn::Vec<D>;
  const auto set = [&](float value) HWY_ATTR { return hn::Set(d, value); };
  const auto load = [&](const float* from) HWY_ATTR { return hn::LoadU(d, from + i); };
  const float* r = view.rotation;
  const V inverse_fx = set(view.inverse_fx), one = set(1.0f);
  const V ray_y = set((row.y + view.offset_y) * view.inverse_fy);
  const V ray_up = set((row.y - 1.0f + view.offset_y) * view.inverse_fy);
  const V ray_down = set((row.y + 1.0f + view.offset_y) * view.inverse_fy);
  const V column = hn::Iota(d, static_cast<float>(i + 1));
  const V ray_x = hn::Mul(hn::Add(column, set(view.offset_x)), inverse_fx);
  const V ray_left = hn::Sub(ray_x, inverse_fx), ray_right = hn::Add(ray_x, inverse_fx);
  const V zl = load(row.depth - 1), zr = load(row.depth + 1), zu = load(row.up),
          zd = load(row.down);
  // a = X(x+1) - X(x-1), b = X(y+1) - X(y-1), c = b x a.
  const V az = hn::Sub(zr, zl), ay = hn::Mul(az, ray_y);
  const V ax = hn::MulSub(zr, ray_right, hn::Mul(zl, ray_left));
  const V bz = hn::Sub(zd, zu), bx = hn::Mul(bz, ray_x);
  const V by = hn::MulSub(zd, ray_down, hn::Mul(zu, ray_up));
  const V cx = hn::MulSub(by, az, hn::Mul(bz, ay));
  const V cy = hn::MulSub(bz, ax, hn::Mul(bx, az));
  const V cz = hn::MulSub(bx, ay, hn::Mul(by, ax));
  const V squares = hn::MulAdd(cx, cx, hn::MulAdd(cy, cy, hn::Mul(cz, cz)));
  // A vanishing cross product (neighbours closer than a micrometre) has no direction: flat towards
  // the camera, no gradient.
  const auto counts = pixel_counts(d, row.depth + i, row.up + i, row.down + i);
  const auto solid = hn::And(counts, hn::Gt(squares, set(1e-30f)));
  const V inverse = hn::IfThenElseZero(solid, hn::Div(one, hn::Sqrt(squares)));
  const V nx = hn::Mul(cx, inverse), ny = hn::Mul(cy, inverse);
  const V nz = hn::IfThenElse(solid, hn::Mul(cz, inverse), set(-1.0f));
  // The accumulated normal in camera axes.
  const V wx = load(row.nx), wy = load(row.ny), wz = load(row.nz);
  const auto turned = [&](int k) HWY_ATTR {
    return hn::MulAdd(set(r[3 * k]), wx,
                      hn::MulAdd(set(r[3 * k + 1]), wy, hn::Mul(set(r[3 * k + 2]), wz)));
  };
  const V mx = turned(0), my = turned(1), mz = turned(2);
  const V along = hn::MulAdd(mx, nx, hn::MulAdd(my, ny, hn::Mul(mz, nz)));
  const V value = hn::IfThenElseZero(counts, hn::Sub(load(row.alpha), along));
  if constexpr (kBackward) {
    const V s = hn::IfThenElseZero(counts, set(-row.scale));
    float* const d_normal[3] = {row.d_nx, row.d_ny, row.d_nz};
    for (int k = 0; k < 3; ++k) {
      const V world =
          hn::MulAdd(set(r[k]), nx, hn::MulAdd(set(r[3 + k]), ny, hn::Mul(set(r[6 + k]), nz)));
      hn::StoreU(hn::MulAdd(s, world, load(d_normal[k])), d, d_normal[k] + i);
    }
    // Through the normalisation to c, then db = a x dc, da = dc x b.
    const V t = hn::Mul(set(-row.scale), inverse);
    const V gx = hn::Mul(t, hn::NegMulAdd(along, nx, mx));
    const V gy = hn::Mul(t, hn::NegMulAdd(along, ny, my));
    const V gz = hn::Mul(t, hn::NegMulAdd(along, nz, mz));
    const V dbx = hn::MulSub(ay, gz, hn::Mul(az, gy));
    const V dby = hn::MulSub(az, gx, hn::Mul(ax, gz));
    const V dbz = hn::MulSub(ax, gy, hn::Mul(ay, gx));
    const V dax = hn::MulSub(gy, bz, hn::Mul(gz, by));
    const V day = hn::MulSub(gz, bx, hn::Mul(gx, bz));
    const V daz = hn::MulSub(gx, by, hn::Mul(gy, bx));
    const V horizontal = hn::MulAdd(day, ray_y, daz), vertical = hn::MulAdd(dbx, ray_x, dbz);
    hn::StoreU(hn::MulAdd(dax, ray_right, horizontal), d, row.right + i);
    hn::StoreU(hn::Neg(hn::MulAdd(dax, ray_left, horizontal)), d, row.left + i);
    hn::StoreU(hn::MulAdd(dby, ray_down, vertical), d, row.below + i);
    hn::StoreU(hn::Neg(hn::MulAdd(dby, ray_up, vertical)), d, row.above + i);
  }
  return value;
}

// Returns the sum of alpha - n . N over the pixels of the row that count.
double consistency_row(const ConsistencyRow& row, const ConsistencyView& view) {
  double sum = 0;
  for_columns(row.count, [&](auto d, size_t i) HWY_ATTR {
    const auto value = row.right == nullptr ? consistency<false>(d, row, view, i)
                                            : consistency<true>(d, row, view, i);
    sum += static_cast<double>(hn::GetLane(hn::SumOfLanes(d, value)));
  });
  return sum;
}

void depth_gradient_row(const DepthRow& row) {
  for_columns(row.count, [&](auto d, size_t i) HWY_ATTR {
    const auto sides = hn::Add(hn::LoadU(d, row.right + i - 1), hn::LoadU(d, row.left + i + 1));
    const auto ends = hn::Add(hn::LoadU(d, row.below + i), hn::LoadU(d, row.above + i));
    const auto z = hn::LoadU(d, row.depth + i);
    const auto g = hn::IfThenElseZero(hn::Gt(z, hn::Zero(d)),
                                      hn::Div(hn::Add(sides, ends), hn::LoadU(d, row.alpha + i)));
    hn::StoreU(hn::Add(hn::LoadU(d, row.d_depth + i), g), d, row.d_depth + i);
    hn::StoreU(hn::NegMulAdd(g, z, hn::LoadU(d, row.d_alpha + i)), d, row.d_alpha + i);
  });
}

}  // namespace effigy::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy {
namespace {

HWY_EXPORT(expected_depth_row);
HWY_EXPORT(count_row);
HWY_EXPORT(consistency_row);
HWY_EXPORT(depth_gradient_row);

ConsistencyView make_view(const Camera& camera) {
  ConsistencyView view;
  for (int i = 0; i < 9; ++i)
    view.rotation[i] = static_cast<float>(camera.camera_from_world_rotation(i / 3, i % 3));
  view.inverse_fx = static_cast<float>(1.0 / camera.fx);
  view.inverse_fy = static_cast<float>(1.0 / camera.fy);
  view.offset_x = static_cast<float>(0.5 - camera.cx);
  view.offset_y = static_cast<float>(0.5 - camera.cy);
  return view;
}

// Expected depths, and (backward) what each pixel wants of its right, left, lower and upper
// neighbour's depth: planes whose outermost columns and rows stay zero.
class PaddedPlanes {
 public:
  PaddedPlanes(size_t width, size_t height, size_t planes, std::vector<float>& memory)
      : pitch(width + 2), plane_(pitch * (height + 2)) {
    memory.assign(planes * plane_, 0.0f);
    memory_ = memory.data();
  }
  // Column 0 of a row.
  float* row(size_t plane, size_t y) const {
    return memory_ + plane * plane_ + (y + 1) * pitch + 1;
  }
  const size_t pitch;

 private:
  size_t plane_;
  float* memory_;
};

// Sum of alpha - n . N over a row; adds the normals' gradient and writes the neighbours' wishes.
double evaluate_row(const Planes& gbuffer, const ConsistencyView& view, const PaddedPlanes& planes,
                    size_t y, float scale, Planes* d_gbuffer) {
  const size_t width = static_cast<size_t>(gbuffer.width), at = y * width + 1;
  ConsistencyRow row{};
  row.count = width - 2;
  row.y = static_cast<float>(y);
  row.depth = planes.row(0, y) + 1;
  row.up = row.depth - planes.pitch;
  row.down = row.depth + planes.pitch;
  row.alpha = gbuffer.plane(kAlpha) + at;
  row.nx = gbuffer.plane(kNormal) + at;
  row.ny = gbuffer.plane(kNormal + 1) + at;
  row.nz = gbuffer.plane(kNormal + 2) + at;
  row.scale = scale;
  if (d_gbuffer != nullptr) {
    row.right = planes.row(1, y) + 1;
    row.left = planes.row(2, y) + 1;
    row.below = planes.row(3, y) + 1;
    row.above = planes.row(4, y) + 1;
    row.d_nx = d_gbuffer->plane(kNormal) + at;
    row.d_ny = d_gbuffer->plane(kNormal + 1) + at;
    row.d_nz = d_gbuffer->plane(kNormal + 2) + at;
  }
  return HWY_DYNAMIC_DISPATCH(consistency_row)(row, view);
}

// Adds the gradients with respect to accumulated depth and alpha; `attached` > 0 is the derivative
// with respect to the alpha that stands alone.
void gather_row(const Planes& gbuffer, const PaddedPlanes& planes, size_t y, float attached,
                Planes& d_gbuffer) {
  const size_t width = static_cast<size_t>(gbuffer.width);
  DepthRow row;
  row.count = width;
  row.right = planes.row(1, y);
  row.left = planes.row(2, y);
  row.below = planes.row(3, y) - planes.pitch;
  row.above = planes.row(4, y) + planes.pitch;
  row.depth = planes.row(0, y);
  row.alpha = gbuffer.plane(kAlpha) + y * width;
  row.d_depth = d_gbuffer.plane(kDepth) + y * width;
  row.d_alpha = d_gbuffer.plane(kAlpha) + y * width;
  HWY_DYNAMIC_DISPATCH(depth_gradient_row)(row);
  if (attached == 0.0f) return;
  const float *z = row.depth, *up = z - planes.pitch, *down = z + planes.pitch;
  for (size_t x = 1; x + 1 < width; ++x)
    if (z[x] > 0 && z[x - 1] > 0 && z[x + 1] > 0 && up[x] > 0 && down[x] > 0)
      row.d_alpha[x] += attached;
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
  const PaddedPlanes planes(width, height, d_gbuffer == nullptr ? 1 : 5, scratch);
  const auto for_rows = [&](const auto& body) {
    parallel_for(height, 16, [&](size_t begin, size_t end, int) {
      for (size_t y = begin; y < end; ++y) body(y);
    });
  };
  for_rows([&](size_t y) {
    HWY_DYNAMIC_DISPATCH(expected_depth_row)
    (gbuffer.plane(kDepth) + y * width, gbuffer.plane(kAlpha) + y * width, planes.row(0, y), width,
     options.min_alpha);
  });
  std::vector<size_t> counts(height);
  for_rows([&](size_t y) {
    const float* depth = planes.row(0, y);
    counts[y] =
        HWY_DYNAMIC_DISPATCH(count_row)(depth, depth - planes.pitch, depth + planes.pitch, width);
  });
  size_t count = 0;
  for (const size_t row : counts) count += row;
  if (count == 0) return 0.0;

  const ConsistencyView view = make_view(camera);
  const float scale = static_cast<float>(weight / static_cast<double>(count));
  std::vector<double> sums(height);
  for_rows([&](size_t y) {
    if (counts[y] > 0) sums[y] = evaluate_row(gbuffer, view, planes, y, scale, d_gbuffer);
  });
  if (d_gbuffer != nullptr)
    for_rows([&](size_t y) {
      gather_row(gbuffer, planes, y, options.detach_alpha ? 0.0f : scale, *d_gbuffer);
    });
  double sum = 0;
  for (const double row : sums) sum += row;
  return sum / static_cast<double>(count);
}

}  // namespace effigy
#endif  // HWY_ONCE
