// Deferred split-sum shading of a surfel G-buffer (GTAvatar Eq. 5), display transform and
// compositing, forward and backward:
//   m = G / alpha (guard), n = normalize(mapped normal), v = direction to the camera,
//   L = albedo * E_d(n) + (F0 A(n.v, r) + B(n.v, r)) * E_s(reflect(v, n), r)
//   image = alpha * display(L) + (1 - alpha) * background
#pragma once

#include <array>

#include "effigy/geometry/types.h"
#include "effigy/image/colour.h"
#include "effigy/image/image.h"
#include "effigy/light/brdf_table.h"
#include "effigy/light/environment.h"

namespace effigy {

struct ShadeOptions {
  bool divide_by_alpha = true;  // false: premultiplied materials, as the paper's reference code
  bool mapped_normal = true;    // shade with the normal map
  DisplayTransform display = DisplayTransform::kSrgb;
  std::array<float, 3> background{0, 0, 0};  // display-encoded
};

// `colour`: 3 planes, display-encoded, composited. `radiance` (optional): 3 planes, linear, not
// composited.
void shade_deferred(const Planes& gbuffer, const Camera& camera,
                    const PrefilteredEnvironment& light, const ShadeOptions& options,
                    Planes& colour, Planes* radiance = nullptr);

// Adds to d_gbuffer (kGBufferPlanes planes) and, when not null, to d_light (shaped like light).
// Bit-reproducible for a given thread count. n.v is differentiated too.
void shade_deferred_backward(const Planes& gbuffer, const Camera& camera,
                             const PrefilteredEnvironment& light, const ShadeOptions& options,
                             const Planes& d_colour, Planes& d_gbuffer,
                             PrefilteredEnvironment* d_light);

}  // namespace effigy
