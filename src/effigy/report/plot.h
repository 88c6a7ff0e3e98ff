// Line plots as SVG.
#pragma once

#include <string>
#include <vector>

#include "effigy/report/report.h"

namespace effigy::detail {

// The <svg> element: axes, ticks, grid, lines. Colours come from the report's style sheet; title,
// y label and legend stand above it in the page.
std::string plot_svg(const LinePlot& plot);

// Round numbers (1, 2, 5 times a power of ten) that divide [low, high] into about `count` steps.
std::vector<double> round_ticks(double low, double high, int count);
// "12 000", "0.05", "1e-07".
std::string tick_label(double value);

}  // namespace effigy::detail
