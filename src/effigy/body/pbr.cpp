#include "effigy/body/pbr.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr float kF0 = 0.04f, kLeastRough = 0.05f, kLeastCosine = 1e-3f;
constexpr size_t kGrain = 512;

// A number with its derivatives by n.l, n.v, n.h and roughness.
struct Dual {
  float value = 0;
  std::array<float, 4> d{};
  static Dual variable(float v, size_t which) {
    Dual x{v, {}};
    x.d[which] = 1;
    return x;
  }
};
Dual operator+(Dual a, const Dual& b) {
  a.value += b.value;
  for (size_t i = 0; i < 4; ++i) a.d[i] += b.d[i];
  return a;
}
Dual operator*(const Dual& a, const Dual& b) {
  Dual c{a.value * b.value, {}};
  for (size_t i = 0; i < 4; ++i) c.d[i] = a.d[i] * b.value + a.value * b.d[i];
  return c;
}
Dual operator*(float a, Dual b) {
  b.value *= a;
  for (float& d : b.d) d *= a;
  return b;
}
Dual operator+(float a, Dual b) {
  b.value += a;
  return b;
}
Dual inverse(const Dual& a) {
  Dual c{1 / a.value, {}};
  for (size_t i = 0; i < 4; ++i) c.d[i] = -a.d[i] * c.value * c.value;
  return c;
}
Dual root(const Dual& a) {
  Dual c{std::sqrt(a.value), {}};
  for (size_t i = 0; i < 4; ++i) c.d[i] = a.d[i] / (2 * c.value);
  return c;
}

// D G2 F / (4 n.l n.v); vh: cosine between view and half vector.
Dual lobe(float nl, float nv, float nh, float vh, float roughness) {
  const Dual cos_l = Dual::variable(std::max(nl, kLeastCosine), 0);
  const Dual cos_v = Dual::variable(std::max(nv, kLeastCosine), 1);
  const Dual cos_h = Dual::variable(std::clamp(nh, 0.0f, 1.0f), 2);
  const Dual r = Dual::variable(std::max(roughness, kLeastRough), 3);
  const Dual alpha = r * r, alpha2 = alpha * alpha;
  const Dual below = 1.0f + cos_h * cos_h * (-1.0f + alpha2);
  const Dual d = alpha2 * inverse(std::numbers::pi_v<float> * (below * below));
  const auto smith = [&](const Dual& cosine) {
    return root(alpha2 + (1.0f + -1.0f * alpha2) * cosine * cosine);
  };
  const Dual masking = 0.5f * inverse(cos_l * smith(cos_v) + cos_v * smith(cos_l));
  const float m = 1 - std::clamp(vh, 0.0f, 1.0f), m2 = m * m;
  const float fresnel = kF0 + (1 - kF0) * m2 * m2 * m;
  return fresnel * (d * masking);
}

Vec3f at(std::span<const float> planes, size_t n, size_t i) {
  return {planes[i], planes[n + i], planes[2 * n + i]};
}

// Calls with(l, irradiance facing the lamp) for every lamp at a point.
template <typename With>
void each_lamp(const PointLights& lights, const Vec3f& point, const With& with) {
  for (const PointLight& lamp : lights.lights) {
    const LampWay way = way_to_lamp(lights, lamp, point);
    with(way.direction, Vec3f(way.strength * lamp.intensity));
  }
}

}  // namespace

void shade_pbr(const PointLights& lights, const PbrView& view, std::span<float> colour) {
  const size_t n = view.count;
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const Vec3f normal = at(view.normal, n, i), v = at(view.to_camera, n, i);
      const Vec3f albedo = at(view.albedo, n, i) * std::numbers::inv_pi_v<float>;
      Vec3f sum = Vec3f::Zero();
      each_lamp(lights, at(view.position, n, i), [&](const Vec3f& l, const Vec3f& given) {
        const float nl = normal.dot(l);
        if (nl <= 0) return;
        const Vec3f h = (l + v).normalized();
        const float shine =
            view.weight[i] *
            lobe(nl, normal.dot(v), normal.dot(h), v.dot(h), view.roughness[i]).value;
        sum += nl * given.cwiseProduct(Vec3f(albedo.array() + shine));
      });
      for (int c = 0; c < 3; ++c) colour[static_cast<size_t>(c) * n + i] = sum[c];
    }
  });
}

void shade_pbr_backward(const PointLights& lights, const PbrView& view,
                        std::span<const float> d_colour, const PbrGradients& gradients) {
  const size_t n = view.count;
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const Vec3f normal = at(view.normal, n, i), v = at(view.to_camera, n, i);
      const Vec3f albedo = at(view.albedo, n, i) * std::numbers::inv_pi_v<float>;
      const Vec3f d = at(d_colour, n, i);
      const float weight = view.weight[i], nv = normal.dot(v);
      Vec3f d_normal = Vec3f::Zero(), d_albedo = Vec3f::Zero();
      float d_weight = 0, d_roughness = 0;
      each_lamp(lights, at(view.position, n, i), [&](const Vec3f& l, const Vec3f& given) {
        const float nl = normal.dot(l);
        if (nl <= 0) return;
        const Vec3f h = (l + v).normalized();
        const float nh = normal.dot(h);
        const Dual shine = lobe(nl, nv, nh, v.dot(h), view.roughness[i]);
        const Vec3f lit = d.cwiseProduct(given);  // derivative by n.l (albedo / pi + shine)
        const float grey = lit.sum();
        d_albedo += nl * std::numbers::inv_pi_v<float> * lit;
        d_weight += nl * shine.value * grey;
        const float d_shine = nl * weight * grey;
        d_normal += (lit.dot(albedo) + weight * shine.value * grey) * l;
        if (nl > kLeastCosine) d_normal += d_shine * shine.d[0] * l;
        if (nv > kLeastCosine) d_normal += d_shine * shine.d[1] * v;
        if (nh < 1) d_normal += d_shine * shine.d[2] * h;
        if (view.roughness[i] > kLeastRough) d_roughness += d_shine * shine.d[3];
      });
      for (int c = 0; c < 3; ++c) {
        gradients.normal[static_cast<size_t>(c) * n + i] += d_normal[c];
        gradients.albedo[static_cast<size_t>(c) * n + i] += d_albedo[c];
      }
      gradients.weight[i] += d_weight;
      gradients.roughness[i] += d_roughness;
    }
  });
}

}  // namespace effigy
