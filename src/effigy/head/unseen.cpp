#include "effigy/head/unseen.h"

#include <algorithm>
#include <array>

#include "effigy/head/frames.h"
#include "effigy/head/surface_fill.h"

namespace effigy {
namespace {

constexpr float kOpaque = 0.7f;   // alpha that hides what is behind it
constexpr float kBehind = 0.02f;  // metres behind the surface that count as hidden
constexpr float kInside = 0.5f;   // of the matte
constexpr float kFacing = 0.2f;   // cosine under which a front does not count as seen
constexpr float kReach = 1.5f;    // standard deviations at which a surfel is tested

// What the frames show of a surfel or a triangle: in how many it is in the picture; of these, in
// how many all of it is hidden, its front is seen, it reaches out of the matte.
struct Sight {
  int in_view = 0, hidden = 0, front = 0, outside = 0;
};

enum class Point : uint8_t { kOutOfView, kHidden, kEdgeOn, kFront, kOutside };

// How one frame sees a point of the surface, of which the side along `normal` is the front.
Point look_at(const Vec3f& point, const Vec3f& normal, const Camera& camera, const Planes& gbuffer,
              const Planes& mask) {
  const Vec3d at_camera = camera.to_camera(point.cast<double>());
  if (at_camera.z() <= 0) return Point::kOutOfView;
  const Vec2d pixel = camera.project(point.cast<double>());
  if (!(pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() < camera.width && pixel.y() < camera.height))
    return Point::kOutOfView;
  const size_t at = static_cast<size_t>(pixel.y()) * camera.width + static_cast<size_t>(pixel.x());
  if (mask.data[at] < kInside) return Point::kOutside;
  const float alpha = gbuffer.plane(kAlpha)[at];
  if (alpha > kOpaque && at_camera.z() > gbuffer.plane(kDepth)[at] / alpha + kBehind)
    return Point::kHidden;
  const Vec3f ray = (point - camera.center().cast<float>()).normalized();
  return -ray.dot(normal) > kFacing ? Point::kFront : Point::kEdgeOn;
}

// What one frame sees of a patch with this normal: the most that it sees of any of its points.
void count(const std::array<Vec3f, 5>& points, const Vec3f& normal, const Camera& camera,
           const Planes& gbuffer, const Planes& mask, Sight& sight) {
  Point most = Point::kOutOfView;
  for (const Vec3f& point : points)
    most = std::max(most, look_at(point, normal, camera, gbuffer, mask));
  sight.in_view += most != Point::kOutOfView;
  sight.hidden += most == Point::kHidden;
  sight.front += most == Point::kFront;
  sight.outside += most == Point::kOutside;
}

void look_at_surfels(const PosedSurfels& posed, const Camera& camera, const Planes& gbuffer,
                     const Planes& mask, std::vector<Sight>& sights) {
  for (size_t i = 0; i < posed.count(); ++i) {
    const Vec3f center(&posed.center[3 * i]);
    const Vec3f s = kReach * Vec3f(&posed.s[3 * i]), t = kReach * Vec3f(&posed.t[3 * i]);
    count({center, center + s, center - s, center + t, center - t}, Vec3f(&posed.frame[9 * i + 6]),
          camera, gbuffer, mask, sights[i]);
  }
}

void look_at_triangles(const Mesh& mesh, const std::vector<float>& vertices, const Camera& camera,
                       const Planes& gbuffer, const Planes& mask, std::vector<Sight>& sights) {
  const auto vertex = [&](int i) { return Vec3f(&vertices[3 * static_cast<size_t>(i)]); };
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Vec3f a = vertex(mesh.triangles[t][0]), b = vertex(mesh.triangles[t][1]),
                c = vertex(mesh.triangles[t][2]);
    const Vec3f middle = (a + b + c) / 3;
    count({middle, a, b, c, middle}, (b - a).cross(c - a).normalized(), camera, gbuffer, mask,
          sights[t]);
  }
}

// Per texel: 0 in triangles of which the frames do not show the front, else 1.
std::vector<float> texel_weights(const std::vector<Sight>& triangles, const Mesh& mesh, int size) {
  const TexelMap map = texel_map(mesh, size);
  std::vector<float> weights(map.triangle.size(), 1.0f);
  for (size_t t = 0; t < weights.size(); ++t) {
    if (map.triangle[t] < 0) continue;
    const Sight& sight = triangles[map.triangle[t]];
    const size_t row = t / static_cast<size_t>(size), column = t % static_cast<size_t>(size);
    if (sight.front + sight.outside == 0)
      weights[(static_cast<size_t>(size) - 1 - row) * static_cast<size_t>(size) + column] = 0;
  }
  return weights;
}

// Whether all frames hide a surfel, so that its start is the better guess and disturbs none.
bool is_unseen(const Sight& sight) {
  return sight.hidden > 0 && sight.hidden == sight.in_view;
}

void copy_surfel(const BoundSurfels& from, size_t i, BoundSurfels& to) {
  const auto copy = [i](const std::vector<float>& source, std::vector<float>& target,
                        size_t width) {
    std::copy_n(&source[width * i], width, &target[width * i]);
  };
  to.triangle[i] = from.triangle[i];
  copy(from.barycentric, to.barycentric, 2);
  copy(from.displacement, to.displacement, 1);
  copy(from.rotation, to.rotation, 4);
  copy(from.log_scale, to.log_scale, 2);
  copy(from.opacity_logit, to.opacity_logit, 1);
}

}  // namespace

size_t restore_unseen(const Capture& capture, const std::vector<int>& frames,
                      const BoundSurfels& start, HeadAvatar& avatar) {
  EFFIGY_CHECK(start.count() == avatar.surfels.count());
  const Mesh& mesh = avatar.rig.mesh;
  std::vector<Sight> sights(start.count()), triangles(mesh.triangles.size());
  std::vector<float> vertices;
  PosedSurfels posed, posed_start;
  SurfelFrame raster;
  Planes gbuffer;
  FrameStore store(capture, 0);
  TargetFrame target;
  for (const int frame : frames) {
    store.load(frame, target);
    pose_vertices(avatar.shape, avatar.tracks.at("train").poses[frame], vertices);
    pose_surfels(mesh, vertices, avatar.surfels, avatar.bind, posed);
    render_surfels(capture.camera, posed, avatar.material, {}, gbuffer, raster);
    pose_surfels(mesh, vertices, start, avatar.bind, posed_start);
    look_at_surfels(posed_start, capture.camera, gbuffer, target.mask, sights);
    look_at_triangles(mesh, vertices, capture.camera, gbuffer, target.mask, triangles);
  }
  size_t restored = 0;
  for (size_t i = 0; i < start.count(); ++i) {
    if (!is_unseen(sights[i])) continue;
    copy_surfel(start, i, avatar.surfels);
    ++restored;
  }
  const int size = avatar.material.width;
  fill_over_surface(mesh, size, kTexelFloats, 1.0f, texel_weights(triangles, mesh, size),
                    avatar.material.texels);
  return restored;
}

}  // namespace effigy
