#include "effigy/base/random.h"

#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/progress.h"

namespace effigy {
namespace {

TEST(Random, IsSplitMix64) {
  // Published test vector of SplitMix64 for the seed 1234567.
  Random random(1234567);
  for (const uint64_t expected : {uint64_t{6457827717110365317u}, uint64_t{3203168211198807973u},
                                  uint64_t{9817491932198370423u}, uint64_t{4593380528125082431u},
                                  uint64_t{16408922859458223821u}})
    EXPECT_EQ(random.bits(), expected);
}

TEST(Random, StateIsThreeIntegers) {
  Random random(7, 3);
  for (int i = 0; i < 100; ++i) random.normal();
  Random copy(random.seed(), random.stream());
  copy.set_counter(random.counter());
  for (int i = 0; i < 100; ++i) EXPECT_EQ(random.bits(), copy.bits());
}

TEST(Random, StreamsAndSeedsAreUnrelated) {
  for (const auto& [a, b] : {std::pair{Random(1, 0), Random(1, 1)},
                             {Random(1, 0), Random(2, 0)},
                             {Random(5, 2), Random(5, 3)}}) {
    Random first = a, second = b;
    double sum = 0.0;
    const int count = 20000;
    for (int i = 0; i < count; ++i) sum += (first.uniform() - 0.5) * (second.uniform() - 0.5);
    // The standard deviation of the mean of products is (1 / 12) / sqrt(count).
    EXPECT_LT(std::fabs(sum / count), 4.5 / 12.0 / std::sqrt(count));
  }
}

TEST(Random, UniformAndNormalMoments) {
  Random random(11);
  const int count = 200000;
  double sum = 0, squares = 0, normal = 0, normal_squares = 0, fourth = 0;
  for (int i = 0; i < count; ++i) {
    const double u = random.uniform();
    ASSERT_GE(u, 0.0);
    ASSERT_LT(u, 1.0);
    sum += u;
    squares += u * u;
    const double n = random.normal();
    ASSERT_TRUE(std::isfinite(n));
    normal += n;
    normal_squares += n * n;
    fourth += n * n * n * n;
  }
  EXPECT_NEAR(sum / count, 0.5, 0.003);
  EXPECT_NEAR(squares / count, 1.0 / 3.0, 0.003);
  EXPECT_NEAR(normal / count, 0.0, 0.01);
  EXPECT_NEAR(normal_squares / count, 1.0, 0.015);
  EXPECT_NEAR(fourth / count, 3.0, 0.12);
  for (int i = 0; i < 1000; ++i) {
    const double v = random.uniform(-3.0, 5.0);
    EXPECT_GE(v, -3.0);
    EXPECT_LT(v, 5.0);
  }
}

TEST(Random, BelowReachesEveryValue) {
  Random random(13);
  std::vector<int> hits(7);
  for (int i = 0; i < 7000; ++i) ++hits.at(random.below(7));
  for (const int count : hits) EXPECT_NEAR(count, 1000, 150);
  EXPECT_EQ(random.below(1), 0u);
}

TEST(Duration, ReadsWell) {
  EXPECT_EQ(format_duration(0.2), "0 s");
  EXPECT_EQ(format_duration(12.4), "12 s");
  EXPECT_EQ(format_duration(59.6), "1 min 00 s");
  EXPECT_EQ(format_duration(185), "3 min 05 s");
  EXPECT_EQ(format_duration(3720), "1 h 02 min");
}

TEST(Errors, ExitCodes) {
  EXPECT_EQ(Error("x").exit_code(), 2);
  EXPECT_EQ(Error("x", Blame::kResource).exit_code(), 1);
  EXPECT_EQ(Error("x", Blame::kInternal).exit_code(), 1);
  try {
    const int three = 3;
    EFFIGY_CHECK_EQ(three, 4);
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_EQ(error.blame(), Blame::kInternal);
    EXPECT_NE(std::string(error.what()).find("3 vs 4"), std::string::npos);
  }
}

TEST(InterruptDeathTest, FirstSignalIsNoticedSecondEnds) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        install_interrupt_handler();
        std::raise(SIGINT);
        if (!interrupt_requested()) std::exit(1);
        try {
          Progress progress("working", "it", 10);
          progress.update(1);
        } catch (const Interrupted&) {
          std::exit(7);
        }
        std::exit(2);
      },
      testing::ExitedWithCode(7), "");
  EXPECT_EXIT(
      {
        install_interrupt_handler();
        std::raise(SIGINT);
        std::raise(SIGINT);
      },
      testing::KilledBySignal(SIGINT), "");
}

}  // namespace
}  // namespace effigy
