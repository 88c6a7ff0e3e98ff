#include "effigy/splat/gaussian_prepare.h"

#include <bit>
#include <cmath>

#include "effigy/base/simd.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr float kMinAlpha = 1.0f / 255.0f;
constexpr double kLog2OverMinAlpha = 7.9943534368588575;  // log2(255)
constexpr double kRoundingShift = 6755399441055744.0;     // 1.5 * 2^52
constexpr double kHalfLog2E = 0.72134752044448170368;     // log2(e) / 2
// Ellipses are drawn a little larger, so that rounding never cuts off a pixel (squared pixels).
constexpr double kOutlineMargin = 0.01;
// Outlines larger than this many pixels are not worth computing.
constexpr float kLargestOutline = 1e6f;
// Variances (squared pixels) beyond which single precision could overflow.
constexpr double kSmallest = 1e-16, kLargest = 1e20;
// Exponents that 2^x can still represent; alpha is clamped far below.
constexpr float kLargestLog2Opacity = 100.0f;

// Gaussians are projected a block at a time, every quantity an array over the block, so that the
// loops become vector instructions.
constexpr size_t kBlock = 32;
using Lane = double[kBlock];

struct Inputs {
  Lane center[3], rotation[4], scale[3];
};

// The camera with its matrix as plain numbers.
struct Projector {
  double w[9], t[3], fx, fy, cx, cy, blur;

  Projector(const Camera& camera, const GaussianRasterOptions& options)
      : fx(camera.fx), fy(camera.fy), cx(camera.cx), cy(camera.cy), blur(options.blur) {
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) w[3 * r + c] = camera.camera_from_world_rotation(r, c);
      t[r] = camera.camera_from_world_translation[r];
    }
  }
};

// A block in camera and image space.
struct Projected {
  Lane x, y, z, px, py;  // camera space, x / z, y / z
  Lane rotation[9];      // of the quaternion over its length
  Lane inverse_length;   // of the quaternion
  Lane jw[6];            // J W
  Lane jwr[6];           // J W R
  Lane v[6];             // J W R diag(scale): C = v v^T + blur I
  Lane xx, xy, yy;       // C
  Lane det, bare_det;    // of C, and without the blur
  Lane slope, k;
};

// The Gaussians index[0 .. count), the first one again in what remains of the block.
[[gnu::always_inline]] inline void load_block(const GaussianView& g, const uint32_t* index,
                                              size_t count, Inputs& in) {
  if (count == kBlock && index[kBlock - 1] == index[0] + kBlock - 1) {  // neighbours
    const float* center = g.center.data() + 3 * static_cast<size_t>(index[0]);
    const float* rotation = g.rotation.data() + 4 * static_cast<size_t>(index[0]);
    const float* scale = g.scale.data() + 3 * static_cast<size_t>(index[0]);
    for (size_t i = 0; i < kBlock; ++i) {
      in.center[0][i] = static_cast<double>(center[3 * i]);
      in.center[1][i] = static_cast<double>(center[3 * i + 1]);
      in.center[2][i] = static_cast<double>(center[3 * i + 2]);
    }
    for (size_t i = 0; i < kBlock; ++i) {
      in.scale[0][i] = static_cast<double>(scale[3 * i]);
      in.scale[1][i] = static_cast<double>(scale[3 * i + 1]);
      in.scale[2][i] = static_cast<double>(scale[3 * i + 2]);
    }
    for (size_t i = 0; i < kBlock; ++i) {
      in.rotation[0][i] = static_cast<double>(rotation[4 * i]);
      in.rotation[1][i] = static_cast<double>(rotation[4 * i + 1]);
      in.rotation[2][i] = static_cast<double>(rotation[4 * i + 2]);
      in.rotation[3][i] = static_cast<double>(rotation[4 * i + 3]);
    }
    return;
  }
  for (size_t i = 0; i < kBlock; ++i) {
    const size_t s = index[i < count ? i : 0];
    for (size_t k = 0; k < 3; ++k) in.center[k][i] = static_cast<double>(g.center[3 * s + k]);
    for (size_t k = 0; k < 4; ++k) in.rotation[k][i] = static_cast<double>(g.rotation[4 * s + k]);
    for (size_t k = 0; k < 3; ++k) in.scale[k][i] = static_cast<double>(g.scale[3 * s + k]);
  }
}

