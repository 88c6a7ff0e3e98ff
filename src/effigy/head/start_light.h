// The light that training starts from, told from the frames: the one that explains most of what is
// bright and dark by how surfaces are turned, so that little is left to the albedo.
#pragma once

#include <array>
#include <vector>

#include "effigy/light/environment.h"

namespace effigy {

// A pixel of a frame: which way its surface faces (world, unit), its linear radiance, and which
// patch of the surface it shows.
struct SurfaceSample {
  Vec3f normal;
  std::array<float, 3> radiance;
  int patch = 0;
};

// Alternates between light and albedo (patch by patch, all frames) with positive radiance
// throughout. Albedo that differs little from its median over the patches is taken for shading not
// yet explained; that of hair, lips and eyes, which differs much, is left. In each channel the mean
// radiance over all directions is 1: the light's colour and level cannot be told from the albedo's.
// Directions that no sample faces stay near 1. `patches`: above every sample's patch. `size`: of
// the cubemap returned.
Cubemap start_light(const std::vector<SurfaceSample>& samples, int patches, int size);

// The light's irradiance / pi by normal: what shading multiplies the albedo with.
Cubemap diffuse_response(const Cubemap& light);

}  // namespace effigy
