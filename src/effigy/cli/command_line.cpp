#include "effigy/cli/command_line.h"

#include <cmath>
#include <cstdio>
#include <sstream>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/threads.h"

namespace effigy {

void add_common(CLI::App& app, CommonOptions& options, bool seed, bool json) {
  app.add_option("--threads", options.threads, "Threads to use (default: all cores)")
      ->check(CLI::Range(1, 256));
  app.add_flag_callback(
      "--quiet", [] { set_log_level(LogLevel::kWarning); }, "Only warnings on standard error");
  if (seed) app.add_option("--seed", options.seed, "Seed of all random numbers (default 1)");
  if (json) app.add_flag("--json", options.json, "Print the result as JSON on standard output");
}

bool parse_command_line(CLI::App& app, int argc, char** argv, const CommonOptions& options) {
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp&) {
    std::fputs(app.help().c_str(), stdout);
    return false;
  } catch (const CLI::ParseError& problem) {
    std::string sentence = problem.what();
    for (char& c : sentence)
      if (c == '\n') c = ' ';
    throw Error(sentence + "; see 'effigy " + app.get_name() + " --help'.");
  }
  if (options.threads > 0) set_thread_count(options.threads);
  return true;
}

CLI::Validator at_least(int least) {
  return CLI::Validator(
      [least](std::string& text) {
        char* end = nullptr;
        const double value = std::strtod(text.c_str(), &end);
        if (text.empty() || *end != '\0' || !(value >= least))
          return text + " is not a number from " + std::to_string(least) + " on";
        return std::string();
      },
      ">=" + std::to_string(least));
}

std::vector<double> parse_numbers(const std::string& text, size_t count,
                                  const std::string& option) {
  std::vector<double> numbers;
  std::stringstream stream(text);
  std::string part;
  while (std::getline(stream, part, ',')) {
    char* end = nullptr;
    const double value = std::strtod(part.c_str(), &end);
    if (part.empty() || *end != '\0' || !std::isfinite(value)) break;
    numbers.push_back(value);
  }
  if (numbers.size() != count || !stream.eof())
    throw Error(option + " wants " + std::to_string(count) + " numbers separated by commas, not '" +
                text + "'.");
  return numbers;
}

Json parse_assignments(const std::vector<std::string>& assignments) {
  Json values = Json::object();
  for (const std::string& assignment : assignments) {
    const size_t equals = assignment.find('=');
    if (equals == std::string::npos)
      throw Error("--set wants name=value, not '" + assignment + "'.");
    const std::string value = assignment.substr(equals + 1);
    const Json parsed = Json::parse(value, nullptr, false);
    values[assignment.substr(0, equals)] = parsed.is_discarded() ? Json(value) : parsed;
  }
  return values;
}

void print_json(const Json& value) {
  std::printf("%s\n", value.dump(2, ' ', false, Json::error_handler_t::replace).c_str());
}

}  // namespace effigy
