// One figure of `effigy bench`.
#pragma once

#include <string>

namespace effigy {

struct BenchResult {
  std::string name;  // key of `effigy bench --json`
  double median = 0, min = 0, max = 0;
  int threads = 1;
};

}  // namespace effigy
