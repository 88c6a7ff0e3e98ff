#include "effigy/splat/depth_sort.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "effigy/base/threads.h"

namespace effigy {
namespace {

// As std::stable_sort has it, for every number of threads; many depths are equal or differ by less
// than single precision.
TEST(DepthSort, IsAStableSortInDoublePrecision) {
  std::mt19937 random(3);
  const int before = thread_count();
  DepthSort sort;
  for (const size_t n : {0u, 1u, 2u, 50u, 9000u, 30000u})
    for (const double spread : {0.0, 1e-9, 1e-3, 50.0}) {
      std::vector<double> depth(n);
      std::vector<uint8_t> seen(n);
      std::uniform_int_distribution<int> step(-300, 300);
      for (size_t i = 0; i < n; ++i) {
        depth[i] = 2.0 + spread * step(random);
        seen[i] = step(random) > -200;
      }
      std::vector<uint32_t> expected(n), order;
      std::iota(expected.begin(), expected.end(), 0u);
      std::erase_if(expected, [&](uint32_t i) { return !seen[i]; });
      std::stable_sort(expected.begin(), expected.end(),
                       [&](uint32_t a, uint32_t b) { return depth[a] < depth[b]; });
      for (const int threads : {1, 2, 3, 7}) {
        set_thread_count(threads);
        sort.sort(seen, depth, order);
        EXPECT_EQ(order, expected) << n << " by " << spread << ", " << threads << " threads";
      }
    }
  set_thread_count(before);
}

}  // namespace
}  // namespace effigy
