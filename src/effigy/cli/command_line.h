// What all commands share: parsing with one sentence for bad usage, --threads, --seed, --json.
#pragma once

#include <CLI/CLI.hpp>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "effigy/base/json.h"

namespace effigy {

struct CommonOptions {
  int threads = 0;  // 0: all cores
  uint64_t seed = 1;
  bool json = false;
};

// Adds --threads and --quiet; and --seed, --json where asked for.
void add_common(CLI::App& app, CommonOptions& options, bool seed, bool json);
// Parses argv[1..]. False when --help was asked for and printed; throws Error (exit 2) for bad
// usage; applies --threads.
bool parse_command_line(CLI::App& app, int argc, char** argv, const CommonOptions& options);

// For options: a number from `least` on.
CLI::Validator at_least(int least);

// "x,y,z,..." as exactly `count` finite numbers; throws Error naming `option`.
std::vector<double> parse_numbers(const std::string& text, size_t count, const std::string& option);

// "name=value" each, values as JSON or, where they are none, as text; throws Error for others.
Json parse_assignments(const std::vector<std::string>& assignments);

// Results for machines on standard output.
void print_json(const Json& value);

}  // namespace effigy
