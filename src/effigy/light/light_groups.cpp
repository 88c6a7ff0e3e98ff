#include "effigy/light/light_groups.h"

#include <algorithm>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"

namespace effigy {
namespace {

constexpr int kRounds = 16;  // of means and nearest groups, at most

int nearest(const Vec3f& direction, const std::vector<Vec3f>& centers) {
  int best = 0;
  for (size_t g = 1; g < centers.size(); ++g)
    if ((direction - centers[g]).squaredNorm() <
        (direction - centers[static_cast<size_t>(best)]).squaredNorm())
      best = static_cast<int>(g);
  return best;
}

std::vector<Vec3f> first_centers(std::span<const Vec3f> directions, std::span<const float> weights,
                                 int groups) {
  std::vector<Vec3f> centers;
  std::vector<float> distance(directions.size(), 1.0f);  // squared, to the nearest center
  while (static_cast<int>(centers.size()) < groups) {
    size_t best = 0;
    for (size_t i = 1; i < directions.size(); ++i)
      if (weights[i] * distance[i] > weights[best] * distance[best]) best = i;
    if (!centers.empty() && !(weights[best] * distance[best] > 0)) break;
    centers.push_back(directions[best]);
    for (size_t i = 0; i < directions.size(); ++i) {
      const float now = (directions[i] - directions[best]).squaredNorm();
      distance[i] = centers.size() == 1 ? now : std::min(distance[i], now);
    }
  }
  return centers;
}

}  // namespace

std::vector<int> group_directions(std::span<const Vec3f> directions, std::span<const float> weights,
                                  int groups) {
  EFFIGY_CHECK_EQ(directions.size(), weights.size());
  EFFIGY_CHECK(groups >= 1);
  std::vector<int> group(directions.size(), 0);
  if (groups == 1 || directions.empty()) return group;
  std::vector<Vec3f> centers = first_centers(directions, weights, groups);
  for (int round = 0; round < kRounds; ++round) {
    bool changed = false;
    for (size_t i = 0; i < directions.size(); ++i) {
      const int now = nearest(directions[i], centers);
      changed = changed || now != group[i];
      group[i] = now;
    }
    if (!changed && round > 0) break;
    std::vector<Vec3d> sums(centers.size(), Vec3d::Zero());
    for (size_t i = 0; i < directions.size(); ++i)
      sums[static_cast<size_t>(group[i])] +=
          static_cast<double>(weights[i]) * directions[i].cast<double>();
    for (size_t g = 0; g < centers.size(); ++g)
      if (sums[g].squaredNorm() > 0) centers[g] = sums[g].normalized().cast<float>();
  }
  // Numbers without gaps.
  std::vector<int> number(centers.size(), -1);
  int next = 0;
  for (int& g : group) {
    int& to = number[static_cast<size_t>(g)];
    if (to < 0) to = next++;
    g = to;
  }
  return group;
}

std::vector<PointLights> group_points(const PointLights& points, int groups) {
  std::vector<Vec3f> directions;
  std::vector<float> weights;
  for (const PointLight& light : points.lights) {
    directions.push_back(light.directional ? light.position
                                           : Vec3f(light.position - points.center).normalized());
    weights.push_back(luminance(light.intensity.x(), light.intensity.y(), light.intensity.z()));
  }
  const std::vector<int> group = group_directions(directions, weights, groups);
  const int count = group.empty() ? 1 : 1 + *std::max_element(group.begin(), group.end());
  std::vector<PointLights> parts(static_cast<size_t>(count),
                                 PointLights{{}, points.falloff, points.center});
  for (size_t i = 0; i < group.size(); ++i)
    parts[static_cast<size_t>(group[i])].lights.push_back(points.lights[i]);
  return parts;
}

std::vector<Cubemap> group_environment(const Cubemap& radiance, int groups) {
  const int n = radiance.size;
  std::vector<Vec3f> directions;
  std::vector<float> weights;
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        const float* rgb = &radiance.texels[3 * directions.size()];
        directions.push_back(cubemap_direction(face, x, y, n));
        weights.push_back(luminance(rgb[0], rgb[1], rgb[2]) *
                          static_cast<float>(cubemap_solid_angle(x, y, n)));
      }
  const std::vector<int> group = group_directions(directions, weights, groups);
  const int count = 1 + *std::max_element(group.begin(), group.end());
  std::vector<Cubemap> parts(static_cast<size_t>(count), Cubemap(n));
  for (size_t i = 0; i < group.size(); ++i)
    std::copy_n(&radiance.texels[3 * i], 3, &parts[static_cast<size_t>(group[i])].texels[3 * i]);
  return parts;
}

}  // namespace effigy
