#include "effigy/light/point_light.h"

#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/light/zonal.h"

namespace effigy {
namespace {

constexpr size_t kCount = sh_count(kZonalOrder);

void add_sh(const Vec3d& direction, const Vec3d& rgb, double* sh) {
  for_each_sh(kZonalOrder, direction.data(), [&](int l, int m, double value, const double*) {
    double* to = sh + 3 * (l * l + l + m);
    for (int c = 0; c < 3; ++c) to[c] += value * rgb[c];
  });
}

// Node k of Gauss' quadrature over [-1, 1] with kNodes nodes, and its weight.
constexpr int kNodes = kZonalOrder + 1, kAngles = 2 * kZonalOrder + 1;
Vec2d gauss_node(int k) {
  double x = std::cos(std::numbers::pi * (k + 0.75) / (kNodes + 0.5)), slope = 1;
  for (int round = 0; round < 8; ++round) {  // Newton on P_kNodes
    double p = 1, before = 0;
    for (int l = 0; l < kNodes; ++l) {
      const double next = ((2 * l + 1) * x * p - l * before) / (l + 1);
      before = p;
      p = next;
    }
    slope = kNodes * (x * p - before) / (x * x - 1);
    x -= p / slope;
  }
  return {x, 2 / ((1 - x * x) * slope * slope)};
}

}  // namespace

PointLights sh_lamps(std::span<const float> sh) {
  EFFIGY_CHECK_EQ(sh.size(), 3 * kCount);
  PointLights lamps;
  for (int k = 0; k < kNodes; ++k) {
    const Vec2d node = gauss_node(k);
    const double around = std::sqrt(1 - node.x() * node.x());
    for (int j = 0; j < kAngles; ++j) {
      const double angle = 2 * std::numbers::pi * j / kAngles;
      const Vec3d direction(around * std::cos(angle), around * std::sin(angle), node.x());
      Vec3d radiance = Vec3d::Zero();
      for_each_sh(kZonalOrder, direction.data(), [&](int l, int m, double value, const double*) {
        const float* given = &sh[3 * static_cast<size_t>(l * l + l + m)];
        for (int c = 0; c < 3; ++c) radiance[c] += value * static_cast<double>(given[c]);
      });
      const double share = 2 * std::numbers::pi / kAngles * node.y();
      lamps.lights.push_back({direction.cast<float>(), (share * radiance).cast<float>(), true});
    }
  }
  return lamps;
}

LampWay way_to_lamp(const PointLights& lights, const PointLight& lamp, const Vec3f& from) {
  if (lamp.directional) return {lamp.position};
  const Vec3f way = lamp.position - from;
  const float inverse = 1.0f / std::sqrt(way.squaredNorm() + 1e-20f);
  const float reference = lights.falloff ? (lamp.position - lights.center).squaredNorm() : 0.0f;
  return {way * inverse, lights.falloff ? reference * inverse * inverse : 1.0f, inverse};
}

std::vector<float> sh_of_points(const PointLights& points, const Vec3f& from) {
  std::vector<double> sh(3 * kCount, 0.0);
  for (const PointLight& light : points.lights) {
    Vec3d towards = light.position.cast<double>();
    double strength = 1.0;
    if (!light.directional) {
      towards -= from.cast<double>();
      if (points.falloff)
        strength =
            (light.position - points.center).cast<double>().squaredNorm() / towards.squaredNorm();
    }
    add_sh(towards.normalized(), strength * light.intensity.cast<double>(), sh.data());
  }
  return {sh.begin(), sh.end()};
}

std::vector<float> sh_of_cubemap(const Cubemap& radiance) {
  const int n = radiance.size;
  std::vector<double> faces(6 * 3 * kCount, 0.0);
  parallel_for(6, 1, [&](size_t begin, size_t end, int) {
    for (size_t face = begin; face < end; ++face)
      for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) {
          const size_t texel =
              (face * static_cast<size_t>(n) + static_cast<size_t>(y)) * static_cast<size_t>(n) +
              static_cast<size_t>(x);
          const float* rgb = radiance.texels.data() + 3 * texel;
          const Vec3d direction =
              cubemap_direction(static_cast<int>(face), x, y, n).cast<double>().normalized();
          add_sh(direction, cubemap_solid_angle(x, y, n) * Vec3d(rgb[0], rgb[1], rgb[2]),
                 faces.data() + face * 3 * kCount);
        }
  });
  std::vector<float> sh(3 * kCount, 0.0f);
  for (size_t i = 0; i < sh.size(); ++i) {
    double sum = 0.0;
    for (size_t face = 0; face < 6; ++face) sum += faces[face * 3 * kCount + i];
    sh[i] = static_cast<float>(sum);
  }
  return sh;
}

}  // namespace effigy
