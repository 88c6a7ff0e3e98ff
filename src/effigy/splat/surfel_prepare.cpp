#include "effigy/splat/surfel_prepare.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr double kMinAlpha = 1.0 / 255.0;
// Ellipses are drawn a little larger, so that rounding never cuts off a pixel (squared pixels).
constexpr double kOutlineMargin = 0.01;
// Outlines larger than this many pixels are not worth computing.
constexpr double kLargestOutline = 1e6;
// Far enough that the low-pass never wins.
constexpr float kNoLowPass = 1e15f;

Vec3d load3(const float* p) {
  return {p[0], p[1], p[2]};
}

void add3(float* p, const Vec3d& v) {
  for (int k = 0; k < 3; ++k) p[k] += static_cast<float>(v[k]);
}

bool all_finite(const float* p, int count) {
  // A sum is finite only if every term is (or overflows, which is as bad).
  float sum = 0.0f;
  for (int k = 0; k < count; ++k) sum += std::abs(p[k]);
  return sum <= 1e30f;
}

bool is_sound(const PosedSurfels& s, size_t i) {
  return all_finite(&s.center[3 * i], 3) && all_finite(&s.s[3 * i], 3) &&
         all_finite(&s.t[3 * i], 3) && all_finite(&s.opacity[i], 1) &&
         all_finite(&s.uv[2 * i], 2) && all_finite(&s.uv_per_st[4 * i], 4) &&
         all_finite(&s.frame[9 * i], 9);
}

// The camera-space geometry of one surfel.
struct CameraSurfel {
  Vec3d p, s, t, cross;
  double cross_length;

  CameraSurfel(const Camera& camera, const PosedSurfels& surfels, size_t i) {
    const Mat3d& r = camera.camera_from_world_rotation;
    p = camera.to_camera(load3(&surfels.center[3 * i]));
    s = r * load3(&surfels.s[3 * i]);
    t = r * load3(&surfels.t[3 * i]);
    cross = s.cross(t);
    cross_length = cross.norm();
  }
};

// Fills the outline; false when nothing of it is in the image.
bool outline_surfel(const Camera& camera, const CameraSurfel& g, const SurfelRecord& record,
                    double near, bool low_pass, SurfelOutline& outline) {
  outline = {};
  const double reach2 = record.rho_max;
  // Dual conic of the disc u^2 + v^2 <= rho_max, rows M = (x - anchor, y - anchor, 1) homogeneous.
  const double ax = (record.anchor_x - camera.cx) / camera.fx;
  const double ay = (record.anchor_y - camera.cy) / camera.fy;
  const double m0[3] = {camera.fx * (g.s.x() - ax * g.s.z()), camera.fx * (g.t.x() - ax * g.t.z()),
                        camera.fx * (g.p.x() - ax * g.p.z())};
  const double m1[3] = {camera.fy * (g.s.y() - ay * g.s.z()), camera.fy * (g.t.y() - ay * g.t.z()),
                        camera.fy * (g.p.y() - ay * g.p.z())};
  const double m2[3] = {g.s.z(), g.t.z(), g.p.z()};
  const auto conic = [&](const double* a, const double* b) {
    return reach2 * (a[0] * b[0] + a[1] * b[1]) - a[2] * b[2];
  };
  const double reach_z = std::sqrt(reach2 * (m2[0] * m2[0] + m2[1] * m2[1]));
  if (g.p.z() + reach_z <= near) return false;
  const double w = -conic(m2, m2);
  const double x = -conic(m0, m2) / w, y = -conic(m1, m2) / w;
  const double xx = x * x + conic(m0, m0) / w + kOutlineMargin;
  const double yy = y * y + conic(m1, m1) / w + kOutlineMargin;
  const double xy = x * y + conic(m0, m1) / w;
  if (g.p.z() - reach_z <= 0.0 || !(w > 0.0) || !(xx > 0.0) || !(yy > 0.0) ||
      !(xx + yy < kLargestOutline * kLargestOutline)) {
    outline.everywhere = true;
    return true;
  }
  outline.x = static_cast<float>(x);
  outline.y = static_cast<float>(y);
  outline.slope = static_cast<float>(xy / yy);
  outline.k = static_cast<float>(std::max(xx - xy * xy / yy, kOutlineMargin));
  outline.inverse_yy = static_cast<float>(1.0 / yy);
  outline.half_x = static_cast<float>(std::sqrt(xx));
  outline.half_y = static_cast<float>(std::sqrt(yy));
  outline.extreme_dy = static_cast<float>(xy / std::sqrt(xx));
  double left = x - std::sqrt(xx), right = x + std::sqrt(xx);
  double top = y - std::sqrt(yy), bottom = y + std::sqrt(yy);
  if (low_pass && record.low_pass_x < kNoLowPass) {
    const double radius2 = reach2 / 2.0 + kOutlineMargin, radius = std::sqrt(radius2);
    outline.disc_x = record.low_pass_x;
    outline.disc_y = record.low_pass_y;
    outline.disc_squared = static_cast<float>(radius2);
    left = std::min(left, outline.disc_x - radius);
    right = std::max(right, outline.disc_x + radius);
    top = std::min(top, outline.disc_y - radius);
    bottom = std::max(bottom, outline.disc_y + radius);
  } else {
    outline.disc_squared = -1.0f;
  }
  return record.anchor_x + right >= 0.5 && record.anchor_x + left <= camera.width - 0.5 &&
         record.anchor_y + bottom >= 0.5 && record.anchor_y + top <= camera.height - 0.5;
}

