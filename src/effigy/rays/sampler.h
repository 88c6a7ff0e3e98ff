// Sample points of the path tracer: Owen-scrambled Sobol pairs, one independent scramble per pixel
// and pair (Burley 2020, "Practical Hash-based Owen Scrambling"; the hash is Laine and Karras'
// with Vegdahl's constants). A pixel's pattern depends on the pixel and the seed only, never on the
// frame, so that a resting surface keeps its noise and an animation does not flicker needlessly.
#pragma once

#include <algorithm>
#include <cstdint>

#include "effigy/geometry/types.h"

namespace effigy {

inline uint32_t reverse_bits(uint32_t x) {
  x = __builtin_bswap32(x);
  x = ((x & 0x0f0f0f0fu) << 4) | ((x >> 4) & 0x0f0f0f0fu);
  x = ((x & 0x33333333u) << 2) | ((x >> 2) & 0x33333333u);
  return ((x & 0x55555555u) << 1) | ((x >> 1) & 0x55555555u);
}

// A well mixed 32-bit hash of two (the finaliser of MurmurHash3 over a product sum).
inline uint32_t hash_pair(uint32_t a, uint32_t b) {
  uint32_t h = a * 0x9e3779b1u + b * 0x85ebca77u + 0xc2b2ae3du;
  h = (h ^ (h >> 16)) * 0x85ebca6bu;
  h = (h ^ (h >> 13)) * 0xc2b2ae35u;
  return h ^ (h >> 16);
}

// Owen scrambling of a number whose bits are reversed: each bit is flipped by a hash of the lower
// ones.
inline uint32_t scramble_reversed(uint32_t x, uint32_t seed) {
  x ^= x * 0x3d20adeau;
  x += seed;
  x *= (seed >> 16) | 1u;
  x ^= x * 0x05526c56u;
  x ^= x * 0x53a22864u;
  return x;
}

// Second coordinate of Sobol's sequence from the bit-reversed index (which is the first): Pascal's
// triangle mod 2 as five shifts.
inline uint32_t sobol_second(uint32_t reversed_index) {
  uint32_t y = reversed_index;
  y ^= y << 16;
  y ^= (y & 0x00ff00ffu) << 8;
  y ^= (y & 0x0f0f0f0fu) << 4;
  y ^= (y & 0x33333333u) << 2;
  return y ^ ((y & 0x55555555u) << 1);
}

// Chooses one of a sequence in proportion to shares that become known one by one: a candidate
// replaces the chosen one with its part of the sum so far. One random number in [0, 1) does for
// all, stretched again at each step.
class WeightedChoice {
 public:
  explicit WeightedChoice(float u) : u_(u) {}
  // Whether this candidate is the chosen one for now.
  bool offer(float share) {
    if (!(share > 0)) return false;
    sum_ += share;
    const float chance = share / sum_;
    const bool taken = u_ < chance;
    u_ = std::min(taken ? u_ / chance : (u_ - chance) / (1 - chance), 0x1.fffffep-1f);
    if (taken) chosen_ = share;
    return taken;
  }
  bool any() const { return chosen_ > 0; }
  float inverse_chance() const { return sum_ / chosen_; }  // of the chosen one

 private:
  float u_, sum_ = 0, chosen_ = 0;
};

class PixelSampler {
 public:
  PixelSampler(uint32_t x, uint32_t y, uint64_t seed)
      : pixel_(hash_pair(hash_pair(x, y), hash_pair(static_cast<uint32_t>(seed),
                                                    static_cast<uint32_t>(seed >> 32)))) {}

  // Begins sample `index` of the pixel.
  void start(uint32_t index) {
    reversed_ = reverse_bits(index);
    pair_ = 0;
  }
  // The next two coordinates in [0, 1).
  Vec2f next() {
    const uint32_t key = hash_pair(pixel_, pair_++);
    // Shuffles the order of the points, so that pairs are independent of each other.
    const uint32_t x = scramble_reversed(reversed_, key), y = sobol_second(x);
    return {unit(reverse_bits(scramble_reversed(reverse_bits(x), hash_pair(key, 1)))),
            unit(reverse_bits(scramble_reversed(reverse_bits(y), hash_pair(key, 2))))};
  }

 private:
  static float unit(uint32_t x) { return static_cast<float>(x >> 8) * 0x1.0p-24f; }
  uint32_t pixel_, reversed_ = 0, pair_ = 0;
};

}  // namespace effigy
