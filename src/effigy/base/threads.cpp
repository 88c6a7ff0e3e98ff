#include "effigy/base/threads.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "effigy/base/error.h"

namespace effigy {
namespace {

std::atomic<int> g_threads{0};
thread_local int t_alone = 0;  // OneThreads that live here

// Calls body(slot) for every slot, on a team of so many threads.
//
// OpenMP's, because its threads wait awake for a while: the next piece of work begins within 3
// microseconds, where a sleeping thread takes 50 to 1000 (BENCHMARKS.md), and because libtorch
// works on the same team. Inside of other parallel work everything runs on the caller's thread.
void on_team(int threads, int slots, const std::function<void(int)>& body) {
#if defined(__SANITIZE_THREAD__)
  // The thread sanitizer does not see OpenMP's barriers.
  std::vector<std::thread> team;
  team.reserve(static_cast<size_t>(threads));
  for (int t = 0; t < threads; ++t)
    team.emplace_back([&, t] {
      for (int slot = t; slot < slots; slot += threads) body(slot);
    });
  for (std::thread& thread : team) thread.join();
#else
#pragma omp parallel for num_threads(threads) schedule(static, 1)
  for (int slot = 0; slot < slots; ++slot) body(slot);
#endif
}

}  // namespace

OneThread::OneThread() {
  ++t_alone;
}
OneThread::~OneThread() {
  --t_alone;
}

int thread_count() {
  if (t_alone > 0) return 1;
  int count = g_threads;
  if (count == 0) {
    count = std::clamp(static_cast<int>(std::thread::hardware_concurrency()), 1, 256);
    g_threads = count;
  }
  return count;
}

void set_thread_count(int count) {
  if (count < 1 || count > 256)
    throw Error("--threads must be between 1 and 256, got " + std::to_string(count) + ".");
  g_threads = count;
}

void run_slots(int slots, const std::function<void(int)>& body) {
  if (slots <= 1 || thread_count() == 1) {
    for (int slot = 0; slot < slots; ++slot) body(slot);
    return;
  }
  // Exceptions must not leave the team.
  std::mutex mutex;
  std::exception_ptr first;
  on_team(thread_count(), slots, [&](int slot) {
    try {
      body(slot);
    } catch (...) {
      const std::lock_guard lock(mutex);
      if (!first) first = std::current_exception();
    }
  });
  if (first) std::rethrow_exception(first);
}

void parallel_for(size_t count, size_t grain,
                  const std::function<void(size_t, size_t, int)>& body) {
  if (count == 0) return;
  const size_t most = std::max<size_t>(1, count / std::max<size_t>(1, grain));
  const size_t slots = std::min<size_t>(static_cast<size_t>(thread_count()), most);
  run_slots(static_cast<int>(slots), [&](int slot) {
    const size_t begin = count * static_cast<size_t>(slot) / slots;
    const size_t end = count * static_cast<size_t>(slot + 1) / slots;
    body(begin, end, slot);
  });
}

}  // namespace effigy
