// From texels to picture (Relightable Full-Body Gaussian Codec Avatars, sections 3.2 and 3.3):
// diffuse radiance transfer for every Gaussian, all channels splatted in one pass, specular light
// for every pixel, shadow; forward and backward on plain arrays.
//
// With premultiplied channels D (diffuse), n, s (width of the lobe), v (specular visibility), h
// (shadow), z (depth) and alpha a of a pixel:
//   n' = n / |n|, s' = s / a, h' = h / a, position = the pixel's ray at depth z / a,
//   C = (D + v S(reflect(n'), s')) h'      (Eq. 12, 16; S: light filtered by the lobe, Eq. 13)
// Where groups of lights have shadows of their own, each has its D, S and h, and C is the sum over
// them: with the shadows given, linear in the lights.
// C is linear radiance over black, premultiplied. Without divide_by_alpha s' = s and h' = h, as the
// paper prints. Depth has no gradient: blended depth is too noisy to be steered by highlights.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "effigy/body/uv_gaussians.h"
#include "effigy/image/image.h"
#include "effigy/shade/transfer.h"
#include "effigy/splat/gaussian_raster.h"

namespace effigy {

// The light of one frame, ready for both kinds of transfer.
struct BodyLight {
  PointLights points;
  std::vector<float> sh;                         // sh_of_cubemap of an environment, or empty
  std::shared_ptr<const LobeEnvironment> lobes;  // of the same environment, or none
  std::shared_ptr<const BandTable> bands;        // of the same, where they are to be looked up
  PointLights directions;                        // the environment as far lamps, for the baselines
  // Groups of lights with shadows of their own: then this is their sum, and all of the above is
  // empty.
  std::vector<BodyLight> groups;
  std::span<const BodyLight> parts() const {
    return groups.empty() ? std::span(this, 1) : std::span(groups);
  }
  // The points, or the directions of an environment.
  const PointLights& lamps() const { return sh.empty() ? points : directions; }
};
// In at most so many groups (light/light_groups.h), each with a shadow of its own. Environments
// take seconds when their cubemap is large (LobeEnvironment).
BodyLight body_light(PointLights points, int groups = 1);
BodyLight body_light(const Cubemap& radiance, int groups = 1, bool band_table = false);

// How light becomes colour.
enum class BodyAppearance {
  kZonal,  // zonal harmonics on the Gaussian's axes (Eq. 8-9), and lobes: the method
  // Baselines of the paper:
  kHarmonics,  // spherical harmonics in the root's frame that do not turn with the surface, and
               // lobes; light comes to all Gaussians from where it comes to the root
  kTurnedHarmonics,  // the same, but turned with each Gaussian's axes
  kPbr,              // Cook-Torrance (body/pbr.h) on the same Gaussians; deferred
};
// By name: zonal, sh, sh_turned, pbr. Throws Error for others.
BodyAppearance body_appearance_named(const std::string& name);
// Coefficients a Gaussian has: 51 or, of spherical harmonics, 3 x 16 + 65.
size_t transfer_coefficients(BodyAppearance appearance);

struct BodyDrawOptions {
  BodyAppearance appearance = BodyAppearance::kZonal;
  bool deferred = true;         // else specular light is found for every Gaussian and splatted
  bool divide_by_alpha = true;  // see above
  SgNorm sg_norm = SgNorm::kCode;
  GaussianRasterOptions raster;
};

// What drawing reads of n texels.
struct BodySurface {
  UvGaussians placed;
  std::vector<float> albedo;      // 3 a texel, linear
  std::vector<float> roughness;   // width of the lobe, > 0
  std::vector<float> visibility;  // of specular light, in [0, 1]
  std::vector<float> shadow;      // in [0, 1], count() for each part of the light; empty: all lit
  Mat3f world_from_root = Mat3f::Identity();  // of the body
  Vec3f root = Vec3f::Zero();                 // metres, world
  size_t count() const { return roughness.size(); }
};

// Derivatives of a loss by its arrays (UvGaussians' layouts).
struct BodySurfaceGradients {
  std::vector<float> center, rotation, scale, opacity, axes, zonal, normal;
  std::vector<float> albedo, roughness, visibility, shadow;
  // Sets all to zero, for `count` texels with so many coefficients of transfer and shadows.
  void clear(size_t count, size_t transfer = kZonalCoefficients, size_t shadows = 1);
  UvGaussianGradients placed() const;
};

// Planes of BodyPicture::channels() after alpha; premultiplied.
enum BodyChannel : int {
  kBodyDiffuse = 0,  // 3
  kBodyNormal = 3,   // 3, world
  kBodyRoughness = 6,
  kBodyVisibility = 7,
  kBodyShadow = 8,
  kBodyDepth = 9,
  kBodyChannels = 10,
  kBodySpecular = 10,  // 3 more when not deferred
};
// Of a group of lights: the first of its channels. Those of groups after the first follow all the
// others.
struct BodyGroupChannels {
  int diffuse = kBodyDiffuse, shadow = kBodyShadow, specular = kBodySpecular;
};

// What a loss says about a picture.
struct BodyPictureGradients {
  const Planes* radiance = nullptr;  // 3 planes
  std::span<const float> alpha;      // 1 a pixel, or empty
  std::span<const float> diffuse;    // 3 planes over texels (BodyPicture::diffuse()), or empty
  // Weight of the mean over drawn pixels of max(0, -n'.w)^2, w towards the camera: normals that
  // look away (Eq. B.3 with its sign put right); its gradient is added.
  float normal_orient = 0;
};

class BodyPicture {
 public:
  BodyPicture();
  ~BodyPicture();
  BodyPicture(BodyPicture&&) noexcept;
  BodyPicture& operator=(BodyPicture&&) noexcept;

  void draw(const Camera& camera, const BodySurface& surface, const BodyLight& light,
            const BodyDrawOptions& options);
  // The same surface, but for its visibility, in the same light from another camera: what the last
  // draw() found of diffuse light is kept.
  void draw_again(const Camera& camera, const BodySurface& surface, const BodyLight& light,
                  const BodyDrawOptions& options);
  // Adds the derivatives of the last draw with the same arguments.
  void backward(const Camera& camera, const BodySurface& surface, const BodyLight& light,
                const BodyDrawOptions& options, const BodyPictureGradients& loss,
                BodySurfaceGradients& gradients);

  const Planes& radiance() const;  // 3 planes, linear, over black
  const Planes& channels() const;  // plane 0: alpha; plane 1 + c: BodyChannel c
  std::span<const float> alpha() const;
  // Groups of lights of the last draw, at least 1, and where their channels are.
  size_t groups() const;
  BodyGroupChannels channels_of(size_t group) const;
  // Diffuse colour of every texel before splatting, 3 planes; may be negative.
  std::span<const float> diffuse() const;
  // Mean of max(0, -n'.w)^2 over the drawn pixels (0 when not deferred).
  double normal_orient() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace effigy
