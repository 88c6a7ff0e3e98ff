// effigy bench --only networks: the body's networks, in effigy-learn.

#include "bench/networks.h"
#include "effigy/base/log.h"
#include "effigy/cli/bench_figures.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"

namespace effigy {

int run_bench_learn(int argc, char** argv) {
  CLI::App app(
      "Measures the networks of body avatars: milliseconds for one frame, and the time of a bare\n"
      "loop of oneDNN's convolutions over the same layers as a share of it. Medians with their "
      "spread.\n\n"
      "example: effigy bench --only networks --json",
      "bench");
  std::string only = "networks", size = "small";
  int repeats = 9;
  CommonOptions common;
  app.add_option("--only", only, "networks")->check(CLI::IsMember({"networks"}));
  app.add_option("--size", size, "tiny, small or full (default small)")
      ->check(CLI::IsMember({"tiny", "small", "full"}));
  app.add_option("--repeats", repeats, "Timed runs of each figure (default 9)")
      ->check(CLI::Range(1, 1000));
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  log_info("measuring the body's networks");
  print_figures(bench_networks(size, repeats), common.json);
  return 0;
}

}  // namespace effigy
