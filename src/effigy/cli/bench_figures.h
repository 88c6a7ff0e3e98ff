// How `effigy bench` shows its figures.
#pragma once

#include <vector>

#include "bench/result.h"

namespace effigy {

// On standard output: a table, or one JSON object by name.
void print_figures(const std::vector<BenchResult>& figures, bool json);

}  // namespace effigy
