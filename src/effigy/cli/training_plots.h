// Sections that the reports of heads and bodies share.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "effigy/base/json.h"
#include "effigy/report/report.h"

namespace effigy {

// Curves, time and memory from training.json; `losses`: names of those drawn; `heldout`: what the
// held-out curve is called.
void add_training_plots(Report& report, const Json& training,
                        const std::vector<std::string>& losses, const std::string& heldout,
                        const std::vector<std::pair<std::string, std::string>>& more = {});

// Source, licence, consent and settings from avatar.json, and what has to be said of renders.
void add_provenance(Report& report, const Json& info,
                    const std::vector<std::pair<std::string, std::string>>& more);

}  // namespace effigy
