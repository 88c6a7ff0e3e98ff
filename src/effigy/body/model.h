// A body avatar as numbers that can be trained and drawn: the atlas of its mesh, its networks, and
// what every texel has for itself (albedo and roughness).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "effigy/body/draw.h"
#include "effigy/body/moment.h"
#include "effigy/body/networks.h"
#include "effigy/geometry/mesh.h"

namespace effigy {

// Trained directly (RFGCA: static maps).
struct BodyMaps {
  std::vector<float> albedo;         // 3 a texel, linear, [0, 1]
  std::vector<float> log_roughness;  // 1 a texel: logarithm of the lobe's width in radians
};
inline constexpr float kLeastRoughness = 0.003f, kMostRoughness = 1.0f;

class BodyModel {
 public:
  // Starts at albedo 0.5 and roughness 0.2. The same seed gives the same bits. Throws Error when
  // the mesh has no UVs.
  BodyModel(const Mesh& mesh, const BodyNetworkSettings& settings, uint64_t seed);
  // From the tensors that save() has written. Throws Error when they do not fit the mesh.
  BodyModel(const Mesh& mesh, const TensorFile& file);
  void save(TensorFile& file) const;

  BodyNetworks& networks() { return networks_; }
  const BodyNetworks& networks() const { return networks_; }
  const UvTexels& texels() const { return texels_; }
  // Texels of the shadow network's picture.
  const UvTexels& shadow_texels() const { return shadow_texels_; }
  BodyMaps& maps() { return maps_; }
  const BodyMaps& maps() const { return maps_; }
  void set_mesh_normals(bool mesh_normals) { mesh_normals_ = mesh_normals; }
  // Where transfer is spherical harmonics: of each Gaussian's own frame, not the root's.
  void set_turned_harmonics();

  // Decodes a moment; how it is shadowed; how it looks from `eye` (world). All three, in this
  // order, before drawing; afterwards `look` alone when only the camera moves, `light` alone when
  // only lights do. normals: the vertices', where they are known already.
  void pose(const BodyMoment& moment, std::span<const float> normals = {});
  // Pictures of shadow_side^2, one for each part of the light; empty: no shadow.
  void light(std::span<const float> irradiance);
  void look(const Vec3f& eye);
  const BodySurface& surface() const { return surface_; }
  // Of the last pose: numbers of every texel (gaussian_channels.h), valid until the next.
  std::span<const float> decoded() const { return decoded_; }

  // From the derivatives by the surface (and, already in d_decoded, by the decoded numbers) to
  // those of networks (kept in them) and maps, which are added to.
  void backward(const BodySurfaceGradients& gradients, std::span<float> d_decoded,
                BodyMaps& d_maps);

 private:
  std::vector<Vec3i> triangles_;
  UvTexels texels_, shadow_texels_;
  BodyNetworks networks_;
  BodyMaps maps_;
  bool mesh_normals_ = false;
  // Added to the decoded coefficients where they are spherical harmonics: Lambert about the normal
  // at rest (of the frame's third axis, where they turn), planes; else empty.
  std::vector<float> start_transfer_;
  TexelFrames frames_;
  BodySurface surface_;
  std::span<const float> decoded_;
  std::vector<float> from_placing_;
};

}  // namespace effigy
