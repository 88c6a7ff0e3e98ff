// Deferred split-sum shading of a surfel G-buffer (GTAvatar Eq. 5), display transform and
// compositing, forward and backward:
//   m = G / max(alpha, 1e-4), n = normalize(mapped normal), v = direction to the camera,
//   L = albedo * E_d(n) + (F0 A(n.v, r) + B(n.v, r)) * E_s(reflect(v, n), r)
//   image = alpha * display(L) + (1 - alpha) * background
// E_d, E_s: seamless bilinear lookups (sample_cubemap), E_s linear between roughness levels; A, B:
// brdf_table(), n.v and r clamped to [0, 1]. display: above radiance 1 kSrgb is flat and has no
// gradient; below zero both transforms are odd. A pixel without a normal (shorter than 1e-6) is
// shaded as if it faced the camera and has no normal gradient. Pixels with alpha <= 0 are
// background and have no gradient. Accuracy: within 2e-5 (display-encoded) of the double-precision
// oracle.
#pragma once

#include <array>

#include "effigy/geometry/types.h"
#include "effigy/image/colour.h"
#include "effigy/image/image.h"
#include "effigy/light/brdf_table.h"
#include "effigy/light/packed_environment.h"

namespace effigy {

struct ShadeOptions {
  bool divide_by_alpha = true;  // false: premultiplied materials, as the paper's reference code
  bool mapped_normal = true;    // shade with the normal map
  DisplayTransform display = DisplayTransform::kSrgb;
  std::array<float, 3> background{0, 0, 0};  // display-encoded
};

// `colour`: 3 planes, display-encoded, composited. `radiance` (optional): 3 planes, linear, not
// composited, 0 where nothing is. `gbuffer` has kGBufferPlanes planes of the camera's size.
void shade_deferred(const Planes& gbuffer, const Camera& camera,
                    const PrefilteredEnvironment& light, const ShadeOptions& options,
                    Planes& colour, Planes* radiance = nullptr);
// The same for a light packed beforehand: playback packs an HDRI once, not every frame.
void shade_deferred(const Planes& gbuffer, const Camera& camera, const PackedEnvironment& light,
                    const ShadeOptions& options, Planes& colour, Planes* radiance = nullptr);

// Adds to d_gbuffer (kGBufferPlanes planes) and, when not null, to d_light (shaped like light).
// Bit-reproducible for a given thread count. n.v is differentiated too.
void shade_deferred_backward(const Planes& gbuffer, const Camera& camera,
                             const PrefilteredEnvironment& light, const ShadeOptions& options,
                             const Planes& d_colour, Planes& d_gbuffer,
                             PrefilteredEnvironment* d_light);

}  // namespace effigy
