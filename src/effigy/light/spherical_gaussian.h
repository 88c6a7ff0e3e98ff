// Spherical Gaussians of RFGCA Eq. 13: G(w) = N(sigma) exp(-theta^2 / (2 sigma^2)), theta the angle
// between w and the lobe's direction q.
//
// Angles come from the chord, h = |w - q|^2 / 4 = (1 - cos theta) / 2: theta = 2 asin(sqrt h),
// exact near the lobe's centre where the arc cosine loses half its digits, and d G / d cos theta =
// G theta / (sin theta sigma^2) is finite there.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "effigy/base/error.h"

namespace effigy {

enum class SgNorm {
  kCode,  // 1 / (sqrt 2 pi^(2/3) sigma): the paper's and the public code's; energy about 2.07 sigma
  kPi32,  // 1 / (sqrt 2 pi^(3/2) sigma): the sine of the angle left out of the integral
  kUnit,  // the lobe integrates to 1 over the sphere
};
// By name: code, pi32, unit. Throws Error for others.
SgNorm sg_norm_named(const char* name);

// Integral of exp(-theta^2 / 2 sigma^2) over the sphere, over sigma^2, and its derivative by sigma:
//   2 pi sum over k of (-sigma^2)^k / (2k + 1)!!,
// which takes theta to infinity instead of pi; relative error below 1e-6 for sigma <= 0.6.
template <class T>
inline void sg_integral(T sigma, T& value, T& derivative) {
  const T s2 = sigma * sigma;
  T sum = 0, slope = 0;  // by s2
  // Horner over 1 / (2k + 1)!!: 1 - s2 / 3 (1 - s2 / 5 (1 - ...)).
  for (int k = 12; k >= 1; --k) {
    const T c = T(1) / static_cast<T>(2 * k + 1);
    const T inner = T(1) - sum;
    slope = c * (inner - s2 * slope);
    sum = c * s2 * inner;
  }
  const T two_pi = T(2) * std::numbers::pi_v<T>;
  value = two_pi * (T(1) - sum);
  derivative = -two_pi * slope * T(2) * sigma;
}

// N(sigma) and its derivative. sigma > 0.
template <class T>
inline void sg_constant(SgNorm norm, T sigma, T& value, T& derivative) {
  if (norm == SgNorm::kUnit) {
    T integral, slope;
    sg_integral(sigma, integral, slope);
    value = T(1) / (sigma * sigma * integral);
    derivative = -value * (T(2) / sigma + slope / integral);
    return;
  }
  const T pi = std::numbers::pi_v<T>;
  const T power = norm == SgNorm::kCode ? std::cbrt(pi * pi) : pi * std::sqrt(pi);
  value = T(1) / (std::numbers::sqrt2_v<T> * power * sigma);
  derivative = -value / sigma;
}

// Largest h: keeps the derivative finite where w is opposite to q.
template <class T>
inline constexpr T kSgLargestChord = T(1) - T(5e-7);

// asin(sqrt h) / sqrt h for h in [0, 1/2]: Chebyshev polynomial, relative error below 3e-9.
template <class T>
inline T asin_over(T h) {
  T p = T(0.12391350138932467);
  p = p * h + T(-0.13591628438896602);
  p = p * h + T(0.10740003215161978);
  p = p * h + T(-0.0070205838172923);
  p = p * h + T(0.035814240393240944);
  p = p * h + T(0.04409161659164815);
  p = p * h + T(0.07502757317222197);
  p = p * h + T(0.16666614237805938);
  return p * h + T(1.0000000016226236);
}

// theta^2 and theta / sin theta from h = (1 - cos theta) / 2 in [0, 1).
template <class T>
inline void sg_angle(T chord, T& theta2, T& theta_over_sine) {
  const T most = kSgLargestChord<T>;
  const T h = chord < most ? chord : most;
  const bool near = h <= T(0.5);
  const T rest = T(1) - h, small = near ? h : rest, large = near ? rest : h;
  const T series = asin_over(small);  // asin of the root of the smaller one, over it
  const T root = std::sqrt(small), other = std::sqrt(large);
  const T close = T(2) * series * root;
  const T theta = near ? close : std::numbers::pi_v<T> - close;
  theta2 = theta * theta;
  theta_over_sine = (near ? series : theta) / (near ? other : T(2) * root * other);
}

// 2^x for x <= 0, relative error below 2e-7; 0 below -126.
inline float sg_exp2(float x) {
  const float least = -126.0f;
  const float held = x > least ? x : least;
  const float whole = (held + 12582912.0f) - 12582912.0f, f = held - whole;
  float p = 0.0013390863f;
  p = p * f + 0.0096760319f;
  p = p * f + 0.0555035711f;
  p = p * f + 0.2402210749f;
  p = p * f + 0.6931471880f;
  p = p * f + 1.0000000755f;
  const int32_t bits = (static_cast<int32_t>(whole) + 127) << 23;
  return p * std::bit_cast<float>(bits) * (x > least ? 1.0f : 0.0f);
}
inline constexpr float kSgHalfLog2E = 0.72134752044f;  // exp(-t / 2) = 2^(-kSgHalfLog2E t)

}  // namespace effigy
