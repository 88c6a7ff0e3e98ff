// Processes that train one model together, each on data of its own. What they add up is added in
// one fixed order, so that N processes get the bits that one would get from all their data.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "effigy/base/error.h"

namespace effigy {

// One of `size()` processes, numbered from 0. This class is the only process there is;
// learn/mpi_ranks.h makes those of an MPI job. All functions but the first three are collective:
// every process calls them in the same order.
class Ranks {
 public:
  Ranks() = default;
  virtual ~Ranks() = default;
  Ranks(const Ranks&) = delete;
  Ranks& operator=(const Ranks&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }
  // The process whose error the last together() ended with, and which says so; -1: none.
  int failed() const { return failed_; }

  // Numbers of all processes, of rank 0 first; each gives equally many.
  virtual std::vector<double> gather(std::span<const double> values);
  // Of arrays that are equally long on all processes each keeps the sum of one part: `sum` (empty
  // at first: starts as the values of rank 0) has the values of rank 0 added, then of rank 1, ...
  virtual void add_part(std::span<const float> values, std::vector<float>& sum);
  // From the parts to the whole array, on every process.
  virtual void gather_parts(std::span<const float> sum, std::span<float> values);
  // Ends all processes at once, when they cannot be asked any more.
  [[noreturn]] virtual void abort(int code);

 protected:
  Ranks(int rank, int size) : rank_(rank), size_(size) {}

 private:
  friend void together(Ranks& ranks, const std::function<void()>& work);
  int rank_ = 0, size_ = 1, failed_ = -1;
};

// The only process.
Ranks& one_process();

// How many processes the launcher of this job (mpirun, srun) says it has started, by the variables
// that it sets; 1 without a launcher.
int job_size();

// Thrown where another process has failed, with that one's exit code.
class RankFailed : public Error {
 public:
  RankFailed(int rank, int code);
  int code() const { return code_; }

 private:
  int code_;
};

// Does `work`, which must not be collective, on every process, and throws on every process when it
// threw on one: there what was thrown, elsewhere RankFailed. Interrupted is thrown by all.
void together(Ranks& ranks, const std::function<void()>& work);

// Throws Error (on all processes) when they do not hold the same number; `what` says what differs.
void check_alike(Ranks& ranks, uint64_t number, const std::string& what);

}  // namespace effigy
