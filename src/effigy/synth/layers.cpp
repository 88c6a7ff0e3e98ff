// What stands in each pixel and at each vertex, whatever the light's reflection.

#include <cmath>
#include <numbers>

#include "effigy/rays/sampler.h"
#include "effigy/synth/brdf.h"
#include "effigy/synth/camera_rays.h"
#include "effigy/synth/path_tracer.h"

namespace effigy {
namespace {

constexpr size_t kLampsCounted = 64;
constexpr int kTile = 16;
constexpr float kPi = std::numbers::pi_v<float>;

// The first surface that is more than half opaque.
TraceScene::Hit first_surface(const TraceScene& scene, const Vec3f& origin, const Vec3f& direction,
                              float least_opacity) {
  float near = 0;
  for (int layers = 0; layers < 256; ++layers) {
    const TraceScene::Hit hit = scene.closest(origin, direction, near);
    if (hit.triangle < 0 || scene.opacity(hit) > least_opacity) return hit;
    near = hit.distance * (1 + 1e-6f) + scene.offset();
  }
  return {};
}

// Fills the pixel of the G-buffer; the pixel's label, or 0.
int trace_centre(const TraceScene& scene, const CameraRays& rays, int x, int y, Planes& gbuffer) {
  const Vec3f direction = rays.direction(x + 0.5, y + 0.5);
  const TraceScene::Hit hit = first_surface(scene, rays.origin(), direction, 0.5f);
  if (hit.triangle < 0) return 0;
  const ScenePoint point = scene.surface(hit, direction);
  const size_t i = static_cast<size_t>(y) * gbuffer.width + x;
  const auto put = [&](int plane, float value) { gbuffer.plane(plane)[i] = value; };
  put(kAlpha, 1);
  put(kDepth, hit.distance * direction.dot(rays.forward()));
  for (int c = 0; c < 3; ++c) {
    put(kAlbedo + c, point.albedo[c]);
    put(kNormal + c, point.normal[c]);
    put(kMappedNormal + c, point.mapped[c]);
  }
  put(kRoughness, point.roughness);
  put(kSpecular, std::max(point.specular, 0.0f));
  put(kUv, point.uv.x());
  put(kUv + 1, point.uv.y());
  return 256 * point.mesh + point.part + 1;
}

// Means over the pixel's square.
void trace_square(const TraceScene& scene, const CameraRays& rays, int x, int y, int samples,
                  uint64_t seed, SurfaceLayers& layers) {
  PixelSampler sampler(static_cast<uint32_t>(x), static_cast<uint32_t>(y), seed);
  Vec3f albedo = Vec3f::Zero(), material = Vec3f::Zero();
  int covered = 0;
  for (int s = 0; s < samples; ++s) {
    sampler.start(static_cast<uint32_t>(s));
    const Vec2f place = sampler.next();
    const Vec2f u = sampler.next();
    const float least_opacity = sampler.next().x();
    const Vec3f direction = rays.direction(x + place.x(), y + place.y());
    const TraceScene::Hit hit = first_surface(scene, rays.origin(), direction, least_opacity);
    if (hit.triangle < 0) continue;
    const ScenePoint point = scene.surface(hit, direction);
    const float sine = std::sqrt(u.y());
    const Vec3f local(sine * std::cos(2 * kPi * u.x()), sine * std::sin(2 * kPi * u.x()),
                      std::sqrt(1 - u.y()));
    const Vec3f outward = ShadingFrame(point.normal).to_world(local);
    albedo += point.albedo;
    material += Vec3f(point.roughness, std::max(point.specular, 0.0f),
                      scene.transmittance(point.origin, outward, 1e30f));
    ++covered;
  }
  if (covered == 0) return;
  Eigen::Map<Vec3f>(layers.albedo.at(x, y)) = albedo / static_cast<float>(covered);
  Eigen::Map<Vec3f>(layers.material.at(x, y)) = material / static_cast<float>(covered);
}

}  // namespace

Planes trace_gbuffer(const TraceScene& scene, const Camera& camera) {
  const CameraRays rays(camera);
  Planes gbuffer(camera.width, camera.height, kGBufferPlanes);
  for_each_tile(camera, kTile, nullptr,
                [&](int x, int y) { trace_centre(scene, rays, x, y, gbuffer); });
  return gbuffer;
}

SurfaceLayers trace_layers(const TraceScene& scene, const Camera& camera, int samples,
                           uint64_t seed) {
  const CameraRays rays(camera);
  SurfaceLayers layers;
  layers.gbuffer = Planes(camera.width, camera.height, kGBufferPlanes);
  layers.part.assign(layers.gbuffer.pixels(), 0);
  layers.albedo = Image(camera.width, camera.height, 3);
  layers.material = Image(camera.width, camera.height, 3);
  const std::vector<char> seen = scene.seen_pixels(camera);
  for_each_tile(camera, kTile, nullptr, [&](int x, int y) {
    const size_t i = static_cast<size_t>(y) * camera.width + x;
    if (!seen[i]) return;
    layers.part[i] = trace_centre(scene, rays, x, y, layers.gbuffer);
    trace_square(scene, rays, x, y, samples, seed, layers);
  });
  return layers;
}

std::vector<float> vertex_irradiance(const TraceScene& scene, int mesh, int samples,
                                     uint64_t seed) {
  scene.check_lights();
  const std::vector<float>&vertices = scene.vertices(mesh), &normals = scene.normals(mesh);
  std::vector<float> irradiance(vertices.size());
  const EnvironmentSampler* light = scene.environment();
  constexpr float kUniform = 0.25f / kPi;
  const auto lit = [&](size_t v) {
    const Vec3f origin = Vec3f(&vertices[3 * v]) + 10 * scene.offset() * Vec3f(&normals[3 * v]);
    Vec3f arrived = Vec3f::Zero(), sent = Vec3f::Zero();
    const auto add = [&](const Vec3f& direction, const Vec3f& amount, float far) {
      sent += amount;
      arrived += amount * scene.transmittance(origin, direction, far);
    };
    PixelSampler sampler(static_cast<uint32_t>(v), 0x1e55u, seed);
    for (int s = 0; s < samples && light != nullptr; ++s) {
      sampler.start(static_cast<uint32_t>(s));
      const EnvironmentSampler::Sample drawn = light->sample(sampler.next());
      if (drawn.density > 0)
        add(drawn.direction, drawn.radiance / (drawn.density + kUniform), 1e30f);
      const Vec2f u = sampler.next();
      const float z = 1 - 2 * u.y(), r = std::sqrt(std::max(0.0f, 1 - z * z));
      const Vec3f even(r * std::cos(2 * kPi * u.x()), z, r * std::sin(2 * kPi * u.x()));
      float density = 0;
      const Vec3f radiance = light->radiance(even, density);
      add(even, radiance / (density + kUniform), 1e30f);
    }
    const float share = light != nullptr ? 1.0f / static_cast<float>(samples) : 1.0f;
    sent *= share;
    arrived *= share;
    const auto arrives = [&](const StageLight& lamp) {
      return Vec3f(lamp.intensity / std::max((lamp.position - origin).squaredNorm(), 1e-12f));
    };
    const std::vector<StageLight>& lamps = scene.point_lights();
    const size_t counted = std::min(lamps.size(), kLampsCounted);
    const float stride =
        static_cast<float>(lamps.size()) / static_cast<float>(std::max<size_t>(counted, 1));
    for (const StageLight& lamp : lamps) sent += arrives(lamp);
    // Of very many lights every n-th is asked whether it is seen, from a random one on.
    sampler.start(static_cast<uint32_t>(samples));
    const float start = counted < lamps.size() ? sampler.next().x() : 0.5f;
    for (size_t k = 0; k < counted; ++k) {
      const size_t index = static_cast<size_t>((static_cast<float>(k) + start) * stride);
      const StageLight& lamp = lamps[std::min(index, lamps.size() - 1)];
      const Vec3f way = lamp.position - origin;
      const float far = std::max(way.norm(), 1e-6f);
      arrived += stride * scene.transmittance(origin, way / far, far) * arrives(lamp);
    }
    for (size_t c = 0; c < 3; ++c)
      irradiance[3 * v + c] = sent[c] > 0 ? std::min(arrived[c] / sent[c], 1.0f) : 0.0f;
  };
  parallel_for(vertices.size() / 3, 64, [&](size_t begin, size_t end, int) {
    for (size_t v = begin; v < end; ++v) lit(v);
  });
  return irradiance;
}

}  // namespace effigy
