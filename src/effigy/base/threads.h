// The one thread pool. Work is split statically, so the same thread count gives the same bits.
#pragma once

#include <cstddef>
#include <functional>

namespace effigy {

// Number of slots that parallel work is split into; default: the cores of this machine. 1 where a
// OneThread lives.
int thread_count();
// Sets it (1..256). Results of order-dependent sums may change with it, never from run to run.
void set_thread_count(int count);

// While it lives, all work of the thread that made it stays on that thread: for work beside another
// thread that has the cores.
class OneThread {
 public:
  OneThread();
  ~OneThread();
  OneThread(const OneThread&) = delete;
  OneThread& operator=(const OneThread&) = delete;
};

// Calls body(slot) for slot = 0..slots-1, each exactly once, possibly at the same time. The first
// exception thrown by a body is rethrown after all have ended.
void run_slots(int slots, const std::function<void(int)>& body);

// Splits [0, count) into thread_count() contiguous ranges (at least `grain` long) and calls
// body(begin, end, slot) for each.
void parallel_for(size_t count, size_t grain,
                  const std::function<void(size_t begin, size_t end, int slot)>& body);

}  // namespace effigy
