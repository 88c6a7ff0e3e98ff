#include "effigy/base/threads.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <vector>

#include "effigy/base/error.h"

namespace effigy {
namespace {

// Sets the thread count for one test.
class Threads {
 public:
  explicit Threads(int count) : old_(thread_count()) { set_thread_count(count); }
  ~Threads() { set_thread_count(old_); }
  Threads(const Threads&) = delete;
  Threads& operator=(const Threads&) = delete;

 private:
  int old_;
};

TEST(ParallelFor, CoversEveryIndexOnce) {
  for (const int threads : {1, 2, 3, 7})
    for (const size_t count : {size_t{0}, size_t{1}, size_t{2}, size_t{7}, size_t{1000}})
      for (const size_t grain : {size_t{0}, size_t{1}, size_t{3}, size_t{5000}}) {
        const Threads set(threads);
        std::vector<std::atomic<int>> visits(count);
        std::mutex mutex;
        std::vector<std::array<size_t, 3>> ranges;
        parallel_for(count, grain, [&](size_t begin, size_t end, int slot) {
          for (size_t i = begin; i < end; ++i) ++visits[i];
          const std::lock_guard lock(mutex);
          ranges.push_back({static_cast<size_t>(slot), begin, end});
        });
        for (size_t i = 0; i < count; ++i) ASSERT_EQ(visits[i], 1) << i;
        ASSERT_LE(ranges.size(), static_cast<size_t>(threads));
        // Slots are 0, 1, ... and their ranges follow each other.
        std::sort(ranges.begin(), ranges.end());
        size_t at = 0;
        for (size_t k = 0; k < ranges.size(); ++k) {
          EXPECT_EQ(ranges[k][0], k);
          EXPECT_EQ(ranges[k][1], at);
          at = ranges[k][2];
          if (ranges.size() > 1) {
            EXPECT_GE(ranges[k][2] - ranges[k][1], std::max<size_t>(1, grain));
          }
        }
        EXPECT_EQ(at, count);
      }
}

TEST(ParallelFor, SplitIsTheSameEveryTime) {
  const Threads set(3);
  const auto split = [] {
    std::mutex mutex;
    std::vector<std::pair<int, size_t>> begins;
    parallel_for(1001, 10, [&](size_t begin, size_t, int slot) {
      const std::lock_guard lock(mutex);
      begins.emplace_back(slot, begin);
    });
    std::sort(begins.begin(), begins.end());
    return begins;
  };
  const auto first = split();
  for (int i = 0; i < 20; ++i) EXPECT_EQ(split(), first);
}

TEST(ParallelFor, ExceptionsComeBack) {
  for (const int threads : {1, 2, 4}) {
    const Threads set(threads);
    std::atomic<int> running{0};
    try {
      parallel_for(100, 1, [&](size_t begin, size_t, int) {
        ++running;
        const bool last =
            begin + 1 >= 100u * static_cast<unsigned>(threads - 1) / static_cast<unsigned>(threads);
        --running;
        if (last) throw Error("from a worker");
      });
      ADD_FAILURE() << "no exception with " << threads << " threads";
    } catch (const Error& error) {
      EXPECT_STREQ(error.what(), "from a worker");
    }
    EXPECT_EQ(running, 0);  // nobody works on after the exception has been rethrown
    // And the pool still works.
    std::atomic<size_t> sum{0};
    parallel_for(1000, 1, [&](size_t begin, size_t end, int) { sum += end - begin; });
    EXPECT_EQ(sum, 1000u);
  }
  EXPECT_THROW(run_slots(8,
                         [](int slot) {
                           if (slot == 5) throw std::runtime_error("other kind");
                         }),
               std::runtime_error);
}

TEST(ParallelFor, MayBeNested) {
  const Threads set(3);
  std::atomic<size_t> sum{0};
  parallel_for(20, 1, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i)
      parallel_for(50, 1, [&](size_t a, size_t b, int) { sum += b - a; });
  });
  EXPECT_EQ(sum, 1000u);
}

TEST(RunSlots, EachSlotOnce) {
  for (const int threads : {1, 2, 5}) {
    const Threads set(threads);
    for (const int slots : {0, 1, 2, 13}) {
      std::vector<std::atomic<int>> visits(13);
      run_slots(slots, [&](int slot) { ++visits[static_cast<size_t>(slot)]; });
      for (int i = 0; i < 13; ++i) EXPECT_EQ(visits[static_cast<size_t>(i)], i < slots ? 1 : 0);
    }
  }
}

TEST(OneThread, KeepsWorkOnItsThread) {
  const Threads set(3);
  std::thread beside([] {
    const OneThread alone;
    EXPECT_EQ(thread_count(), 1);
    const auto here = std::this_thread::get_id();
    run_slots(4, [&](int) { EXPECT_EQ(std::this_thread::get_id(), here); });
    { const OneThread inner; }
    EXPECT_EQ(thread_count(), 1);
  });
  EXPECT_EQ(thread_count(), 3);
  beside.join();
}

TEST(ThreadCount, Limits) {
  const Threads keep(2);
  EXPECT_EQ(thread_count(), 2);
  for (const int bad : {0, -1, 257, 1 << 30}) {
    EXPECT_THROW(set_thread_count(bad), Error);
    EXPECT_EQ(thread_count(), 2);
  }
  set_thread_count(256);
  EXPECT_EQ(thread_count(), 256);
}

}  // namespace
}  // namespace effigy
