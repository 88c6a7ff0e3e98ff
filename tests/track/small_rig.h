// A small random rig with every feature (identity, expressions, pose basis, five joints) for the
// tests of track/.
#pragma once

#include <cmath>

#include "effigy/base/random.h"
#include "effigy/rig/rig.h"

namespace effigy::test {

// A bumpy grid of `side` x `side` vertices facing +z, with `points` landmarks spread over it,
// numbered 0, 1, ...
inline Rig small_rig(int side, int points, uint64_t seed, bool pose_basis) {
  Random random(seed);
  Rig rig;
  rig.kind = "test";
  rig.licence = "CC0";
  const int count = side * side;
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      const double u = (x + 0.5) / side - 0.5, v = (y + 0.5) / side - 0.5;
      rig.mesh.vertices.push_back(static_cast<float>(0.16 * u + random.uniform(-0.002, 0.002)));
      rig.mesh.vertices.push_back(static_cast<float>(0.2 * v + random.uniform(-0.002, 0.002)));
      rig.mesh.vertices.push_back(
          static_cast<float>(0.08 - 0.25 * (u * u + v * v) + random.uniform(-0.004, 0.004)));
    }
  for (int y = 0; y + 1 < side; ++y)
    for (int x = 0; x + 1 < side; ++x) {
      const int a = y * side + x;
      rig.mesh.triangles.emplace_back(a, a + 1, a + side);
      rig.mesh.triangles.emplace_back(a + 1, a + side + 1, a + side);
    }
  const auto noise = [&](size_t n, double scale) {
    std::vector<float> values(n);
    for (float& value : values) value = static_cast<float>(scale * random.normal());
    return values;
  };
  rig.identity_count = 3;
  rig.expression_count = 5;
  rig.identity_basis = noise(static_cast<size_t>(3 * count) * 3, 0.003);
  rig.expression_basis = noise(static_cast<size_t>(3 * count) * 5, 0.004);
  rig.expression_names = {"jawOpen", "eyeBlink_L", "eyeBlink_R", "browInnerUp_L", "other"};
  rig.identity_sigma.assign(3, 1.0f);
  rig.expression_low.assign(5, 0.0f);
  rig.expression_high.assign(5, 1.0f);
  rig.joint_names = {"root", "neck", "jaw", "eye_left", "eye_right"};
  rig.parents = {-1, 0, 1, 1, 1};
  if (pose_basis) rig.pose_basis = noise(static_cast<size_t>(36 * count) * 3, 0.001);
  rig.joint_regressor.assign(static_cast<size_t>(5 * count), 0.0f);
  rig.weights.assign(static_cast<size_t>(5 * count), 0.0f);
  for (int j = 0; j < 5; ++j)
    for (int k = 0; k < 4; ++k)
      rig.joint_regressor[static_cast<size_t>(j) * count + random.below(count)] += 0.25f;
  for (int v = 0; v < count; ++v) {
    float total = 0;
    for (int j = 0; j < 5; ++j)
      total += rig.weights[5 * v + j] = j == 0 ? 0.0f : static_cast<float>(random.uniform());
    for (int j = 0; j < 5; ++j) rig.weights[5 * v + j] /= total;
  }
  for (int i = 0; i < points; ++i) {
    const double a = random.uniform(), b = random.uniform(0.0, 1.0 - a);
    rig.mediapipe.index.push_back(i);
    rig.mediapipe.triangle.push_back(static_cast<int>(random.below(rig.mesh.triangles.size())));
    rig.mediapipe.barycentric.emplace_back(static_cast<float>(a), static_cast<float>(b),
                                           static_cast<float>(1.0 - a - b));
  }
  return rig;
}

}  // namespace effigy::test
