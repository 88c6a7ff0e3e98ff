#include "effigy/cli/bench_figures.h"

#include <cstdio>

#include "effigy/cli/command_line.h"

namespace effigy {

void print_figures(const std::vector<BenchResult>& figures, bool json) {
  if (!json) {
    std::printf("%-48s %12s %12s %12s %8s\n", "", "median", "min", "max", "threads");
    for (const BenchResult& f : figures)
      std::printf("%-48s %12.3f %12.3f %12.3f %8d\n", f.name.c_str(), f.median, f.min, f.max,
                  f.threads);
    return;
  }
  Json object = Json::object();
  for (const BenchResult& f : figures)
    object[f.name] = {{"median", f.median}, {"min", f.min}, {"max", f.max}, {"threads", f.threads}};
  print_json(object);
}

BenchResult frames_per_second(const std::string& name, int repeats,
                              const std::function<void(int)>& draw) {
  constexpr int kFrames = 20;
  for (int i = 0; i < 3; ++i) draw(i);
  std::vector<double> rates;
  for (int r = 0; r < repeats; ++r) {
    rates.push_back(kFrames / seconds_of([&] {
                      for (int i = 0; i < kFrames; ++i) draw(r * kFrames + i);
                    }));
  }
  return summarise(name, std::move(rates));
}

}  // namespace effigy
