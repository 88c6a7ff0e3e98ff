// One Gaussian per valid texel of the tracked mesh's atlas (Relightable Full-Body Gaussian Codec
// Avatars, Wang et al. 2025, Eq. 5-6 and 10): where texels are and how they are turned on the posed
// mesh, and what the decoder's numbers become there; forward and backward on plain arrays.
//
// Interleaved arrays hold a texel's numbers side by side; planar ones ([c * texels + i]) are what
// radiance transfer reads (shade/). The mesh is given by tracking: vertices get no gradient.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "effigy/body/gaussian_channels.h"
#include "effigy/geometry/mesh.h"

namespace effigy {

// The valid texels of an atlas: those whose centre lies in a triangle that has an area in UV space
// and on the mesh.
struct UvTexels {
  int size = 0;                    // of the atlas, texels a side
  std::vector<int32_t> texel;      // ascending row-major index, row 0 = top (v = 1)
  std::vector<int32_t> corner;     // 3 a texel: vertices of its triangle
  std::vector<float> barycentric;  // 3 a texel, of the corners
  // 2 a texel: the direction of growing u is [0] (v1 - v0) + [1] (v2 - v0).
  std::vector<float> along_u;
  // Metres between neighbouring texels on the mesh given, at least a tenth of a millimetre.
  std::vector<float> spacing;
  std::vector<float> scale_start;  // what softplus makes the spacing of
  size_t count() const { return texel.size(); }
};
// Throws Error when the mesh has no UVs or no texel is valid.
UvTexels uv_texels(const Mesh& mesh, int size);

// Where the texels of a posed mesh are and how they are turned.
struct TexelFrames {
  std::vector<float> position;  // 3 a texel, world: v_k of Eq. 5
  // 9 a texel, row-major: columns tangent (along u, in the surface), bitangent, normal
  // (interpolated from the vertices), a rotation even where the atlas mirrors: TBN_k of Eq. 5-6.
  // Where the mesh gives no direction (a degenerate triangle), some rotation.
  std::vector<float> rotation;
};
// vertices: 3 a vertex, posed; normals: vertex_normals() of them, where they are known already.
TexelFrames texel_frames(const UvTexels& texels, std::span<const float> vertices,
                         const std::vector<Vec3i>& triangles, std::span<const float> normals = {});

// Unit directions texel -> `eye` in the texels' frames, 3 a texel: what the view-dependent decoder
// gets (BodyNetworks::visibility).
std::vector<float> local_view_directions(const TexelFrames& frames, const Vec3f& eye);

// Metres that one unit of the decoder's offset channels stands for.
inline constexpr double kOffsetUnit = 0.01;
// Opacity where the decoder says zero.
inline constexpr double kStartOpacity = 0.5;

struct UvGaussians {
  std::vector<float> center;    // 3 a texel: v + TBN (kOffsetUnit delta t)
  std::vector<float> rotation;  // 4 a texel: unit quaternion w x y z of R = TBN delta R
  std::vector<float> scale;     // 3 a texel: softplus, the spacing where the decoder says zero
  std::vector<float> opacity;   // 1 a texel: sigmoid
  std::vector<float> axes;      // 9 planes: t, b, n, the columns of R
  // 51 planes: Lambert about n where the decoder says zero; of other coefficients of transfer as
  // many as the decoder has, as it says.
  std::vector<float> zonal;
  std::vector<float> normal;  // 3 planes: of specular light, R ((0, 0, 1) + delta n) normalised
};

// decoded: 65 numbers a texel, or others with their own transfer (gaussian_channels.h). delta R is
// the quaternion (1, 0, 0, 0) plus the decoder's; all zero, it is the identity and has no gradient.
// delta n is added in the Gaussian's own frame, so that it turns with the body.
void place_gaussians(const UvTexels& texels, const TexelFrames& frames,
                     std::span<const float> decoded, UvGaussians& gaussians);

// Derivatives of a loss by the arrays of UvGaussians; an empty span: none.
struct UvGaussianGradients {
  std::span<const float> center, rotation, scale, opacity, axes, zonal, normal;
};
// Writes the derivatives by `decoded`.
void place_gaussians_backward(const UvTexels& texels, const TexelFrames& frames,
                              std::span<const float> decoded, const UvGaussianGradients& gradients,
                              std::span<float> d_decoded);

}  // namespace effigy
