// effigy eval, shared by both executables: only effigy-learn can run the networks of perceptual
// distances.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>

#include "effigy/cli/evaluation.h"
#include "effigy/cli/perceptual_files.h"
#include "effigy/cli/shard.h"

namespace effigy {

// The distances that the files make possible.
using DistanceSource = std::function<PerceptualDistances(const PerceptualFiles& files)>;

// --shard and --merge.
struct ShardOptions {
  std::string shard;
  bool merge = false;
  // Throws Error when both are given.
  Shard parse() const;
};
void add_shard_options(CLI::App& app, ShardOptions& options);

// --models, --lpips and the files of it.
void add_perceptual_options(CLI::App& app, PerceptualOptions& perceptual);

// effigy eval of a body avatar (in effigy-learn).
int evaluate_body_command(int argc, char** argv, const DistanceSource& source);

// effigy study body (in effigy-learn).
int run_study_body(int argc, char** argv, const PerceptualDistances& distances);

// Without a source the command is handed over to effigy-learn when there are such files.
int evaluate_command(int argc, char** argv, const DistanceSource& source);

}  // namespace effigy
