#include "effigy/learn/ranks.h"

#include <cstdlib>

#include "support.h"

namespace effigy {
namespace {

TEST(Ranks, OneProcessAddsInTurn) {
  Ranks& one = one_process();
  EXPECT_EQ(one.rank(), 0);
  EXPECT_EQ(one.size(), 1);
  const std::vector<float> big = {1e8f, 1}, small = {-1, 2};
  std::vector<float> sum;
  one.add_part(big, sum);
  one.add_part(small, sum);
  one.add_part(small, sum);
  std::vector<float> whole(2);
  one.gather_parts(sum, whole);
  EXPECT_EQ(whole, (std::vector<float>{(1e8f + -1.0f) + -1.0f, 5}));
  EXPECT_EQ(one.gather(std::vector<double>{1, 2}), (std::vector<double>{1, 2}));
}

// Two processes of which the other one is known: what it says in gather() is prepared.
class WithAnother : public Ranks {
 public:
  explicit WithAnother(int rank) : Ranks(rank, 2) {}
  std::vector<double> other;
  std::vector<double> gather(std::span<const double> values) override {
    std::vector<double> both(values.begin(), values.end());
    both.insert(rank() == 0 ? both.end() : both.begin(), other.begin(), other.end());
    return both;
  }
};

TEST(Ranks, AFailureIsEverybodys) {
  WithAnother first(0), second(1);
  first.other = second.other = {0};
  together(first, [] {});
  EXPECT_EQ(first.failed(), -1);
  const auto fail = [] { throw Error("mine"); };
  EXPECT_EQ(test::error_of([&] { together(second, fail); }), "mine");
  EXPECT_EQ(second.failed(), 1);
  first.other = {2};
  try {
    together(first, [] {});
    ADD_FAILURE();
  } catch (const RankFailed& elsewhere) {
    EXPECT_EQ(elsewhere.code(), 2);
  }
  EXPECT_EQ(first.failed(), 1);
  EXPECT_EQ(test::error_of([&] { together(first, fail); }), "mine");
  EXPECT_EQ(first.failed(), 0);  // which speaks for both
  first.other = {130};
  EXPECT_THROW(together(first, [] {}), Interrupted);
  first.other = {0};
  together(first, [] {});
  EXPECT_EQ(first.failed(), -1);
}

TEST(Ranks, DifferentNumbersAreFound) {
  const uint64_t number = 0x123456789abcdef0;
  // The halves of the other's number, then whether it has thrown: one answer has to do for both.
  class Different : public WithAnother {
   public:
    using WithAnother::WithAnother;
    std::vector<double> gather(std::span<const double> values) override {
      other = values.size() == 2 ? std::vector<double>{1, 2} : std::vector<double>{2};
      return WithAnother::gather(values);
    }
  } ranks(0);
  EXPECT_EQ(test::error_of([&] { check_alike(ranks, number, "differ."); }),
            "Processes 0 and 1 differ.");
  check_alike(one_process(), number, "differ.");
}

TEST(Ranks, LaunchersSayHowManyThereAre) {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK", "SLURM_STEP_NUM_TASKS"})
    unsetenv(name);
  EXPECT_EQ(job_size(), 1);
  setenv("SLURM_STEP_NUM_TASKS", "8", 1);
  EXPECT_EQ(job_size(), 1);  // nobody speaks MPI
  setenv("PMIX_RANK", "3", 1);
  EXPECT_EQ(job_size(), 8);
  setenv("OMPI_COMM_WORLD_SIZE", "4", 1);
  EXPECT_EQ(job_size(), 4);
}

}  // namespace
}  // namespace effigy
