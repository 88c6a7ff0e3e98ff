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

}  // namespace

// Each slot counts and moves its own range; within a bucket the slots' shares follow each other, so
// the result does not depend on their number.
void DepthSort::radix_pass(int shift, int slots) {
  const size_t n = items_.size(), parts = static_cast<size_t>(slots);
  next_.resize(n);
  count_.assign(parts * kBuckets, 0);
  const auto each = [&](int slot, const auto& body) {
    const size_t part = static_cast<size_t>(slot);
    uint32_t* const mine = count_.data() + part * kBuckets;
    for (size_t i = n * part / parts; i < n * (part + 1) / parts; ++i)
      body(items_[i], mine[(items_[i].key >> shift) & (kBuckets - 1)]);
  };
  run_slots(slots, [&](int slot) { each(slot, [](Item, uint32_t& count) { ++count; }); });
  uint32_t sum = 0;
  for (size_t b = 0; b < kBuckets; ++b)
    for (size_t part = 0; part < parts; ++part)
      sum += std::exchange(count_[part * kBuckets + b], sum);
  run_slots(slots,
            [&](int slot) { each(slot, [&](Item item, uint32_t& to) { next_[to++] = item; }); });
  items_.swap(next_);
}

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
  items_.resize(all.count);
  // Two passes are enough to bring splats of about the same depth together.
  int drop = 0;
  while (all.count > 0 && (all.most - all.least) >> drop >= kBuckets * kBuckets) ++drop;
  run_slots(slots, [&](int slot) {
    size_t to = shares[static_cast<size_t>(slot)].count;
    each(slot, [&](size_t i, uint32_t key) {
      items_[to++] = {(key - all.least) >> drop, static_cast<uint32_t>(i)};
    });
  });
}

void DepthSort::settle(const std::vector<double>& depth, int slots, std::vector<uint32_t>& order) {
  const size_t n = items_.size(), parts = static_cast<size_t>(slots);
  order.resize(n);
  run_slots(slots, [&](int slot) {
    const size_t part = static_cast<size_t>(slot), last = n * (part + 1) / parts;
    size_t begin = n * part / parts;
    // Equal keys belong to the slot of their first.
    while (begin > 0 && begin < last && items_[begin].key == items_[begin - 1].key) ++begin;
    while (begin < last) {
      size_t end = begin;
      for (; end < n && items_[end].key == items_[begin].key; ++end) order[end] = items_[end].index;
      if (end - begin > 1)
        std::stable_sort(order.begin() + static_cast<std::ptrdiff_t>(begin),
                         order.begin() + static_cast<std::ptrdiff_t>(end),
                         [&](uint32_t a, uint32_t b) { return depth[a] < depth[b]; });
      begin = end;
    }
  });
}

void DepthSort::sort(const std::vector<uint8_t>& seen, const std::vector<double>& depth,
                     std::vector<uint32_t>& order) {
  const int slots = std::clamp(static_cast<int>(seen.size() / kGrain), 1, thread_count());
  gather(seen, depth, slots);
  for (int pass = 0; pass < 2 && items_.size() > 1; ++pass) radix_pass(pass * kBits, slots);
  settle(depth, slots, order);
}

}  // namespace effigy
