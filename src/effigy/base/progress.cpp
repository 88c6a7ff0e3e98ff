#include "effigy/base/progress.h"

#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>

#include "effigy/base/error.h"
#include "effigy/base/log.h"

namespace effigy {
namespace {

std::atomic<bool> g_interrupted{false};
std::atomic<bool> g_line_open{false};

void on_signal(int signal) {
  if (g_interrupted.exchange(true)) {
    std::signal(signal, SIG_DFL);
    std::raise(signal);
  }
}

bool on_terminal() {
  static const bool terminal = isatty(STDERR_FILENO) != 0;
  return terminal;
}

}  // namespace

void install_interrupt_handler() {
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
}

bool interrupt_requested() {
  return g_interrupted.load(std::memory_order_relaxed);
}

void throw_if_interrupted() {
  if (interrupt_requested()) throw Interrupted();
}

void clear_progress_line() {
  if (g_line_open.exchange(false)) std::fputs("\r\033[K", stderr);
}

std::string format_duration(double seconds) {
  const auto total = static_cast<int64_t>(seconds + 0.5);
  if (total < 60) return format("{} s", total);
  if (total < 3600) return format("{} min {:02} s", total / 60, total % 60);
  return format("{} h {:02} min", total / 3600, total / 60 % 60);
}

Progress::Progress(std::string what, std::string unit, int64_t total, int64_t start)
    : what_(std::move(what)),
      unit_(std::move(unit)),
      total_(total),
      start_(start),
      done_(start),
      begin_(std::chrono::steady_clock::now()),
      last_(begin_) {}

Progress::~Progress() {
  // An error is on its way: its sentence is all that should be read.
  if (std::uncaught_exceptions() > 0) {
    clear_progress_line();
  } else {
    finish();
  }
}

double Progress::seconds() const {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
}

void Progress::update(int64_t done, const std::string& detail) {
  throw_if_interrupted();
  done_ = done;
  if (!detail.empty()) detail_ = detail;
  const auto now = std::chrono::steady_clock::now();
  if (std::chrono::duration<double>(now - last_).count() < (on_terminal() ? 0.2 : 10.0)) return;
  last_ = now;
  print(false);
}

void Progress::finish() {
  if (finished_) return;
  finished_ = true;
  print(true);
}

void Progress::print(bool final_line) {
  const double elapsed = seconds();
  const double rate = elapsed > 0 ? static_cast<double>(done_ - start_) / elapsed : 0.0;
  std::string line = what_ + ": " + std::to_string(done_);
  if (total_ > 0) line += "/" + std::to_string(total_);
  line += format(" {} ({:.1f}/s)", unit_, rate);
  if (final_line) {
    line += " in " + format_duration(elapsed);
  } else if (total_ > 0 && rate > 0) {
    line += ", " + format_duration(static_cast<double>(total_ - done_) / rate) + " left";
  }
  if (!detail_.empty()) line += ", " + detail_;
  if (on_terminal() && !final_line) {
    std::fprintf(stderr, "\r\033[K%s", line.c_str());
    std::fflush(stderr);
    g_line_open = true;
  } else {
    log_info(line);
  }
}

}  // namespace effigy
