#include "effigy/light/band_table.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/geometry/types.h"

namespace effigy {
namespace {

// A face is a major axis and its sign; s and t are the other two coordinates over the major one.
Vec3d direction_of(int face, double s, double t) {
  const int major = face / 2;
  Vec3d d;
  d[major] = face % 2 == 0 ? 1 : -1;
  d[(major + 1) % 3] = s;
  d[(major + 2) % 3] = t;
  return d.normalized();
}

}  // namespace

BandTable::BandTable(std::span<const float> sh, int side)
    : side_(side), nodes_(6 * static_cast<size_t>((side + 1) * (side + 1)) * kNumbers) {
  EFFIGY_CHECK_EQ(sh.size(), 3 * sh_count(kZonalOrder));
  EFFIGY_CHECK(side >= 2);
  const auto rows = static_cast<size_t>(side + 1);
  parallel_for(6 * rows, 8, [&](size_t begin, size_t end, int) {
    for (size_t row = begin; row < end; ++row)
      for (size_t column = 0; column < rows; ++column) {
        const auto place = [side](size_t k) { return 2.0 * static_cast<double>(k) / side - 1; };
        const Vec3d d =
            direction_of(static_cast<int>(row / rows), place(column), place(row % rows));
        double e[kNumbers] = {};
        for_each_sh(kZonalOrder, d.data(), [&](int l, int m, double value, const double*) {
          for (int c = 0; c < 3; ++c)
            e[3 * l + c] +=
                value * static_cast<double>(sh[static_cast<size_t>(3 * (l * l + l + m) + c)]);
        });
        std::copy_n(e, kNumbers, &nodes_[(row * rows + column) * kNumbers]);
      }
  });
}

void BandTable::look_up(float x, float y, float z, float* e) const {
  const float v[3] = {x, y, z};
  const float ax = std::abs(x), ay = std::abs(y), az = std::abs(z);
  const int major = ax >= ay && ax >= az ? 0 : (ay >= az ? 1 : 2);
  const int face = 2 * major + (v[major] < 0 ? 1 : 0);
  const float inverse = 1.0f / std::abs(v[major]), half = 0.5f * static_cast<float>(side_);
  const float s = (v[(major + 1) % 3] * inverse + 1) * half;
  const float t = (v[(major + 2) % 3] * inverse + 1) * half;
  const int column = std::clamp(static_cast<int>(s), 0, side_ - 1);
  const int row = std::clamp(static_cast<int>(t), 0, side_ - 1);
  const float fs = s - static_cast<float>(column), ft = t - static_cast<float>(row);
  const size_t stride = static_cast<size_t>(side_ + 1) * kNumbers;
  const float* node = &nodes_[static_cast<size_t>(face * (side_ + 1) + row) * stride +
                              static_cast<size_t>(column) * kNumbers];
  const float w00 = (1 - fs) * (1 - ft), w10 = fs * (1 - ft), w01 = (1 - fs) * ft, w11 = fs * ft;
  for (size_t k = 0; k < kNumbers; ++k)
    e[k] = w00 * node[k] + w10 * node[kNumbers + k] + w01 * node[stride + k] +
           w11 * node[stride + kNumbers + k];
}

}  // namespace effigy
