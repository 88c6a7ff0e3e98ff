#include "effigy/base/log.h"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include "effigy/base/progress.h"

namespace effigy {
namespace {

spdlog::logger& logger() {
  static const auto instance = [] {
    auto made = spdlog::stderr_logger_mt("effigy");
    made->set_pattern("%v");
    made->set_level(spdlog::level::info);
    return made;
  }();
  return *instance;
}

}  // namespace

void set_log_level(LogLevel level) {
  switch (level) {
    case LogLevel::kQuiet:
      logger().set_level(spdlog::level::off);
      break;
    case LogLevel::kWarning:
      logger().set_level(spdlog::level::warn);
      break;
    case LogLevel::kInfo:
      logger().set_level(spdlog::level::info);
      break;
    case LogLevel::kDebug:
      logger().set_level(spdlog::level::debug);
      break;
  }
}

void log_info(const std::string& line) {
  clear_progress_line();
  logger().info(line);
}

void log_warning(const std::string& line) {
  clear_progress_line();
  logger().warn("warning: {}", line);
}

void log_debug(const std::string& line) {
  clear_progress_line();
  logger().debug(line);
}

}  // namespace effigy
