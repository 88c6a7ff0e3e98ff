#include "effigy/body/stage_schedule.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <set>

#include "support.h"

namespace effigy {
namespace {

std::vector<int> numbers(int count, int first = 0) {
  std::vector<int> out(static_cast<size_t>(count));
  std::iota(out.begin(), out.end(), first);
  return out;
}

StageCapture capture_of(int frames, int cameras) {
  StageCapture capture;
  capture.frames.resize(static_cast<size_t>(frames));
  capture.cameras.resize(static_cast<size_t>(cameras));
  return capture;
}

TEST(StageSchedule, ShufflesArePermutations) {
  for (const uint64_t count : {1, 2, 3, 4, 5, 16, 17, 100, 1000, 4097})
    for (const uint64_t key : {0, 1, 77}) {
      std::vector<int> hit(count);
      for (uint64_t i = 0; i < count; ++i) {
        const uint64_t to = shuffled(i, count, key);
        ASSERT_LT(to, count);
        ++hit[to];
      }
      EXPECT_TRUE(std::all_of(hit.begin(), hit.end(), [](int n) { return n == 1; })) << count;
    }
  // Numbers beyond 32 bits come back in range too.
  const uint64_t many = uint64_t{1} << 40;
  EXPECT_LT(shuffled(many - 1, many, 5), many);
}

// Over many keys every place is as likely for every index: chi squared of a table of counts.
TEST(StageSchedule, ShufflesAreEven) {
  constexpr uint64_t kCount = 12, kKeys = 24000;
  std::vector<double> table(kCount * kCount);
  double neighbours = 0;  // how often two neighbours stay neighbours
  for (uint64_t key = 0; key < kKeys; ++key) {
    uint64_t before = kCount;
    for (uint64_t i = 0; i < kCount; ++i) {
      const uint64_t to = shuffled(i, kCount, 7919 * key + 3);
      ++table[i * kCount + to];
      if (before < kCount && to == before + 1) ++neighbours;
      before = to;
    }
  }
  const double expected = static_cast<double>(kKeys) / kCount;
  double chi = 0;
  for (const double n : table) chi += (n - expected) * (n - expected) / expected;
  EXPECT_LT(chi, 121 + 6 * 15.6);  // 11 x 11 degrees of freedom, standard deviation sqrt(2 n)
  // Of a random permutation: (n - 1) pairs, each followed by its successor with chance 1 / n.
  EXPECT_NEAR(neighbours / kKeys, (kCount - 1.0) / kCount, 0.05);
}

TEST(StageSchedule, AnEpochShowsEachPairOnceAndTheNextInAnotherOrder) {
  const StageCapture capture = capture_of(107, 25);
  const auto schedule = [&](uint64_t seed) {
    return StageSchedule::random(capture, numbers(7, 100), numbers(5, 20), seed);
  };
  const StageSchedule s = schedule(3);
  ASSERT_EQ(s.size(), 35u);
  std::vector<std::pair<int, int>> orders[2];
  for (uint64_t n = 0; n < 70; ++n) {
    const StageViewKey key = s.view(n);
    EXPECT_TRUE(key.frame >= 100 && key.frame < 107 && key.camera >= 20 && key.camera < 25);
    orders[n / 35].emplace_back(key.frame, key.camera);
  }
  EXPECT_NE(orders[0], orders[1]);
  EXPECT_EQ(std::set(orders[0].begin(), orders[0].end()).size(), 35u);
  EXPECT_EQ(std::set(orders[1].begin(), orders[1].end()).size(), 35u);
  // The same seed says the same again at any number, another seed does not.
  const StageSchedule again = schedule(3), other = schedule(4);
  int same = 0;
  for (uint64_t n = 0; n < 35; ++n) {
    EXPECT_EQ(again.view(n).frame, orders[0][n].first);
    EXPECT_EQ(again.view(n).camera, orders[0][n].second);
    same +=
        other.view(n).frame == orders[0][n].first && other.view(n).camera == orders[0][n].second;
  }
  EXPECT_LT(same, 8);
}

TEST(StageSchedule, GroupsShareAFrameAndNoCamera) {
  for (const int group : {2, 3, 4}) {
    const StageSchedule s =
        StageSchedule::random(capture_of(6, 8), numbers(6), numbers(8), 9, group);
    const uint64_t blocks = (8 + static_cast<uint64_t>(group) - 1) / static_cast<uint64_t>(group);
    ASSERT_EQ(s.size(), 6 * blocks * static_cast<uint64_t>(group));
    std::map<std::pair<int, int>, int> seen;
    for (uint64_t n = 0; n < s.size(); n += static_cast<uint64_t>(group)) {
      std::set<int> frames, cameras;
      for (uint64_t j = 0; j < static_cast<uint64_t>(group); ++j) {
        const StageViewKey key = s.view(n + j);
        frames.insert(key.frame);
        cameras.insert(key.camera);
        ++seen[{key.frame, key.camera}];
      }
      EXPECT_EQ(frames.size(), 1u);
      EXPECT_EQ(cameras.size(), static_cast<size_t>(group));
    }
    EXPECT_EQ(seen.size(), 48u);
    for (const auto& [key, count] : seen) EXPECT_LE(count, group == 3 ? 2 : 1);
  }
}

TEST(StageSchedule, InOrderAndEmpty) {
  const StageSchedule s = StageSchedule::in_order(capture_of(5, 4), {4, 2}, {1, 0, 3});
  ASSERT_EQ(s.size(), 6u);
  EXPECT_EQ(s.view(0).frame, 4);
  EXPECT_EQ(s.view(1).camera, 0);
  EXPECT_EQ(s.view(5).frame, 2);
  EXPECT_EQ(s.view(5).camera, 3);
  const StageCapture c = capture_of(2, 2);
  EXPECT_TRUE(
      test::contains(test::error_of([&] { StageSchedule::in_order(c, {}, {1}); }), "no view"));
  EXPECT_TRUE(
      test::contains(test::error_of([&] { StageSchedule::random(c, {1}, {}, 0); }), "no view"));
}

TEST(StageSchedule, OnlyCamerasThatSawAFrame) {
  StageCapture c = capture_of(5, 4);
  c.frames[0].cameras = {1, 3};
  c.frames[2].cameras = {0};
  c.frames[3].cameras = {2};
  const std::vector<int> frames = {0, 2, 3, 4}, cameras = {0, 1, 3};
  std::set<std::pair<int, int>> wanted;
  for (const int f : frames)
    for (const int k : c.cameras_of(f, cameras)) wanted.emplace(f, k);
  ASSERT_EQ(wanted.size(), 2u + 1u + 0u + 3u);
  for (const bool random : {false, true}) {
    const StageSchedule s = random ? StageSchedule::random(c, frames, cameras, 8)
                                   : StageSchedule::in_order(c, frames, cameras);
    ASSERT_EQ(s.size(), wanted.size());
    std::set<std::pair<int, int>> seen;
    for (uint64_t n = 0; n < s.size(); ++n) seen.emplace(s.view(n).frame, s.view(n).camera);
    EXPECT_EQ(seen, wanted);
  }
  // Two views a frame: a frame that one camera saw is shown twice by it.
  const StageSchedule pairs = StageSchedule::random(c, frames, cameras, 8, 2);
  EXPECT_EQ(pairs.size(), 2u + 2u + 4u);
  for (uint64_t n = 0; n < pairs.size(); ++n) {
    EXPECT_EQ(pairs.view(n).frame, pairs.view(n ^ 1).frame);
    EXPECT_TRUE(wanted.count({pairs.view(n).frame, pairs.view(n).camera}));
  }
}

}  // namespace
}  // namespace effigy
