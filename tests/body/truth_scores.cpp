// A body's surface beside a truth that is known in closed form.
#include "effigy/body/truth_scores.h"

#include <cmath>

#include "effigy/body/trainer.h"
#include "effigy/image/files.h"
#include "lit_ball.h"
#include "support.h"

namespace effigy {
namespace {

TEST(BodyTruthScores, ABallOfGaussiansIsNearTheBall) {
  const test::ScratchFolder scratch;
  StageCapture capture = test::write_lit_ball(scratch.path(), 4, 64, true);
  BodyTrainSettings settings = BodyTrainSettings::from_preset("quick");
  settings.iterations = 1;
  BodyTrainer trainer(capture, settings);
  std::fill(trainer.model().maps().log_roughness.begin(),
            trainer.model().maps().log_roughness.end(), std::log(0.36f));
  BodyViewer viewer(settings, trainer.model(), trainer.moments());
  const DrawnView drawn = viewer.draw({1, 3});
  const std::optional<SurfaceScores> scores = score_surface(viewer, capture);
  ASSERT_TRUE(scores.has_value());
  EXPECT_LT(scores->depth_error_mm, 8);  // blended depth lies behind a rim
  EXPECT_LT(scores->normal_degrees, 12);
  // The lobe's width is the square of a roughness: sqrt(0.36) against 0.5.
  EXPECT_NEAR(scores->roughness_error, 0.1, 1e-3);
  const SurfaceImages surface = drawn_surface(viewer);
  EXPECT_EQ(surface.albedo.width, drawn.drawn.width);

  // A map that is twice as bright scores the same; a layer that is missing leaves the scores out.
  for (float& v : trainer.model().maps().albedo) v *= 0.5f;
  viewer.draw({1, 3});
  EXPECT_NEAR(score_surface(viewer, capture)->albedo_error, scores->albedo_error, 1e-5);
  capture.layers = {"albedo", "depth"};
  EXPECT_FALSE(score_surface(viewer, capture).has_value());
}

TEST(BodyTruthScores, NamesADamagedLayer) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path(), 4, 64, true);
  const Path file = scratch.path() / stage_layer_path("normal", capture.cameras[3].name, 1);
  write_exr(file, Image(8, 8, 3), false);
  const StageSource source(capture);
  const StageView view = source.view({1, 3}, {0, 4, 0});
  try {
    (void)true_surface(capture, view);
    FAIL();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("normal"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace effigy
