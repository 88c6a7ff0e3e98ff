// Internal to texture_kernel: the few Highway operations it uses, on 8 lanes in plain C++, for the
// fallback target whose vectors (one lane) cannot hold a texel.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace effigy::texel_vector {

struct Texel {
  float lane[8];
};
struct Mask {
  bool lane[8];
};
template <typename T, size_t kLimit>
struct CappedTag {};
template <typename D>
using Vec = Texel;

template <typename F>
inline Texel map(F&& f) {
  Texel r;
  for (int i = 0; i < 8; ++i) r.lane[i] = f(i);
  return r;
}
template <typename F>
inline Mask test(F&& f) {
  Mask r;
  for (int i = 0; i < 8; ++i) r.lane[i] = f(i);
  return r;
}

template <typename D>
constexpr size_t Lanes(D) {
  return 8;
}
template <typename D>
inline Texel Set(D, float value) {
  return map([&](int) { return value; });
}
template <typename D>
inline Texel Zero(D) {
  return map([](int) { return 0.0f; });
}
template <typename D>
inline Texel LoadU(D, const float* from) {
  return map([&](int i) { return from[i]; });
}
template <typename D>
inline Texel Load(D d, const float* from) {
  return LoadU(d, from);
}
template <typename D>
inline void StoreU(const Texel& v, D, float* to) {
  for (int i = 0; i < 8; ++i) to[i] = v.lane[i];
}
template <typename D>
inline void Store(const Texel& v, D d, float* to) {
  StoreU(v, d, to);
}
inline Texel Add(const Texel& a, const Texel& b) {
  return map([&](int i) { return a.lane[i] + b.lane[i]; });
}
inline Texel Sub(const Texel& a, const Texel& b) {
  return map([&](int i) { return a.lane[i] - b.lane[i]; });
}
inline Texel Mul(const Texel& a, const Texel& b) {
  return map([&](int i) { return a.lane[i] * b.lane[i]; });
}
inline Texel Div(const Texel& a, const Texel& b) {
  return map([&](int i) { return a.lane[i] / b.lane[i]; });
}
inline Texel MulAdd(const Texel& a, const Texel& b, const Texel& c) {
  return map([&](int i) { return a.lane[i] * b.lane[i] + c.lane[i]; });
}
inline Texel NegMulAdd(const Texel& a, const Texel& b, const Texel& c) {
  return map([&](int i) { return c.lane[i] - a.lane[i] * b.lane[i]; });
}
inline Texel ApproximateReciprocalSqrt(const Texel& a) {
  return map([&](int i) { return 1.0f / std::sqrt(a.lane[i]); });
}
inline Texel Min(const Texel& a, const Texel& b) {
  return map([&](int i) { return a.lane[i] < b.lane[i] ? a.lane[i] : b.lane[i]; });
}
inline Texel Max(const Texel& a, const Texel& b) {
  return map([&](int i) { return a.lane[i] > b.lane[i] ? a.lane[i] : b.lane[i]; });
}
// Of the bits.
inline Texel Or(const Texel& a, const Texel& b) {
  return map([&](int i) {
    return std::bit_cast<float>(std::bit_cast<uint32_t>(a.lane[i]) |
                                std::bit_cast<uint32_t>(b.lane[i]));
  });
}
inline Mask Or(const Mask& a, const Mask& b) {
  return test([&](int i) { return a.lane[i] || b.lane[i]; });
}
inline Texel Neg(const Texel& a) {
  return map([&](int i) { return -a.lane[i]; });
}
inline Texel Abs(const Texel& a) {
  return map([&](int i) { return std::fabs(a.lane[i]); });
}
inline Texel Sqrt(const Texel& a) {
  return map([&](int i) { return std::sqrt(a.lane[i]); });
}
template <typename D>
inline Texel Exp(D, const Texel& a) {
  return map([&](int i) { return std::exp(a.lane[i]); });
}
inline Texel CopySign(const Texel& magnitude, const Texel& sign) {
  return map([&](int i) { return std::copysign(magnitude.lane[i], sign.lane[i]); });
}
// Reverses each block of four lanes.
inline Texel Shuffle0123(const Texel& a) {
  return map([&](int i) { return a.lane[i ^ 3]; });
}
inline Mask Gt(const Texel& a, const Texel& b) {
  return test([&](int i) { return a.lane[i] > b.lane[i]; });
}
inline Mask Ge(const Texel& a, const Texel& b) {
  return test([&](int i) { return a.lane[i] >= b.lane[i]; });
}
inline Mask Ne(const Texel& a, const Texel& b) {
  return test([&](int i) { return a.lane[i] != b.lane[i]; });
}
inline Mask IsFinite(const Texel& a) {
  return test([&](int i) { return std::isfinite(a.lane[i]); });
}
inline Texel IfThenElse(const Mask& m, const Texel& a, const Texel& b) {
  return map([&](int i) { return m.lane[i] ? a.lane[i] : b.lane[i]; });
}
inline Texel IfThenElseZero(const Mask& m, const Texel& a) {
  return map([&](int i) { return m.lane[i] ? a.lane[i] : 0.0f; });
}
template <typename D>
inline size_t CountTrue(D, const Mask& m) {
  size_t count = 0;
  for (int i = 0; i < 8; ++i) count += m.lane[i] ? 1 : 0;
  return count;
}
template <typename D>
inline bool AllTrue(D d, const Mask& m) {
  return CountTrue(d, m) == 8;
}
template <typename D>
inline bool AllFalse(D d, const Mask& m) {
  return CountTrue(d, m) == 0;
}

}  // namespace effigy::texel_vector
