#include "effigy/light/prefilter_rows.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/light/environment.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;

// A difference is kept when it exceeds this part of the lobe's peak, or when its share of the whole
// lobe exceeds kShare.
constexpr float kPeakPart = 0.004f;
constexpr float kShare = 0.0003f;
// Difference made by the lobe's kink at the horizon, of slope 1, for a node of radius 1.
constexpr float kKink = 0.15f;

uint32_t z_order(uint32_t x, uint32_t y) {
  uint32_t z = 0;
  for (int i = 0; i < 12; ++i) z |= ((x >> i) & 1u) << (2 * i) | ((y >> i) & 1u) << (2 * i + 1);
  return z;
}

}  // namespace

FluxPyramid::FluxPyramid(int n) : size(n) {
  while ((1 << depth) < n) ++depth;
  coarsest = std::min(depth, 2);
  offset.push_back(0);
  for (int level = 0; level <= depth; ++level)
    offset.push_back(offset.back() + (level < coarsest ? 0 : size_t{6} << (2 * level)));
  direction.resize(nodes());
  solid_angle.resize(nodes());
  parents.resize(nodes());
  flux_of_one.assign(nodes(), 0.0f);
  source_texel.resize(size_t{6} << (2 * depth));
  // Node of a cubemap texel index on a level.
  const auto node_of = [&](size_t texel, int level) {
    const size_t m = size_t{1} << level;
    return static_cast<uint32_t>(
        offset[level] + texel / (m * m) * (m * m) +
        z_order(static_cast<uint32_t>(texel % m), static_cast<uint32_t>(texel / m % m)));
  };
  for (int level = coarsest; level <= depth; ++level) {
    const int m = 1 << level;
    for (int face = 0; face < 6; ++face) {
      const CubeFace& f = cube_face(face);
      const auto point = [&](double x, double y) {
        return Vec3d(f.normal + f.s * (-1.0 + 2.0 * x / m) + f.t * (-1.0 + 2.0 * y / m))
            .normalized();
      };
      for (int y = 0; y < m; ++y) {
        for (int x = 0; x < m; ++x) {
          const size_t texel = (static_cast<size_t>(face) * m + y) * m + x;
          const uint32_t node = node_of(texel, level);
          const Vec3d center = point(x + 0.5, y + 0.5);
          double radius = 0.0;
          for (int corner = 0; corner < 4; ++corner)
            radius = std::max(radius, center.cross(point(x + corner % 2, y + corner / 2)).norm());
          direction[node] = {static_cast<float>(center.x()), static_cast<float>(center.y()),
                             static_cast<float>(center.z()), static_cast<float>(radius)};
          solid_angle[node] = static_cast<float>(cubemap_solid_angle(x, y, m));
          if (level == depth) {
            flux_of_one[node] = solid_angle[node];
            source_texel[node - offset[depth]] = static_cast<uint32_t>(texel);
          }
          if (level == coarsest) continue;
          // Bilinear position among the coarser texels: quarters.
          const int px = x / 2, py = y / 2, h = m / 2;
          const int qx = px + (x % 2 ? 1 : -1), qy = py + (y % 2 ? 1 : -1);
          const bool corner = (qx < 0 || qx >= h) && (qy < 0 || qy >= h);
          const float third = corner ? 1.0f / 48.0f : 0.0f;
          const auto parent = [&](int tx, int ty) {
            return node_of(cubemap_texel_across(face, tx, ty, h), level - 1);
          };
          parents[node] = {
              Parent{parent(px, py), 9.0f / 16.0f + third},
              Parent{parent(qx, py), 3.0f / 16.0f + third},
              Parent{parent(px, qy), 3.0f / 16.0f + third},
              corner ? Parent{parent(px, py), 0.0f} : Parent{parent(qx, qy), 1.0f / 16.0f}};
        }
      }
    }
  }
  for (int level = depth - 1; level >= coarsest; --level)
    for (size_t i = offset[level + 1]; i < offset[level + 2]; ++i)
      for (const Parent& parent : parents[i])
        flux_of_one[parent.node] += parent.weight * flux_of_one[i];
}

