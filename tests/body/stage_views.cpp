#include "effigy/body/stage_views.h"

#include <cmath>
#include <fstream>
#include <map>
#include <set>

#include "effigy/base/safetensors.h"
#include "support.h"
#include "tiny_stage.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;
using test::contains;
using test::error_of;

constexpr int kFrames = 6, kCameras = 4, kWidth = 24, kHeight = 20;

uint8_t level(int frame, int camera, int x, int y, int c) {
  return static_cast<uint8_t>(37 * frame + 59 * camera + 7 * x + 3 * y + 101 * c);
}

// The body: a slanted stripe.
bool body_at(int frame, int x, int y) {
  return std::abs(x - y / 2 - 6 - frame) < 3 && y >= 4 && y < 17;
}

// A training capture in which every pixel of every view is another.
StageCapture write_stage(const Path& folder, int frames = kFrames, int cameras = kCameras) {
  StageCapture c = test::tiny_stage();
  c.true_poses.clear();
  c.layers.clear();
  const StageCapture few = c;
  c.cameras.clear();
  c.frames.clear();
  c.poses.clear();
  c.body_keypoints.clear();
  c.face_keypoints.clear();
  c.body_from_rest.clear();
  c.face_from_rest.clear();
  for (int k = 0; k < cameras; ++k) {
    c.cameras.push_back({"c" + std::to_string(k), test::small_camera(16), false});
    c.cameras.back().camera.width = kWidth;
    c.cameras.back().camera.height = kHeight;
  }
  for (int f = 0; f < frames; ++f) {
    StageFrame frame;
    frame.number = 5 * f + 1;
    frame.fully_lit = f == 0;
    if (f > 0) frame.lights = {{f % 3, 0.5f}};
    c.frames.push_back(frame);
    c.poses.push_back(few.poses[0]);
    // A quarter turn about y and a step along x, z: a point p was at (-z, y, x) + step.
    const float s = static_cast<float>(f);
    c.body_from_rest.push_back({0, 0, -1, s, 0, 1, 0, 0, 1, 0, 0, 2});
    c.face_from_rest.push_back({1, 0, 0, 0, 0, 1, 0, s, 0, 0, 1, 0});
    for (const float value : {s, 0.0f, 2.0f, s - 3, 2.0f, 3.0f}) c.body_keypoints.push_back(value);
    for (const float value : {7.0f, s, 9.0f}) c.face_keypoints.push_back(value);
    std::vector<float> vertices = c.rig.mesh.vertices;
    for (float& v : vertices) v += s;
    write_frame_arrays({vertices, {}, {}}, folder, frame.number);
    for (int k = 0; k < cameras; ++k) {
      Image8 image(kWidth, kHeight, 3), mask(kWidth, kHeight, 1);
      for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x) {
          for (int b = 0; b < 3; ++b) image.at(x, y)[b] = level(f, k, x, y, b);
          mask.at(x, y)[0] = body_at(f, x, y) ? 255 : 0;
        }
      write_png8(folder / stage_image_path(c.cameras[static_cast<size_t>(k)].name, frame.number),
                 image);
      write_png8(folder / stage_mask_path(c.cameras[static_cast<size_t>(k)].name, frame.number),
                 mask);
    }
  }
  write_stage_capture(c, folder);
  return read_stage_capture(folder);
}

StageSchedule all_of(const StageCapture& c, uint64_t seed = 1) {
  return StageSchedule::random(c, c.frames_of(StageSplit::kTrain), c.train_cameras(), seed);
}

void damage(const StageCapture& c, int frame, int camera) {
  std::ofstream(c.folder / stage_image_path(c.cameras[static_cast<size_t>(camera)].name,
                                            c.frames[static_cast<size_t>(frame)].number))
      << "\x89PNG but no more";
}

