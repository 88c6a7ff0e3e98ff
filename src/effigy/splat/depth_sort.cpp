#include "effigy/splat/depth_sort.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>

#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr int kBits = 11;  // of a radix pass
constexpr size_t kBuckets = size_t{1} << kBits;
constexpr size_t kGrain = 8192;  // splats worth a slot

// Order-preserving bits of a float.
uint32_t sortable(float x) {
  const auto bits = std::bit_cast<uint32_t>(x);
  return (bits & 0x80000000u) ? ~bits : bits | 0x80000000u;
}

// One stable pass over the bits from `shift` on. Each slot counts and moves its own range; within a
// bucket the slots' shares follow each other, so the result does not depend on their number.
void radix_pass(int shift, const std::vector<uint32_t>& keys, const std::vector<uint32_t>& index,
                std::vector<uint32_t>& to_keys, std::vector<uint32_t>& to_index,
                std::vector<uint32_t>& count, int slots) {
  const size_t n = keys.size(), parts = static_cast<size_t>(slots);
  const auto bucket = [&](size_t i) { return (keys[i] >> shift) & (kBuckets - 1); };
  count.assign(parts * kBuckets, 0);
  run_slots(slots, [&](int slot) {
    const size_t part = static_cast<size_t>(slot);
    uint32_t* mine = count.data() + part * kBuckets;
    for (size_t i = n * part / parts; i < n * (part + 1) / parts; ++i) ++mine[bucket(i)];
  });
  uint32_t sum = 0;
  for (size_t b = 0; b < kBuckets; ++b)
    for (size_t part = 0; part < parts; ++part) {
      uint32_t& c = count[part * kBuckets + b];
      const uint32_t share = c;
      c = sum;
      sum += share;
    }
  run_slots(slots, [&](int slot) {
    const size_t part = static_cast<size_t>(slot);
    uint32_t* mine = count.data() + part * kBuckets;
    for (size_t i = n * part / parts; i < n * (part + 1) / parts; ++i) {
      const uint32_t to = mine[bucket(i)]++;
      to_keys[to] = keys[i];
      to_index[to] = index[i];
    }
  });
}

}  // namespace

void DepthSort::sort(const std::vector<uint8_t>& seen, const std::vector<double>& depth,
                     std::vector<uint32_t>& order) {
  keys_.clear();
  index_.clear();
  uint32_t least = ~uint32_t{0}, most = 0;
  for (size_t i = 0; i < seen.size(); ++i) {
    if (!seen[i]) continue;
    const uint32_t key = sortable(static_cast<float>(depth[i]));
    keys_.push_back(key);
    index_.push_back(static_cast<uint32_t>(i));
    least = std::min(least, key);
    most = std::max(most, key);
  }
  const size_t n = keys_.size();
  next_keys_.resize(n);
  next_.resize(n);
  const int slots = std::clamp(static_cast<int>(n / kGrain), 1, thread_count());
  // Two passes are enough to bring splats of about the same depth together.
  int drop = 0;
  while (n > 0 && (most - least) >> drop >= kBuckets * kBuckets) ++drop;
  for (uint32_t& key : keys_) key = (key - least) >> drop;
  for (int pass = 0; pass < 2 && n > 1; ++pass) {
    radix_pass(pass * kBits, keys_, index_, next_keys_, next_, count_, slots);
    keys_.swap(next_keys_);
    index_.swap(next_);
  }
  // Within about the same depth by the depth itself.
  for (size_t begin = 0; begin < n;) {
    size_t end = begin + 1;
    while (end < n && keys_[end] == keys_[begin]) ++end;
    if (end - begin > 1)
      std::stable_sort(index_.begin() + static_cast<std::ptrdiff_t>(begin),
                       index_.begin() + static_cast<std::ptrdiff_t>(end),
                       [&](uint32_t a, uint32_t b) { return depth[a] < depth[b]; });
    begin = end;
  }
  order.swap(index_);
}

}  // namespace effigy