[[gnu::always_inline]] inline void project(const Projector& p, const Inputs& in, Projected& out) {
  for (size_t i = 0; i < kBlock; ++i) {
    const double a = in.center[0][i], b = in.center[1][i], c = in.center[2][i];
    const double x = p.w[0] * a + p.w[1] * b + p.w[2] * c + p.t[0];
    const double y = p.w[3] * a + p.w[4] * b + p.w[5] * c + p.t[1];
    const double z = p.w[6] * a + p.w[7] * b + p.w[8] * c + p.t[2];
    const double inverse = 1.0 / z;
    out.x[i] = x;
    out.y[i] = y;
    out.z[i] = z;
    const double px = x * inverse, py = y * inverse;
    out.px[i] = px;
    out.py[i] = py;
    const double jx = p.fx * inverse, jy = p.fy * inverse;
    for (int k = 0; k < 3; ++k) {
      out.jw[k][i] = jx * (p.w[k] - px * p.w[6 + k]);
      out.jw[3 + k][i] = jy * (p.w[3 + k] - py * p.w[6 + k]);
    }
  }
  for (size_t i = 0; i < kBlock; ++i) {
    const double q0 = in.rotation[0][i], q1 = in.rotation[1][i];
    const double q2 = in.rotation[2][i], q3 = in.rotation[3][i];
    const double inverse = 1.0 / std::sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3);
    const double w = q0 * inverse, x = q1 * inverse, y = q2 * inverse, z = q3 * inverse;
    out.inverse_length[i] = inverse;
    out.rotation[0][i] = 1.0 - 2.0 * (y * y + z * z);
    out.rotation[1][i] = 2.0 * (x * y - w * z);
    out.rotation[2][i] = 2.0 * (x * z + w * y);
    out.rotation[3][i] = 2.0 * (x * y + w * z);
    out.rotation[4][i] = 1.0 - 2.0 * (x * x + z * z);
    out.rotation[5][i] = 2.0 * (y * z - w * x);
    out.rotation[6][i] = 2.0 * (x * z - w * y);
    out.rotation[7][i] = 2.0 * (y * z + w * x);
    out.rotation[8][i] = 1.0 - 2.0 * (x * x + y * y);
  }
  for (int r = 0; r < 2; ++r)
    for (int c = 0; c < 3; ++c)
      for (size_t i = 0; i < kBlock; ++i) {
        const double sum = out.jw[3 * r][i] * out.rotation[c][i] +
                           out.jw[3 * r + 1][i] * out.rotation[3 + c][i] +
                           out.jw[3 * r + 2][i] * out.rotation[6 + c][i];
        out.jwr[3 * r + c][i] = sum;
        out.v[3 * r + c][i] = sum * in.scale[c][i];
      }
  for (size_t i = 0; i < kBlock; ++i) {
    const double a = out.v[0][i], b = out.v[1][i], c = out.v[2][i];
    const double d = out.v[3][i], e = out.v[4][i], f = out.v[5][i];
    const double xx = a * a + b * b + c * c, yy = d * d + e * e + f * f;
    const double xy = a * d + b * e + c * f;
    // det(v v^T) = |v_0 x v_1|^2: nothing cancels when the ellipse is thin.
    const double m0 = b * f - c * e, m1 = c * d - a * f, m2 = a * e - b * d;
    const double bare = m0 * m0 + m1 * m1 + m2 * m2;
    const double det = bare + p.blur * (xx + yy) + p.blur * p.blur;
    out.xx[i] = xx + p.blur;
    out.xy[i] = xy;
    out.yy[i] = yy + p.blur;
    out.bare_det[i] = bare;
    out.det[i] = det;
    const double inverse = 1.0 / (yy + p.blur);
    out.slope[i] = xy * inverse;
    out.k[i] = det * inverse;
  }
}

// What the kernels read of a block, as arrays.
using FloatLane = float[kBlock];
struct Drawn {
  FloatLane log2_opacity, mean_x, mean_y, anchor_x, anchor_y, x, y;
  FloatLane slope, k, inverse_yy, extreme_dy, half_x, half_y;
  FloatLane a, b, c;
  FloatLane seen, drawable;  // 1 or 0
};

