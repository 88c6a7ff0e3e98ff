#include "effigy/body/trainer.h"

#include <cmath>
#include <fstream>
#include <functional>
#include <iterator>

#include "effigy/body/body_avatar.h"
#include "effigy/body/evaluate.h"
#include "effigy/body/renderer.h"
#include "effigy/body/train_run.h"
#include "effigy/image/metrics.h"
#include "lit_ball.h"
#include "support.h"

namespace effigy {
namespace {

BodyTrainSettings quick(int iterations) {
  BodyTrainSettings settings = BodyTrainSettings::from_preset("quick");
  settings.iterations = iterations;
  settings.evaluate_every = 0;
  settings.checkpoint_every = 1000;
  return settings;
}

// A view of the capture drawn from an avatar's folder in two ways: as eval does, and as render
// does.
struct DrawnFolder {
  StageSource source;
  StageMoments moments;
  BodyViewer viewer;
  DrawnView seen;
  BodyRenderer renderer;

  DrawnFolder(const StageCapture& capture, BodyAvatar& avatar)
      : source(capture),
        moments(source, avatar.model.shadow_texels(), avatar.settings),
        viewer(avatar.settings, avatar.model, moments),
        seen(viewer.draw({1, 0})),
        renderer(avatar) {
    renderer.set_pose(avatar.tracks.at("train").poses[1]);
    renderer.set_points(source.moment(1).lights);
  }
  double agreement() {  // dB
    const Image drawn = to_image(renderer.draw(viewer.view().view));
    return psnr(to_float(to_8bit(drawn)), seen.drawn);
  }
};

std::string bytes_of(const Path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

TEST(BodyTrainer, LearnsALitBall) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path());
  BodyTrainer trainer(capture, quick(160));
  double first = 0, last = 0;
  while (trainer.iteration() < 160) {
    const BodyLossValues losses = trainer.step();
    for (const auto& [name, value] : losses) ASSERT_TRUE(std::isfinite(value)) << name;
    if (trainer.iteration() <= 10) first += losses.at("l1") / 10;
    if (trainer.iteration() > 150) last += losses.at("l1") / 10;
  }
  EXPECT_LT(last, 0.6 * first);
  // A view, a light and a motion that were held out; and light matters.
  trainer.model().networks().set_training(false);
  BodyViewer viewer(trainer.settings(), trainer.model(), trainer.moments());
  const double relit = score_of(viewer.draw({6, 3})).psnr;
  EXPECT_GT(relit, 19.0);
  EXPECT_LT(score_of(viewer.draw_in_light_of({5, 3}, 0)).psnr,
            score_of(viewer.draw({5, 3})).psnr - 0.7);
}

TEST(BodyTrainer, StartsWithTheAlbedoOfTheFrames) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path());
  BodyTrainer trainer(capture, quick(1));
  const UvTexels& texels = trainer.model().texels();
  const TexelFrames frames =
      texel_frames(texels, capture.rig.mesh.vertices, capture.rig.mesh.triangles);
  // The untrained shadow network darkens everything by one factor.
  double product = 0, square = 0, truth = 0;
  size_t seen = 0;
  for (size_t i = 0; i < texels.count(); ++i) {
    const Vec3f local(&frames.position[3 * i]);
    if (local.z() < 0.03f) continue;
    const Vec3f albedo = test::ball_albedo(local);
    for (size_t c = 0; c < 3; ++c) {
      const double a = static_cast<double>(albedo[static_cast<int>(c)]);
      const double b = static_cast<double>(trainer.model().maps().albedo[3 * i + c]);
      product += a * b;
      square += b * b;
      truth += a * a;
      ++seen;
    }
  }
  ASSERT_GT(seen, 300u);
  EXPECT_GT(product / std::sqrt(square * truth), 0.98);
}

TEST(BodyTrainer, ResumeIsBitExact) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch / "capture", 4, 32);
  const BodyTrainSettings settings = quick(8);
  BodyTrainer straight(capture, settings);
  for (int i = 0; i < 4; ++i) straight.step();
  straight.save_checkpoint(scratch / "half.safetensors");
  for (int i = 0; i < 4; ++i) straight.step();
  straight.save_checkpoint(scratch / "straight.safetensors");
  BodyTrainer resumed(capture, settings);
  resumed.load_checkpoint(scratch / "half.safetensors");
  EXPECT_EQ(resumed.iteration(), 4);
  for (int i = 0; i < 4; ++i) resumed.step();
  resumed.save_checkpoint(scratch / "resumed.safetensors");
  EXPECT_EQ(bytes_of(scratch / "straight.safetensors"), bytes_of(scratch / "resumed.safetensors"));
}

