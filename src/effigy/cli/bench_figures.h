// How `effigy bench` shows its figures.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "bench/result.h"

namespace effigy {

// On standard output: a table, or one JSON object by name.
void print_figures(const std::vector<BenchResult>& figures, bool json);

// Frames a second in `repeats` batches of frames, drawn by draw(0), draw(1), ...
BenchResult frames_per_second(const std::string& name, int repeats,
                              const std::function<void(int)>& draw);

}  // namespace effigy
