// Relighting scores: the truth is the avatar itself in another light of known brightness.
#include "effigy/head/relight.h"

#include "effigy/image/files.h"
#include "head/untrained_head.h"

namespace effigy {
namespace {

class Relit : public test::UntrainedHead {
 protected:
  void SetUp() override {
    Image light(64, 32, 3, 0.2f);
    for (int y = 4; y < 16; ++y)
      for (int x = 0; x < 20; ++x) light.at(x, y)[0] = light.at(x, y)[1] = 3.0f;
    write_exr(folder_.path() / "lights/side.exr", light, false);
  }

  // The held-out frames in that light times `brightness`, as the truth.
  void write_truth_images(float brightness) {
    HeadRenderer renderer(avatar_);
    Image light = read_environment(folder_.path() / "lights/side.exr");
    for (float& v : light.data) v *= brightness;
    renderer.set_light(prefilter_environment(light));
    Json images = Json::object();
    for (const int frame : capture_.test_frames()) {
      renderer.set_pose(capture_.poses[frame]);
      const std::string name = "relight/" + std::to_string(frame) + ".png";
      write_png8(folder_.path() / name, to_8bit(to_image(renderer.draw(capture_.camera))));
      images[std::to_string(capture_.frames[frame].number)] = name;
    }
    capture_.extra["relight"]["side"] = {{"light", "lights/side.exr"}, {"images", images}};
  }

  RelightScores score() {
    const std::vector<RelightSet> sets = relight_sets(capture_);
    EXPECT_EQ(sets.size(), 1u);
    return score_relight(avatar_, capture_, sets.at(0));
  }
};

TEST_F(Relit, TheSameLightIsTheTruth) {
  write_truth_images(1.0f);
  const RelightScores s = score();
  EXPECT_GT(s.psnr, 99);
  EXPECT_NEAR(s.ssim, 1, 1e-6);
  EXPECT_NEAR(s.scale, 1, 0.01);
  EXPECT_GT(s.psnr_aligned, 50);
  EXPECT_LT(s.psnr_unlit, s.psnr_aligned - 10);
}

TEST_F(Relit, AlignedScoresAreFreeOfBrightness) {
  write_truth_images(0.5f);
  const RelightScores s = score();
  EXPECT_NEAR(s.scale, 0.5, 0.01);
  EXPECT_LT(s.psnr, 35);
  EXPECT_GT(s.psnr_aligned, 45);
  EXPECT_GT(s.ssim_aligned, s.ssim);
}

TEST_F(Relit, NamesAFrameThatIsNotThere) {
  write_truth_images(1.0f);
  capture_.extra["relight"]["side"]["images"]["999"] = "relight/999.png";
  EXPECT_THROW(relight_sets(capture_), Error);
}

}  // namespace
}  // namespace effigy