// What differs in how light becomes colour trains too, and draws the same from its folder.
TEST(BodyTrainer, OtherWaysOfLight) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch / "capture", 7, 32);
  int run = 0;
  for (const auto& change : std::vector<std::function<void(BodyTrainSettings&)>>{
           [](BodyTrainSettings& s) { s.shadow_groups = 3; },
           [](BodyTrainSettings& s) { s.appearance = "sh_turned"; },
           [](BodyTrainSettings& s) {
             s.environment_bands = "table";
             s.environment_from = 3;
           }}) {
    BodyTrainSettings settings = quick(30);
    change(settings);
    const Path out = scratch / std::to_string(run++);
    train_body(capture, settings, out, {});
    BodyAvatar avatar = read_body_avatar(out);
    DrawnFolder drawn(capture, avatar);
    EXPECT_GT(drawn.agreement(), 38.0) << run;
    EXPECT_GT(score_of(drawn.seen).psnr, 17.0) << run;
    const Image shadow = body_buffer_values(drawn.renderer.picture(), "shadow");
    for (const float value : shadow.data) ASSERT_TRUE(value >= 0 && value <= 1.001f);
  }
}

// Fully lit pictures before a bright wall: the avatar is drawn over it, or both are put on black;
// on black before the wall it would be far off.
TEST(BodyTrainer, BackgroundsAreBehindTheBody) {
  const test::ScratchFolder scratch;
  StageCapture capture = test::write_lit_ball(scratch.path(), 4, 32);
  BodyTrainSettings settings = quick(1);
  const auto score = [&] {
    BodyTrainer trainer(capture, settings);
    BodyViewer viewer(settings, trainer.model(), trainer.moments());
    return score_of(viewer.draw({0, 1})).psnr;
  };
  const double on_black = score();
  Image8 wall(32, 32, 3);
  for (size_t i = 0; i < wall.data.size(); ++i) wall.data[i] = static_cast<uint8_t>(90 + i % 60);
  capture.cameras[1].background = true;
  write_png8(scratch / stage_background_path("cam1"), wall);
  Image8 image = capture.load_image(1, 0);
  const Image8 mask = capture.load_mask(1, 0);
  for (size_t p = 0; p < mask.data.size(); ++p)
    for (size_t c = 0; c < 3; ++c)
      if (mask.data[p] == 0) image.data[3 * p + c] = wall.data[3 * p + c];
  write_png8(scratch / stage_image_path("cam1", 0), image);
  EXPECT_GT(score(), on_black - 1);
  capture.cameras[1].background = false;
  EXPECT_LT(score(), on_black - 3);
  capture.cameras[1].background = true;
  settings.backgrounds = false;
  EXPECT_NEAR(score(), on_black, 1e-9);
}

TEST(BodyTrainer, CheckpointsOfOthersAreRefused) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch / "capture", 4, 32);
  BodyTrainer trainer(capture, quick(8));
  trainer.save_checkpoint(scratch / "c.safetensors");
  BodyTrainer longer(capture, quick(9));
  EXPECT_TRUE(
      test::contains(test::error_of([&] { longer.load_checkpoint(scratch / "c.safetensors"); }),
                     "other settings"));
  const StageCapture other = test::write_lit_ball(scratch / "other", 5, 32);
  BodyTrainer elsewhere(other, quick(8));
  EXPECT_TRUE(
      test::contains(test::error_of([&] { elsewhere.load_checkpoint(scratch / "c.safetensors"); }),
                     "another capture"));
}

TEST(BodyTrainer, NothingToTrainOn) {
  const test::ScratchFolder scratch;
  StageCapture capture = test::write_lit_ball(scratch.path(), 3, 32);
  for (StageCamera& camera : capture.cameras) camera.test = true;
  EXPECT_TRUE(test::contains(test::error_of([&] { BodyTrainer(capture, quick(1)); }),
                             "no training frames or no training cameras"));
}

