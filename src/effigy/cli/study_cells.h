// Cells of a study: rows of a table that differ in their settings, each kept on disk once it is
// done.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/base/json.h"

namespace effigy {

// One row: the settings that differ from the first row's.
struct Cell {
  std::string name;
  Json changes;
};

// The cells named in `only` (all when it is empty), and always the first. Throws Error for a name
// that is none, naming `list`, the command that prints them.
std::vector<Cell> chosen_cells(const std::vector<Cell>& all, const std::vector<std::string>& only,
                               const std::string& list);

// What `make` returns, or what it returned before for the same key in the same folder.
Json kept_cell(const Path& folder, const Json& key, const std::function<Json()>& make);

// Folder of a cell below that of the study.
std::string folder_name(const Cell& cell);

}  // namespace effigy
