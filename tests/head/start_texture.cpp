// What training starts from: holes filled, colours gathered from the frames.
#include "effigy/head/start_texture.h"

#include "effigy/head/trainer.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

TEST(FillByWeight, AnEvenColourHasNoHoles) {
  const int width = 37, height = 20;
  std::vector<float> values(2 * width * height, -5.0f), weights(width * height, 0.0f);
  for (int i = 0; i < width * height; i += 11) {
    weights[i] = 2.0f;
    values[2 * i] = 0.25f;
    values[2 * i + 1] = 0.75f;
  }
  fill_by_weight(values, weights, width, height, 2, 1.0f);
  for (int i = 0; i < width * height; ++i) {
    EXPECT_NEAR(values[2 * i], 0.25f, 1e-5f) << i;
    EXPECT_NEAR(values[2 * i + 1], 0.75f, 1e-5f) << i;
  }
}

TEST(FillByWeight, WhatIsKnownStaysAndHolesLieBetween) {
  const int width = 64, height = 64;
  std::vector<float> values(width * height, 99.0f), weights(width * height, 0.0f);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      if (x < 16 || x >= 48) {
        values[y * width + x] = x < 16 ? 0.0f : 1.0f;
        weights[y * width + x] = 1.0f;
      }
  fill_by_weight(values, weights, width, height, 1, 1.0f);
  for (int y = 0; y < height; ++y) {
    EXPECT_EQ(values[y * width + 5], 0.0f);
    EXPECT_EQ(values[y * width + 60], 1.0f);
    for (int x = 16; x < 48; ++x) {
      EXPECT_GE(values[y * width + x], 0.0f);
      EXPECT_LE(values[y * width + x], 1.0f);
    }
    EXPECT_LT(values[y * width + 18], 0.4f);
    EXPECT_GT(values[y * width + 45], 0.6f);
  }
  // A texel that is seen a little takes a little of its surroundings.
  std::vector<float> pair = {0.0f, 1.0f}, little = {0.25f, 1.0f};
  fill_by_weight(pair, little, 2, 1, 1, 1.0f);
  EXPECT_GT(pair[0], 0.2f);
  EXPECT_EQ(pair[1], 1.0f);
}

TEST(FillByWeight, NothingKnownNothingChanged) {
  std::vector<float> values = {1, 2, 3, 4}, weights(4, 0.0f);
  fill_by_weight(values, weights, 2, 2, 1, 1.0f);
  EXPECT_EQ(values, (std::vector<float>{1, 2, 3, 4}));
}

TrainSettings tiny_settings(bool start) {
  TrainSettings settings = TrainSettings::from_preset("quick");
  settings.surfels = 400;
  settings.texture_size = 64;
  settings.start_from_frames = start;
  return settings;
}

TEST(StartFromFrames, TheFirstImageIsNearTheFrame) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path());
  const Capture capture = read_capture(scratch.path());
  HeadTrainer plain(capture, tiny_settings(false)), started(capture, tiny_settings(true));
  EXPECT_LT(started.step().at("l1"), 0.5 * plain.step().at("l1"));
}

TEST(StartFromFrames, TheBackIsFilledFromWhatIsSeen) {
  test::ScratchFolder scratch;
  test::write_tiny_capture(scratch.path());
  const Capture capture = read_capture(scratch.path());
  const TrainSettings settings = tiny_settings(true);
  const HeadModel model = initial_model(capture, settings);
  MaterialTexture texture;
  activate_texture(model.material, {}, texture);
  const UvMask mask = uv_mask(capture.rig.mesh, settings.texture_size);
  // The disc's blue is 90 of 255 everywhere, so all of the ball's is alike, seen or not.
  float least = 1, most = 0;
  for (size_t t = 0; t < mask.flags().size(); ++t) {
    if ((mask.flags()[t] & 1) == 0) continue;
    least = std::min(least, texture.texels[8 * t + 2]);
    most = std::max(most, texture.texels[8 * t + 2]);
  }
  EXPECT_GT(least, 0.05f);
  EXPECT_LT(most, 1.25f * least);
  // The light is even and white.
  for (const float x : model.environment) EXPECT_EQ(x, model.environment[0]);
}

}  // namespace
}  // namespace effigy
