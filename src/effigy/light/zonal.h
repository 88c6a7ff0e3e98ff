// Zonal harmonics: functions of the angle to an axis, and what they make of light.
//
// A lobe about the unit axis a with coefficients z_l is the function whose spherical harmonics are
// z_l Y_lm(a) (RFGCA Eq. 8-9; no factor sqrt(4 pi / (2l + 1)), which Sloan 2005 has). By the
// addition theorem its value in direction w is
//   sum over l of z_l (2l + 1) / (4 pi) P_l(a.w),
// so light that arrives from directions w_j with strengths I_j gives
//   sum over l of z_l E_l(a),  E_l(a) = sum over j of I_j (2l + 1) / (4 pi) P_l(a.w_j)
//                                     = sum over m of L_lm Y_lm(a),
// L_lm the light's spherical harmonics. P_l: Legendre polynomials.
#pragma once

#include <array>
#include <cstddef>
#include <numbers>

#include "effigy/light/spherical_harmonics.h"

namespace effigy {

inline constexpr int kZonalOrder = 8;
inline constexpr size_t kZonalBands = kZonalOrder + 1;

// (2l + 1) / (4 pi).
template <class T>
constexpr T zonal_factor(size_t l) {
  return static_cast<T>(2 * l + 1) / (T(4) * std::numbers::pi_v<T>);
}

// P_0 .. P_8 at x in [-1, 1], and their derivatives (stable at the ends).
template <class T>
inline void legendre(T x, T* p, T* dp) {
  p[0] = T(1);
  p[1] = x;
  dp[0] = T(0);
  dp[1] = T(1);
  for (size_t l = 1; l + 1 < kZonalBands; ++l) {
    const T odd = static_cast<T>(2 * l + 1);
    p[l + 1] = (odd * x * p[l] - static_cast<T>(l) * p[l - 1]) / static_cast<T>(l + 1);
    dp[l + 1] = dp[l - 1] + odd * p[l];
  }
}

// Value of a lobe at the cosine of the angle to its axis. z: kZonalBands.
template <class T>
T zonal_value(const T* z, T cosine) {
  T p[kZonalBands], dp[kZonalBands], sum = 0;
  legendre(cosine, p, dp);
  for (size_t l = 0; l < kZonalBands; ++l) sum += z[l] * zonal_factor<T>(l) * p[l];
  return sum;
}

// Spherical harmonics (sh_count(kZonalOrder)) of a lobe about the unit `axis`: its rotation.
template <class T>
void zonal_to_sh(const T* z, const T* axis, T* sh) {
  for_each_sh(kZonalOrder, axis,
              [&](int l, int m, T value, const T*) { sh[l * l + l + m] = z[l] * value; });
}

// z of max(0, cosine) / pi: a Lambertian surface of albedo 1 about its normal. Within 0.034 / pi of
// it everywhere.
const std::array<double, kZonalBands>& lambert_zonal();

// Between the two conventions: z = sqrt(4 pi / (2l + 1)) z_sloan.
double zonal_from_sloan(size_t l);

}  // namespace effigy
