// Progress of long work: one rewritten line with rate and time left on a terminal, a plain line
// every few seconds otherwise. Also the place where long work notices Ctrl-C.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace effigy {

class Progress {
 public:
  // `what`: e.g. "training"; `unit`: e.g. "it"; `total` 0 when unknown; `start`: steps already
  // done.
  Progress(std::string what, std::string unit, int64_t total, int64_t start = 0);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // Sets the number of finished steps; `detail` is appended to the line (loss, PSNR, ...).
  // Throws Interrupted after Ctrl-C.
  void update(int64_t done, const std::string& detail = {});
  // Prints the final line once. Called by the destructor if not called before.
  void finish();
  double seconds() const;

 private:
  void print(bool final_line);
  std::string what_, unit_, detail_;
  int64_t total_, start_, done_;
  std::chrono::steady_clock::time_point begin_, last_;
  bool finished_ = false;
};

// Installs the SIGINT/SIGTERM handler; the first signal makes interrupt_requested() true, a second
// one ends the process.
void install_interrupt_handler();
bool interrupt_requested();
// Throws Interrupted if a signal has come.
void throw_if_interrupted();

// Ends a half-drawn progress line before something else is printed.
void clear_progress_line();

// "1 h 02 min", "3 min 05 s", "12 s".
std::string format_duration(double seconds);

}  // namespace effigy
