// The pictures of the users' own materials, brought into the rig's new atlas.

#include <algorithm>
#include <cmath>

#include "effigy/geometry/gutter.h"
#include "effigy/image/colour.h"
#include "effigy/image/resample.h"
#include "effigy/people/user_parts.h"

namespace effigy::people {
namespace {

struct Pictures {
  Image colour, roughness, normal;
};

// Bilinear; textures repeat outside [0, 1]. `out` has four channels.
void sample(const Image& picture, const Vec2f& uv, float* out) {
  const double u = static_cast<double>(uv.x()) - std::floor(static_cast<double>(uv.x()));
  const double v = static_cast<double>(uv.y()) - std::floor(static_cast<double>(uv.y()));
  sample_bilinear(picture, u * picture.width, (1 - v) * picture.height, out);
  if (picture.channels == 1) out[1] = out[2] = out[0];
}

using Frame = Eigen::Matrix<double, 3, 2>;  // columns: along u, along v; unit, in the triangle

// The tangent frame of a triangle under a UV layout; false when the layout gives none.
bool tangent_frame(const Vec3d edges[2], const Vec2d uv_edges[2], Frame& frame) {
  const double area = uv_edges[0].x() * uv_edges[1].y() - uv_edges[0].y() * uv_edges[1].x();
  const Vec3d normal = edges[0].cross(edges[1]);
  if (std::abs(area) < 1e-14 || !(normal.norm() > 0)) return false;
  const Vec3d along_u = (edges[0] * uv_edges[1].y() - edges[1] * uv_edges[0].y()) / area;
  if (!(along_u.norm() > 0)) return false;
  frame.col(0) = along_u.normalized();
  frame.col(1) = (area < 0 ? -1.0 : 1.0) * normal.normalized().cross(frame.col(0));
  return true;
}

// Turns tangent-space normals of each triangle from the frame of its own UVs to the atlas's.
std::vector<Eigen::Matrix2f> frame_turns(const Mesh& mesh, const std::vector<Vec2f>& old_uv) {
  std::vector<Eigen::Matrix2f> turns;
  for (size_t f = 0; f < mesh.triangles.size(); ++f) {
    const Vec3i &t = mesh.triangles[f], &u = mesh.uv_triangles[f];
    Vec3d edges[2];
    Vec2d was[2], is[2];
    for (int k = 0; k < 2; ++k) {
      edges[k] = (mesh.vertex(t[k + 1]) - mesh.vertex(t[0])).cast<double>();
      const auto edge = [&](const std::vector<Vec2f>& uv) {
        return Vec2d(
            (uv[static_cast<size_t>(u[k + 1])] - uv[static_cast<size_t>(u[0])]).cast<double>());
      };
      was[k] = edge(old_uv);
      is[k] = edge(mesh.uvs);
    }
    Frame from, to;
    turns.push_back(tangent_frame(edges, was, from) && tangent_frame(edges, is, to)
                        ? Eigen::Matrix2f((to.transpose() * from).cast<float>())
                        : Eigen::Matrix2f(Eigen::Matrix2f::Identity()));
  }
  return turns;
}

Vec3f mapped_normal(const Pictures& pictures, const UserMaterial& material, const Vec2f& uv,
                    const Eigen::Matrix2f& turn) {
  if (pictures.normal.empty()) return Vec3f::UnitZ();
  float c[4] = {0.5f, 0.5f, 1, 1};
  sample(pictures.normal, uv, c);
  Vec3f n(2 * c[0] - 1, 2 * c[1] - 1, std::max(2 * c[2] - 1, 0.05f));
  n.head<2>() = material.normal_scale * (turn * n.head<2>());
  return n.normalized();
}

}  // namespace

void bake_user_maps(const std::vector<UserMaterial>& materials, const std::vector<Vec2f>& old_uv,
                    int size, UserBody& body) {
  const Mesh& mesh = body.rig.mesh;
  const TexelMap map = texel_map(mesh, size);
  const std::vector<int> from = nearest_shown(map.size, map.triangle);
  body.albedo = Image(size, size, 3);
  body.roughness = Image(size, size, 1, 0.6f);
  body.alpha = Image(size, size, 1, 1.0f);
  std::vector<Pictures> pictures;
  bool bumpy = false;
  for (const UserMaterial& m : materials) {
    pictures.push_back(
        {to_float(m.texture), to_float(m.roughness_texture), to_float(m.normal_texture)});
    bumpy |= !m.normal_texture.empty();
  }
  std::vector<Eigen::Matrix2f> turns;
  if (bumpy) {
    body.normal = Image(size, size, 3);
    turns = frame_turns(mesh, old_uv);
  }
  for (size_t i = 0; i < from.size(); ++i) {
    if (bumpy) body.normal.data[3 * i + 2] = 1;
    if (from[i] < 0) continue;
    const auto s = static_cast<size_t>(from[i]);
    const auto f = static_cast<size_t>(map.triangle[s]);
    const auto part = static_cast<size_t>(mesh.triangle_part[f]);
    const UserMaterial& material = materials[part];
    const auto corner = [&](int k) { return old_uv[static_cast<size_t>(mesh.uv_triangles[f][k])]; };
    const float b1 = map.barycentric[2 * s], b2 = map.barycentric[2 * s + 1];
    const Vec2f uv = (1 - b1 - b2) * corner(0) + b1 * corner(1) + b2 * corner(2);
    Vec4f colour = material.colour;
    if (!pictures[part].colour.empty()) {
      float c[4] = {1, 1, 1, 1};
      sample(pictures[part].colour, uv, c);
      for (int k = 0; k < 3; ++k) colour[k] *= linear_from_srgb(c[k]);
      if (pictures[part].colour.channels == 4) colour[3] *= c[3];
    }
    float roughness = material.roughness;
    if (!pictures[part].roughness.empty()) {
      float c[4] = {1, 1, 1, 1};
      sample(pictures[part].roughness, uv, c);
      roughness = std::clamp(roughness * c[1], 0.05f, 1.0f);
    }
    for (int k = 0; k < 3; ++k)
      body.albedo.data[3 * i + static_cast<size_t>(k)] = std::clamp(colour[k], 0.0f, 1.0f);
    body.roughness.data[i] = roughness;
    body.alpha.data[i] = material.opaque ? 1.0f : std::clamp(colour[3], 0.0f, 1.0f);
    if (!bumpy) continue;
    const Vec3f normal = mapped_normal(pictures[part], material, uv, turns[f]);
    for (int k = 0; k < 3; ++k) body.normal.data[3 * i + static_cast<size_t>(k)] = normal[k];
  }
}

}  // namespace effigy::people
