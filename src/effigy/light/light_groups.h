// Lights in groups of near directions, for shadows that each group has for itself.
#pragma once

#include <span>
#include <vector>

#include "effigy/light/environment.h"
#include "effigy/light/point_light.h"

namespace effigy {

// Group 0, 1 .. of each direction (unit), at most `groups` of them, none empty. The strongest
// direction begins the first group; each further group begins at the direction whose weight times
// squared distance from the groups there are is the largest (k-means++ without chance: Arthur and
// Vassilvitskii 2007); then weighted means and nearest groups take turns (Lloyd). Weights are not
// negative. The same input gives the same groups.
std::vector<int> group_directions(std::span<const Vec3f> directions, std::span<const float> weights,
                                  int groups);

// Points by their direction from `points.center` and their luminance; the groups together are
// `points`. One empty group when there are none.
std::vector<PointLights> group_points(const PointLights& points, int groups);
// An environment by its texels' luminance times solid angle: each group is black where another one
// is not, and they sum to `radiance`. A sun, being strong and apart, gets a group of its own with
// its surroundings.
std::vector<Cubemap> group_environment(const Cubemap& radiance, int groups);

}  // namespace effigy
