// A floor that catches a body's shadow.
#pragma once

#include <cstdint>

#include "effigy/geometry/types.h"
#include "effigy/image/image.h"
#include "effigy/light/environment_sampler.h"
#include "effigy/light/point_light.h"
#include "effigy/rays/ray_scene.h"

namespace effigy {

struct GroundSampling {
  int samples = 64;  // directions a pixel, of an environment
  uint64_t seed = 0;
};

// Share of the light that still reaches the horizontal plane y = height where each pixel's ray
// meets it: irradiance with the body over irradiance without it, r g b (3 planes, in [0, 1]); 1
// where the ray misses the plane or no light reaches it anyway. The same input gives the same bits
// for every thread count.
Planes ground_shadow(const Camera& camera, float height, const RayScene& body,
                     const PointLights& lights);
// `light` draws by EnvironmentDraw::kLuminance.
Planes ground_shadow(const Camera& camera, float height, const RayScene& body,
                     const EnvironmentSampler& light, const GroundSampling& sampling);

}  // namespace effigy
