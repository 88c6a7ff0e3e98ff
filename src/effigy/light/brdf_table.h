// The split-sum BRDF table (Karis 2013): directional albedo of the GGX specular lobe (alpha =
// roughness^2, height-correlated Smith G, Schlick F), F0 * scale + bias, computed by us.
#pragma once

#include <vector>

namespace effigy {

struct BrdfTable {
  int size = 0;              // size x size
  std::vector<float> value;  // [roughness row][n.v column][2]: scale, bias at texel centres
};
// The table (computed once, shared).
const BrdfTable& brdf_table();
// Bilinear, clamped to texel centres, with the derivatives of scale and bias by n.v and roughness
// (0 where clamped). Within 2e-3 of the integrals from n.v = 0.04 on; closer to grazing up to 0.02,
// and 0.04 below the first texel centre (n.v < 0.008, half a degree).
struct BrdfSample {
  float scale, bias;
  float d_scale_nv, d_bias_nv, d_scale_roughness, d_bias_roughness;
};
BrdfSample sample_brdf(const BrdfTable& table, float n_dot_v, float roughness);

}  // namespace effigy