// log2 of positive numbers, absolute error below 1e-9: the series of artanh over the mantissa in
// [1/sqrt 2, sqrt 2].
inline double log2_of(float x) {
  const auto bits = std::bit_cast<uint32_t>(x);  // unsigned: any input may come
  const int32_t exponent = static_cast<int32_t>(bits - 0x3f3504f3u) >> 23;
  const auto mantissa =
      static_cast<double>(std::bit_cast<float>(bits - (static_cast<uint32_t>(exponent) << 23)));
  const double s = (mantissa - 1.0) / (mantissa + 1.0), s2 = s * s;
  const double series =
      1.0 + s2 * (1.0 / 3 + s2 * (1.0 / 5 + s2 * (1.0 / 7 + s2 * (1.0 / 9 + s2 * (1.0 / 11)))));
  return static_cast<double>(exponent) + 2.8853900817779268 * s * series;
}

[[gnu::always_inline]] inline void outline(const Camera& camera, const Projector& p,
                                           const Projected& f, const FloatLane opacity, Drawn& d) {
  const double fx = p.fx, fy = p.fy, cx = p.cx, cy = p.cy;
  for (size_t i = 0; i < kBlock; ++i) {
    const double log2_opacity = log2_of(opacity[i]);
    d.log2_opacity[i] = static_cast<float>(log2_opacity);
    const double reach2 = (log2_opacity + kLog2OverMinAlpha) * (1.0 / kHalfLog2E);
    const double mean_x = fx * f.px[i] + cx, mean_y = fy * f.py[i] + cy;
    // Rounds to whole numbers.
    const double anchor_x = (mean_x + kRoundingShift) - kRoundingShift;
    const double anchor_y = (mean_y + kRoundingShift) - kRoundingShift;
    d.anchor_x[i] = static_cast<float>(anchor_x);
    d.anchor_y[i] = static_cast<float>(anchor_y);
    d.x[i] = static_cast<float>(mean_x - anchor_x);
    d.y[i] = static_cast<float>(mean_y - anchor_y);
    d.mean_x[i] = static_cast<float>(mean_x);
    d.mean_y[i] = static_cast<float>(mean_y);
    d.slope[i] = static_cast<float>(f.slope[i]);
    d.k[i] = static_cast<float>(reach2 * f.k[i]);
    d.half_y[i] = static_cast<float>(reach2 * f.yy[i] + kOutlineMargin);  // squared
    d.a[i] = static_cast<float>(kHalfLog2E / f.k[i]);                     // squared
    d.c[i] = static_cast<float>(kHalfLog2E / f.yy[i]);                    // squared
  }
  const auto margin = static_cast<float>(kOutlineMargin);
  const auto right = static_cast<float>(camera.width) - 0.5f;
  const auto bottom = static_cast<float>(camera.height) - 0.5f;
  for (size_t i = 0; i < kBlock; ++i) {
    const float slope = d.slope[i], yy = d.half_y[i];
    // With the margin added to the variances of x and of y.
    const float k = d.k[i] + margin * (1.0f + slope * slope);
    const float half_x = std::sqrt(slope * slope * yy + k), half_y = std::sqrt(yy);
    d.k[i] = k;
    d.half_x[i] = half_x;
    d.half_y[i] = half_y;
    d.inverse_yy[i] = 1.0f / yy;
    d.extreme_dy[i] = slope * yy / half_x;
    const float a = std::sqrt(d.a[i]);
    d.a[i] = a;
    d.b[i] = -a * slope;
    d.c[i] = std::sqrt(d.c[i]);
    // Comparisons with NaN are false.
    const bool inside = (d.mean_x[i] + half_x >= 0.5f) & (d.mean_x[i] - half_x <= right) &
                        (d.mean_y[i] + half_y >= 0.5f) & (d.mean_y[i] - half_y <= bottom);
    d.seen[i] = inside ? 1.0f : 0.0f;
  }
}

// Where a block's Gaussians lie among the tiles.
struct Covers {
  int32_t row[kBlock], last_row[kBlock];
  int32_t first[TileCover::kRows][kBlock], last[TileCover::kRows][kBlock];
};