Lobe::Lobe(double alpha) {
  const double a2 = alpha * alpha, half = 0.5 * (1.0 - a2);
  squeeze = static_cast<float>(half);
  core = static_cast<float>(4.0 * a2);
  peak = static_cast<float>(1.0 / (a2 * a2));
  horizon = static_cast<float>(1.0 / ((1.0 - half) * (1.0 - half)));
  // Integral over c: q = 1 - half (1 + c) runs from alpha^2 (c = 1) to 1 - half (c = 0); midpoint
  // rule over log q, in which the integrand is smooth.
  double sum = half < 1e-6 ? 0.5 : 0.0;
  constexpr int kSteps = 1024;
  const double low = std::log(a2), high = std::log(1.0 - half);
  for (int i = 0; i < kSteps && half >= 1e-6; ++i) {
    const double q = std::exp(low + (high - low) * (i + 0.5) / kSteps);
    const double c = (1.0 - q) / half - 1.0;
    sum += c / (q * q) * (q / half) * (high - low) / kSteps;
  }
  integral = 2.0 * kPi * sum;
}

RowBuilder::RowBuilder(const FluxPyramid& pyramid, double alpha)
    : pyramid_(pyramid), lobe_(alpha), value_(pyramid.nodes()), stamp_(pyramid.nodes(), 0) {}

void RowBuilder::append(const Vec3f& axis, PrefilterRows& rows) {
  ++row_;
  const size_t first_group = rows.group.size();
  active_.clear();
  const FluxPyramid& p = pyramid_;
  const auto cosine = [&](uint32_t node) {
    const auto& d = p.direction[node];
    return axis.x() * d[0] + axis.y() * d[1] + axis.z() * d[2];
  };
  // The coarsest level, whole.
  const int coarsest = p.coarsest;
  for (size_t i = p.offset[coarsest]; i < p.offset[coarsest + 1]; i += 4) {
    std::array<float, 4> value;
    for (uint32_t k = 0; k < 4; ++k) {
      const uint32_t node = static_cast<uint32_t>(i) + k;
      value[k] = lobe_at(node, coarsest, axis);
      value_[node] = value[k];
      stamp_[node] = row_;
      if (coarsest < p.depth && refine(node, cosine(node))) active_.push_back(node);
    }
    if (*std::max_element(value.begin(), value.end()) <= 0.0f) continue;
    rows.group.push_back(static_cast<uint32_t>(i));
    rows.weight.insert(rows.weight.end(), value.begin(), value.end());
  }
  for (int level = coarsest + 1; level <= p.depth; ++level) {
    next_.clear();
    for (const uint32_t parent : active_) {
      const uint32_t first =
          static_cast<uint32_t>(p.offset[level] + 4 * (parent - p.offset[level - 1]));
      add_group(first, level, axis, rows);
      for (uint32_t k = 0; k < 4 && level < p.depth; ++k)
        if (refine(first + k, cosine(first + k))) next_.push_back(first + k);
    }
    active_.swap(next_);
  }
  double sum = 0.0;
  for (size_t g = first_group; g < rows.group.size(); ++g)
    for (size_t k = 0; k < 4; ++k)
      sum += double{rows.weight[4 * g + k]} * double{p.flux_of_one[rows.group[g] + k]};
  const float scale = static_cast<float>(1.0 / sum);
  for (size_t i = 4 * first_group; i < rows.weight.size(); ++i) rows.weight[i] *= scale;
}

// Whether the differences at a node's children may matter: a bound of the lobe's curvature around
// the node times its size squared (without the factor c, for a lobe linear in direction still
// curves in face coordinates), and near the horizon the lobe's kink times its size.
bool RowBuilder::refine(uint32_t node, float cosine) const {
  const float w = pyramid_.solid_angle[node], reach = 1.5f * pyramid_.direction[node][3];
  const float nearest = std::min(1.0f, cosine + reach);
  if (nearest <= 0.0f) return false;
  const float chord = std::max(0.0f, std::sqrt(2.0f - 2.0f * std::min(1.0f, cosine)) - reach);
  const float q = 1.0f - lobe_.squeeze * (1.0f + nearest);
  float bound = w / (q * q * (chord * chord + lobe_.core));
  if (std::abs(cosine) < reach) bound = std::max(bound, kKink * reach * lobe_.horizon);
  bound = std::min(bound, lobe_(nearest));
  return bound > kPeakPart * lobe_.peak ||
         0.25 * double{bound} * double{w} > double{kShare} * lobe_.integral;
}

