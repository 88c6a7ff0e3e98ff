#include "effigy/learn/mpi_ranks.h"

#include <mpi.h>

#include <algorithm>
#include <cstdlib>
#include <limits>

namespace effigy {
namespace {

int world_rank() {
  int rank = 0;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  return rank;
}
int world_size() {
  int size = 1;
  MPI_Comm_size(MPI_COMM_WORLD, &size);
  return size;
}

// What MPI reports as an error ends the job (its default handler), so results are not looked at.
class MpiRanks : public Ranks {
 public:
  MpiRanks() : Ranks(world_rank(), world_size()) {}
  ~MpiRanks() override { MPI_Finalize(); }

  std::vector<double> gather(std::span<const double> values) override {
    const int count = static_cast<int>(values.size());
    std::vector<double> all(values.size() * static_cast<size_t>(size()));
    MPI_Allgather(values.data(), count, MPI_DOUBLE, all.data(), count, MPI_DOUBLE, MPI_COMM_WORLD);
    return all;
  }

  void add_part(std::span<const float> values, std::vector<float>& sum) override {
    split(values.size());
    const auto mine = static_cast<size_t>(counts_[static_cast<size_t>(rank())]);
    const std::vector<int> received(counts_.size(), static_cast<int>(mine));
    std::vector<int> places(counts_.size());
    for (size_t r = 0; r < places.size(); ++r) places[r] = static_cast<int>(r * mine);
    parts_.resize(mine * counts_.size());
    MPI_Alltoallv(values.data(), counts_.data(), starts_.data(), MPI_FLOAT, parts_.data(),
                  received.data(), places.data(), MPI_FLOAT, MPI_COMM_WORLD);
    for (size_t r = 0; r < counts_.size(); ++r)
      Ranks::add_part({parts_.data() + r * mine, mine}, sum);
  }

  void gather_parts(std::span<const float> sum, std::span<float> values) override {
    split(values.size());
    EFFIGY_CHECK_EQ(sum.size(), counts_[static_cast<size_t>(rank())]);
    MPI_Allgatherv(sum.data(), static_cast<int>(sum.size()), MPI_FLOAT, values.data(),
                   counts_.data(), starts_.data(), MPI_FLOAT, MPI_COMM_WORLD);
  }

  void abort(int code) override {
    MPI_Abort(MPI_COMM_WORLD, code);
    std::_Exit(code);
  }

 private:
  // Which part of so many numbers each process owns.
  void split(size_t count) {
    EFFIGY_CHECK(count <= static_cast<size_t>(std::numeric_limits<int>::max()));
    const auto ranks = static_cast<size_t>(size());
    counts_.resize(ranks);
    starts_.resize(ranks);
    for (size_t r = 0; r < ranks; ++r) {
      starts_[r] = static_cast<int>(count * r / ranks);
      counts_[r] = static_cast<int>(count * (r + 1) / ranks) - starts_[r];
    }
  }

  std::vector<int> counts_, starts_;
  std::vector<float> parts_;
};

}  // namespace

std::unique_ptr<Ranks> start_ranks() {
  if (job_size() <= 1) return std::make_unique<Ranks>();
  int provided = 0;
  // Threads compute; only the main one talks.
  MPI_Init_thread(nullptr, nullptr, MPI_THREAD_FUNNELED, &provided);
  return std::make_unique<MpiRanks>();
}

}  // namespace effigy
