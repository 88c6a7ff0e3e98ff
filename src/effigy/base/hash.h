// A short number that tells files and captures apart; not against anybody's ill will.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace effigy {

// FNV-1a, 64 bits (Fowler, Noll and Vo).
struct Hash {
  uint64_t value = 1469598103934665603ULL;
  void mix(const void* data, size_t bytes) {
    for (size_t i = 0; i < bytes; ++i)
      value = (value ^ static_cast<const uint8_t*>(data)[i]) * 1099511628211ULL;
  }
  void mix(std::span<const float> numbers) { mix(numbers.data(), numbers.size_bytes()); }
};

}  // namespace effigy
