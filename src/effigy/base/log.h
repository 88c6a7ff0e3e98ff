// Log lines on standard error (standard output carries results only).
#pragma once

#include <spdlog/fmt/fmt.h>

#include <string>
#include <utility>

namespace effigy {

enum class LogLevel { kQuiet, kWarning, kInfo, kDebug };

// Process-wide; default kInfo.
void set_log_level(LogLevel level);

void log_info(const std::string& line);
void log_warning(const std::string& line);
void log_debug(const std::string& line);

// fmt::format without naming fmt everywhere: format("{} frames", n).
template <typename... Args>
std::string format(fmt::format_string<Args...> pattern, Args&&... args) {
  return fmt::format(pattern, std::forward<Args>(args)...);
}

}  // namespace effigy
