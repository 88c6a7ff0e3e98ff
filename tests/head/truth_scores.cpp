// Scores against a synthetic capture's truth: nothing off scores nothing, known errors score
// themselves.
#include "effigy/head/truth_scores.h"

#include <numbers>

#include "effigy/image/files.h"
#include "head/untrained_head.h"

namespace effigy {
namespace {

// The tiny capture with layers that are what an untrained avatar draws.
class TruthScored : public test::UntrainedHead {
 protected:
  void SetUp() override {
    make_opaque(8.0f);
    frames_ = capture_.test_frames();
    for (const char* name : {"radiance", "albedo", "material", "normal", "depth"})
      truth_.layers[name] = Path("layers") / name;
    truth_.transport = "split-sum";
    truth_.poses = capture_.poses;
    truth_.identity = capture_.identity;
    truth_.vertices.assign(capture_.frames.size() * capture_.rig.mesh.vertices.size(), 0.0f);
    truth_.keypoints.assign(capture_.frames.size() * 68 * 3, 0.0f);
    write_truth(truth_, capture_, folder_.path());
    write_exr(folder_.path() / "lights/own.exr",
              equirectangular_from_cubemap(avatar_.environment, 64, 32), false);
    capture_.extra["light"] = "lights/own.exr";
  }

  // Writes the layers as the avatar draws them; `normal_turn` radians about x, the others added.
  void write_layers(float roughness, float specular, double normal_turn, float depth,
                    float albedo_scale) {
    HeadRenderer renderer(avatar_);
    for (const int frame : frames_) {
      renderer.set_pose(capture_.poses[frame]);
      renderer.draw(capture_.camera);
      const Planes& g = renderer.gbuffer();
      Image radiance(g.width, g.height, 4), albedo(g.width, g.height, 3),
          material(g.width, g.height, 3), normal(g.width, g.height, 3), z(g.width, g.height, 1);
      const Eigen::Matrix3f turn =
          Eigen::AngleAxisf(static_cast<float>(normal_turn), Vec3f::UnitX()).toRotationMatrix();
      for (size_t i = 0; i < g.pixels(); ++i) {
        const float alpha = g.plane(kAlpha)[i];
        if (alpha <= 0) continue;
        const auto value = [&](int plane) { return g.plane(plane)[i] / alpha; };
        radiance.data[4 * i + 3] = alpha;
        for (int c = 0; c < 3; ++c) albedo.data[3 * i + c] = albedo_scale * value(kAlbedo + c);
        material.data[3 * i] = value(kRoughness) + roughness;
        material.data[3 * i + 1] = value(kSpecular) + specular;
        Eigen::Map<Vec3f>(&normal.data[3 * i]) =
            turn * Vec3f(value(kMappedNormal), value(kMappedNormal + 1), value(kMappedNormal + 2))
                       .normalized();
        z.data[i] = value(kDepth) + depth;
      }
      const Path name = capture_.frames[frame].image.filename().replace_extension(".exr");
      const auto put = [&](const char* layer, const Image& image) {
        write_exr(folder_.path() / truth_.layers[layer] / name, image, false);
      };
      put("radiance", radiance);
      put("albedo", albedo);
      put("material", material);
      put("normal", normal);
      put("depth", z);
    }
  }

  CaptureTruth truth_;
  std::vector<int> frames_;
};

TEST_F(TruthScored, NothingOffScoresNothing) {
  write_layers(0, 0, 0, 0, 1);
  const auto scores = score_truth(avatar_, capture_, frames_);
  ASSERT_TRUE(scores.has_value());
  EXPECT_LT(scores->surface.albedo_error, 1e-5);
  EXPECT_LT(scores->surface.roughness_error, 1e-6);
  EXPECT_LT(scores->surface.specular_error.value(), 1e-6);
  EXPECT_LT(scores->surface.normal_degrees, 0.05);
  EXPECT_LT(scores->surface.depth_error_mm, 1e-3);
  EXPECT_LT(scores->environment_error, 0.01);
}

TEST_F(TruthScored, KnownErrorsScoreThemselvesAndAlbedosScaleIsFree) {
  write_layers(0.1f, -0.01f, 10 * std::numbers::pi / 180, 0.005f, 0.5f);
  const auto scores = score_truth(avatar_, capture_, frames_);
  ASSERT_TRUE(scores.has_value());
  EXPECT_LT(scores->surface.albedo_error, 1e-4);
  EXPECT_NEAR(scores->surface.roughness_error, 0.1, 1e-5);
  EXPECT_NEAR(scores->surface.specular_error.value(), 0.01, 1e-5);
  EXPECT_GT(scores->surface.normal_degrees, 5);  // a normal along x does not turn
  EXPECT_LT(scores->surface.normal_degrees, 10.01);
  EXPECT_NEAR(scores->surface.depth_error_mm, 5, 1e-2);
}

TEST_F(TruthScored, CapturesWithoutTruthHaveNoScores) {
  capture_.extra = Json::object();
  EXPECT_FALSE(score_truth(avatar_, capture_, frames_).has_value());
}

TEST(LightError, IsFreeOfScaleAndSeesWhereLightComesFrom) {
  Cubemap light(8, 0.1f), other(8, 0.1f);
  for (int c = 0; c < 3; ++c) {
    light.texels[(2 * 64 + 27) * 3 + c] = 200.0f;  // +y
    other.texels[(3 * 64 + 27) * 3 + c] = 200.0f;  // -y
  }
  Cubemap twice = light;
  for (float& v : twice.texels) v *= 2;
  EXPECT_LT(light_error(twice, light), 1e-5);
  EXPECT_GT(light_error(other, light), 0.5);
}

}  // namespace
}  // namespace effigy