TEST(StageViews, AViewIsWhatTheFilesSay) {
  const test::ScratchFolder scratch;
  const StageCapture c = write_stage(scratch.path());
  const StageSource source(c);
  const StageView view = source.view({3, 2}, {});
  ASSERT_EQ(view.image.width, kWidth);
  ASSERT_EQ(view.image.height, kHeight);
  EXPECT_EQ(view.view.cx, c.cameras[2].camera.cx);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const size_t i = static_cast<size_t>(y * kWidth + x);
      for (int b = 0; b < 3; ++b)
        EXPECT_FLOAT_EQ(view.image.plane(b)[i], level(3, 2, x, y, b) / 255.0f);
      EXPECT_EQ(view.mask[i], body_at(3, x, y) ? 1.0f : 0.0f);
    }
  const StageMoment& moment = *view.moment;
  EXPECT_EQ(moment.frame, 3);
  EXPECT_EQ(moment.vertices[7], c.rig.mesh.vertices[7] + 3);
  // Moved by the inverse of the root frames: the first keypoint is the root itself.
  const std::vector<float> body = {0, 0, 0, 1, 2, 3}, face = {7, 0, 9};
  for (size_t i = 0; i < 6; ++i) EXPECT_NEAR(moment.body_keypoints[i], body[i], 1e-5) << i;
  for (size_t i = 0; i < 3; ++i) EXPECT_NEAR(moment.face_keypoints[i], face[i], 1e-5) << i;
}

TEST(StageViews, LightsFallOffFromTheCentre) {
  const test::ScratchFolder scratch;
  const StageCapture c = write_stage(scratch.path());
  const StageSource source(c);
  // The mean of the keypoints over frames: x of (s, s - 3), s = 0 .. 5.
  EXPECT_LT((source.center() - Vec3f(1.0f, 1.0f, 2.5f)).norm(), 1e-5f);
  const StageMoment one = source.moment(1), all = source.moment(0);
  EXPECT_TRUE(all.fully_lit);
  EXPECT_EQ(all.lights.lights.size(), 3u);
  ASSERT_EQ(one.lights.lights.size(), 1u);
  EXPECT_FALSE(one.fully_lit);
  EXPECT_TRUE(one.environment.empty());
  // At any point p: amount intensity / |light - p|^2.
  const PointLight& light = one.lights.lights[0];
  const Vec3f p(0.3f, -1, 0.5f);
  const float strength = light.intensity.x() * (light.position - one.lights.center).squaredNorm() /
                         (light.position - p).squaredNorm();
  EXPECT_NEAR(strength, 0.5f / (c.lights[1].position - p).squaredNorm(), 1e-6);
  StageCapture sunny = c;
  sunny.frames[2].lights.clear();
  sunny.frames[2].environment = "lights/studio.exr";
  const StageMoment moment = StageSource(sunny).moment(2);
  EXPECT_TRUE(moment.lights.lights.empty());
  EXPECT_EQ(moment.environment, scratch / "lights/studio.exr");
}

TEST(StageViews, CropsShowTheBody) {
  const test::ScratchFolder scratch;
  const StageCapture c = write_stage(scratch.path());
  const StageSource source(c);
  std::set<std::pair<int, int>> places;
  std::map<std::pair<int, int>, int> covered;  // pixels of the body, how often they are shown
  for (uint64_t n = 0; n < 400; ++n) {
    const StageView view = source.view({2, 1}, {.side = 8, .seed = 5}, n);
    ASSERT_EQ(view.image.width, 8);
    ASSERT_EQ(view.image.height, 8);
    ASSERT_TRUE(view.left >= 0 && view.left + 8 <= kWidth && view.top >= 0 &&
                view.top + 8 <= kHeight);
    places.emplace(view.left, view.top);
    float most = 0;
    for (int y = 0; y < 8; ++y)
      for (int x = 0; x < 8; ++x) {
        const size_t i = static_cast<size_t>(8 * y + x);
        EXPECT_FLOAT_EQ(view.image.plane(1)[i],
                        level(2, 1, view.left + x, view.top + y, 1) / 255.0f);
        most = std::max(most, view.mask[i]);
        if (view.mask[i] > 0) ++covered[{view.left + x, view.top + y}];
      }
    EXPECT_EQ(most, 1.0f);
    // What the crop's camera projects is the image's pixel less the corner.
    const Vec3d point(0.01, -0.02, -1);
    const Vec2d whole = c.cameras[1].camera.project(point), part = view.view.project(point);
    EXPECT_NEAR(part.x() + view.left, whole.x(), 1e-9);
    EXPECT_NEAR(part.y() + view.top, whole.y(), 1e-9);
  }
  EXPECT_GT(places.size(), 60u);
  int body = 0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) body += body_at(2, x, y);
  EXPECT_EQ(covered.size(), static_cast<size_t>(body));
  for (const auto& [pixel, count] : covered) EXPECT_GT(count, 40);
  // All of the body with one pixel around it; a square larger than the image.
  const StageView trimmed = source.view({2, 1}, {.side = 0, .border = 1});
  EXPECT_EQ(trimmed.top, 3);
  EXPECT_EQ(trimmed.image.height, 15);
  double inside = 0;
  for (const float m : trimmed.mask) inside += m;
  EXPECT_EQ(inside, body);
  const StageView large = source.view({2, 1}, {.side = 64}, 3);
  EXPECT_EQ(large.image.width, kWidth);
  EXPECT_EQ(large.image.height, kHeight);
  // Nothing of the body in the picture: somewhere, but no error.
  write_png8(c.folder / stage_mask_path("c1", c.frames[2].number), Image8(kWidth, kHeight, 1));
  EXPECT_EQ(source.view({2, 1}, {.side = 8}, 1).image.width, 8);
  EXPECT_EQ(source.view({2, 1}, {.side = 0, .border = 1}).image.width, kWidth);
}

