// Lights that are points or directions.
#pragma once

#include <span>
#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/light/environment.h"

namespace effigy {

struct PointLight {
  Vec3f position = Vec3f::Zero();   // metres; of a directional light the unit direction towards it
  Vec3f intensity = Vec3f::Zero();  // linear RGB
  bool directional = false;
};

// Diffuse and specular shading take intensities as Diracs: light arriving from one direction with
// that strength. With `falloff` a point light's strength at distance r is its intensity times
// (|position - center| / r)^2, so that it is the intensity itself at `center` (the middle of a
// light stage); without it, distance does not matter.
struct PointLights {
  std::vector<PointLight> lights;
  bool falloff = false;
  Vec3f center = Vec3f::Zero();
};

// From a point to a lamp: unit direction, what distance leaves of the intensity, and 1 / distance
// (0 for far lamps). A lamp at the point itself has a direction of no meaning, but a finite one.
struct LampWay {
  Vec3f direction;
  float strength = 1, inverse_distance = 0;
};
LampWay way_to_lamp(const PointLights& lights, const PointLight& lamp, const Vec3f& from);

// Spherical harmonics up to order kZonalOrder, r g b of each coefficient: of the points as seen
// from `from`, and of an environment's radiance with exact texel solid angles. A point of intensity
// I is a texel of radiance times solid angle I.
std::vector<float> sh_of_points(const PointLights& points, const Vec3f& from);
std::vector<float> sh_of_cubemap(const Cubemap& radiance);
// The other way round: 153 far lamps, some of negative intensity, that have these harmonics. What
// they give to a function of order kZonalOrder is exactly what the light gives it (quadrature of
// Gauss and Legendre over z, even over the angle about it).
PointLights sh_lamps(std::span<const float> sh);

}  // namespace effigy
