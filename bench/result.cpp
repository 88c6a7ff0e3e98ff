#include "bench/result.h"

#include <algorithm>
#include <chrono>

#include "effigy/base/threads.h"

namespace effigy {

BenchResult summarise(const std::string& name, std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return {name, values[values.size() / 2], values.front(), values.back(), thread_count()};
}

double seconds_of(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace effigy
