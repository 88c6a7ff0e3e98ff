#include "effigy/light/point_light.h"

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

}  // namespace

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
