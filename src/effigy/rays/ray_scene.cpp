#include "effigy/rays/ray_scene.h"

#include <embree3/rtcore.h>

#include <cmath>
#include <cstring>
#include <string>

#include "effigy/base/error.h"

namespace effigy {
namespace {

// One device for the process: creating one costs milliseconds.
RTCDevice device() {
  static const RTCDevice shared = [] {
    const RTCDevice made = rtcNewDevice("set_affinity=0");
    if (made == nullptr)
      throw Error("Embree could not start (error " + std::to_string(rtcGetDeviceError(nullptr)) +
                  "); reinstall libembree3-3.");
    return made;
  }();
  return shared;
}

void check_positions(std::span<const float> vertices) {
  for (size_t i = 0; i < vertices.size(); ++i)
    if (!std::isfinite(vertices[i]))
      throw Error("Ray scene: vertex " + std::to_string(i / 3) +
                  " is not finite; repair the mesh.");
}

}  // namespace

struct RayScene::State {
  RTCScene scene = nullptr;
  RTCGeometry geometry = nullptr;
  float* positions = nullptr;  // Embree's buffer
  size_t floats = 0;
  bool refit = false;

  ~State() {
    if (geometry != nullptr) rtcReleaseGeometry(geometry);
    if (scene != nullptr) rtcReleaseScene(scene);
  }
};

RayScene::RayScene(std::span<const float> vertices, const std::vector<Vec3i>& triangles, RayUse use)
    : state_(std::make_unique<State>()) {
  const int vertex_count = static_cast<int>(vertices.size() / 3);
  if (vertices.size() % 3 != 0)
    throw Error("Ray scene: the vertex array's length is not a multiple of 3; repair the mesh.");
  check_positions(vertices);
  for (size_t i = 0; i < triangles.size(); ++i)
    for (int k = 0; k < 3; ++k)
      if (triangles[i][k] < 0 || triangles[i][k] >= vertex_count)
        throw Error("Ray scene: triangle " + std::to_string(i) + " names vertex " +
                    std::to_string(triangles[i][k]) + " of " + std::to_string(vertex_count) +
                    "; repair the mesh.");
  State& s = *state_;
  s.scene = rtcNewScene(device());
  s.refit = use == RayUse::kMoving;
  // Robust: no ray slips through between triangles; for shadows in playback not worth its time.
  // Only a dynamic scene of low quality has a tree of its own for each geometry, which can be
  // refitted.
  rtcSetSceneFlags(s.scene, s.refit ? RTC_SCENE_FLAG_DYNAMIC : RTC_SCENE_FLAG_ROBUST);
  if (s.refit) rtcSetSceneBuildQuality(s.scene, RTC_BUILD_QUALITY_LOW);
  if (!triangles.empty()) {
    s.geometry = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_TRIANGLE);
    // Embree pads its own buffers, as its 16-byte loads need.
    s.positions = static_cast<float*>(rtcSetNewGeometryBuffer(s.geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                                              RTC_FORMAT_FLOAT3, 3 * sizeof(float),
                                                              static_cast<size_t>(vertex_count)));
    auto* indices = static_cast<unsigned*>(
        rtcSetNewGeometryBuffer(s.geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(unsigned), triangles.size()));
    if (s.positions == nullptr || indices == nullptr)
      throw Error("Ray scene: no memory for the mesh; close other programs and try again.",
                  Blame::kResource);
    s.floats = vertices.size();
    std::memcpy(s.positions, vertices.data(), vertices.size() * sizeof(float));
    for (size_t i = 0; i < triangles.size(); ++i)
      for (int k = 0; k < 3; ++k) indices[3 * i + k] = static_cast<unsigned>(triangles[i][k]);
    rtcCommitGeometry(s.geometry);
    rtcAttachGeometryByID(s.scene, s.geometry, 0);
  }
  rtcCommitScene(s.scene);
  const RTCError problem = rtcGetDeviceError(device());
  if (problem != RTC_ERROR_NONE)
    throw Error("Ray scene: Embree reports error " + std::to_string(problem) +
                    " while building; close other programs and try again.",
                Blame::kResource);
}

RayScene::~RayScene() = default;
RayScene::RayScene(RayScene&&) noexcept = default;
RayScene& RayScene::operator=(RayScene&&) noexcept = default;

void RayScene::move(std::span<const float> vertices) {
  State& s = *state_;
  if (s.geometry == nullptr) return;
  EFFIGY_CHECK_EQ(vertices.size(), s.floats);
  check_positions(vertices);
  std::memcpy(s.positions, vertices.data(), vertices.size() * sizeof(float));
  rtcUpdateGeometryBuffer(s.geometry, RTC_BUFFER_TYPE_VERTEX, 0);
  if (s.refit) rtcSetGeometryBuildQuality(s.geometry, RTC_BUILD_QUALITY_REFIT);
  rtcCommitGeometry(s.geometry);
  rtcCommitScene(s.scene);
}

RayHit RayScene::closest(const Vec3f& origin, const Vec3f& direction, float near, float far) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRayHit query;
  query.ray.org_x = origin.x();
  query.ray.org_y = origin.y();
  query.ray.org_z = origin.z();
  query.ray.dir_x = direction.x();
  query.ray.dir_y = direction.y();
  query.ray.dir_z = direction.z();
  query.ray.tnear = near;
  query.ray.tfar = far;
  query.ray.time = 0;
  query.ray.mask = ~0u;
  query.ray.id = 0;
  query.ray.flags = 0;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(state_->scene, &context, &query);
  RayHit hit;
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return hit;
  hit.triangle = static_cast<int>(query.hit.primID);
  hit.distance = query.ray.tfar;
  hit.b = query.hit.u;  // Embree: point = (1 - u - v) p0 + u p1 + v p2
  hit.c = query.hit.v;
  return hit;
}

bool RayScene::occluded(const Vec3f& origin, const Vec3f& direction, float near, float far) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay ray;
  ray.org_x = origin.x();
  ray.org_y = origin.y();
  ray.org_z = origin.z();
  ray.dir_x = direction.x();
  ray.dir_y = direction.y();
  ray.dir_z = direction.z();
  ray.tnear = near;
  ray.tfar = far;
  ray.time = 0;
  ray.mask = ~0u;
  ray.id = 0;
  ray.flags = 0;
  rtcOccluded1(state_->scene, &context, &ray);
  return ray.tfar < 0;  // Embree marks a hit with tfar = -infinity
}

}  // namespace effigy