TEST(BodyTrainer, BatchesAverage) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch.path(), 4, 32);
  BodyTrainSettings settings = quick(2);
  settings.batch = 3;
  BodyTrainer trainer(capture, settings);
  BodyTrainer single(capture, quick(6));
  const BodyLossValues together = trainer.step();
  double l1 = 0;
  // The first view alone is the same; afterwards the single one has learned.
  l1 = single.step().at("l1");
  EXPECT_NEAR(together.at("l1"), l1, 0.5 * l1);
  EXPECT_EQ(trainer.iteration(), 1);
}

// The folder that training writes, read back, draws what the trained model drew; a repainted PNG is
// simply used; keypoints follow from the rig alone.
TEST(BodyAvatar, IsAFolderThatDrawsTheSame) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch / "capture", 7, 48);
  const Path out = scratch / "avatar";
  const Json training = train_body(capture, quick(40), out, {});
  EXPECT_EQ(training["iterations"], 40);
  EXPECT_LT(training["keypoints_from_rig_worst_m"].get<double>(), 1e-4);
  EXPECT_FALSE(std::filesystem::exists(out / "checkpoint.safetensors"));

  BodyAvatar avatar = read_body_avatar(out);
  EXPECT_EQ(avatar.tracks.at("train").poses.size(), capture.frames.size());
  DrawnFolder drawn(capture, avatar);
  EXPECT_GT(drawn.agreement(), 38.0);
  BodyRenderer& renderer = drawn.renderer;
  BodyViewer& viewer = drawn.viewer;
  PointLights lamps = drawn.source.moment(1).lights;

  // Twice the light is twice the radiance, whatever the shadow network says.
  const std::vector<float> once = renderer.picture().radiance().data;
  for (PointLight& lamp : lamps.lights) lamp.intensity *= 2;
  renderer.set_points(lamps);
  renderer.draw(viewer.view().view);
  for (size_t i = 0; i < once.size(); ++i)
    ASSERT_NEAR(renderer.picture().radiance().data[i], 2 * once[i], 1e-4f);

  Image black(avatar.model.texels().size, avatar.model.texels().size, 3);
  write_png16(out / "textures/albedo.png", black);
  BodyAvatar painted = read_body_avatar(out);
  BodyRenderer dark(painted);
  dark.set_pose(painted.tracks.at("train").poses[1]);
  dark.set_points(lamps);
  dark.draw(viewer.view().view);
  double sum = 0, sum_before = 0;
  for (size_t i = 0; i < once.size(); ++i) {
    sum += static_cast<double>(dark.picture().radiance().data[i]);
    sum_before += static_cast<double>(once[i]);
  }
  EXPECT_LT(sum, 0.3 * sum_before);  // highlights are left
}

TEST(BodyAvatar, DamagedFoldersAreNamed) {
  const test::ScratchFolder scratch;
  const StageCapture capture = test::write_lit_ball(scratch / "capture", 3, 32);
  const Path out = scratch / "avatar";
  train_body(capture, quick(1), out, {});
  const auto with = [&](const std::function<void()>& harm) {
    const Path copy = scratch / "copy";
    std::filesystem::remove_all(copy);
    std::filesystem::copy(out, copy, std::filesystem::copy_options::recursive);
    std::filesystem::current_path(copy);
    harm();
    const std::string sentence = test::error_of([&] { read_body_avatar(copy); });
    std::filesystem::current_path(scratch.path());
    return sentence;
  };
  EXPECT_TRUE(
      test::contains(with([] { std::filesystem::remove("avatar.json"); }), "not an avatar"));
  EXPECT_TRUE(test::contains(with([] { std::filesystem::remove("networks.safetensors"); }),
                             "networks.safetensors"));
  EXPECT_TRUE(test::contains(with([] { write_png16("textures/albedo.png", Image(9, 12, 3)); }),
                             "must be square"));
  EXPECT_TRUE(test::contains(with([] {
                               Json info = read_json("avatar.json");
                               info["camera"]["fx"] = -1;
                               write_json("avatar.json", info);
                             }),
                             "camera"));
  EXPECT_TRUE(test::contains(with([] {
                               Json info = read_json("avatar.json");
                               info["settings"]["sg_norm"] = "loud";
                               write_json("avatar.json", info);
                             }),
                             "sg_norm"));
}

}  // namespace
}  // namespace effigy