// Adds the differences at four siblings when one of them matters.
void RowBuilder::add_group(uint32_t first, int level, const Vec3f& axis, PrefilterRows& rows) {
  std::array<float, 4> exact, difference;
  bool matters = false;
  for (uint32_t k = 0; k < 4; ++k) {
    exact[k] = lobe_at(first + k, level, axis);
    float interpolated = 0.0f;
    for (const FluxPyramid::Parent& parent : pyramid_.parents[first + k])
      interpolated += parent.weight * approximation(parent.node, level - 1);
    difference[k] = exact[k] - interpolated;
    const float size = std::abs(difference[k]);
    matters =
        matters || size > kPeakPart * lobe_.peak ||
        double{size} * double{pyramid_.solid_angle[first + k]} > double{kShare} * lobe_.integral;
    value_[first + k] = interpolated;
    stamp_[first + k] = row_;
  }
  if (!matters) return;
  for (uint32_t k = 0; k < 4; ++k) value_[first + k] = exact[k];
  rows.group.push_back(first);
  rows.weight.insert(rows.weight.end(), difference.begin(), difference.end());
}

// The row's effective lobe at a node of a level that is already complete.
float RowBuilder::approximation(uint32_t node, int level) {
  if (stamp_[node] == row_) return value_[node];
  float interpolated = 0.0f;
  for (const FluxPyramid::Parent& parent : pyramid_.parents[node])
    interpolated += parent.weight * approximation(parent.node, level - 1);
  value_[node] = interpolated;
  stamp_[node] = row_;
  return interpolated;
}

// The lobe at a node's centre, slightly smoothed; on the finest level its mean over the texel, from
// a grid of points fine enough for the lobe.
float RowBuilder::lobe_at(uint32_t node, int level, const Vec3f& axis) const {
  const auto& d = pyramid_.direction[node];
  const float c = std::min(1.0f, axis.x() * d[0] + axis.y() * d[1] + axis.z() * d[2]);
  if (level < pyramid_.depth) {
    // A coarse node on the axis of a narrow lobe must not read its peak, which finer differences
    // would then have to cancel in single precision: smooth by a part of the node's size.
    const float q = 1.0f - lobe_.squeeze * (1.0f + c - pyramid_.solid_angle[node] / 32.0f);
    return c > 0.0f ? c / (q * q) : 0.0f;
  }
  // (texel size / distance over which the lobe varies)^2
  const float wide = pyramid_.solid_angle[node] / (2.0f - 2.0f * c + lobe_.core);
  const int grid = std::clamp(static_cast<int>(std::ceil(4.0f * std::sqrt(wide))), 1, 32);
  if (grid == 1) return lobe_(c);
  return texel_mean(static_cast<uint32_t>(node - pyramid_.offset[pyramid_.depth]), axis, grid);
}

float RowBuilder::texel_mean(uint32_t z_index, const Vec3f& axis, int grid) const {
  const uint32_t n = static_cast<uint32_t>(pyramid_.size), texel = pyramid_.source_texel[z_index];
  const CubeFace& f = cube_face(static_cast<int>(texel / (n * n)));
  const float an = axis.dot(f.normal.cast<float>()), as = axis.dot(f.s.cast<float>()),
              at = axis.dot(f.t.cast<float>());
  const float size = 2.0f / static_cast<float>(n), step = size / static_cast<float>(grid);
  const float s0 = -1.0f + size * static_cast<float>(texel % n);
  const float t0 = -1.0f + size * static_cast<float>(texel / n % n);
  float sum = 0.0f, weights = 0.0f;
  for (int j = 0; j < grid; ++j) {
    for (int i = 0; i < grid; ++i) {
      const float s = s0 + step * (static_cast<float>(i) + 0.5f);
      const float t = t0 + step * (static_cast<float>(j) + 0.5f);
      const float r = 1.0f / std::sqrt(1.0f + s * s + t * t);
      const float area = r * r * r;  // solid angle per face area
      sum += area * lobe_(std::min(1.0f, (an + as * s + at * t) * r));
      weights += area;
    }
  }
  return sum / weights;
}

}  // namespace effigy
