// Diffusion profiles of translucent surfaces: how far from where it entered light leaves again.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/synth/brdf.h"
#include "effigy/synth/scene.h"

namespace effigy {

// R(r) = (exp(-r/d) + exp(-r/3d)) / (8 pi d r) per area and channel (Christensen and Burley 2015),
// without the albedo: its integral over a plane is 1. Lengths in metres.
class ScatterProfile {
 public:
  // d of each channel, positive.
  explicit ScatterProfile(const Vec3f& d) : d_(d.cwiseMax(1e-7f)) {}

  // Beyond this distance less than a thousandth leaves; it is left out.
  float reach() const { return 21 * d_.maxCoeff(); }
  Vec3f value(float r) const {
    const Vec3f x = (-std::max(r, 1e-9f) / d_.array()).matrix();
    return (x.array().exp() + (x.array() / 3).exp())
        .matrix()
        .cwiseQuotient((8 * std::numbers::pi_v<float> * std::max(r, 1e-9f)) * d_);
  }
  // A distance whose density per area in a plane is density(); u in [0, 1)^2.
  float sample(Vec2f u) const {
    const int channel = std::min(static_cast<int>(3 * u.x()), 2);
    u.x() = 3 * u.x() - static_cast<float>(channel);
    return -(u.x() < 0.25f ? 1.0f : 3.0f) * d_[channel] * std::log1p(-u.y());
  }
  float density(float r) const { return value(r).mean(); }

 private:
  Vec3f d_;
};

// A line through a surface near a point where light leaves, along the normal or a tangent there.
struct ScatterProbe {
  // Length 0: the drawn distance is beyond the profile's reach.
  ScatterProbe(const ScenePoint& exit, const Vec2f& u_radius, const Vec2f& u_turn)
      : profile(exit.scatter), frame(exit.geometric) {
    const float radius = profile.sample(u_radius), reach = profile.reach();
    if (radius >= reach) return;
    const Vec3f axes[3] = {frame.x, frame.y, frame.z};
    const int axis = u_turn.x() < 0.5f ? 2 : (u_turn.x() < 0.75f ? 0 : 1);
    const float angle = 2 * std::numbers::pi_v<float> * u_turn.y();
    const float half = std::sqrt(reach * reach - radius * radius);
    direction = -axes[axis];
    origin =
        exit.position - half * direction +
        radius * (std::cos(angle) * axes[(axis + 1) % 3] + std::sin(angle) * axes[(axis + 2) % 3]);
    length = 2 * half;
  }

  // What enters per irradiance at a place `way` from the exit with normal `outward`, over the
  // density per area with which probes of all axes and channels find it.
  Vec3f share(const Vec3f& way, const Vec3f& outward) const {
    const Vec3f axes[3] = {frame.x, frame.y, frame.z};
    constexpr float kChance[3] = {0.25f, 0.25f, 0.5f};
    const float square = way.squaredNorm();
    float density = 0;
    for (int k = 0; k < 3; ++k) {
      const float along = way.dot(axes[k]);
      const float across = std::sqrt(std::max(0.0f, square - along * along));
      if (across < profile.reach())
        density += kChance[k] * std::abs(outward.dot(axes[k])) * profile.density(across);
    }
    if (!(density > 0)) return Vec3f::Zero();
    return profile.value(std::sqrt(square)) / density;
  }

  ScatterProfile profile;
  ShadingFrame frame;
  Vec3f origin = Vec3f::Zero(), direction = Vec3f::UnitZ();
  float length = 0;
};

// Skin. Diffuse mean free paths l of 3.67, 1.37 and 0.68 mm (Jensen et al. 2001, skin 1), as
// d = l / (3.5 + 100 (A - 0.33)^4) at the albedos A of middling skin.
inline const Vec3f kSkinScatter(1.0e-3f, 0.38e-3f, 0.19e-3f);

}  // namespace effigy
