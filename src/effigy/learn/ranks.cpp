#include "effigy/learn/ranks.h"

#include <algorithm>
#include <cstdlib>

namespace effigy {
namespace {

constexpr int kInterrupted = 130;

}  // namespace

std::vector<double> Ranks::gather(std::span<const double> values) {
  return {values.begin(), values.end()};
}

void Ranks::add_part(std::span<const float> values, std::vector<float>& sum) {
  if (sum.empty()) return sum.assign(values.begin(), values.end());
  EFFIGY_CHECK_EQ(sum.size(), values.size());
  for (size_t i = 0; i < sum.size(); ++i) sum[i] += values[i];
}

void Ranks::gather_parts(std::span<const float> sum, std::span<float> values) {
  EFFIGY_CHECK_EQ(sum.size(), values.size());
  std::copy(sum.begin(), sum.end(), values.begin());
}

void Ranks::abort(int code) {
  std::exit(code);
}

Ranks& one_process() {
  static Ranks one;
  return one;
}

int job_size() {
  const auto number = [](const char* name) {
    const char* text = std::getenv(name);
    return text == nullptr ? 0 : std::atoi(text);
  };
  int size = number("OMPI_COMM_WORLD_SIZE");  // mpirun of OpenMPI
  if (size < 1) size = number("PMI_SIZE");    // MPICH, Intel MPI, srun --mpi=pmi2
  if (size < 1 && std::getenv("PMIX_RANK") != nullptr)
    size = number("SLURM_STEP_NUM_TASKS");  // srun --mpi=pmix
  return std::max(size, 1);
}

RankFailed::RankFailed(int rank, int code)
    : Error("Process " + std::to_string(rank) + " of this job has failed; see its message.",
            code == 2 ? Blame::kInput : Blame::kResource),
      code_(code) {}

void together(Ranks& ranks, const std::function<void()>& work) {
  if (ranks.size() == 1) return work();
  std::exception_ptr problem;
  double code = 0;
  try {
    work();
  } catch (const Interrupted&) {
    problem = std::current_exception();
    code = kInterrupted;
  } catch (const Error& error) {
    problem = std::current_exception();
    code = error.exit_code();
  } catch (...) {
    problem = std::current_exception();
    code = 1;
  }
  const std::vector<double> codes = ranks.gather({&code, 1});
  const auto first = std::find_if(codes.begin(), codes.end(), [](double c) { return c != 0; });
  ranks.failed_ = first == codes.end() ? -1 : static_cast<int>(first - codes.begin());
  if (ranks.failed_ < 0) return;
  if (std::count(codes.begin(), codes.end(), kInterrupted) > 0) throw Interrupted();
  if (problem) std::rethrow_exception(problem);
  throw RankFailed(ranks.failed_, static_cast<int>(*first));
}

void check_alike(Ranks& ranks, uint64_t number, const std::string& what) {
  const double halves[2] = {static_cast<double>(number >> 32),
                            static_cast<double>(number & 0xffffffffU)};
  const std::vector<double> all = ranks.gather(halves);
  together(ranks, [&] {
    for (size_t r = 1; r < static_cast<size_t>(ranks.size()); ++r)
      if (all[2 * r] != all[0] || all[2 * r + 1] != all[1])
        throw Error("Processes 0 and " + std::to_string(r) + " " + what);
  });
}

}  // namespace effigy