TEST(StageViews, SameForEveryNumberOfThreadsAndQueue) {
  const test::ScratchFolder scratch;
  const StageCapture c = write_stage(scratch.path());
  damage(c, 4, 3);
  const StageSource source(c);
  const auto run = [&](int threads, int ahead, uint64_t first) {
    StageViewsOptions options;
    options.crop = {.side = 6, .seed = 2};
    options.threads = threads;
    options.ahead = ahead;
    StageViews views(source, all_of(c), options, first);
    std::vector<std::vector<float>> shown;
    for (uint64_t n = first; n < 60; ++n) {
      EXPECT_EQ(views.number(), n);
      const std::optional<StageView> view = views.next();
      if (!view) return shown;
      EXPECT_EQ(view->number, n);
      shown.push_back(view->image.data);
      shown.back().push_back(static_cast<float>(100 * view->frame + view->camera));
      shown.back().insert(shown.back().end(), view->moment->vertices.begin(),
                          view->moment->vertices.end());
    }
    EXPECT_EQ(views.missing(), 1u);
    return shown;
  };
  const auto reference = run(0, 1, 0);
  ASSERT_EQ(reference.size(), 60u);
  for (const auto& [threads, ahead] : {std::pair{1, 1}, {1, 4}, {3, 2}, {3, 7}, {8, 3}})
    EXPECT_EQ(run(threads, ahead, 0), reference) << threads << ' ' << ahead;
  // Begun in the middle, the rest is the same.
  const auto rest = run(2, 4, 23);
  EXPECT_EQ(rest, decltype(rest)(reference.begin() + 23, reference.end()));
}

TEST(StageViews, ADamagedViewIsReplacedOrLeftOutAndCounted) {
  const test::ScratchFolder scratch;
  const StageCapture c = write_stage(scratch.path());
  damage(c, 1, 1);
  fs::remove(c.folder / stage_mask_path("c2", c.frames[5].number));
  const StageSource source(c);
  {
    StageViews views(source, all_of(c), {});
    for (int n = 0; n < 100; ++n) {
      const std::optional<StageView> view = views.next();
      ASSERT_TRUE(view);
      EXPECT_FALSE(view->frame == 1 && view->camera == 1);
      EXPECT_FALSE(view->frame == 5 && view->camera == 2);
    }
    EXPECT_EQ(views.missing(), 2u);
  }
  StageViewsOptions once;
  once.endless = false;
  once.threads = 3;
  StageViews views(source,
                   StageSchedule::in_order(c, c.frames_of(StageSplit::kTrain), {0, 1, 2, 3}), once);
  std::vector<int> shown;
  while (const std::optional<StageView> view = views.next())
    shown.push_back(kCameras * view->frame + view->camera);
  ASSERT_EQ(shown.size(), 22u);
  for (size_t i = 1; i < shown.size(); ++i) EXPECT_GT(shown[i], shown[i - 1]);
  EXPECT_EQ(views.missing(), 2u);
  EXPECT_FALSE(views.next());
}

