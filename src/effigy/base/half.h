// 16-bit floating point as files hold it.
#pragma once

#include <cmath>
#include <cstdint>

namespace effigy {

// IEEE 754 binary16; exact.
inline double half_to_double(uint16_t bits) {
  const int exponent = (bits >> 10) & 31, mantissa = bits & 1023;
  double value;
  if (exponent == 31)
    value = mantissa == 0 ? INFINITY : NAN;
  else
    value = exponent == 0 ? std::ldexp(mantissa, -24) : std::ldexp(mantissa + 1024, exponent - 25);
  return bits & 0x8000 ? -value : value;
}

}  // namespace effigy