// Whether the low-pass can win anywhere: it cannot when u^2 + v^2 <= 2 |pixel - centre|^2
// throughout a box around the outline.
bool can_be_filtered(const SurfelRecord& r, const SurfelOutline& o) {
  if (r.low_pass_x >= kNoLowPass) return false;
  if (o.everywhere) return true;
  const float radius = std::sqrt(std::max(o.disc_squared, 0.0f));
  const float x = std::max(std::abs(o.x) + o.half_x, std::abs(o.disc_x) + radius);
  const float y = std::max(std::abs(o.y) + o.half_y, std::abs(o.disc_y) + radius);
  const float c = std::abs(r.c[0]) - std::abs(r.c[1]) * x - std::abs(r.c[2]) * y;
  if (!(c > 0.0f)) return true;
  return r.a[1] * r.a[1] + r.a[2] * r.a[2] + r.b[1] * r.b[1] + r.b[2] * r.b[2] > 2.0f * c * c;
}

// Fills record and outline; false when the surfel cannot be seen.
bool prepare_one(const Camera& camera, const PosedSurfels& surfels, size_t i, float near,
                 bool low_pass, SurfelRecord& record, SurfelOutline& outline) {
  if (!is_sound(surfels, i)) return false;
  const double opacity = surfels.opacity[i];
  if (!(opacity >= kMinAlpha)) return false;
  const CameraSurfel g(camera, surfels, i);
  if (!(g.cross_length > 0.0)) return false;

  // Anchor: the projected centre, rounded to a float and kept near the image.
  double screen_x = camera.cx, screen_y = camera.cy;
  const bool in_front = g.p.z() > near;
  if (in_front) {
    screen_x = camera.fx * g.p.x() / g.p.z() + camera.cx;
    screen_y = camera.fy * g.p.y() / g.p.z() + camera.cy;
  }
  record.anchor_x = static_cast<float>(std::clamp<double>(screen_x, 0.0, camera.width));
  record.anchor_y = static_cast<float>(std::clamp<double>(screen_y, 0.0, camera.height));
  const double ax = (record.anchor_x - camera.cx) / camera.fx;
  const double ay = (record.anchor_y - camera.cy) / camera.fy;
  const double scale = 1.0 / g.cross_length;
  const auto expand = [&](const Vec3d& v, float* out) {
    out[0] = static_cast<float>(scale * (v.x() * ax + v.y() * ay + v.z()));
    out[1] = static_cast<float>(scale * v.x() / camera.fx);
    out[2] = static_cast<float>(scale * v.y() / camera.fy);
  };
  expand(g.t.cross(g.p), record.a);
  expand(g.p.cross(g.s), record.b);
  expand(g.cross, record.c);
  const double distance = g.p.dot(g.cross);
  record.depth = static_cast<float>(scale * distance);
  if (!all_finite(record.a, 3) || !all_finite(record.b, 3) || !all_finite(record.c, 3))
    return false;

  record.log2_opacity = static_cast<float>(std::log2(opacity));
  record.rho_max = static_cast<float>(2.0 * std::log(opacity / kMinAlpha));
  record.center_z = static_cast<float>(g.p.z());
  record.low_pass_x = record.low_pass_y = kNoLowPass;
  if (in_front && low_pass && std::abs(screen_x) < kNoLowPass && std::abs(screen_y) < kNoLowPass) {
    record.low_pass_x = static_cast<float>(screen_x - record.anchor_x);
    record.low_pass_y = static_cast<float>(screen_y - record.anchor_y);
  }
  for (size_t k = 0; k < 2; ++k) record.uv[k] = surfels.uv[2 * i + k];
  for (size_t k = 0; k < 4; ++k) record.uv_per_st[k] = surfels.uv_per_st[4 * i + k];
  // Both sides are drawn; n.ray has the sign of n.p wherever the plane is met in front.
  const double sign = distance <= 0.0 ? 1.0 : -1.0;
  const Vec3d normal =
      camera.camera_from_world_rotation.transpose() * g.cross * (sign / g.cross_length);
  for (int k = 0; k < 3; ++k) record.normal[k] = static_cast<float>(normal[k]);
  for (size_t k = 0; k < 9; ++k)
    record.frame[k] = static_cast<float>(sign) * surfels.frame[9 * i + k];
  if (!outline_surfel(camera, g, record, near, low_pass, outline)) return false;
  record.filtered = low_pass && can_be_filtered(record, outline);
  return true;
}

}  // namespace

