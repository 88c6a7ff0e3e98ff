#include "effigy/image/video.h"

#include <gtest/gtest.h>

#include <cstdlib>

#include "base/temp_folder.h"
#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/image/metrics.h"
#include "image/make_video.h"
#include "image/pictures.h"

namespace effigy {
namespace {

using test::make_sound;
using test::make_video;
using test::smooth_picture;
using test::TempFolder;
using test::VideoRecipe;

struct Clip {
  VideoInfo info;
  std::vector<Image8> frames;
  std::vector<double> seconds;
};

Clip read_all(const Path& path) {
  VideoReader reader(path);
  Clip clip;
  clip.info = reader.info();
  Image8 frame;
  double seconds = 0.0;
  while (reader.next(frame, &seconds)) {
    EXPECT_EQ(frame.width, clip.info.width);
    EXPECT_EQ(frame.height, clip.info.height);
    clip.frames.push_back(frame);
    clip.seconds.push_back(seconds);
  }
  EXPECT_FALSE(reader.next(frame));
  return clip;
}

int count_frames(const Path& path, VideoInfo* info = nullptr) {
  VideoReader reader(path);
  if (info != nullptr) *info = reader.info();
  Image8 frame;
  int count = 0;
  double last = -1.0, seconds = 0.0;
  while (reader.next(frame, &seconds)) {
    EXPECT_GT(seconds, last);
    last = seconds;
    ++count;
  }
  return count;
}

std::string sentence(const Path& path) {
  try {
    count_frames(path);
  } catch (const Error& error) {
    EXPECT_EQ(error.exit_code(), 2);
    return error.what();
  }
  return "";
}

void expect_colour(const Image8& frame, int x, int y, const std::array<double, 3>& rgb,
                   double tolerance = 3.0) {
  for (size_t c = 0; c < 3; ++c)
    EXPECT_NEAR(frame.at(x, y)[c], rgb[c], tolerance) << "(" << x << ", " << y << ") channel " << c;
}

TEST(VideoWriter, RoundTrip) {
  const TempFolder folder;
  const Path path = folder / "clips/a.mp4";
  VideoWriter writer(path, 96, 80, 30.0,
                     {{"comment", "synthetic"}, {"subject", "7"}, {"title", "J\xc3\xbcrgen"}});
  for (int t = 0; t < 12; ++t) writer.add(to_8bit(smooth_picture(96, 80, 3, 0.1 * t)));
  EXPECT_FALSE(std::filesystem::exists(path));
  writer.finish();
  const Clip clip = read_all(path);
  ASSERT_EQ(clip.frames.size(), 12u);
  EXPECT_EQ(clip.info.frames, 12);
  EXPECT_EQ(clip.info.codec, "h264");
  EXPECT_EQ(clip.info.pixel_format, "yuv420p");
  EXPECT_NEAR(clip.info.frames_per_second, 30.0, 1e-9);
  EXPECT_EQ(clip.info.metadata.at("comment"), "synthetic\nsubject: 7");
  EXPECT_EQ(clip.info.metadata.at("title"), "J\xc3\xbcrgen");
  for (int t = 0; t < 12; ++t) {
    const auto i = static_cast<size_t>(t);
    EXPECT_GT(psnr(to_float(clip.frames[i]), smooth_picture(96, 80, 3, 0.1 * t)), 34.0) << t;
    EXPECT_NEAR(clip.seconds[i], t / 30.0, 1e-4);
  }
}

TEST(VideoWriter, OddSizesArePaddedAndOtherChannelsTaken) {
  const TempFolder folder;
  const Image8 picture = to_8bit(smooth_picture(51, 37, 4));
  VideoWriter writer(folder / "a.mp4", 51, 37, 30000.0 / 1001.0);
  for (int t = 0; t < 3; ++t) writer.add(picture);
  writer.finish();
  const Clip clip = read_all(folder / "a.mp4");
  ASSERT_EQ(clip.info.width, 52);
  ASSERT_EQ(clip.info.height, 38);
  EXPECT_NEAR(clip.info.frames_per_second, 30000.0 / 1001.0, 1e-9);
  for (int y = 2; y < 35; y += 8)
    for (int x = 2; x < 49; x += 8) {
      const uint8_t* p = picture.at(x, y);
      expect_colour(clip.frames[0], x, y, {double(p[0]), double(p[1]), double(p[2])}, 9.0);
    }
  VideoWriter grey(folder / "g.mp4", 16, 16, 25);
  grey.add(Image8(16, 16, 1, 90));
  grey.finish();
  expect_colour(read_all(folder / "g.mp4").frames.at(0), 8, 8, {90, 90, 90});
}

TEST(VideoWriter, NothingStaysWithoutFinish) {
  const TempFolder folder;
  {
    VideoWriter writer(folder / "a.mp4", 32, 32, 25);
    writer.add(Image8(32, 32, 3, 100));
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
  {
    VideoWriter writer(folder / "a.mp4", 32, 32, 25);
    EXPECT_THROW(writer.finish(), Error);
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
  write_text(folder / "file", "in the way");
  EXPECT_THROW(VideoWriter(folder / "file/a.mp4", 32, 32, 25), Error);
}

TEST(VideoReader, MatrixAndRange) {
  const TempFolder folder;
  for (const auto space : {AVCOL_SPC_BT709, AVCOL_SPC_SMPTE170M, AVCOL_SPC_UNSPECIFIED})
    for (const auto range : {AVCOL_RANGE_MPEG, AVCOL_RANGE_JPEG, AVCOL_RANGE_UNSPECIFIED}) {
      VideoRecipe recipe;
      recipe.space = space;
      recipe.range = range;
      make_video(folder / "a.mp4", recipe);
      const Clip clip = read_all(folder / "a.mp4");
      ASSERT_EQ(clip.frames.size(), 5u);
      for (int t = 0; t < 5; t += 4)
        for (int y : {8, 40})
          for (int x : {8, 56})
            expect_colour(clip.frames[static_cast<size_t>(t)], x, y, recipe.colour(x, y, t));
    }
}

TEST(VideoReader, LargeUntaggedVideosAreBt709) {
  const TempFolder folder;
  VideoRecipe recipe;
  recipe.height = 720;
  recipe.times = {0};
  make_video(folder / "a.mp4", recipe);
  expect_colour(read_all(folder / "a.mp4").frames.at(0), 8, 700, recipe.colour(8, 700, 0));
}

TEST(VideoReader, PixelFormats) {
  const TempFolder folder;
  for (const auto pixels : {AV_PIX_FMT_YUV420P, AV_PIX_FMT_YUV422P, AV_PIX_FMT_YUVJ444P}) {
    VideoRecipe recipe;
    recipe.pixels = pixels;
    if (pixels == AV_PIX_FMT_YUVJ444P) recipe.range = AVCOL_RANGE_JPEG;
    make_video(folder / "a.mp4", recipe);
    const Clip clip = read_all(folder / "a.mp4");
    for (int y : {8, 40})
      for (int x : {8, 56}) expect_colour(clip.frames.at(2), x, y, recipe.colour(x, y, 2));
  }
}

TEST(VideoReader, OddSizes) {
  const TempFolder folder;
  VideoRecipe recipe;
  recipe.width = 51;
  recipe.height = 37;
  make_video(folder / "a.mp4", recipe);
  const Clip clip = read_all(folder / "a.mp4");
  EXPECT_EQ(clip.info.width, 51);
  EXPECT_EQ(clip.info.height, 37);
  EXPECT_EQ(clip.info.pixel_format, "yuv444p");
  expect_colour(clip.frames.at(4), 50, 36, recipe.colour(50, 36, 4));
  expect_colour(clip.frames.at(4), 0, 0, recipe.colour(0, 0, 4));
}

TEST(VideoReader, EveryOrientation) {
  const TempFolder folder;
  constexpr int32_t one = 1 << 16;
  // a b c d of the display matrix: shown = (a p + c q, b p + d q).
  const int32_t matrices[8][4] = {{one, 0, 0, one},   {-one, 0, 0, one}, {one, 0, 0, -one},
                                  {-one, 0, 0, -one}, {0, one, -one, 0}, {0, -one, one, 0},
                                  {0, one, one, 0},   {0, -one, -one, 0}};
  for (const auto& m : matrices) {
    VideoRecipe recipe;
    recipe.times = {0, 1};
    recipe.display_matrix = {m[0], m[1], 0, m[2], m[3], 0, 0, 0, 1 << 30};
    make_video(folder / "a.mp4", recipe);
    const Clip clip = read_all(folder / "a.mp4");
    const bool turned = m[0] == 0;
    ASSERT_EQ(clip.info.width, turned ? 48 : 64);
    ASSERT_EQ(clip.info.height, turned ? 64 : 48);
    for (int q : {4, 44})
      for (int p : {4, 60}) {
        // The matrix maps the picture's corner away from 0; players move it back.
        int x = (m[0] * p + m[2] * q) / one, y = (m[1] * p + m[3] * q) / one;
        if (m[0] + m[2] < 0) x += clip.info.width - 1;
        if (m[1] + m[3] < 0) y += clip.info.height - 1;
        expect_colour(clip.frames.at(1), x, y, recipe.colour(p, q, 1));
      }
  }
}

TEST(VideoReader, PhonePortraitTurnsClockwise) {
  const TempFolder folder;
  VideoRecipe recipe;
  recipe.times = {0};
  recipe.display_matrix.resize(9);
  av_display_rotation_set(recipe.display_matrix.data(), 90.0);  // clockwise, by its manual
  make_video(folder / "a.mp4", recipe);
  const Clip clip = read_all(folder / "a.mp4");
  // The stored top left corner is shown at the top right.
  expect_colour(clip.frames.at(0), clip.info.width - 3, 2, recipe.colour(2, 2, 0));
  expect_colour(clip.frames.at(0), 2, 2, recipe.colour(2, 45, 0));
}

TEST(VideoReader, VariableFrameRate) {
  const TempFolder folder;
  VideoRecipe recipe;
  recipe.times = {0, 1, 5, 6, 20, 21};
  make_video(folder / "a.mp4", recipe);
  const Clip clip = read_all(folder / "a.mp4");
  ASSERT_EQ(clip.frames.size(), 6u);
  for (size_t t = 0; t < 6; ++t) {
    EXPECT_NEAR(clip.seconds[t], static_cast<double>(recipe.times[t]) / 25.0, 1e-4);
    expect_colour(clip.frames[t], 60, 40, recipe.colour(60, 40, static_cast<int>(t)));
  }
}

TEST(VideoReader, EditListHidesFrames) {
  const TempFolder folder;
  VideoRecipe recipe;
  recipe.times = {-4, -3, -2, -1, 0, 1, 2, 3};  // MP4 stores times before 0 as an edit list
  make_video(folder / "a.mp4", recipe);
  const Clip clip = read_all(folder / "a.mp4");
  ASSERT_EQ(clip.frames.size(), 4u);
  EXPECT_EQ(clip.info.frames, 4);
  for (int t = 0; t < 4; ++t)
    expect_colour(clip.frames[static_cast<size_t>(t)], 60, 40, recipe.colour(60, 40, t + 4));
}

TEST(VideoReader, PixelsThatAreNotSquare) {
  const TempFolder folder;
  VideoRecipe recipe;
  make_video(folder / "w.mp4", recipe);
  recipe.aspect = {2, 1};
  make_video(folder / "a.mp4", recipe);
  const Clip clip = read_all(folder / "a.mp4");
  EXPECT_EQ(clip.info.width, 64);
  EXPECT_EQ(clip.info.height, 48);
  EXPECT_NEAR(clip.info.pixel_aspect, 2.0, 1e-9);
  recipe.display_matrix = {0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30};
  make_video(folder / "b.mp4", recipe);
  EXPECT_NEAR(read_all(folder / "b.mp4").info.pixel_aspect, 0.5, 1e-9);
  EXPECT_EQ(read_all(folder / "w.mp4").info.pixel_aspect, 1.0);
}

TEST(VideoReader, SizeChangesInTheStream) {
  const TempFolder folder;
  VideoRecipe recipe;
  recipe.container = "h264";
  make_video(folder / "a.h264", recipe);
  recipe.width = 96;
  recipe.height = 72;
  recipe.colour = [](int, int, int) { return std::array<double, 3>{180, 90, 45}; };
  make_video(folder / "b.h264", recipe);
  auto bytes = read_file(folder / "a.h264");
  const auto more = read_file(folder / "b.h264");
  bytes.insert(bytes.end(), more.begin(), more.end());
  write_file(folder / "c.h264", bytes);
  const Clip clip = read_all(folder / "c.h264");
  ASSERT_EQ(clip.frames.size(), 10u);
  EXPECT_EQ(clip.info.width, 64);
  expect_colour(clip.frames.back(), 30, 30, {180, 90, 45});
}

TEST(VideoReader, SentencesForWhatIsNoVideo) {
  const TempFolder folder;
  const auto says = [](const Path& path, const std::string& what) {
    const std::string text = sentence(path);
    EXPECT_NE(text.find(what), std::string::npos) << text;
    EXPECT_NE(text.find(path.string()), std::string::npos) << text;
  };
  says(folder / "none.mp4", "there is no such file");
  says(folder.path(), "it is a folder");
  write_text(folder / "empty.mp4", "");
  says(folder / "empty.mp4", "it is empty (0 bytes)");
  write_text(folder / "text.mp4", "Dear diary, today I recorded nothing at all.\n");
  says(folder / "text.mp4", "it is not a video file");
  // A playlist must not make us open other files.
  write_text(folder / "list.m3u8", "#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n");
  says(folder / "list.m3u8", "it is not a video file");
  write_png8(folder / "picture.mp4", to_8bit(smooth_picture(32, 32, 3)));
  says(folder / "picture.mp4", "it is not a video file");
  make_sound(folder / "sound.mkv");
  says(folder / "sound.mkv", "it has sound only");
}

TEST(VideoReader, CutShort) {
  const TempFolder folder;
  VideoRecipe recipe;
  recipe.times.clear();
  for (int t = 0; t < 30; ++t) recipe.times.push_back(t);
  recipe.group = 4;
  make_video(folder / "a.mp4", recipe);
  auto bytes = read_file(folder / "a.mp4");
  bytes.resize(bytes.size() / 2);  // the index stands at the end
  write_file(folder / "cut.mp4", bytes);
  EXPECT_NE(sentence(folder / "cut.mp4").find("cut short"), std::string::npos);

  // Index first: the frames that are there.
  set_log_level(LogLevel::kQuiet);
  VideoWriter writer(folder / "b.mp4", 96, 80, 25);
  for (int t = 0; t < 60; ++t) writer.add(to_8bit(test::noise_picture(96, 80, 3, uint64_t(t))));
  writer.finish();
  bytes = read_file(folder / "b.mp4");
  auto half = bytes;
  half.resize(bytes.size() / 2);
  write_file(folder / "half.mp4", half);
  const int frames = count_frames(folder / "half.mp4");
  EXPECT_GT(frames, 10);
  EXPECT_LT(frames, 60);
  half.resize(4000);  // behind the index, before the end of the first frame
  write_file(folder / "head.mp4", half);
  EXPECT_NE(sentence(folder / "head.mp4").find("cut short before its first frame"),
            std::string::npos);
  set_log_level(LogLevel::kInfo);
}

TEST(VideoReader, DamagedFilesNeverCrash) {
  const TempFolder folder;
  set_log_level(LogLevel::kQuiet);
  make_video(folder / "a.mp4", VideoRecipe{});
  const auto good = read_file(folder / "a.mp4");
  Random random(3);
  for (int i = 0; i < 40; ++i) {
    auto bytes = good;
    for (uint64_t k = 0; k < 1 + random.below(20); ++k)
      bytes[random.below(bytes.size())] = static_cast<uint8_t>(random.below(256));
    write_file(folder / "x.mp4", bytes);
    try {
      VideoReader reader(folder / "x.mp4");
      Image8 frame;
      int count = 0;
      while (reader.next(frame)) ++count;
      EXPECT_LE(count, 1000);
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("x.mp4"), std::string::npos);
    }
  }
  set_log_level(LogLevel::kInfo);
}

TEST(VideoReader, RealVideos) {
  const char* data = std::getenv("EFFIGY_DATA");
  if (data == nullptr) GTEST_SKIP() << "EFFIGY_DATA is not set";
  const Path videos = Path(data) / "videos";
  struct Expected {
    const char* name;
    int frames, width, height;
    const char* pixels;
  };
  for (const Expected& expected : {Expected{"justin_1080p.mp4", 300, 1920, 1080, "yuv420p"},
                                   Expected{"wojtek_512.mp4", 400, 512, 512, "yuv444p"},
                                   Expected{"liveportrait_d9.mp4", 587, 512, 480, "yuv420p"}}) {
    if (!std::filesystem::exists(videos / expected.name)) continue;
    VideoInfo info;
    EXPECT_EQ(count_frames(videos / expected.name, &info), expected.frames) << expected.name;
    EXPECT_EQ(info.frames, expected.frames) << expected.name;
    EXPECT_EQ(info.width, expected.width) << expected.name;
    EXPECT_EQ(info.height, expected.height) << expected.name;
    EXPECT_EQ(info.pixel_format, expected.pixels) << expected.name;
  }
}

}  // namespace
}  // namespace effigy
