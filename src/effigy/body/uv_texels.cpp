#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/body/uv_gaussians.h"

namespace effigy {
namespace {

constexpr float kSmallestSpacing = 1e-4f;
constexpr size_t kGrain = 1024;

// The inverse of log(1 + e^x).
float softplus_inverse(float y) {
  return y + std::log(-std::expm1(-y));
}

// The rotation whose third column is along `normal` and whose first is as near to `tangent` as that
// allows.
Eigen::Matrix3f frame_of(const Vec3f& tangent, const Vec3f& normal) {
  const Vec3f n =
      normal.norm() > 0.0f && normal.allFinite() ? Vec3f(normal.normalized()) : Vec3f(0, 0, 1);
  Vec3f t = tangent - tangent.dot(n) * n;
  // Not along the normal, and not nothing.
  if (!(t.norm() > 1e-6f * tangent.norm())) t = n.unitOrthogonal();
  t.normalize();
  Eigen::Matrix3f frame;
  frame << t, n.cross(t), n;
  return frame;
}

}  // namespace

UvTexels uv_texels(const Mesh& mesh, int size) {
  if (mesh.uv_triangles.empty())
    throw Error("The body's mesh has no texture coordinates; its Gaussians need them.");
  EFFIGY_CHECK(size > 0);
  const TexelMap map = texel_map(mesh, size);
  UvTexels texels;
  texels.size = size;
  for (size_t i = 0; i < map.triangle.size(); ++i) {
    if (map.triangle[i] < 0) continue;
    const auto f = static_cast<size_t>(map.triangle[i]);
    const Vec3i corner = mesh.triangles[f], uv = mesh.uv_triangles[f];
    const auto uv_of = [&](int c) { return mesh.uvs[static_cast<size_t>(uv[c])].cast<double>(); };
    const Vec2d e1 = uv_of(1) - uv_of(0), e2 = uv_of(2) - uv_of(0);
    const Vec3d v0 = mesh.vertex(corner[0]).cast<double>();
    const Vec3d w1 = mesh.vertex(corner[1]).cast<double>() - v0,
                w2 = mesh.vertex(corner[2]).cast<double>() - v0;
    const double uv_area = e1.x() * e2.y() - e1.y() * e2.x(), area = w1.cross(w2).norm();
    if (uv_area == 0.0 || !(area > 0.0)) continue;
    texels.texel.push_back(static_cast<int32_t>(i));
    for (int c = 0; c < 3; ++c) texels.corner.push_back(corner[c]);
    const float b1 = map.barycentric[2 * i], b2 = map.barycentric[2 * i + 1];
    texels.barycentric.insert(texels.barycentric.end(), {1.0f - b1 - b2, b1, b2});
    // dP/du of P = v0 + a w1 + b w2 with (u, v) = uv0 + a e1 + b e2. Only its direction counts.
    const double sign = uv_area > 0 ? 1.0 : -1.0, length = std::hypot(e1.y(), e2.y());
    const double unit = length > 0 ? sign / length : 0.0;
    texels.along_u.push_back(static_cast<float>(e2.y() * unit));
    texels.along_u.push_back(static_cast<float>(-e1.y() * unit));
    const auto spacing = static_cast<float>(std::sqrt(area / std::abs(uv_area)) / size);
    texels.spacing.push_back(std::max(spacing, kSmallestSpacing));
    texels.scale_start.push_back(softplus_inverse(texels.spacing.back()));
  }
  if (texels.texel.empty())
    throw Error(
        "No texel of the body's mesh lies in a triangle; its texture coordinates must be "
        "between 0 and 1.");
  return texels;
}

TexelFrames texel_frames(const UvTexels& texels, std::span<const float> vertices,
                         const std::vector<Vec3i>& triangles, std::span<const float> normals) {
  std::vector<float> found;
  if (normals.empty()) normals = found = vertex_normals(vertices, triangles);
  EFFIGY_CHECK_EQ(normals.size(), vertices.size());
  TexelFrames frames;
  frames.position.resize(3 * texels.count());
  frames.rotation.resize(9 * texels.count());
  parallel_for(texels.count(), kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      Vec3f corner[3], position = Vec3f::Zero(), normal = Vec3f::Zero();
      for (size_t c = 0; c < 3; ++c) {
        const size_t at = 3 * static_cast<size_t>(texels.corner[3 * i + c]);
        corner[c] = Vec3f(&vertices[at]);
        position += texels.barycentric[3 * i + c] * corner[c];
        normal += texels.barycentric[3 * i + c] * Vec3f(&normals[at]);
      }
      const Vec3f tangent = texels.along_u[2 * i] * (corner[1] - corner[0]) +
                            texels.along_u[2 * i + 1] * (corner[2] - corner[0]);
      Eigen::Map<Vec3f>(&frames.position[3 * i]) = position;
      Eigen::Map<Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(&frames.rotation[9 * i]) =
          frame_of(tangent, normal);
    }
  });
  return frames;
}

std::vector<float> local_view_directions(const TexelFrames& frames, const Vec3f& eye) {
  std::vector<float> directions(frames.position.size());
  parallel_for(directions.size() / 3, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const Eigen::Map<const Eigen::Matrix<float, 3, 3, Eigen::RowMajor>> rotation(
          &frames.rotation[9 * i]);
      const Vec3f local = rotation.transpose() * (eye - Vec3f(&frames.position[3 * i]));
      const Vec3f unit = local.norm() > 0.0f ? Vec3f(local.normalized()) : Vec3f(0, 0, 1);
      std::copy_n(unit.data(), 3, &directions[3 * i]);
    }
  });
  return directions;
}

}  // namespace effigy
