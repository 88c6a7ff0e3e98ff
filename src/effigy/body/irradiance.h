// How much of the light reaches each texel of a posed body: the input of its shadow network
// (Relightable Full-Body Gaussian Codec Avatars, Eq. 15, A.1-A.3). At texel v with normal n
//   irradiance(v) = sum_i L_i Vis(v, w_i) / sum_i L_i,
// without a cosine; L_i is the luminance of light i at v. Light from behind (n . w <= 0) would pass
// through the body: Vis = 0.
#pragma once

#include <cstdint>
#include <vector>

#include "effigy/body/uv_gaussians.h"
#include "effigy/light/environment_sampler.h"
#include "effigy/light/point_light.h"
#include "effigy/rays/ray_scene.h"

namespace effigy {

struct IrradianceSampling {
  // Directions asked for at each texel. Of point lights: as many as shine on its front, or more,
  // give the sum itself; fewer are drawn from those in proportion to their strength.
  int samples = 1;
  uint64_t seed = 0;
  // Metres along the normal from the mesh to where rays begin: more than the mesh's triangles
  // deviate from the smooth surface that its normals tell of.
  float offset = 2e-3f;
};

class TexelIrradiance {
 public:
  // texels: of the picture wanted, e.g. uv_texels(mesh, shadow_side).
  explicit TexelIrradiance(const UvTexels& texels);

  // Pictures of size^2 numbers in [0, 1], row 0 = top; a texel outside the charts has the value of
  // the nearest one in them. `frames`: of the same texels; `body`: the same posed mesh, and
  // whatever else casts shadows. The expectation over seeds is Eq. 15 for every number of samples;
  // zero where there is no light at all. The same input gives the same bits for every thread count.
  //
  // Throws Error when an intensity is negative or not finite.
  std::vector<float> of_points(const TexelFrames& frames, const RayScene& body,
                               const PointLights& lights, const IrradianceSampling& sampling) const;
  // `light` draws by EnvironmentDraw::kLuminance.
  std::vector<float> of_environment(const TexelFrames& frames, const RayScene& body,
                                    const EnvironmentSampler& light,
                                    const IrradianceSampling& sampling) const;

 private:
  // Values of the valid texels, as a picture.
  std::vector<float> picture(const std::vector<float>& values) const;

  size_t count_;
  std::vector<uint32_t> order_;  // of the valid texels: what lies together follows each other
  std::vector<int32_t> source_;  // per texel of the picture: which of the valid ones it shows
};

}  // namespace effigy
