// What training starts from: colours gathered from the frames.
#include "effigy/head/start_texture.h"

#include "effigy/head/trainer.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

TrainSettings tiny_settings(bool start) {
  TrainSettings settings = TrainSettings::from_preset("quick");
  settings.surfels = 400;
  settings.texture_size = 64;
  settings.start_from_frames = start;
  settings.start_light = false;  // the picture is flat: no light explains it
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
