// Real spherical harmonics: orthonormal, with the Condon-Shortley sign, polar axis z, coefficient
// (l, m) at index l^2 + l + m. Evaluated as polynomials of the direction's coordinates, so that
// neither values nor derivatives are singular at the poles (Sloan 2013).
#pragma once

#include <array>
#include <cstddef>

namespace effigy {

inline constexpr int kMostShOrder = 8;
constexpr size_t sh_count(int order) {
  return static_cast<size_t>(order + 1) * static_cast<size_t>(order + 1);
}

namespace detail {

// sqrt((2l + 1) / (4 pi) (l - m)! / (l + m)!), times sqrt 2 for m > 0, at l (l + 1) / 2 + m.
extern const std::array<double, (kMostShOrder + 1) * (kMostShOrder + 2) / 2> kShNorm;

}  // namespace detail

// Calls term(l, m, value, d) for all coefficients up to `order`; d: derivatives by x, y, z of a
// polynomial that agrees with the harmonic on the unit sphere (only the part along the sphere has a
// meaning). `direction` is unit.
template <class T, class Term>
void for_each_sh(int order, const T* direction, const Term& term) {
  const T x = direction[0], y = direction[1], z = direction[2];
  T c = 1, s = 0, c_before = 0, s_before = 0;  // (x + i y)^m, and of m - 1
  T diagonal = 1;                              // (-1)^m (2m - 1)!!
  for (int m = 0; m <= order; ++m) {
    T p = diagonal, p_before = 0, dp = 0, dp_before = 0;  // P_l^m / (1 - z^2)^(m/2), d/dz
    const T fm = static_cast<T>(m);
    for (int l = m; l <= order; ++l) {
      if (l > m) {
        const T a = static_cast<T>(2 * l - 1), b = static_cast<T>(l + m - 1);
        const T scale = T(1) / static_cast<T>(l - m);
        const T next = (a * z * p - b * p_before) * scale;
        const T d_next = (a * (p + z * dp) - b * dp_before) * scale;
        p_before = p;
        dp_before = dp;
        p = next;
        dp = d_next;
      }
      const int index = l * (l + 1) / 2 + m;
      const T k = static_cast<T>(detail::kShNorm[static_cast<size_t>(index)]);
      const T kp = k * p, kpm = kp * fm, kd = k * dp;
      const T dc[3] = {kpm * c_before, -kpm * s_before, kd * c};
      term(l, m, kp * c, dc);
      if (m == 0) continue;
      const T ds[3] = {kpm * s_before, kpm * c_before, kd * s};
      term(l, -m, kp * s, ds);
    }
    diagonal *= -static_cast<T>(2 * m + 1);
    c_before = c;
    s_before = s;
    c = x * c_before - y * s_before;
    s = x * s_before + y * c_before;
  }
}

// values: sh_count(order).
template <class T>
void evaluate_sh(int order, const T* direction, T* values) {
  for_each_sh(order, direction,
              [&](int l, int m, T value, const T*) { values[l * l + l + m] = value; });
}

}  // namespace effigy
