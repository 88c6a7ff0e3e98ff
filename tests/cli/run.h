// Runs the real program and keeps what it says.
#pragma once

#include <sys/wait.h>

#include <cstdlib>
#include <string>

#include "effigy/base/file.h"
#include "support.h"

namespace effigy::test {

struct Outcome {
  int code = -1;
  std::string out, err;
  // One line on standard error that starts with "effigy: ".
  bool one_sentence() const {
    return err.rfind("effigy: ", 0) == 0 && err.find('\n') == err.size() - 1;
  }
};

inline Outcome run_command(const std::string& command) {
  ScratchFolder scratch;
  const int status = std::system((command + " >" + (scratch / "out").string() + " 2>" +
                                  (scratch / "err").string() + " </dev/null")
                                     .c_str());
  Outcome outcome;
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  outcome.out = read_text(scratch / "out");
  outcome.err = read_text(scratch / "err");
  return outcome;
}

inline Outcome run(const std::string& arguments) {
  return run_command(EFFIGY_BINARY_DIR "/bin/effigy " + arguments);
}

}  // namespace effigy::test
