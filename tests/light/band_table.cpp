// Environments by tables of bands, and as few lamps.
#include "effigy/light/band_table.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/random.h"
#include "effigy/light/builtin_lights.h"
#include "effigy/light/point_light.h"

namespace effigy {
namespace {

std::vector<float> sunset_sh() {
  return sh_of_cubemap(cubemap_from_equirectangular(builtin_light("sunset"), 32));
}

void bands_of(const std::vector<float>& sh, const Vec3d& d, double* e) {
  std::fill_n(e, BandTable::kNumbers, 0.0);
  for_each_sh(kZonalOrder, d.data(), [&](int l, int m, double value, const double*) {
    for (int c = 0; c < 3; ++c)
      e[3 * l + c] += value * static_cast<double>(sh[static_cast<size_t>(3 * (l * l + l + m) + c)]);
  });
}

TEST(BandTable, IsTheHarmonics) {
  // A sun: every band is as strong as it can be.
  const std::vector<float> sh = sunset_sh();
  const BandTable table(sh);
  Random random(2, 5);
  double worst[kZonalBands] = {}, largest[kZonalBands] = {}, lambert = 0, most = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    Vec3d d = Vec3d(random.normal(), random.normal(), random.normal()).normalized();
    if (trial % 4 == 0) d[trial / 4 % 3] *= 1e-3;  // edges of faces, and their middles
    if (trial % 8 == 0) d = Vec3d(1, trial % 16 == 0 ? 1 : -1, random.uniform(-1, 1));
    d.normalize();
    float e[BandTable::kNumbers];
    double truth[BandTable::kNumbers], colour = 0, colour_truth = 0;
    const Vec3f axis = d.cast<float>();
    table.look_up(axis.x(), axis.y(), axis.z(), e);
    bands_of(sh, d, truth);
    for (size_t l = 0; l < kZonalBands; ++l) {
      for (size_t c = 0; c < 3; ++c) {
        worst[l] =
            std::max(worst[l], std::abs(static_cast<double>(e[3 * l + c]) - truth[3 * l + c]));
        largest[l] = std::max(largest[l], std::abs(truth[3 * l + c]));
      }
      colour += lambert_zonal()[l] * static_cast<double>(e[3 * l]);
      colour_truth += lambert_zonal()[l] * truth[3 * l];
    }
    lambert = std::max(lambert, std::abs(colour - colour_truth));
    most = std::max(most, colour_truth);
  }
  for (size_t l = 0; l < kZonalBands; ++l)
    EXPECT_LT(worst[l], (1e-6 + 1.1e-4 * static_cast<double>(l * (l + 1))) * largest[l]) << l;
  EXPECT_LT(lambert, 5e-4 * most);
}

TEST(BandTable, IsContinuousOverEdges) {
  const BandTable table(sunset_sh(), 8);
  for (const float step : {-1e-4f, 1e-4f}) {
    float a[BandTable::kNumbers], b[BandTable::kNumbers];
    table.look_up(1, 1 + step, 0.3f, a);
    table.look_up(1, 1 - step, 0.3f, b);
    for (size_t k = 0; k < BandTable::kNumbers; ++k) EXPECT_NEAR(a[k], b[k], 0.02f);
    table.look_up(-1, 0.2f, -1 + step, a);
    table.look_up(-1, 0.2f, -1 - step, b);
    for (size_t k = 0; k < BandTable::kNumbers; ++k) EXPECT_NEAR(a[k], b[k], 0.02f);
  }
}

TEST(ShLamps, HaveTheHarmonics) {
  const std::vector<float> sh = sunset_sh();
  const PointLights lamps = sh_lamps(sh);
  EXPECT_EQ(lamps.lights.size(), 153u);
  const std::vector<float> again = sh_of_points(lamps, Vec3f::Zero());
  float most = 0;
  for (const float value : sh) most = std::max(most, std::abs(value));
  for (size_t i = 0; i < sh.size(); ++i) EXPECT_NEAR(again[i], sh[i], 2e-6f * most) << i;
}

}  // namespace
}  // namespace effigy
