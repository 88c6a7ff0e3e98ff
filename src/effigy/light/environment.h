// Environment light: equirectangular maps, cubemaps, and the prefiltered environment that split-sum
// shading reads. Directions: y up; equirectangular u = atan2(x, -z)/2pi + 1/2, v = acos(y)/pi from
// the top; cubemap faces +x -x +y -y +z -z in OpenGL order and orientation; exact texel solid
// angles. Radiance is linear RGB.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/geometry/types.h"
#include "effigy/image/image.h"

namespace effigy {

struct Cubemap {
  int size = 0;
  std::vector<float> texels;  // [6][size][size][3]
  Cubemap() = default;
  explicit Cubemap(int n, float value = 0.0f)
      : size(n), texels(static_cast<size_t>(6) * n * n * 3, value) {}
};

// Unit direction of texel centre (x, y) of face f; and a texel's exact solid angle.
Vec3f cubemap_direction(int face, int x, int y, int size);
double cubemap_solid_angle(int x, int y, int size);

// Radiance averaged over each cubemap texel. `rotation`: radians about +y (positive turns the light
// counter-clockwise seen from above). Throws Error for an image that is not about 2:1.
Cubemap cubemap_from_equirectangular(const Image& image, int size, double rotation = 0.0);
Image equirectangular_from_cubemap(const Cubemap& cubemap, int width, int height);
// Reads EXR/HDR/PNG (integer formats are sRGB), checks finite and non-negative.
Image read_environment(const Path& path);
// Mean irradiance/pi over the sphere (luminance): what auto exposure matches.
double mean_radiance(const Cubemap& cubemap);

// Bilinear cubemap lookup that is continuous over face borders.
Vec3f sample_cubemap(const Cubemap& cubemap, const Vec3f& direction);

// What shading reads: L(n, 0) for diffuse (irradiance / pi) and GGX-prefiltered levels.
struct PrefilteredEnvironment {
  Cubemap diffuse;
  std::vector<Cubemap> specular;  // per level
  std::vector<float> roughness;   // of each level, ascending, first .. last cover [0, 1]
};

// The linear map radiance cubemap -> PrefilteredEnvironment with its exact transpose. Specular
// level r holds, for every reflection direction R, the split-sum lobe (Karis 2013 with N = V = R):
//   integral of L(l) D(h) (R.l) dl / integral of D(h) (R.l) dl,  h = normalize(R + l),
// GGX D with alpha = r^2; level 0 is the source itself; diffuse holds the integral of L(l)
// (n.l)/pi. Weights of each output texel sum to 1, so constant light gives exactly its value.
//
// Levels for sources up to 32^2: r = 0 .2 .3 .4 .5 .65 .8 1 of sizes 32 32 32 16 16 16 8 8, diffuse
// 16 (a texel is at most about a quarter of the lobe's width); larger sources add r = .1 and .14.
//
// Each output texel's integral is a quadrature over the source's pyramid, fine where the lobe bends
// (prefilter_rows.h). Against the full sum over source texels, a lamp of one texel is off by at
// most 2 % of the lobe's peak response (typically under 0.5 %), noise by some 1e-3. Weights are
// built once per size and shared by the process: 32^2 some 2 MB, 128^2 20 MB. Safe to use from
// several threads. `source_size`: a power of two in [2, 1024].
class Prefilter {
 public:
  // source_size: e.g. 32 for the learned light, 128 or more for HDRIs.
  explicit Prefilter(int source_size);
  ~Prefilter();
  PrefilteredEnvironment forward(const Cubemap& radiance) const;
  // Zeroed gradients in the shape forward returns.
  PrefilteredEnvironment zero_like() const;
  // Adds the transpose applied to `gradient` to d_radiance (same size as the source).
  // Bit-reproducible for a given thread count.
  void backward(const PrefilteredEnvironment& gradient, Cubemap& d_radiance) const;

 private:
  struct State;
  std::shared_ptr<const State> state_;
};

// One-shot prefilter of an HDRI for relighting: Prefilter::forward on a cubemap of the HDRI, of
// 128^2 or the size its resolution fills; `scale` multiplies the radiance (exposure).
PrefilteredEnvironment prefilter_environment(const Image& equirectangular, double rotation = 0.0,
                                             double scale = 1.0);

}  // namespace effigy