[[gnu::always_inline]] inline EllipseOutline outline_of(const Drawn& d, size_t i) {
  return {d.x[i],          d.y[i],      d.slope[i],  d.k[i], d.inverse_yy[i],
          d.extreme_dy[i], d.half_x[i], d.half_y[i], false};
}

// As for_each_span finds them, for the first rows of tiles.
[[gnu::always_inline]] inline void cover(const Camera& camera, const Drawn& d, Covers& c) {
  for (size_t i = 0; i < kBlock; ++i) {
    const float y = d.anchor_y[i] + d.y[i];
    const PixelRange rows = pixels_between(y - d.half_y[i], y + d.half_y[i], camera.height);
    c.row[i] = rows.first / kTileSize;
    c.last_row[i] = rows.first <= rows.last ? rows.last / kTileSize : c.row[i] - 1;
  }
  for (int r = 0; r < TileCover::kRows; ++r) {
    for (size_t i = 0; i < kBlock; ++i) {
      const float top = static_cast<float>((c.row[i] + r) * kTileSize) - d.anchor_y[i] + 0.5f;
      const EllipseBand band = ellipse_in_band(outline_of(d, i), top, top + (kTileSize - 1));
      const PixelRange columns =
          pixels_between(d.anchor_x[i] + band.left, d.anchor_x[i] + band.right, camera.width);
      const int some = -static_cast<int>(columns.first <= columns.last);  // all bits, or none
      c.first[r][i] = ((columns.first / kTileSize) & some) | (1 & ~some);
      c.last[r][i] = (columns.last / kTileSize) & some;
    }
  }
}

inline void make_cover(const Covers& c, size_t i, bool everywhere, TileCover& cover) {
  const int rows = c.last_row[i] - c.row[i] + 1;
  cover.row = static_cast<uint16_t>(c.row[i]);
  cover.rows =
      everywhere || rows > TileCover::kRows ? TileCover::kMore : static_cast<uint16_t>(rows);
  for (int r = 0; r < TileCover::kRows; ++r) {
    cover.first[r] = static_cast<uint16_t>(c.first[r][i]);
    cover.last[r] = static_cast<uint16_t>(c.last[r][i]);
  }
}

// Sets `seen` to 1 where a Gaussian of the block, with its opacity as it is drawn, can be drawn and
// seen, else 0.
[[gnu::always_inline]] inline void find_seen(const Projected& p, const FloatLane opacity,
                                             double near, Drawn& d) {
  for (size_t i = 0; i < kBlock; ++i) {
    const bool drawable = (p.z[i] > near) & (p.k[i] > kSmallest) & (p.yy[i] > kSmallest) &
                          (p.xx[i] + p.yy[i] < kLargest);
    d.drawable[i] = drawable ? 1.0f : 0.0f;
  }
  for (size_t i = 0; i < kBlock; ++i) {
    const bool seen = (d.seen[i] != 0.0f) & (d.drawable[i] != 0.0f) & (opacity[i] >= kMinAlpha) &
                      (opacity[i] < 1e30f) &
                      (std::abs(d.mean_x[i]) + std::abs(d.mean_y[i]) < 1e15f);
    d.seen[i] = seen ? 1.0f : 0.0f;
  }
}

inline void make_record(const Drawn& d, size_t i, GaussianRecord& r) {
  r.anchor_x = d.anchor_x[i];
  r.anchor_y = d.anchor_y[i];
  EllipseOutline& o = r.outline;
  o = outline_of(d, i);
  o.everywhere = !(o.half_x + o.half_y < kLargestOutline);
  r.a = d.a[i];
  r.b = d.b[i];
  r.c = d.c[i];
  r.log2_opacity = std::min(d.log2_opacity[i], kLargestLog2Opacity);
}

bool finite(std::span<const float> values, size_t first, size_t count) {
  float sum = 0.0f;
  for (size_t k = first; k < first + count; ++k) sum += std::abs(values[k]);
  return sum <= 1e30f;
}