TEST(StageViews, MoreThanATenthMissingIsAnErrorThatNamesTheFirst) {
  const test::ScratchFolder scratch;
  const StageCapture c = write_stage(scratch.path());
  for (const int camera : {0, 1, 3}) damage(c, 2, camera);
  const StageSource source(c);
  for (const int threads : {0, 2}) {
    StageViewsOptions options;
    options.threads = threads;
    StageViews views(source, all_of(c), options);
    const std::string sentence = error_of([&] {
      for (int n = 0; n < 60; ++n) views.next();
    });
    EXPECT_TRUE(contains(sentence, "3 of")) << sentence;
    EXPECT_TRUE(contains(sentence, "000011.png")) << sentence;
    EXPECT_TRUE(contains(sentence, "more than a tenth")) << sentence;
  }
  // A frame without its mesh is missing from every camera.
  const test::ScratchFolder other;
  const StageCapture d = write_stage(other.path());
  fs::remove(d.folder / "frames/000001.safetensors");
  StageViews views(StageSource(d), all_of(d), {});
  EXPECT_TRUE(contains(error_of([&] {
                         for (int n = 0; n < 60; ++n) views.next();
                       }),
                       "000001.safetensors"));
}

TEST(StageViews, EndsWhileViewsAreWaiting) {
  const test::ScratchFolder scratch;
  const StageCapture c = write_stage(scratch.path());
  const StageSource source(c);
  for (int k = 0; k < 20; ++k) {
    StageViewsOptions options;
    options.threads = 4;
    StageViews views(source, all_of(c), options);
    if (k % 2 == 1) {
      EXPECT_TRUE(views.next());
    }
  }
}

TEST(StageViews, BadNumbersAreNamed) {
  const test::ScratchFolder scratch;
  const StageCapture good = write_stage(scratch.path());
  StageCapture c = good;
  c.body_from_rest[2] = {};
  EXPECT_TRUE(contains(error_of([&] { StageSource s(c); }), "frame 11"));
  c = good;
  c.body_keypoints[4] = NAN;
  write_stage_capture(c, scratch.path());
  const std::string sentence = error_of([&] { read_stage_capture(scratch.path()); });
  EXPECT_TRUE(contains(sentence, "body_keypoints") && contains(sentence, "not finite")) << sentence;
}

// A photograph of what is behind: with fully lit views of its camera alone, cropped as they are.
TEST(StageSource, BackgroundsOfFullyLitViews) {
  const test::ScratchFolder scratch;
  StageCapture capture = write_stage(scratch.path());
  capture.cameras[1].background = true;
  Image8 behind(kWidth, kHeight, 3);
  for (size_t i = 0; i < behind.data.size(); ++i) behind.data[i] = static_cast<uint8_t>(i % 251);
  write_png8(scratch / stage_background_path("c1"), behind);
  write_stage_capture(capture, scratch.path());
  capture = read_stage_capture(scratch.path());
  EXPECT_TRUE(capture.cameras[1].background);
  EXPECT_FALSE(capture.cameras[0].background);
  const StageSource source(capture);
  EXPECT_TRUE(source.view({0, 0}, {0, 1, 0}).background.data.empty());
  EXPECT_TRUE(source.view({1, 1}, {0, 1, 0}).background.data.empty());
  StageView view = source.view({0, 1}, {0, 1, 0});
  ASSERT_EQ(view.background.width, view.image.width);
  ASSERT_EQ(view.background.height, view.image.height);
  const uint8_t* corner = behind.at(view.left, view.top);
  for (int c = 0; c < 3; ++c)
    EXPECT_FLOAT_EQ(view.background.plane(c)[0],
                    linear_from_srgb(static_cast<float>(corner[c]) / 255));
  const Planes before = view.image;
  put_on_black(view);
  EXPECT_TRUE(view.background.data.empty());
  for (size_t p = 0; p < view.mask.size(); ++p)
    EXPECT_EQ(view.image.plane(1)[p], view.mask[p] * before.plane(1)[p]);
  fs::remove(scratch / stage_background_path("c1"));
  EXPECT_TRUE(contains(error_of([&] { source.view({0, 1}, {0, 1, 0}); }), "backgrounds"));
}

}  // namespace
}  // namespace effigy
