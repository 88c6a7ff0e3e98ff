#include "effigy/cli/training_plots.h"

#include "effigy/base/log.h"

namespace effigy {

void add_training_plots(Report& report, const Json& training,
                        const std::vector<std::string>& losses, const std::string& heldout,
                        const std::vector<std::pair<std::string, std::string>>& more) {
  LinePlot plot{"Losses", "iteration", "unweighted value", {}, true, false};
  for (const std::string& name : losses) {
    Series s{name, {}, {}};
    for (const Json& entry : training.value("losses", Json::array()))
      if (entry.contains(name)) {
        s.xs.push_back(entry.value("iteration", 0.0));
        s.ys.push_back(entry.value(name, 0.0));
      }
    if (!s.xs.empty()) plot.series.push_back(std::move(s));
  }
  report.add_line_plot(plot);
  LinePlot scores{"Held-out PSNR (sample)", "iteration", "dB", {}, false, false};
  Series s{heldout, {}, {}};
  for (const Json& entry : training.value("heldout", Json::array())) {
    s.xs.push_back(entry.value("iteration", 0.0));
    s.ys.push_back(entry.value("psnr", 0.0));
  }
  if (s.xs.size() > 1) {
    scores.series.push_back(std::move(s));
    report.add_line_plot(scores);
  }
  std::vector<std::pair<std::string, std::string>> items = {
      {"iterations", std::to_string(training.value("iterations", 0))},
      {"time", format("{:.0f} s", training.value("seconds", 0.0))},
      {"rate", format("{:.2f} iterations/s", training.value("iterations_per_second", 0.0))},
      {"peak memory", format("{:.0f} MiB", training.value("peak_memory_bytes", 0.0) / (1 << 20))},
      {"threads", std::to_string(training.value("threads", 0))}};
  items.insert(items.end(), more.begin(), more.end());
  report.add_key_values(items);
}

void add_provenance(Report& report, const Json& info,
                    const std::vector<std::pair<std::string, std::string>>& more) {
  const Json provenance = info.value("provenance", Json::object());
  std::vector<std::pair<std::string, std::string>> items;
  for (const char* name : {"source", "licence", "consent", "rig", "rig_licence", "made_by"})
    items.emplace_back(name, provenance.value(name, std::string("not stated")));
  items.insert(items.end(), more.begin(), more.end());
  report.add_key_values(items);
  report.add_code(info.value("settings", Json::object()).dump(1));
  report.add_note(
      "All renders on this page are synthetic images of a person. Make and show avatars of real "
      "people only with their consent.");
}

}  // namespace effigy