EFFIGY_CLONES
void project_range(const Projector& of_frame, const Camera& camera, const GaussianView& g,
                   const GaussianRasterOptions& options, size_t begin, size_t end,
                   GaussianList& list) {
  const Projector projector = of_frame;  // a copy that nothing else can write to
  Inputs in;
  Projected out;
  Drawn drawn;
  Covers covers;
  FloatLane opacity;
  uint32_t index[kBlock];
  const size_t channels = static_cast<size_t>(g.channels);
  GaussianRecord* const records = list.records.data();
  TileCover* const cover_of = list.covers.data();
  double* const depth = list.depth.data();
  uint8_t* const seen = list.seen.data();
  for (size_t first = begin; first < end; first += kBlock) {
    const size_t count = std::min(kBlock, end - first);
    for (size_t i = 0; i < count; ++i) index[i] = static_cast<uint32_t>(first + i);
    load_block(g, index, count, in);
    project(projector, in, out);
    for (size_t i = 0; i < kBlock; ++i) opacity[i] = g.opacity[index[i < count ? i : 0]];
    for (size_t i = 0; options.compensate && i < kBlock; ++i)
      opacity[i] *= static_cast<float>(std::sqrt(out.bare_det[i] / out.det[i]));
    outline(camera, projector, out, opacity, drawn);
    cover(camera, drawn, covers);
    find_seen(out, opacity, static_cast<double>(options.near), drawn);
    for (size_t i = 0; i < count; ++i) {
      const size_t s = first + i;
      depth[s] = out.z[i];
      const bool visible = drawn.seen[i] != 0.0f && finite(g.features, s * channels, channels);
      seen[s] = visible;
      if (!visible) continue;
      make_record(drawn, i, records[s]);
      make_cover(covers, i, records[s].outline.everywhere, cover_of[s]);
    }
  }
}

// Derivatives with respect to the inputs of a block.
struct Derivatives {
  Lane center[3], rotation[4], scale[3];
};

// Derivatives with respect to the means and J W.
struct Between {
  Lane gxx, gxy, gyy, mean_x,
      mean_y;  // C = [[xx, xy], [xy, yy]]: d loss = gxx dxx + 2 gxy dxy + ...
  Lane jwr[6], jw[6], rotation[9];
};

// From sums over pixels to the mean and C. `sums`: the GaussianSums of the block.
[[gnu::always_inline]] inline void screen_backward(const Projected& f, const Lane* sums,
                                                   Between& d) {
  constexpr double kInverse = 1.0 / kHalfLog2E;
  const double inverse_scale = std::sqrt(kInverse);  // of the kernels' u and v
  for (size_t i = 0; i < kBlock; ++i) {
    const double u = inverse_scale * sums[GaussianSums::kU][i];
    const double v = inverse_scale * sums[GaussianSums::kV][i];
    const double uu = kInverse * sums[GaussianSums::kUU][i];
    const double uv = kInverse * sums[GaussianSums::kUV][i];
    const double vv = kInverse * sums[GaussianSums::kVV][i];
    // C^-1 = L L^T, (u, v) = L^T d: d ln alpha / d mean = L (u, v), d / d C = L (u, v)(u, v)^T
    // L^T/2.
    const double l00 = 1.0 / std::sqrt(f.k[i]), l10 = -f.slope[i] * l00;
    const double l11 = 1.0 / std::sqrt(f.yy[i]);
    d.mean_x[i] = l00 * u;
    d.mean_y[i] = l10 * u + l11 * v;
    d.gxx[i] = 0.5 * l00 * l00 * uu;
    d.gxy[i] = 0.5 * l00 * (l10 * uu + l11 * uv);
    d.gyy[i] = 0.5 * (l10 * l10 * uu + 2.0 * l10 * l11 * uv + l11 * l11 * vv);
  }
}

// ln of the opacity's factor is (ln bare_det - ln det) / 2.
[[gnu::always_inline]] inline void compensation_backward(const Projector& p, const Projected& f,
                                                         const Lane* sums, Between& d) {
  for (size_t i = 0; i < kBlock; ++i) {
    const double one = sums[GaussianSums::kOne][i];
    const double bare = 0.5 * one / f.bare_det[i], full = 0.5 * one / f.det[i];
    d.gxx[i] += bare * (f.yy[i] - p.blur) - full * f.yy[i];
    d.gyy[i] += bare * (f.xx[i] - p.blur) - full * f.xx[i];
    d.gxy[i] -= (bare - full) * f.xy[i];
  }
}

