// Detection, following and smoothing of faces.
#include "effigy/track/face.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <optional>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/image/video.h"
#include "effigy/track/mediapipe.h"
#include "effigy/track/observe.h"

namespace effigy {
namespace {

FaceBox box(double x, double y, double side, double score) {
  FaceBox made;
  made.x = x;
  made.y = y;
  made.width = made.height = side;
  made.score = score;
  return made;
}

TEST(Overlaps, AreAveragedByScore) {
  const auto kept =
      suppress_overlaps({box(10, 10, 20, 0.6), box(100, 0, 20, 0.7), box(12, 10, 20, 0.9)}, 0.3);
  ASSERT_EQ(kept.size(), 2U);
  EXPECT_EQ(kept[0].score, 0.9);
  EXPECT_NEAR(kept[0].x, (0.6 * 10 + 0.9 * 12) / 1.5, 1e-12);
  EXPECT_NEAR(kept[1].x, 100, 1e-12);
}

TEST(Overlaps, BoxesWithoutAreaEnd) {
  EXPECT_TRUE(suppress_overlaps({}, 0.3).empty());
  EXPECT_LE(suppress_overlaps({box(1, 1, 0, 0.9), box(2, 2, 0, 0.8)}, 0.3).size(), 2U);
}

TEST(PointNumbers, AreInRange) {
  for (const int point : mediapipe::kBlendshapeInput) EXPECT_LT(point, 478);
  EXPECT_EQ(mediapipe::kBlendshapeNames[25], "jawOpen");
  EXPECT_EQ(mediapipe::kBlendshapeNames[51], "noseSneerRight");
}

std::vector<FaceObservation> still_face(int frames, double noise, uint64_t seed) {
  Random random(seed);
  std::vector<FaceObservation> seen(frames);
  for (FaceObservation& frame : seen) {
    frame.found = true;
    for (int i = 0; i < 20; ++i) {
      frame.landmarks.push_back(static_cast<float>(100 + 5 * i + noise * random.normal()));
      frame.landmarks.push_back(static_cast<float>(80 + 3 * i + noise * random.normal()));
      frame.landmarks.push_back(0.0f);
    }
  }
  return seen;
}

TEST(Smoothing, CalmsNoiseWithoutDelayAndKeepsBlinks) {
  auto seen = still_face(41, 0.3, 1);
  // A blink: one point jumps by 8 pixels for two frames.
  for (const int f : {20, 21}) seen[f].landmarks[1] += 8;
  const auto raw = seen;
  smooth_landmarks(seen, 1.0, 2.0);
  const auto spread = [](const std::vector<FaceObservation>& frames) {
    double sum = 0;
    for (const FaceObservation& frame : frames)
      for (int i = 5; i < 20; ++i) sum += std::pow(frame.landmarks[3 * i] - (100 + 5 * i), 2);
    return sum;
  };
  EXPECT_LT(spread(seen), 0.5 * spread(raw));
  EXPECT_GT(seen[20].landmarks[1] - seen[18].landmarks[1], 7.0f);
  EXPECT_GT(seen[21].landmarks[1] - seen[23].landmarks[1], 7.0f);
  // Steady motion stays where it is.
  auto moving = still_face(41, 0.0, 2);
  for (size_t f = 0; f < moving.size(); ++f)
    for (size_t i = 0; i < moving[f].landmarks.size(); i += 3)
      moving[f].landmarks[i] += 0.5f * static_cast<float>(f);
  const auto straight = moving;
  smooth_landmarks(moving, 1.0, 2.0);
  for (size_t f = 5; f + 5 < moving.size(); ++f)
    EXPECT_NEAR(moving[f].landmarks[0], straight[f].landmarks[0], 1e-3);
}

TEST(Smoothing, StopsAtFramesWithoutAFace) {
  auto seen = still_face(9, 0.0, 3);
  seen[4] = {};
  for (size_t f = 5; f < 9; ++f)
    for (float& value : seen[f].landmarks) value += 1.0f;
  const auto raw = seen;
  smooth_landmarks(seen, 2.0, 50.0);
  for (size_t f = 0; f < seen.size(); ++f)
    for (size_t i = 0; i < seen[f].landmarks.size(); ++i)
      ASSERT_NEAR(seen[f].landmarks[i], raw[f].landmarks[i], 1e-4) << f;
}

VideoObservation observation(int frames, const std::vector<int>& lost, int faces) {
  VideoObservation seen;
  seen.frames.resize(frames);
  for (FaceObservation& frame : seen.frames) frame.found = true;
  for (const int f : lost) seen.frames[f].found = false;
  seen.most_faces = faces;
  return seen;
}

std::string sentence(const VideoObservation& seen, bool tolerant) {
  try {
    check_observation(seen, "film.mp4", tolerant);
  } catch (const Error& problem) {
    EXPECT_EQ(problem.exit_code(), 2);
    return problem.what();
  }
  return "";
}

TEST(Checks, GiveOneSentenceEach) {
  EXPECT_NE(sentence(observation(0, {}, 0), false).find("no frames"), std::string::npos);
  EXPECT_NE(sentence(observation(3, {0, 1, 2}, 0), true).find("no face"), std::string::npos);
  EXPECT_NE(sentence(observation(2, {}, 1), false).find("only 2 of 2 frames"), std::string::npos);
  const std::string several = sentence(observation(50, {}, 2), false);
  EXPECT_NE(several.find("2 people"), std::string::npos);
  EXPECT_NE(several.find("--tolerant"), std::string::npos);
  EXPECT_EQ(sentence(observation(50, {}, 2), true), "");
  std::vector<int> half;
  for (int f = 20; f < 45; ++f) half.push_back(f);
  EXPECT_NE(sentence(observation(50, half, 1), false).find("frame 20"), std::string::npos);
  EXPECT_EQ(sentence(observation(50, half, 1), true), "");
  EXPECT_EQ(sentence(observation(50, {7}, 1), false), "");
  EXPECT_EQ(sentence(observation(50, {}, 1), false), "");
}

// The networks of whoever runs the tests.
std::optional<ModelSet> models_here() {
  try {
    return find_models(std::nullopt);
  } catch (const Error&) {
    return std::nullopt;
  }
}

TEST(Tracker, FindsNoFaceWhereThereIsNone) {
  const auto models = models_here();
  if (!models) GTEST_SKIP() << "set EFFIGY_DATA or EFFIGY_NPM to where the networks are";
  FaceTracker tracker(*models);
  Image8 noise(320, 240, 3);
  Random random(5);
  for (uint8_t& value : noise.data) value = static_cast<uint8_t>(random.bits());
  for (int f = 0; f < 3; ++f) EXPECT_FALSE(tracker.observe(noise).found);
  EXPECT_FALSE(tracker.observe(Image8(320, 240, 3, 128)).found);
  EXPECT_FALSE(tracker.observe(Image8(1, 1, 3, 128)).found);
  EXPECT_EQ(tracker.most_faces(), 0);
}

// Frames of a real video, if there is one.
std::vector<Image8> real_frames(int count, int step) {
  const char* data = std::getenv("EFFIGY_DATA");
  const Path path = data == nullptr ? Path() : Path(data) / "videos/wojtek_512.mp4";
  std::vector<Image8> frames;
  if (data == nullptr || !std::filesystem::exists(path)) return frames;
  VideoReader reader(path);
  Image8 frame;
  for (int f = 0; f < count * step && reader.next(frame); ++f)
    if (f % step == 0) frames.push_back(frame);
  return frames;
}

TEST(Tracker, FollowsARealFace) {
  const auto models = models_here();
  const auto frames = real_frames(12, 1);
  if (!models || frames.empty())
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models and videos/wojtek_512.mp4";
  FaceTracker tracker(*models);
  std::vector<float> last;
  for (const Image8& frame : frames) {
    const FaceObservation seen = tracker.observe(frame);
    ASSERT_TRUE(seen.found);
    EXPECT_GT(seen.presence, 0.9);
    // Upright: the person's right eye left of the left one, the chin below the forehead.
    const auto& p = seen.landmarks;
    EXPECT_LT(p[3 * 33], p[3 * 263]);
    EXPECT_LT(p[3 * 10 + 1], p[3 * 152 + 1]);
    EXPECT_NEAR(std::hypot(p[3 * 33] - p[3 * 263], p[3 * 33 + 1] - p[3 * 263 + 1]), 105, 25);
    for (size_t i = 0; i < last.size(); ++i) ASSERT_NEAR(p[i], last[i], 25) << "it jumped";
    last = p;
    EXPECT_EQ(seen.scores.size(), models->blendshapes.empty() ? 0U : 52U);
  }
  EXPECT_EQ(tracker.most_faces(), 1);
}

TEST(Tracker, TurnedAndShrunkenPicturesGiveTheSamePoints) {
  const auto models = models_here();
  const auto frames = real_frames(1, 1);
  if (!models || frames.empty())
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models and videos/wojtek_512.mp4";
  const Image8& upright = frames[0];
  FaceTracker first(*models);
  FaceObservation straight;
  for (int i = 0; i < 3; ++i) straight = first.observe(upright);
  // A quarter turn is more than a head does: a person lying down.
  Image8 turned(upright.height, upright.width, 3);
  for (int y = 0; y < upright.height; ++y)
    for (int x = 0; x < upright.width; ++x)
      std::copy_n(upright.at(x, y), 3, turned.at(upright.height - 1 - y, x));
  FaceTracker second(*models);
  FaceObservation seen;
  for (int i = 0; i < 4; ++i) seen = second.observe(turned);
  if (!seen.found) GTEST_SKIP() << "the detector does not see faces that lie on their side";
  double sum = 0;
  for (int i = 0; i < second.landmark_count(); ++i)
    sum += std::hypot(seen.landmarks[3 * i] - (upright.height - straight.landmarks[3 * i + 1]),
                      seen.landmarks[3 * i + 1] - straight.landmarks[3 * i]);
  EXPECT_LT(sum / second.landmark_count(), 3.0);
}

TEST(Tracker, CountsPeople) {
  const auto models = models_here();
  const auto frames = real_frames(2, 60);
  if (!models || frames.size() < 2)
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models and videos/wojtek_512.mp4";
  const auto beside = [](const Image8& a, const Image8& b) {
    Image8 both(a.width + b.width, a.height, 3);
    for (int y = 0; y < a.height; ++y) {
      std::copy_n(a.at(0, y), 3 * a.width, both.at(0, y));
      std::copy_n(b.at(0, y), 3 * b.width, both.at(a.width, y));
    }
    return both;
  };
  const Image8 two = beside(frames[0], frames[1]);
  FaceTracker tracker(*models);
  float x = -1;
  for (int f = 0; f < 27; ++f) {
    const FaceObservation seen = tracker.observe(two);
    ASSERT_TRUE(seen.found);
    EXPECT_NEAR(seen.landmarks[3], f == 0 ? seen.landmarks[3] : x, 60)
        << "it went over to the other face";
    x = seen.landmarks[3];
  }
  EXPECT_EQ(tracker.most_faces(), 2);
}

TEST(Tracker, FindsAFaceAgainThatWasAway) {
  const auto models = models_here();
  const auto frames = real_frames(3, 1);
  if (!models || frames.empty())
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models and videos/wojtek_512.mp4";
  FaceTracker tracker(*models);
  EXPECT_TRUE(tracker.observe(frames[0]).found);
  const Image8 empty(frames[0].width, frames[0].height, 3, 90);
  for (int f = 0; f < 5; ++f) EXPECT_FALSE(tracker.observe(empty).found);
  EXPECT_TRUE(tracker.observe(frames[1]).found);
}

}  // namespace
}  // namespace effigy
