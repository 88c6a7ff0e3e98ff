#include "effigy/light/brdf_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"

// scale(n.v, r) and bias(n.v, r) are the directional albedo of the GGX lobe for F0 = 1 and the part
// of Schlick's F that does not depend on F0:
//   integral of D G F / (4 (n.v)(n.l)) (n.l) dl = F0 * scale + bias.
// With half vectors distributed as GGX's visible normals this is the mean of F G2 / G1 over the
// distribution, a bounded smooth integrand. Visible normals by the spherical-cap construction
// (Dupuy and Benyoub 2023): in the space where the lobe is a hemisphere, h = v + c with c uniform
// on the cap of directions with z > -v.z. Gauss-Legendre over the cap's height, midpoints over half
// of its azimuth (the integrand is even and periodic, so midpoints converge exponentially).

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kSize = 64;
constexpr int kHeights = 32;
constexpr int kAzimuths = 24;

struct Rule {
  std::array<double, kHeights> node, weight;  // on [0, 1]
};

Rule gauss_legendre() {
  Rule rule;
  for (int i = 0; i < kHeights; ++i) {
    double x = std::cos(kPi * (i + 0.75) / (kHeights + 0.5)), derivative = 1.0;
    for (int iteration = 0; iteration < 20; ++iteration) {
      double p0 = 1.0, p1 = x;
      for (int k = 2; k <= kHeights; ++k) {
        const double p2 = ((2.0 * k - 1.0) * x * p1 - (k - 1.0) * p0) / k;
        p0 = p1;
        p1 = p2;
      }
      derivative = kHeights * (x * p1 - p0) / (x * x - 1.0);
      const double step = p1 / derivative;
      x -= step;
      if (std::abs(step) < 1e-15) break;
    }
    rule.node[static_cast<size_t>(i)] = 0.5 * (1.0 - x);
    rule.weight[static_cast<size_t>(i)] = 1.0 / ((1.0 - x * x) * derivative * derivative);
  }
  return rule;
}

struct Albedo {
  double scale, bias;
};

Albedo directional_albedo(const Rule& rule, const std::array<double, kAzimuths>& cosine,
                          double n_dot_v, double roughness) {
  const double alpha = roughness * roughness, a2 = alpha * alpha;
  const double sine = std::sqrt(1.0 - n_dot_v * n_dot_v);
  // The view direction where the lobe is a hemisphere.
  const double length = std::sqrt(a2 * sine * sine + n_dot_v * n_dot_v);
  const double vx = alpha * sine / length, vz = n_dot_v / length;
  const double smith_v = std::sqrt(a2 + (1.0 - a2) * n_dot_v * n_dot_v);
  double scale = 0.0, bias = 0.0;
  for (size_t i = 0; i < kHeights; ++i) {
    const double z = 1.0 - rule.node[i] * (1.0 + vz);
    const double radius = std::sqrt(std::max(0.0, 1.0 - z * z));
    double scale_ring = 0.0, bias_ring = 0.0;
    for (const double cos_azimuth : cosine) {
      // The half vector: x along the view, y only through its length.
      const double cx = radius * cos_azimuth, hy2 = radius * radius - cx * cx;
      const double hx = alpha * (cx + vx), hz = z + vz;
      const double h_length = std::sqrt(hx * hx + a2 * hy2 + hz * hz);
      if (h_length <= 0.0) continue;
      const double v_dot_h = std::clamp((sine * hx + n_dot_v * hz) / h_length, 0.0, 1.0);
      const double n_dot_l = 2.0 * v_dot_h * hz / h_length - n_dot_v;
      if (n_dot_l <= 0.0) continue;
      // Height-correlated G2 over G1(v).
      const double smith_l = std::sqrt(a2 + (1.0 - a2) * n_dot_l * n_dot_l);
      const double g = n_dot_l * (n_dot_v + smith_v) / (n_dot_l * smith_v + n_dot_v * smith_l);
      const double m = 1.0 - v_dot_h, fresnel = m * m * m * m * m;
      scale_ring += g * (1.0 - fresnel);
      bias_ring += g * fresnel;
    }
    scale += rule.weight[i] * scale_ring / kAzimuths;
    bias += rule.weight[i] * bias_ring / kAzimuths;
  }
  return {scale, bias};
}

BrdfTable compute_table() {
  const Rule rule = gauss_legendre();
  std::array<double, kAzimuths> cosine;
  for (size_t i = 0; i < kAzimuths; ++i)
    cosine[i] = std::cos(kPi * (static_cast<double>(i) + 0.5) / kAzimuths);
  BrdfTable table;
  table.size = kSize;
  table.value.resize(size_t{2} * kSize * kSize);
  for (int row = 0; row < kSize; ++row) {
    for (int column = 0; column < kSize; ++column) {
      const Albedo albedo =
          directional_albedo(rule, cosine, (column + 0.5) / kSize, (row + 0.5) / kSize);
      float* value = &table.value[2 * (static_cast<size_t>(row) * kSize + column)];
      value[0] = static_cast<float>(albedo.scale);
      value[1] = static_cast<float>(albedo.bias);
    }
  }
  return table;
}

}  // namespace

// Computed by one thread: a first use inside the thread pool then cannot wait for itself.
const BrdfTable& brdf_table() {
  static const BrdfTable table = compute_table();
  return table;
}

BrdfSample sample_brdf(const BrdfTable& table, float n_dot_v, float roughness) {
  const int n = table.size;
  EFFIGY_CHECK(n >= 2);
  struct Axis {
    int first;
    float fraction, slope;  // slope: table cells per unit, 0 where clamped
  };
  const auto axis = [n](float x) {
    const float u = x * static_cast<float>(n) - 0.5f, last = static_cast<float>(n - 1);
    if (!(u > 0.0f)) return Axis{0, 0.0f, 0.0f};
    if (u >= last) return Axis{n - 2, 1.0f, 0.0f};
    const int first = std::min(static_cast<int>(u), n - 2);
    return Axis{first, u - static_cast<float>(first), static_cast<float>(n)};
  };
  const Axis c = axis(n_dot_v), r = axis(roughness);
  const float* low = &table.value[2 * (static_cast<size_t>(r.first) * n + c.first)];
  const float* high = low + 2 * static_cast<size_t>(n);
  float value[2], by_view[2], by_roughness[2];
  for (int k = 0; k < 2; ++k) {
    const float a = low[k], b = low[k + 2], d = high[k], e = high[k + 2];
    const float bottom = a + c.fraction * (b - a), top = d + c.fraction * (e - d);
    value[k] = bottom + r.fraction * (top - bottom);
    by_view[k] = c.slope * ((b - a) + r.fraction * ((e - d) - (b - a)));
    by_roughness[k] = r.slope * (top - bottom);
  }
  return {value[0], value[1], by_view[0], by_view[1], by_roughness[0], by_roughness[1]};
}

}  // namespace effigy
