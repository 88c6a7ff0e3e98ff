// The main function that both executables share.
#pragma once

#include <string>
#include <vector>

namespace effigy {

struct Command {
  const char* name;
  int (*run)(int argc, char** argv);
  const char* summary;
};

// Runs the command named by argv[1]; turns Error into one sentence on standard error and an exit
// code (2 for usage or input, 1 for the rest, 130 when interrupted). Standard output carries
// results only.
int run_program(const std::vector<Command>& commands, int argc, char** argv);

// The exit code of the exception that is being handled; says its sentence on standard error, unless
// another process of the job does.
int complain_of_exception(bool aloud = true);

// Replaces this process by effigy-learn, which stands beside it, with the same arguments. Throws
// Error when it cannot be started.
int hand_over(int argc, char** argv);
// Whether effigy-learn is there.
bool can_hand_over();

}  // namespace effigy
