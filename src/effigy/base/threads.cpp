#include "effigy/base/threads.h"

#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/partitioner.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <memory>
#include <mutex>
#include <thread>

#include "effigy/base/error.h"

namespace effigy {
namespace {

int g_threads = 0;
std::mutex g_arena_mutex;
std::unique_ptr<tbb::global_control> g_control;  // allows more threads than cores when asked for
std::unique_ptr<tbb::task_arena> g_arena;

tbb::task_arena& arena() {
  const std::lock_guard lock(g_arena_mutex);
  if (!g_arena) {
    const int threads = thread_count();
    g_control = std::make_unique<tbb::global_control>(tbb::global_control::max_allowed_parallelism,
                                                      static_cast<size_t>(threads));
    g_arena = std::make_unique<tbb::task_arena>(threads);
  }
  return *g_arena;
}

}  // namespace

int thread_count() {
  if (g_threads == 0)
    g_threads = std::clamp(static_cast<int>(std::thread::hardware_concurrency()), 1, 256);
  return g_threads;
}

void set_thread_count(int count) {
  if (count < 1 || count > 256)
    throw Error("--threads must be between 1 and 256, got " + std::to_string(count) + ".");
  const std::lock_guard lock(g_arena_mutex);
  g_threads = count;
  g_arena.reset();
  g_control.reset();
}

void run_slots(int slots, const std::function<void(int)>& body) {
  if (slots <= 1 || thread_count() == 1) {
    for (int slot = 0; slot < slots; ++slot) body(slot);
    return;
  }
  arena().execute([&] {
    tbb::parallel_for(
        0, slots, 1, [&](int slot) { body(slot); }, tbb::static_partitioner());
  });
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
