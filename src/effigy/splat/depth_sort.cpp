#include "effigy/splat/depth_sort.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <utility>

#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr int kBits = 11;  // of a radix pass
constexpr size_t kBuckets = size_t{1} << kBits;
constexpr size_t kGrain = 4096;  // splats worth a slot

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

void DepthSort::gather(const std::vector<uint8_t>& seen, const std::vector<double>& depth,
                       int slots) {
  const size_t n = seen.size(), parts = static_cast<size_t>(slots);
  const auto each = [&](int slot, const auto& body) {
    const size_t part = static_cast<size_t>(slot);
    for (size_t i = n * part / parts; i < n * (part + 1) / parts; ++i)
      if (seen[i]) body(i, sortable(static_cast<float>(depth[i])));
  };
  struct alignas(64) Share {
    size_t count = 0;
    uint32_t least = ~uint32_t{0}, most = 0;
  };
  std::vector<Share> shares(parts);
  run_slots(slots, [&](int slot) {
    Share share;
    each(slot, [&](size_t, uint32_t key) {
      ++share.count;
      share.least = std::min(share.least, key);
      share.most = std::max(share.most, key);
    });
    shares[static_cast<size_t>(slot)] = share;
  });
  Share all;
  for (Share& share : shares) {
    all.least = std::min(all.least, share.least);
    all.most = std::max(all.most, share.most);
    all.count += std::exchange(share.count, all.count);  // becomes the place of the slot's first
  }
  for (auto* array : {&keys_, &index_, &next_keys_, &next_}) array->resize(all.count);
  // Two passes are enough to bring splats of about the same depth together.
  int drop = 0;
  while (all.count > 0 && (all.most - all.least) >> drop >= kBuckets * kBuckets) ++drop;
  run_slots(slots, [&](int slot) {
    size_t to = shares[static_cast<size_t>(slot)].count;
    each(slot, [&](size_t i, uint32_t key) {
      keys_[to] = (key - all.least) >> drop;
      index_[to++] = static_cast<uint32_t>(i);
    });
  });
}

void DepthSort::settle(const std::vector<double>& depth, int slots) {
  const size_t n = keys_.size(), parts = static_cast<size_t>(slots);
  run_slots(slots, [&](int slot) {
    const size_t part = static_cast<size_t>(slot), last = n * (part + 1) / parts;
    size_t begin = n * part / parts;
    // Equal keys belong to the slot of their first.
    while (begin > 0 && begin < last && keys_[begin] == keys_[begin - 1]) ++begin;
    while (begin < last) {
      size_t end = begin + 1;
      while (end < n && keys_[end] == keys_[begin]) ++end;
      if (end - begin > 1)
        std::stable_sort(index_.begin() + static_cast<std::ptrdiff_t>(begin),
                         index_.begin() + static_cast<std::ptrdiff_t>(end),
                         [&](uint32_t a, uint32_t b) { return depth[a] < depth[b]; });
      begin = end;
    }
  });
}

void DepthSort::sort(const std::vector<uint8_t>& seen, const std::vector<double>& depth,
                     std::vector<uint32_t>& order) {
  const int slots = std::clamp(static_cast<int>(seen.size() / kGrain), 1, thread_count());
  gather(seen, depth, slots);
  for (int pass = 0; pass < 2 && keys_.size() > 1; ++pass) {
    radix_pass(pass * kBits, keys_, index_, next_keys_, next_, count_, slots);
    keys_.swap(next_keys_);
    index_.swap(next_);
  }
  settle(depth, slots);
  order.swap(index_);
}

}  // namespace effigy
