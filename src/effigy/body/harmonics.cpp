#include "effigy/body/harmonics.h"

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr size_t kGrain = 64, kPlanarGrain = 2048;

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

// Light's harmonics in one Gaussian's frame, r g b of each.
void local_light(const PointLights& lights, const TurnedView& view, size_t i, const Mat3f& axes,
                 float* light) {
  std::fill_n(light, 3 * kHarmonics, 0.0f);
  const Vec3f position = at(view.position, view.count, i);
  for (const PointLight& lamp : lights.lights) {
    const LampWay t = way_to_lamp(lights, lamp, position);
    const Vec3f local = axes.transpose() * t.direction, given = t.strength * lamp.intensity;
    for_each_sh(kZonalOrder, local.data(), [&](int l, int m, float value, const float*) {
      float* to = light + 3 * (l * l + l + m);
      for (int c = 0; c < 3; ++c) to[c] += given[c] * value;
    });
  }
}

}  // namespace

std::vector<float> root_harmonics(PointLights lights, const Mat3f& world_from_root,
                                  const Vec3f& root) {
  for (PointLight& lamp : lights.lights)
    lamp.position = world_from_root.transpose() *
                    (lamp.directional ? lamp.position : Vec3f(lamp.position - root));
  lights.center = world_from_root.transpose() * (lights.center - root);
  return sh_of_points(lights, Vec3f::Zero());
}

void shade_harmonics(std::span<const float> light, size_t count, std::span<const float> transfer,
                     std::span<float> colour) {
  parallel_for(count, kPlanarGrain, [&](size_t begin, size_t end, int) {
    for (size_t c = 0; c < 3; ++c) {
      std::fill_n(&colour[c * count + begin], end - begin, 0.0f);
      for (size_t k = 0; k < kHarmonics; ++k) {
        const float* d = &transfer[harmonic_index(k, c) * count];
        for (size_t i = begin; i < end; ++i) colour[c * count + i] += light[3 * k + c] * d[i];
      }
    }
  });
}

void shade_harmonics_backward(std::span<const float> light, size_t count,
                              std::span<const float> d_colour, std::span<float> d_transfer) {
  parallel_for(count, kPlanarGrain, [&](size_t begin, size_t end, int) {
    for (size_t c = 0; c < 3; ++c)
      for (size_t k = 0; k < kHarmonics; ++k) {
        float* d = &d_transfer[harmonic_index(k, c) * count];
        for (size_t i = begin; i < end; ++i) d[i] += light[3 * k + c] * d_colour[c * count + i];
      }
  });
}

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
        const LampWay t = way_to_lamp(lights, lamp, position);
        const Vec3f local = axes.transpose() * t.direction;
        Vec3f d_local = Vec3f::Zero();
        float d_strength = 0;
        for_each_sh(kZonalOrder, local.data(), [&](int l, int m, float value, const float* slope) {
          const float* w = weight + 3 * (l * l + l + m);
          const float all =
              lamp.intensity.x() * w[0] + lamp.intensity.y() * w[1] + lamp.intensity.z() * w[2];
          d_strength += all * value;
          d_local += t.strength * all * Vec3f(slope[0], slope[1], slope[2]);
        });
        d_axes += t.direction * d_local.transpose();
        if (lamp.directional) continue;
        const Vec3f d_w = axes * d_local;
        d_position -= t.inverse_distance * (d_w - d_w.dot(t.direction) * t.direction);
        if (lights.falloff)
          d_position += 2 * t.inverse_distance * t.strength * d_strength * t.direction;
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
