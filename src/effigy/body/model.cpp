#include "effigy/body/model.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/body/harmonics.h"
#include "effigy/light/zonal.h"

namespace effigy {
namespace {

constexpr float kStartAlbedo = 0.5f, kStartRoughness = 0.2f;
constexpr const char* kAlbedo = "maps.albedo";
constexpr const char* kRoughness = "maps.log_roughness";

// Spherical harmonics of a Lambertian lobe about one normal a texel (3 numbers each), in the layout
// of transfer coefficients; empty for zonal harmonics.
std::vector<float> start_transfer(const std::vector<double>& normals, int transfer) {
  if (transfer == static_cast<int>(kZonalCoefficients)) return {};
  const size_t n = normals.size() / 3;
  std::vector<float> start(static_cast<size_t>(transfer) * n);
  for (size_t i = 0; i < n; ++i) {
    double sh[kHarmonics];
    zonal_to_sh(lambert_zonal().data(), &normals[3 * i], sh);
    for (size_t k = 0; k < kHarmonics; ++k)
      for (size_t c = 0; c < (k < kColouredHarmonics ? 3u : 1u); ++c)
        start[harmonic_index(k, c) * n + i] = static_cast<float>(sh[k]);
  }
  return start;
}

std::vector<double> rest_normals(const Mesh& mesh, const UvTexels& texels) {
  const TexelFrames rest = texel_frames(texels, mesh.vertices, mesh.triangles);
  std::vector<double> normals;
  for (size_t i = 0; i < texels.count(); ++i)
    for (size_t c = 0; c < 3; ++c)
      normals.push_back(static_cast<double>(rest.rotation[9 * i + 3 * c + 2]));
  return normals;
}

}  // namespace

BodyModel::BodyModel(const Mesh& mesh, const BodyNetworkSettings& settings, uint64_t seed)
    : triangles_(mesh.triangles),
      texels_(uv_texels(mesh, settings.texture())),
      shadow_texels_(uv_texels(mesh, settings.shadow_side)),
      networks_(settings, texels_.texel, seed) {
  maps_.albedo.assign(3 * texels_.count(), kStartAlbedo);
  maps_.log_roughness.assign(texels_.count(), std::log(kStartRoughness));
  start_transfer_ = start_transfer(rest_normals(mesh, texels_), settings.transfer);
}

BodyModel::BodyModel(const Mesh& mesh, const TensorFile& file)
    : triangles_(mesh.triangles), networks_(BodyNetworks::load(file)) {
  texels_ = uv_texels(mesh, networks_.settings().texture());
  shadow_texels_ = uv_texels(mesh, networks_.settings().shadow_side);
  if (texels_.texel != networks_.texels())
    throw Error(file.path.string() +
                ": the networks belong to a mesh with another atlas than the rig beside them; "
                "train again.");
  start_transfer_ = start_transfer(rest_normals(mesh, texels_), networks_.settings().transfer);
  const auto count = static_cast<int64_t>(texels_.count());
  maps_.albedo = file.floats(kAlbedo, {count, 3});
  maps_.log_roughness = file.floats(kRoughness, {count});
}

void BodyModel::set_turned_harmonics() {
  std::vector<double> third(3 * texels_.count(), 0.0);
  for (size_t i = 2; i < third.size(); i += 3) third[i] = 1;
  start_transfer_ = start_transfer(third, networks_.settings().transfer);
}

void BodyModel::save(TensorFile& file) const {
  networks_.save(file);
  const auto count = static_cast<int64_t>(texels_.count());
  file.tensors[kAlbedo] = Tensor::from(std::span<const float>(maps_.albedo), {count, 3});
  file.tensors[kRoughness] = Tensor::from(std::span<const float>(maps_.log_roughness), {count});
}

void BodyModel::pose(const BodyMoment& moment, std::span<const float> normals) {
  frames_ = texel_frames(texels_, moment.vertices, triangles_, normals);
  decoded_ = networks_.decode(moment.body_keypoints, moment.face_keypoints);
  place_gaussians(texels_, frames_, decoded_, surface_.placed);
  for (size_t i = 0; i < start_transfer_.size(); ++i)
    surface_.placed.zonal[i] += start_transfer_[i];
  surface_.world_from_root = moment.world_from_root;
  surface_.root = moment.root;
  const size_t n = texels_.count();
  if (mesh_normals_)
    for (size_t i = 0; i < n; ++i)
      for (size_t c = 0; c < 3; ++c)
        surface_.placed.normal[c * n + i] = frames_.rotation[9 * i + 3 * c + 2];
  surface_.albedo = maps_.albedo;
  surface_.roughness.resize(n);
  for (size_t i = 0; i < n; ++i) surface_.roughness[i] = std::exp(maps_.log_roughness[i]);
}

void BodyModel::light(std::span<const float> irradiance) {
  surface_.shadow.clear();
  if (irradiance.empty()) return;
  const std::span<const float> shadow = networks_.shadow(irradiance);
  surface_.shadow.assign(shadow.begin(), shadow.end());
}

void BodyModel::look(const Vec3f& eye) {
  const std::span<const float> seen = networks_.visibility(local_view_directions(frames_, eye));
  surface_.visibility.assign(seen.begin(), seen.end());
}

void BodyModel::backward(const BodySurfaceGradients& gradients, std::span<float> d_decoded,
                         BodyMaps& d_maps) {
  UvGaussianGradients placed = gradients.placed();
  if (mesh_normals_) placed.normal = {};
  from_placing_.resize(d_decoded.size());
  place_gaussians_backward(texels_, frames_, decoded_, placed, from_placing_);
  for (size_t i = 0; i < d_decoded.size(); ++i) d_decoded[i] += from_placing_[i];
  networks_.backward(d_decoded, gradients.visibility,
                     surface_.shadow.empty() ? std::span<const float>() : gradients.shadow);
  for (size_t i = 0; i < gradients.albedo.size(); ++i) d_maps.albedo[i] += gradients.albedo[i];
  for (size_t i = 0; i < gradients.roughness.size(); ++i)
    d_maps.log_roughness[i] += gradients.roughness[i] * surface_.roughness[i];
}

}  // namespace effigy
