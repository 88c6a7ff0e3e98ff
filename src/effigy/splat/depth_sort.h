// Order of splats along the view. Internal to splat/.
#pragma once

#include <cstdint>
#include <vector>

namespace effigy {

// Sorts the splats whose `seen` is set by depth, ties by index. Keeps its memory between frames.
class DepthSort {
 public:
  // `order` becomes the indices of the splats that are seen, nearest first. Depths are compared in
  // double precision.
  void sort(const std::vector<uint8_t>& seen, const std::vector<double>& depth,
            std::vector<uint32_t>& order);

 private:
  struct Item {
    uint32_t key, index;
  };
  // Keys and indices of what is seen, in the order of the indices.
  void gather(const std::vector<uint8_t>& seen, const std::vector<double>& depth, int slots);
  // One stable pass over the keys' bits from `shift` on.
  void radix_pass(int shift, int slots);
  // Within equal keys by the depth itself; the result goes to `order`.
  void settle(const std::vector<double>& depth, int slots, std::vector<uint32_t>& order);

  std::vector<Item> items_, next_;
  std::vector<uint32_t> count_;  // of every slot and bucket
};

}  // namespace effigy