[[gnu::always_inline]] inline void project_backward(const Projector& p, const Inputs& in,
                                                    const Projected& f, Between& b,
                                                    Derivatives& d) {
  // C = v v^T, v = J W R diag(scale).
  for (int k = 0; k < 3; ++k)
    for (size_t i = 0; i < kBlock; ++i) {
      const double d0 = 2.0 * (b.gxx[i] * f.v[k][i] + b.gxy[i] * f.v[3 + k][i]);
      const double d1 = 2.0 * (b.gxy[i] * f.v[k][i] + b.gyy[i] * f.v[3 + k][i]);
      d.scale[k][i] = d0 * f.jwr[k][i] + d1 * f.jwr[3 + k][i];
      b.jwr[k][i] = d0 * in.scale[k][i];
      b.jwr[3 + k][i] = d1 * in.scale[k][i];
    }
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c)
      for (size_t i = 0; i < kBlock; ++i)
        b.rotation[3 * r + c][i] = f.jw[r][i] * b.jwr[c][i] + f.jw[3 + r][i] * b.jwr[3 + c][i];
    for (int h = 0; h < 2; ++h)
      for (size_t i = 0; i < kBlock; ++i)
        b.jw[3 * h + r][i] = b.jwr[3 * h][i] * f.rotation[3 * r][i] +
                             b.jwr[3 * h + 1][i] * f.rotation[3 * r + 1][i] +
                             b.jwr[3 * h + 2][i] * f.rotation[3 * r + 2][i];
  }
  // J W = (fx / z)(W_0 - (x / z) W_2), (fy / z)(W_1 - (y / z) W_2); mean = fx x / z + cx, ...
  for (size_t i = 0; i < kBlock; ++i) {
    const double inverse_z = 1.0 / f.z[i];
    const double dot0 = b.jw[0][i] * p.w[6] + b.jw[1][i] * p.w[7] + b.jw[2][i] * p.w[8];
    const double dot1 = b.jw[3][i] * p.w[6] + b.jw[4][i] * p.w[7] + b.jw[5][i] * p.w[8];
    const double d_px = p.fx * (b.mean_x[i] - inverse_z * dot0);
    const double d_py = p.fy * (b.mean_y[i] - inverse_z * dot1);
    // Of 1 / z in front of both rows.
    const double d_log = b.jw[0][i] * f.jw[0][i] + b.jw[1][i] * f.jw[1][i] +
                         b.jw[2][i] * f.jw[2][i] + b.jw[3][i] * f.jw[3][i] +
                         b.jw[4][i] * f.jw[4][i] + b.jw[5][i] * f.jw[5][i];
    const double dx = d_px * inverse_z, dy = d_py * inverse_z;
    const double dz = -inverse_z * (d_px * f.px[i] + d_py * f.py[i] + d_log);
    d.center[0][i] = p.w[0] * dx + p.w[3] * dy + p.w[6] * dz;
    d.center[1][i] = p.w[1] * dx + p.w[4] * dy + p.w[7] * dz;
    d.center[2][i] = p.w[2] * dx + p.w[5] * dy + p.w[8] * dz;
  }
  // R of q / |q|.
  const Lane* const g = b.rotation;
  for (size_t i = 0; i < kBlock; ++i) {
    const double n = f.inverse_length[i];
    const double w = n * in.rotation[0][i], x = n * in.rotation[1][i];
    const double y = n * in.rotation[2][i], z = n * in.rotation[3][i];
    const double yz = g[7][i] - g[5][i], zx = g[2][i] - g[6][i], xy = g[3][i] - g[1][i];
    const double s_yz = g[7][i] + g[5][i], s_zx = g[2][i] + g[6][i], s_xy = g[3][i] + g[1][i];
    const double dw = 2.0 * (x * yz + y * zx + z * xy);
    const double d1 = 2.0 * (y * s_xy + z * s_zx + w * yz - 2.0 * x * (g[4][i] + g[8][i]));
    const double d2 = 2.0 * (x * s_xy + z * s_yz + w * zx - 2.0 * y * (g[0][i] + g[8][i]));
    const double d3 = 2.0 * (x * s_zx + y * s_yz + w * xy - 2.0 * z * (g[0][i] + g[4][i]));
    const double along = dw * w + d1 * x + d2 * y + d3 * z;
    d.rotation[0][i] = n * (dw - along * w);
    d.rotation[1][i] = n * (d1 - along * x);
    d.rotation[2][i] = n * (d2 - along * y);
    d.rotation[3][i] = n * (d3 - along * z);
  }
}

