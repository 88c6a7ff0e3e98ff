// One figure of `effigy bench`.
#pragma once

#include <functional>
#include <string>
#include <vector>

namespace effigy {

struct BenchResult {
  std::string name;  // key of `effigy bench --json`
  double median = 0, min = 0, max = 0;
  int threads = 1;
};

// Median and ends of `values`, at least one.
BenchResult summarise(const std::string& name, std::vector<double> values);

// How long `work` takes by the clock.
double seconds_of(const std::function<void()>& work);

}  // namespace effigy
