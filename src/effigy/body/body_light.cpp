// Lights made ready for drawing (draw.h).

#include "effigy/body/draw.h"
#include "effigy/light/light_groups.h"

namespace effigy {
namespace {

constexpr int kDirectionsSize = 8;  // of the cubemap that stands for far lamps
// Radiance times solid angle is kept.
Cubemap halved_to(Cubemap map, int size) {
  while (map.size > size && map.size % 2 == 0) {
    Cubemap half(map.size / 2);
    for (int face = 0; face < 6; ++face)
      for (int y = 0; y < half.size; ++y)
        for (int x = 0; x < half.size; ++x) {
          float* out = half.texels.data() + 3 * ((face * half.size + y) * half.size + x);
          double whole = 0, sum[3] = {};
          for (int k = 0; k < 4; ++k) {
            const int fx = 2 * x + k % 2, fy = 2 * y + k / 2;
            const double angle = cubemap_solid_angle(fx, fy, map.size);
            const float* in = map.texels.data() + 3 * ((face * map.size + fy) * map.size + fx);
            whole += angle;
            for (int c = 0; c < 3; ++c) sum[c] += angle * static_cast<double>(in[c]);
          }
          for (int c = 0; c < 3; ++c) out[c] = static_cast<float>(sum[c] / whole);
        }
    map = std::move(half);
  }
  return map;
}

BodyLight whole(PointLights points) {
  BodyLight light;
  light.points = std::move(points);
  return light;
}

BodyLight whole(const Cubemap& radiance, bool band_table) {
  BodyLight light;
  light.sh = sh_of_cubemap(radiance);
  if (band_table) light.bands = std::make_shared<const BandTable>(light.sh);
  light.lobes = std::make_shared<const LobeEnvironment>(radiance);
  const Cubemap coarse = halved_to(radiance, kDirectionsSize);
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < coarse.size; ++y)
      for (int x = 0; x < coarse.size; ++x) {
        const int i = 3 * ((face * coarse.size + y) * coarse.size + x);
        const Vec3f given = Vec3f(coarse.texels.data() + i) *
                            static_cast<float>(cubemap_solid_angle(x, y, coarse.size));
        light.directions.lights.push_back(
            {cubemap_direction(face, x, y, coarse.size), given, true});
      }
  return light;
}

}  // namespace

BodyLight body_light(PointLights points, int groups) {
  if (groups == 1) return whole(std::move(points));
  BodyLight light;
  for (PointLights& part : group_points(points, groups))
    light.groups.push_back(whole(std::move(part)));
  return light;
}

BodyLight body_light(const Cubemap& radiance, int groups, bool band_table) {
  if (groups == 1) return whole(radiance, band_table);
  BodyLight light;
  for (const Cubemap& part : group_environment(radiance, groups))
    light.groups.push_back(whole(part, band_table));
  return light;
}

}  // namespace effigy