EFFIGY_CLONES
void backward_range(const Projector& of_frame, const GaussianView& g, bool compensate,
                    const GaussianList& list, const std::vector<uint32_t>& rank, size_t begin,
                    size_t end, const EntrySums& entries, const GaussianGradients& gradients) {
  const Projector projector = of_frame;  // a copy that nothing else can write to
  Inputs in;
  Projected out;
  Between between;
  Derivatives d;
  Lane sums[GaussianSums::kCount] = {};
  uint32_t index[kBlock];
  const size_t channels = static_cast<size_t>(g.channels);
  const size_t stride = GaussianSums::kCount + channels;
  std::vector<double> all(stride);
  double* const total = all.data();
  size_t next = begin;
  while (true) {
    // The next block of Gaussians that were seen.
    size_t count = 0;
    for (; next < end && count < kBlock; ++next)
      if (list.seen[next]) index[count++] = static_cast<uint32_t>(next);
    if (count == 0) return;
    for (size_t i = 0; i < count; ++i) entries.prefetch(rank[index[i]]);
    for (size_t i = 0; i < count; ++i) {
      std::fill_n(total, stride, 0.0);
      entries.add(rank[index[i]], total);
      for (size_t k = 0; k < GaussianSums::kCount; ++k) sums[k][i] = total[k];
      for (size_t c = 0; c < channels; ++c)
        gradients.features[channels * index[i] + c] +=
            static_cast<float>(total[GaussianSums::kCount + c]);
    }
    load_block(g, index, count, in);
    project(projector, in, out);
    screen_backward(out, sums, between);
    if (compensate) compensation_backward(projector, out, sums, between);
    project_backward(projector, in, out, between, d);
    for (size_t i = 0; i < count; ++i) {
      const size_t s = index[i];
      for (size_t k = 0; k < 3; ++k)
        gradients.center[3 * s + k] += static_cast<float>(d.center[k][i]);
      for (size_t k = 0; k < 4; ++k)
        gradients.rotation[4 * s + k] += static_cast<float>(d.rotation[k][i]);
      for (size_t k = 0; k < 3; ++k)
        gradients.scale[3 * s + k] += static_cast<float>(d.scale[k][i]);
      gradients.opacity[s] +=
          static_cast<float>(sums[GaussianSums::kOne][i] / static_cast<double>(g.opacity[s]));
    }
  }
}

}  // namespace

void prepare_gaussians(const Camera& camera, const GaussianView& gaussians,
                       const GaussianRasterOptions& options, GaussianList& list) {
  const size_t n = gaussians.count();
  const Projector projector(camera, options);
  list.records.resize(n);
  list.covers.resize(n);
  list.seen.resize(n);
  list.depth.resize(n);
  parallel_for(n, 1024, [&](size_t begin, size_t end, int) {
    project_range(projector, camera, gaussians, options, begin, end, list);
  });
  list.sort.sort(list.seen, list.depth, list.order);
}

void gaussians_backward(const Camera& camera, const GaussianView& gaussians,
                        const GaussianRasterOptions& options, const GaussianList& list,
                        const EntrySums& entries, const GaussianGradients& gradients) {
  const Projector projector(camera, options);
  std::vector<uint32_t> rank(gaussians.count());
  for (size_t k = 0; k < list.order.size(); ++k) rank[list.order[k]] = static_cast<uint32_t>(k);
  parallel_for(gaussians.count(), 512, [&](size_t begin, size_t end, int) {
    backward_range(projector, gaussians, options.compensate, list, rank, begin, end, entries,
                   gradients);
  });
}

}  // namespace effigy
