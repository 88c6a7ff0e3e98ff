#include "effigy/body/ground.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/rays/sampler.h"

namespace effigy {
namespace {

constexpr float kAway = 1e30f;
constexpr float kLift = 1e-3f;  // metres above the plane where rays begin

// Irradiance of the plane with and without the body.
struct Light {
  Vec3f seen = Vec3f::Zero(), all = Vec3f::Zero();
};

// Calls shade(point, pixel) -> Light for every pixel whose ray meets the plane from above.
template <typename Shade>
Planes shares(const Camera& camera, float height, const Shade& shade) {
  Planes out(camera.width, camera.height, 3, 1.0f);
  const Vec3d eye = camera.center();
  const Mat3d world_from_camera = camera.camera_from_world_rotation.transpose();
  parallel_for(static_cast<size_t>(camera.height), 4, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const Vec3d ray =
            world_from_camera * Vec3d((x + 0.5 - camera.cx) / camera.fx,
                                      (static_cast<double>(y) + 0.5 - camera.cy) / camera.fy, 1.0);
        const double along = (static_cast<double>(height) - eye.y()) / ray.y();
        if (!(along > 0) || eye.y() <= static_cast<double>(height) || !std::isfinite(along))
          continue;
        const Vec3f point = (eye + along * ray).cast<float>() + Vec3f(0, kLift, 0);
        const size_t pixel = y * static_cast<size_t>(camera.width) + static_cast<size_t>(x);
        const Light light = shade(point, pixel);
        for (int c = 0; c < 3; ++c)
          if (light.all[c] > 0)
            out.plane(c)[pixel] = std::clamp(light.seen[c] / light.all[c], 0.0f, 1.0f);
      }
  });
  return out;
}

}  // namespace

Planes ground_shadow(const Camera& camera, float height, const RayScene& body,
                     const PointLights& lights) {
  return shares(camera, height, [&](const Vec3f& point, size_t) {
    Light light;
    for (const PointLight& lamp : lights.lights) {
      const Vec3f way = lamp.directional ? lamp.position : Vec3f(lamp.position - point);
      const float square = way.squaredNorm();
      const float cosine = way.y() / std::sqrt(square);
      if (!(cosine > 0)) continue;
      float strength = cosine;
      if (lights.falloff && !lamp.directional)
        strength *= (lamp.position - lights.center).squaredNorm() / square;
      const Vec3f given = strength * lamp.intensity;
      light.all += given;
      if (!body.occluded(point, way, 0.0f, lamp.directional ? kAway : 1.0f)) light.seen += given;
    }
    return light;
  });
}

Planes ground_shadow(const Camera& camera, float height, const RayScene& body,
                     const EnvironmentSampler& environment, const GroundSampling& sampling) {
  EFFIGY_CHECK(environment.draw() == EnvironmentDraw::kLuminance && sampling.samples > 0);
  return shares(camera, height, [&](const Vec3f& point, size_t pixel) {
    Light light;
    PixelSampler sampler(static_cast<uint32_t>(pixel), 0x9d0u, sampling.seed);
    for (int s = 0; s < sampling.samples; ++s) {
      sampler.start(static_cast<uint32_t>(s));
      const EnvironmentSampler::Sample drawn = environment.sample(sampler.next());
      if (!(drawn.density > 0) || drawn.direction.y() <= 0) continue;
      const Vec3f given = drawn.radiance * (drawn.direction.y() / drawn.density);
      light.all += given;
      if (!body.occluded(point, drawn.direction, 0.0f, kAway)) light.seen += given;
    }
    return light;
  });
}

}  // namespace effigy
