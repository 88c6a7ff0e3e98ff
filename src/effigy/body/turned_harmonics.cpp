#include "effigy/body/turned_harmonics.h"

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr size_t kGrain = 64;

Vec3f at(std::span<const float> planes, size_t n, size_t i) {
  return {planes[i], planes[n + i], planes[2 * n + i]};
}

// Columns are the axes.
Mat3f axes_of(const TurnedView& view, size_t i) {
  Mat3f axes;
  for (int k = 0; k < 3; ++k)
    for (int c = 0; c < 3; ++c)
      axes(c, k) = view.axes[static_cast<size_t>(3 * k + c) * view.count + i];
  return axes;
}

struct Towards {
  Vec3f w;
  float strength = 1, inverse_distance = 0;
};

Towards towards(const PointLights& lights, const PointLight& lamp, const Vec3f& position) {
  if (lamp.directional) return {lamp.position};
  const Vec3f way = lamp.position - position;
  const float inverse = 1.0f / std::sqrt(way.squaredNorm() + 1e-20f);
  const float reference = lights.falloff ? (lamp.position - lights.center).squaredNorm() : 0.0f;
  return {way * inverse, lights.falloff ? reference * inverse * inverse : 1.0f, inverse};
}

// Light's harmonics in one Gaussian's frame, r g b of each.
void local_light(const PointLights& lights, const TurnedView& view, size_t i, const Mat3f& axes,
                 float* light) {
  std::fill_n(light, 3 * kHarmonics, 0.0f);
  const Vec3f position = at(view.position, view.count, i);
  for (const PointLight& lamp : lights.lights) {
    const Towards t = towards(lights, lamp, position);
    const Vec3f local = axes.transpose() * t.w, given = t.strength * lamp.intensity;
    for_each_sh(kZonalOrder, local.data(), [&](int l, int m, float value, const float*) {
      float* to = light + 3 * (l * l + l + m);
      for (int c = 0; c < 3; ++c) to[c] += given[c] * value;
    });
  }
}

}  // namespace

void shade_turned_harmonics(const PointLights& lights, const TurnedView& view,
                            std::span<float> colour) {
  const size_t n = view.count;
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    float light[3 * kHarmonics];
    for (size_t i = begin; i < end; ++i) {
      local_light(lights, view, i, axes_of(view, i), light);
      for (size_t c = 0; c < 3; ++c) {
        float sum = 0;
        for (size_t k = 0; k < kHarmonics; ++k)
          sum += light[3 * k + c] * view.transfer[harmonic_index(k, c) * n + i];
        colour[c * n + i] = sum;
      }
    }
  });
}

void shade_turned_harmonics_backward(const PointLights& lights, const TurnedView& view,
                                     std::span<const float> d_colour,
                                     const TurnedGradients& gradients) {
  const size_t n = view.count;
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    float light[3 * kHarmonics], weight[3 * kHarmonics];
    for (size_t i = begin; i < end; ++i) {
      const Mat3f axes = axes_of(view, i);
      local_light(lights, view, i, axes, light);
      for (size_t k = 0; k < kHarmonics; ++k)
        for (size_t c = 0; c < 3; ++c) {
          const size_t z = harmonic_index(k, c) * n + i;
          weight[3 * k + c] = d_colour[c * n + i] * view.transfer[z];
          gradients.transfer[z] += d_colour[c * n + i] * light[3 * k + c];
        }
      const Vec3f position = at(view.position, n, i);
      Mat3f d_axes = Mat3f::Zero();
      Vec3f d_position = Vec3f::Zero();
      for (const PointLight& lamp : lights.lights) {
        const Towards t = towards(lights, lamp, position);
        const Vec3f local = axes.transpose() * t.w;
        Vec3f d_local = Vec3f::Zero();
        float d_strength = 0;
        for_each_sh(kZonalOrder, local.data(), [&](int l, int m, float value, const float* slope) {
          const float* w = weight + 3 * (l * l + l + m);
          const float all =
              lamp.intensity.x() * w[0] + lamp.intensity.y() * w[1] + lamp.intensity.z() * w[2];
          d_strength += all * value;
          d_local += t.strength * all * Vec3f(slope[0], slope[1], slope[2]);
        });
        d_axes += t.w * d_local.transpose();
        if (lamp.directional) continue;
        const Vec3f d_w = axes * d_local;
        d_position -= t.inverse_distance * (d_w - d_w.dot(t.w) * t.w);
        if (lights.falloff) d_position += 2 * t.inverse_distance * t.strength * d_strength * t.w;
      }
      for (int k = 0; k < 3; ++k)
        for (int c = 0; c < 3; ++c)
          gradients.axes[static_cast<size_t>(3 * k + c) * n + i] += d_axes(c, k);
      for (int c = 0; c < 3; ++c)
        gradients.position[static_cast<size_t>(c) * n + i] += d_position[c];
    }
  });
}

}  // namespace effigy
