// Unbiased images of a scene by path tracing: at every surface point one light sample and one
// surface sample, weighed by the balance heuristic (Veach 1997), Russian roulette from the third
// bounce on. Every sample depends on pixel, index and seed only: the same seed gives the same bits
// for any number of threads.
//
// Diffuse light of a translucent material leaves elsewhere than it entered, by the material's
// diffusion profile over the true distance (subsurface.h): through ears and nostrils too. Between
// entering and leaving no bounce is counted, and without shadows (kUnshadowed) it is Lambert's.
//
// Where a normal map turns a normal away from the viewer it is bent back until it stands at right
// angles to the view; surfaces are seen and lit from both sides. Rays leave from the smooth surface
// that the vertex normals describe (scene.h), so a coarse mesh does not shadow itself by its
// facets. Light that is reflected more than `bounces` times is left out, nothing else.
#pragma once

#include "effigy/base/progress.h"
#include "effigy/synth/scene.h"

namespace effigy {

enum class Transport {
  kUnshadowed,  // light reaches every surface as if nothing else were there; no bounces
  kGlobal,      // shadows and interreflection
};

struct TraceOptions {
  int samples = 64;  // a pixel; powers of two are spread best
  int bounces = 8;   // surface reflections of a path; 1: direct light only
  uint64_t seed = 1;
  Transport transport = Transport::kGlobal;
};

// Linear radiance times alpha, and alpha: 4 channels. The environment itself is not drawn. Pixels
// average over their square. With more than four point lights one is chosen at each point in
// proportion to what it would give unshadowed; with more than 16, of every n-th from a random one
// on. Throws Error when there is no light or the camera is
// inside a mesh. `progress` counts rows of pixels.
Image trace_image(const TraceScene& scene, const Camera& camera, const TraceOptions& options,
                  Progress* progress = nullptr);

// What stands in each pixel, whatever the light.
struct SurfaceLayers {
  // Of the ray through the pixel's centre: kGBufferPlanes planes (splat/surfel_raster.h), alpha 0
  // or 1; mesh * 256 + part + 1, 0 where nothing is.
  Planes gbuffer;
  std::vector<int> part;
  // Means over the covered part of the pixel, 0 where nothing is: albedo 3; roughness, F0 and the
  // visible share of the cosine-weighted hemisphere over the surface.
  Image albedo, material;
};
SurfaceLayers trace_layers(const TraceScene& scene, const Camera& camera, int samples,
                           uint64_t seed);
// Only the pixel-centre G-buffer.
Planes trace_gbuffer(const TraceScene& scene, const Camera& camera);

// Normalised irradiance of the vertices of a mesh, 3V (RGB), in [0, 1]: the integral of L Vis over
// that of L over the whole sphere (Relightable Full-Body Gaussian Codec Avatars, Eq. 15), by
// `samples` pairs of light and uniform samples a vertex; point lights are summed, of more than 64
// every n-th from a random one on (appendix A there).
std::vector<float> vertex_irradiance(const TraceScene& scene, int mesh, int samples, uint64_t seed);

}  // namespace effigy
