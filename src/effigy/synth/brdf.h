// The material model of the whole program as a path tracer needs it: evaluation, density and
// sampling of  f = albedo / pi + D G2 F / (4 n.l n.v)
// with alpha = roughness^2, GGX D, height-correlated Smith G2, Schlick F; the diffuse part is not
// multiplied by 1 - F (docs/conventions.md). Directions are unit, in the shading frame (z =
// normal).
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/geometry/types.h"

namespace effigy {

// Roughness below 0.03 is traced as 0.03: a perfect mirror has no density.
inline constexpr float kLeastAlpha = 1e-3f;

// Orthonormal tangents of a unit normal (Duff et al. 2017).
struct ShadingFrame {
  Vec3f x, y, z;
  explicit ShadingFrame(const Vec3f& n) : z(n) {
    const float sign = std::copysign(1.0f, n.z()), a = -1.0f / (sign + n.z()),
                b = n.x() * n.y() * a;
    x = Vec3f(1.0f + sign * n.x() * n.x() * a, sign * b, -sign * n.x());
    y = Vec3f(b, sign + n.y() * n.y() * a, -n.y());
  }
  Vec3f to_local(const Vec3f& v) const { return {x.dot(v), y.dot(v), z.dot(v)}; }
  Vec3f to_world(const Vec3f& v) const { return v.x() * x + v.y() * y + v.z() * z; }
};

class Brdf {
 public:
  // `view`: towards the camera, view.z() > 0. `specular` < 0: no specular lobe.
  Brdf(const Vec3f& albedo, float roughness, float specular, const Vec3f& view)
      : albedo_(albedo),
        view_(view),
        alpha_(std::max(roughness * roughness, kLeastAlpha)),
        alpha2_(alpha_ * alpha_),
        specular_(specular),
        smith_view_(smith(view.z())) {
    if (specular < 0) return;
    // How often the specular lobe is chosen: its share of the reflected light, roughly.
    const float grazing = std::pow(1.0f - view.z(), 5.0f) * (1.0f - roughness);
    const float shine = specular + (1.0f - specular) * grazing, body = albedo.mean();
    chance_ = body <= 0 ? 1.0f : std::clamp(shine / (shine + body), 0.1f, 0.9f);
  }

  // How often sample() takes the specular lobe.
  float specular_chance() const { return chance_; }

  struct Value {
    Vec3f reflected = Vec3f::Zero();  // f times n.l
    float density = 0;                // of sample(), per steradian
  };
  Value evaluate(const Vec3f& light) const {
    Value value;
    const float nl = light.z();
    if (nl <= 0) return value;
    constexpr float kInversePi = std::numbers::inv_pi_v<float>;
    value.reflected = albedo_ * (nl * kInversePi);
    value.density = (1.0f - chance_) * nl * kInversePi;
    if (specular_ < 0) return value;
    const Vec3f half = (light + view_).normalized();
    const float d = distribution(half);
    const float vh = std::max(view_.dot(half), 0.0f), m = 1.0f - vh, m2 = m * m;
    const float fresnel = specular_ + (1.0f - specular_) * m2 * m2 * m;
    const float masking = 0.5f / (nl * smith_view_ + view_.z() * smith(nl));  // G2 / (4 n.l n.v)
    value.reflected.array() += d * fresnel * masking * nl;
    value.density += chance_ * d * 0.5f / (view_.z() + smith_view_);  // G1 D / (4 n.v)
    return value;
  }

  // A direction with the density of evaluate(); its z is <= 0 when the sample is lost below the
  // surface. u in [0, 1)^2.
  Vec3f sample(Vec2f u) const {
    constexpr float kTau = 2.0f * std::numbers::pi_v<float>;
    if (u.x() < chance_) {
      // Visible normals by spherical caps (Dupuy and Benyoub 2023).
      u.x() /= chance_;
      const Vec3f v = Vec3f(alpha_ * view_.x(), alpha_ * view_.y(), view_.z()).normalized();
      const float z = (1.0f - u.y()) * (1.0f + v.z()) - v.z();
      const float sine = std::sqrt(std::max(0.0f, 1.0f - z * z));
      const Vec3f h = Vec3f(sine * std::cos(kTau * u.x()), sine * std::sin(kTau * u.x()), z) + v;
      const Vec3f half = Vec3f(alpha_ * h.x(), alpha_ * h.y(), std::max(h.z(), 1e-9f)).normalized();
      return 2.0f * view_.dot(half) * half - view_;
    }
    u.x() = (u.x() - chance_) / (1.0f - chance_);
    const float sine = std::sqrt(u.y());
    return {sine * std::cos(kTau * u.x()), sine * std::sin(kTau * u.x()),
            std::sqrt(std::max(0.0f, 1.0f - u.y()))};
  }

 private:
  float smith(float cosine) const {
    return std::sqrt(alpha2_ + (1.0f - alpha2_) * cosine * cosine);
  }
  // GGX; written so that nothing cancels for narrow lobes.
  float distribution(const Vec3f& h) const {
    const float s = (h.x() * h.x() + h.y() * h.y()) / alpha2_ + h.z() * h.z();
    return std::numbers::inv_pi_v<float> / (alpha2_ * s * s);
  }

  Vec3f albedo_, view_;
  float alpha_, alpha2_, specular_, smith_view_, chance_ = 0;
};

}  // namespace effigy