void prepare_surfels(const Camera& camera, const PosedSurfels& surfels, float near, bool low_pass,
                     SurfelView& view) {
  const size_t n = surfels.count();
  view.all_records.resize(n);
  view.all_outlines.resize(n);
  view.seen.resize(n);
  view.depth.resize(n);
  parallel_for(n, 512, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      view.depth[i] = camera.to_camera(load3(&surfels.center[3 * i])).z();
      view.seen[i] = prepare_one(camera, surfels, i, near, low_pass, view.all_records[i],
                                 view.all_outlines[i]);
    }
  });
  view.sort.sort(view.seen, view.depth, view.source);
  const std::vector<uint32_t>& kept = view.source;
  view.records.resize(kept.size());
  view.outlines.resize(kept.size());
  parallel_for(kept.size(), 1024, [&](size_t begin, size_t end, int) {
    for (size_t k = begin; k < end; ++k) {
      view.records[k] = view.all_records[kept[k]];
      view.outlines[k] = view.all_outlines[kept[k]];
    }
  });
}

void surfel_backward(const Camera& camera, const PosedSurfels& surfels, const SurfelRecord& record,
                     size_t i, const double* sums, PosedSurfels& d_surfels) {
  const CameraSurfel g(camera, surfels, i);
  const double scale = 1.0 / g.cross_length;
  const double ax = (record.anchor_x - camera.cx) / camera.fx;
  const double ay = (record.anchor_y - camera.cy) / camera.fy;
  // A = scale (t x p).(r_anchor + (dx / fx, dy / fy, 0)); the scale cancels, so it is a constant.
  const auto gather = [&](int first) {
    const double at = sums[first] * scale;
    return Vec3d(at * ax + sums[first + 1] * scale / camera.fx,
                 at * ay + sums[first + 2] * scale / camera.fy, at);
  };
  const Vec3d d_a = gather(SurfelSums::kA), d_b = gather(SurfelSums::kB);
  Vec3d d_c = gather(SurfelSums::kC);
  const double d_distance = sums[SurfelSums::kDepth] * scale;

  d_c += d_distance * g.p;
  Vec3d d_p = d_distance * g.cross + d_a.cross(g.t) + g.s.cross(d_b);
  Vec3d d_t = g.p.cross(d_a) + d_c.cross(g.s);
  Vec3d d_s = d_b.cross(g.p) + g.t.cross(d_c);

  // Projected centre and its depth (low-pass).
  const double gx = sums[SurfelSums::kScreen] * camera.fx;
  const double gy = sums[SurfelSums::kScreen + 1] * camera.fy;
  if (gx != 0.0 || gy != 0.0) {
    const double inverse_z = 1.0 / g.p.z();
    d_p.x() += gx * inverse_z;
    d_p.y() += gy * inverse_z;
    d_p.z() -= (gx * g.p.x() + gy * g.p.y()) * inverse_z * inverse_z;
  }
  d_p.z() += sums[SurfelSums::kCenterZ];

  // Normal: sign (s x t) / |s x t|.
  const Mat3d& rotation = camera.camera_from_world_rotation;
  const double sign = g.p.dot(g.cross) <= 0.0 ? 1.0 : -1.0;
  const Vec3d normal = g.cross * scale;
  const Vec3d d_normal =
      sign * (rotation * Vec3d(sums[SurfelSums::kNormal], sums[SurfelSums::kNormal + 1],
                               sums[SurfelSums::kNormal + 2]));
  const Vec3d d_cross = (d_normal - normal * normal.dot(d_normal)) * scale;
  d_s += g.t.cross(d_cross);
  d_t += d_cross.cross(g.s);

  add3(&d_surfels.center[3 * i], rotation.transpose() * d_p);
  add3(&d_surfels.s[3 * i], rotation.transpose() * d_s);
  add3(&d_surfels.t[3 * i], rotation.transpose() * d_t);
  d_surfels.opacity[i] +=
      static_cast<float>(sums[SurfelSums::kOpacity] / static_cast<double>(surfels.opacity[i]));
  for (size_t k = 0; k < 2; ++k)
    d_surfels.uv[2 * i + k] += static_cast<float>(sums[SurfelSums::kUv + k]);
  for (size_t k = 0; k < 4; ++k)
    d_surfels.uv_per_st[4 * i + k] += static_cast<float>(sums[SurfelSums::kUvPerSt + k]);
  for (size_t k = 0; k < 9; ++k)
    d_surfels.frame[9 * i + k] += static_cast<float>(sign * sums[SurfelSums::kFrame + k]);
}

}  // namespace effigy
