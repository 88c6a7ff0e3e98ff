// effigy track from file to folder: what goes wrong gives one sentence and harms nothing; a real
// video becomes a sound capture.
#include "effigy/track/track.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <functional>

#include "effigy/base/error.h"
#include "effigy/capture/capture.h"
#include "effigy/image/files.h"
#include "effigy/image/video.h"
#include "effigy/infer/models.h"
#include "effigy/people/builtin_head.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

class TrackFiles : public testing::Test {
 protected:
  void SetUp() override {
    folder_ =
        Path(testing::TempDir()) / (std::string("effigy_track_") +
                                    testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  bool networks() const {
    try {
      find_models(std::nullopt);
      return true;
    } catch (const Error&) {
      return false;
    }
  }

  // The rig that track would choose, prepared once: making it takes a second each time.
  static Path prepared_rig() {
    static const Path path = [] {
      const Path file = Path(testing::TempDir()) / "effigy_track_rig.safetensors";
      const char* data = std::getenv("EFFIGY_DATA");
      const Path ict = data == nullptr ? Path() : Path(data) / "face/ict_facekit";
      write_rig(file, std::filesystem::exists(ict) ? load_rig(ict, Path(data) / "models")
                                                   : builtin_head_rig());
      return file;
    }();
    return path;
  }

  // A moving grey square: a video without a face.
  Path faceless(int frames) const {
    const Path path = folder_ / "faceless.mp4";
    VideoWriter writer(path, 160, 120, 25);
    for (int f = 0; f < frames; ++f) {
      Image8 frame(160, 120, 3, 60);
      for (int y = 40; y < 80; ++y)
        for (int x = 20 + f; x < 60 + f; ++x)
          for (int c = 0; c < 3; ++c) frame.at(x, y)[c] = 170;
      writer.add(frame);
    }
    writer.finish();
    return path;
  }

  // Tracks into a folder where something of value stands already; returns the sentence.
  std::string sentence(const Path& video, TrackOptions options = {}) {
    const Path output = folder_ / "capture";
    write_text(output / "capture.json", "{}");
    write_text(output / "keep.txt", "years of work");
    std::string said;
    if (!options.rig) options.rig = prepared_rig();
    try {
      track_video(video, output, options);
    } catch (const Error& problem) {
      said = problem.what();
      EXPECT_EQ(problem.exit_code(), 2) << said;
    }
    EXPECT_FALSE(said.empty());
    EXPECT_EQ(said.find('\n'), std::string::npos) << "one sentence";
    EXPECT_EQ(read_text(output / "keep.txt"), "years of work");
    // Nothing half-written is left beside it.
    for (const auto& entry : std::filesystem::directory_iterator(folder_))
      EXPECT_TRUE(entry.path().filename() == "capture" || entry.path().filename() == "mattes" ||
                  entry.is_regular_file())
          << entry.path();
    return said;
  }

  Path folder_;
};

TEST_F(TrackFiles, WithoutNetworksItSaysWhereTheyComeFrom) {
  TrackOptions options;
  options.models = folder_;
  const std::string said = sentence(faceless(3), options);
  EXPECT_NE(said.find("./effigy"), std::string::npos) << said;
  EXPECT_NE(said.find(folder_.string()), std::string::npos) << said;
}

TEST_F(TrackFiles, BadVideos) {
  if (!networks()) GTEST_SKIP() << "set EFFIGY_DATA or EFFIGY_NPM to where the networks are";
  EXPECT_NE(sentence(folder_ / "missing.mp4").find("missing.mp4"), std::string::npos);
  write_text(folder_ / "empty.mp4", "");
  EXPECT_NE(sentence(folder_ / "empty.mp4").find("empty.mp4"), std::string::npos);
  write_text(folder_ / "notes.txt", "This is no video at all, only some text in a file.");
  EXPECT_NE(sentence(folder_ / "notes.txt").find("notes.txt"), std::string::npos);
  EXPECT_NE(sentence(folder_).find(folder_.string()), std::string::npos);
}

TEST_F(TrackFiles, AnAudioFileHasNoPictures) {
  if (!networks()) GTEST_SKIP() << "set EFFIGY_DATA or EFFIGY_NPM to where the networks are";
  const Path path = folder_ / "speech.wav";
  std::ofstream out(path, std::ios::binary);
  const auto u32 = [&](uint32_t v) { out.write(reinterpret_cast<const char*>(&v), 4); };
  const auto u16 = [&](uint16_t v) { out.write(reinterpret_cast<const char*>(&v), 2); };
  out << "RIFF";
  u32(36 + 16000);
  out << "WAVEfmt ";
  u32(16);
  u16(1);
  u16(1);
  u32(8000);
  u32(16000);
  u16(2);
  u16(16);
  out << "data";
  u32(16000);
  for (int i = 0; i < 8000; ++i)
    u16(static_cast<uint16_t>(static_cast<int16_t>(8000 * std::sin(0.1 * i))));
  out.close();
  EXPECT_NE(sentence(path).find("speech.wav"), std::string::npos);
}

TEST_F(TrackFiles, ATruncatedVideo) {
  if (!networks()) GTEST_SKIP() << "set EFFIGY_DATA or EFFIGY_NPM to where the networks are";
  const auto bytes = read_file(faceless(20));
  for (const size_t keep : {bytes.size() / 3, bytes.size() / 2, bytes.size() - 40}) {
    const Path path = folder_ / "cut.mp4";
    write_file(path, std::span(bytes).first(keep));
    EXPECT_NE(sentence(path).find("cut.mp4"), std::string::npos) << keep;
  }
}

TEST_F(TrackFiles, NoFaceAndTooShort) {
  if (!networks()) GTEST_SKIP() << "set EFFIGY_DATA or EFFIGY_NPM to where the networks are";
  EXPECT_NE(sentence(faceless(12)).find("no face"), std::string::npos);
}

TEST_F(TrackFiles, UnknownRigsAndMattes) {
  if (!networks()) GTEST_SKIP() << "set EFFIGY_DATA or EFFIGY_NPM to where the networks are";
  TrackOptions options;
  options.rig = folder_ / "no_such_rig.safetensors";
  EXPECT_NE(sentence(faceless(3), options).find("no_such_rig"), std::string::npos);
  write_text(folder_ / "rig.pkl", "not a pickle");
  options.rig = folder_ / "rig.pkl";
  EXPECT_NE(sentence(faceless(3), options).find("rig.pkl"), std::string::npos);
}

// The first `count` frames of a real video.
Path real_video() {
  const char* data = std::getenv("EFFIGY_DATA");
  return data == nullptr ? Path() : Path(data) / "videos/wojtek_512.mp4";
}

TEST_F(TrackFiles, ShortAndFacelessPartsOfARealVideo) {
  if (!networks() || !std::filesystem::exists(real_video()))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models and videos/wojtek_512.mp4";
  TrackOptions options;
  options.most_frames = 2;
  EXPECT_NE(sentence(real_video(), options).find("only 2 of 2 frames"), std::string::npos);
  // The face leaves the picture after 12 of 40 frames.
  const Path path = folder_ / "leaves.mp4";
  VideoReader reader(real_video());
  VideoWriter writer(path, 512, 512, 25);
  Image8 frame;
  for (int f = 0; f < 40; ++f) {
    if (f < 12) {
      ASSERT_TRUE(reader.next(frame));
    }
    if (f == 12) frame = Image8(512, 512, 3, 120);
    writer.add(frame);
  }
  writer.finish();
  EXPECT_NE(sentence(path).find("frame 12"), std::string::npos);
}

TEST_F(TrackFiles, ARealVideoBecomesACapture) {
  if (!networks() || !std::filesystem::exists(real_video()))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models and videos/wojtek_512.mp4";
  TrackOptions options;
  options.most_frames = 14;
  options.test_frames = 3;
  options.size = 256;
  options.consent = "a test";
  options.rig = prepared_rig();
  const Path output = folder_ / "capture";
  const Json summary = track_video(real_video(), output, options);
  EXPECT_EQ(summary["frames"], 14);
  EXPECT_EQ(summary["tracked"], 14);
  EXPECT_LT(summary["landmark_error_median_px"].get<double>(), 2.5);
  EXPECT_LT(summary["heldout_landmark_error_median_px"].get<double>(), 3.5);
  EXPECT_GT(summary["milliseconds_per_frame"].get<double>(), 0);
  EXPECT_TRUE(std::filesystem::exists(output / "track.html"));
  EXPECT_EQ(read_json(output / "track.json"), summary);

  const Capture capture = read_capture(output);
  ASSERT_EQ(capture.frames.size(), 14U);
  EXPECT_EQ(capture.test_frames().size(), 3U);
  EXPECT_EQ(capture.consent, "a test");
  EXPECT_EQ(capture.camera.width, 256);
  for (const int f : {0, 7, 13}) {
    const Image8 image = capture.load_image(f), mask = capture.load_mask(f);
    ASSERT_EQ(mask.width, 256);
    // The rig's landmarks lie where the network's are, inside the matte.
    std::vector<float> vertices;
    pose_vertices(shape_rig(capture.rig, capture.identity), capture.poses[f], vertices);
    const auto points =
        landmark_positions(capture.rig.mediapipe, capture.rig.mesh.triangles, vertices);
    double sum = 0;
    size_t inside = 0;
    for (size_t l = 0; l < capture.rig.mediapipe.size(); ++l) {
      const Vec2d p = capture.camera.project(Vec3f(points.data() + 3 * l).cast<double>());
      const size_t at = (static_cast<size_t>(f) * capture.landmark_count +
                         static_cast<size_t>(capture.rig.mediapipe.index[l])) *
                        2;
      sum += std::hypot(p.x() - capture.landmarks[at], p.y() - capture.landmarks[at + 1]);
      const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
      ASSERT_TRUE(x >= 0 && y >= 0 && x < 256 && y < 256);
      inside += *mask.at(x, y) > 128;
    }
    const double count = static_cast<double>(capture.rig.mediapipe.size());
    EXPECT_LT(sum / count, 2.5);
    EXPECT_GT(static_cast<double>(inside) / count, 0.97);
    EXPECT_LT(*mask.at(2, 2), 10);
    size_t covered = 0;
    for (const uint8_t value : mask.data) covered += value > 128;
    EXPECT_GT(covered, mask.data.size() / 10);
    EXPECT_LT(covered, mask.data.size() * 3 / 4);
  }
}

TEST_F(TrackFiles, OwnMattesAreUsedAsTheyAre) {
  if (!networks() || !std::filesystem::exists(real_video()))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models and videos/wojtek_512.mp4";
  TrackOptions options;
  options.most_frames = 10;
  options.crop_head = false;
  options.matte = folder_ / "mattes";
  options.rig = prepared_rig();
  Image8 half(512, 512, 1);
  for (int y = 0; y < 512; ++y)
    for (int x = 0; x < 256; ++x) *half.at(x, y) = 255;
  for (int f = 0; f < 9; ++f) write_png8(*options.matte / ("m" + std::to_string(f) + ".png"), half);
  EXPECT_NE(sentence(real_video(), options).find("9 pictures for 10 frames"), std::string::npos);
  write_png8(*options.matte / "m9.png", half);
  std::filesystem::remove_all(folder_ / "capture");
  track_video(real_video(), folder_ / "capture", options);
  const Capture capture = read_capture(folder_ / "capture");
  EXPECT_EQ(capture.load_mask(5).data, half.data);
  EXPECT_EQ(capture.camera.width, 512);
}

}  // namespace
}  // namespace effigy
