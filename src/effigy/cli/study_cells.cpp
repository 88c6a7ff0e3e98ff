#include "effigy/cli/study_cells.h"

#include <algorithm>
#include <cctype>

#include "effigy/base/error.h"

namespace effigy {

std::vector<Cell> chosen_cells(const std::vector<Cell>& all, const std::vector<std::string>& only,
                               const std::string& list) {
  std::vector<Cell> cells;
  for (const std::string& name : only)
    if (std::none_of(all.begin(), all.end(), [&](const Cell& c) { return c.name == name; }))
      throw Error("--cell '" + name + "' is unknown; run '" + list + "'.");
  for (const Cell& cell : all)
    if (only.empty() || &cell == all.data() ||
        std::find(only.begin(), only.end(), cell.name) != only.end())
      cells.push_back(cell);
  return cells;
}

Json kept_cell(const Path& folder, const Json& key, const std::function<Json()>& make) {
  const Path done = folder / "cell.json";
  if (std::filesystem::exists(done)) {
    const Json before = read_json(done);
    if (before.contains("key") && before["key"] == key) return before.at("metrics");
  }
  const Json metrics = make();
  write_json(done, {{"key", key}, {"metrics", metrics}});
  return metrics;
}

std::string folder_name(const Cell& cell) {
  std::string name = cell.name;
  for (char& c : name)
    if (!std::isalnum(static_cast<unsigned char>(c))) c = '-';
  return name;
}

}  // namespace effigy
