// Counter-based random numbers: the same (seed, stream, counter) gives the same number on every
// machine and for every thread count, and the state to save in a checkpoint is three integers.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>

namespace effigy {

class Random {
 public:
  explicit Random(uint64_t seed = 0, uint64_t stream = 0) : seed_(seed), stream_(stream) {}

  // Uniform 64 bits (SplitMix64 finaliser over seed, stream and counter; Steele et al. 2014).
  uint64_t bits() {
    uint64_t z = seed_ + 0x9e3779b97f4a7c15ULL * (++counter_) + 0xd1342543de82ef95ULL * stream_;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }
  // Uniform in [0, 1).
  double uniform() { return static_cast<double>(bits() >> 11) * 0x1.0p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  // Uniform integer in [0, n), n > 0.
  uint64_t below(uint64_t n) { return bits() % n; }
  // Standard normal (Box-Muller, one of the pair).
  double normal() {
    const double u = 1.0 - uniform();
    const double v = uniform();
    return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * std::numbers::pi * v);
  }

  uint64_t seed() const { return seed_; }
  uint64_t stream() const { return stream_; }
  uint64_t counter() const { return counter_; }
  void set_counter(uint64_t counter) { counter_ = counter; }

 private:
  uint64_t seed_, stream_, counter_ = 0;
};

}  // namespace effigy
