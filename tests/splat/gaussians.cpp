// The table-driven harness of the Gaussian rasterizer. Rows: random scenes, one per kind of trouble
// (random_gaussians.h), times every instruction set this machine has. Three modes: forward against
// the double-precision oracle, gradient against finite differences of the oracle, speed.

#include <gtest/gtest.h>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/splat/gaussian_kernels.h"
#include "splat/gaussian_oracle.h"
#include "splat/kernel_targets.h"
#include "splat/random_gaussians.h"

namespace effigy {
namespace {

std::vector<int64_t> all_targets() {
  std::vector<int64_t> targets = gaussian_kernel_targets();
  targets.push_back(0);
  return targets;
}

struct Drawn {
  Planes image;
  GaussianFrame frame;
};

Drawn draw(const GaussianScene3d& scene) {
  Drawn drawn;
  render_gaussians(scene.camera, scene.gaussians.view(), scene.options, drawn.image, drawn.frame);
  return drawn;
}

struct Gradients {
  Gaussians gaussians;
  std::vector<float> background;
  GaussianGradients spans() {
    Gaussians& g = gaussians;
    return {g.center, g.rotation, g.scale, g.opacity, g.features, background};
  }
};

Gradients go_back(const GaussianScene3d& scene, const Drawn& drawn, const Planes& upstream) {
  Gradients g;
  g.gaussians.channels = scene.gaussians.channels;
  g.gaussians.resize(scene.gaussians.count());
  g.background.resize(static_cast<size_t>(scene.gaussians.channels));
  render_gaussians_backward(scene.camera, scene.gaussians.view(), scene.options, drawn.image,
                            drawn.frame, upstream, g.spans());
  return g;
}

gaussian_oracle::Scene oracle_scene(const GaussianScene3d& scene) {
  return gaussian_oracle::make_scene(scene.camera, scene.gaussians, scene.options);
}

// Every pixel within 1e-4 of the plane's largest value, except where the oracle stands on the edge
// of a decision, there within 5e-3.
void expect_image_near(const gaussian_oracle::Image& expected, const Planes& actual) {
  ASSERT_EQ(actual.data.size(), expected.planes.size());
  const size_t pixels = actual.pixels();
  for (int plane = 0; plane < actual.count; ++plane) {
    const double* e = expected.planes.data() + static_cast<size_t>(plane) * pixels;
    double largest = 1e-6;
    for (size_t i = 0; i < pixels; ++i) largest = std::max(largest, std::abs(e[i]));
    for (size_t i = 0; i < pixels; ++i) {
      const double bound = expected.on_the_edge[i] ? 5e-3 : 1e-4;
      ASSERT_NEAR(static_cast<double>(actual.plane(plane)[i]), e[i], bound * largest)
          << "plane " << plane << " pixel " << i;
    }
  }
}

class GaussianTest : public testing::TestWithParam<GaussianCase> {};

TEST_P(GaussianTest, ForwardAgreesWithTheOracle) {
  const GaussianScene3d scene = GetParam().make();
  const gaussian_oracle::Image expected = gaussian_oracle::render(oracle_scene(scene));
  for (const int64_t target : all_targets()) {
    const UseTarget use(target);
    SCOPED_TRACE(target_name(target));
    if (target != 0) {
      EXPECT_STREQ(best_gaussian_kernels().target, hwy::TargetName(target));
    }
    const Drawn drawn = draw(scene);
    EXPECT_NEAR(static_cast<double>(drawn.frame.pairs()), static_cast<double>(expected.pairs),
                1 + 1e-4 * static_cast<double>(expected.pairs));
    expect_image_near(expected, drawn.image);
  }
  EXPECT_EQ(expected.pairs > 0, scene.gaussians.count() > 0);
}

// Derivatives of sum(upstream * image) by central differences of the oracle; NaN where the two ends
// of the step took different decisions.
class Differences {
 public:
  Differences(const GaussianScene3d& scene, const Planes& upstream)
      : scene_(oracle_scene(scene)), upstream_(upstream) {}

  // Steps are a millionth of the value, or of `least`.
  std::vector<double> of(std::vector<double> gaussian_oracle::Scene::*field, double least = 1e-3) {
    std::vector<double>& x = scene_.*field;
    std::vector<double> g(x.size(), std::nan(""));
    for (size_t i = 0; i < x.size(); ++i) {
      const double at = x[i], h = 1e-6 * std::max(least, std::abs(at));
      if (!std::isfinite(at)) continue;
      x[i] = at + h;
      const auto [up, up_signature] = value();
      x[i] = at - h;
      const auto [down, down_signature] = value();
      x[i] = at;
      if (up_signature == down_signature) g[i] = (up - down) / (2 * h);
    }
    return g;
  }

 private:
  std::pair<double, uint64_t> value() const {
    const gaussian_oracle::Image image = gaussian_oracle::render(scene_);
    double sum = 0;
    for (size_t i = 0; i < image.planes.size(); ++i)
      sum += image.planes[i] * static_cast<double>(upstream_.data[i]);
    return {sum, image.signature};
  }
  gaussian_oracle::Scene scene_;
  const Planes& upstream_;
};

// Relative L2 error over the entries that are known; `known` counts them.
double relative_error(const std::vector<double>& expected, const std::vector<float>& actual,
                      size_t& known) {
  EXPECT_EQ(expected.size(), actual.size());
  double error = 0, size = 0;
  known = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    EXPECT_TRUE(std::isfinite(actual[i])) << i;
    if (std::isnan(expected[i])) continue;
    ++known;
    const double e = expected[i] - static_cast<double>(actual[i]);
    error += e * e;
    size += expected[i] * expected[i];
  }
  return size > 1e-20 ? std::sqrt(error / size) : std::sqrt(error);
}

TEST_P(GaussianTest, GradientAgreesWithFiniteDifferences) {
  const GaussianScene3d scene = GetParam().make();
  const Planes upstream = random_upstream(scene.camera, 1 + scene.gaussians.channels, 3);
  Differences differences(scene, upstream);
  using S = gaussian_oracle::Scene;
  struct Row {
    const char* name;
    std::vector<float> Gaussians::*actual;
    std::vector<double> expected;
  };
  const Row rows[] = {
      {"center", &Gaussians::center, differences.of(&S::center)},
      {"rotation", &Gaussians::rotation, differences.of(&S::rotation)},
      {"scale", &Gaussians::scale, differences.of(&S::scale)},
      {"opacity", &Gaussians::opacity, differences.of(&S::opacity)},
      {"features", &Gaussians::features, differences.of(&S::features)},
  };
  const std::vector<double> background = differences.of(&S::background, 1.0);
  for (const int64_t target : all_targets()) {
    const UseTarget use(target);
    SCOPED_TRACE(target_name(target));
    const Gradients g = go_back(scene, draw(scene), upstream);
    size_t known = 0;
    for (const Row& row : rows) {
      const double error = relative_error(row.expected, g.gaussians.*row.actual, known);
      EXPECT_LE(error, 1e-4) << row.name;
      EXPECT_GE(2 * known, (g.gaussians.*row.actual).size()) << "too few entries checked";
      if (std::getenv("EFFIGY_VERBOSE"))
        std::printf("%s %s %.2e\n", GetParam().name, row.name, error);
    }
    EXPECT_LE(relative_error(background, g.background, known), 1e-4);
    EXPECT_EQ(known, g.background.size());
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, GaussianTest, testing::ValuesIn(kGaussianCases),
                         [](const auto& tested) { return std::string(tested.param.name); });

TEST(GaussianSpeed, TheBestKernelsAreSeveralTimesFasterThanOneLane) {
  const GaussianScene3d scene = gaussian_soup(192, 192, 900, 5, 0.3, 3, 21);
  const Planes upstream = random_upstream(scene.camera, 1 + scene.gaussians.channels, 4);
  expect_faster_than_one_lane(
      gaussian_kernel_targets(), [&] { return draw(scene); },
      [&](const Drawn& drawn) { go_back(scene, drawn, upstream); });
}

// More Gaussians than a slot of the parallel sort and of the parallel binning takes.
TEST(GaussianRaster, AnyNumberOfThreadsGivesTheSameBits) {
  const GaussianScene3d scene = gaussian_soup(200, 130, 20000, 1.5, 0.4, 3, 31);
  const Planes upstream = random_upstream(scene.camera, 1 + scene.gaussians.channels, 5);
  const int before = thread_count();
  set_thread_count(1);
  const Drawn one = draw(scene);
  const Gradients one_back = go_back(scene, one, upstream);
  set_thread_count(3);
  const Drawn three = draw(scene);
  const Gradients three_back = go_back(scene, three, upstream);
  set_thread_count(before);
  EXPECT_EQ(one.image.data, three.image.data);
  EXPECT_EQ(one.frame.pairs(), three.frame.pairs());
  EXPECT_EQ(one_back.gaussians.center, three_back.gaussians.center);
  EXPECT_EQ(one_back.gaussians.rotation, three_back.gaussians.rotation);
  EXPECT_EQ(one_back.gaussians.scale, three_back.gaussians.scale);
  EXPECT_EQ(one_back.gaussians.opacity, three_back.gaussians.opacity);
  EXPECT_EQ(one_back.gaussians.features, three_back.gaussians.features);
}

TEST(GaussianRaster, BackwardAddsToWhatIsThere) {
  const GaussianScene3d scene = plain_gaussians();
  const Planes upstream = random_upstream(scene.camera, 1 + scene.gaussians.channels, 6);
  const Drawn drawn = draw(scene);
  const Gradients alone = go_back(scene, drawn, upstream);
  Gradients sum;
  sum.gaussians.resize(scene.gaussians.count());
  std::fill(sum.gaussians.center.begin(), sum.gaussians.center.end(), 2.0f);
  std::fill(sum.gaussians.features.begin(), sum.gaussians.features.end(), 3.0f);
  render_gaussians_backward(scene.camera, scene.gaussians.view(), scene.options, drawn.image,
                            drawn.frame, upstream, sum.spans());
  for (size_t i = 0; i < sum.gaussians.center.size(); ++i)
    EXPECT_NEAR(sum.gaussians.center[i], alone.gaussians.center[i] + 2.0f,
                1e-5f * (3.0f + std::abs(alone.gaussians.center[i])));
  for (size_t i = 0; i < sum.gaussians.features.size(); ++i)
    EXPECT_NEAR(sum.gaussians.features[i], alone.gaussians.features[i] + 3.0f,
                1e-5f * (4.0f + std::abs(alone.gaussians.features[i])));
}

TEST(GaussianRaster, AFrameCanBeUsedAgainForOtherScenes) {
  Drawn reused;
  for (const auto make : {plain_gaussians, no_gaussians, huge_gaussians, ten_channels,
                          stacked_gaussians, plain_gaussians}) {
    const GaussianScene3d scene = make();
    const Planes upstream = random_upstream(scene.camera, 1 + scene.gaussians.channels, 7);
    const Drawn fresh = draw(scene);
    render_gaussians(scene.camera, scene.gaussians.view(), scene.options, reused.image,
                     reused.frame);
    EXPECT_EQ(fresh.image.data, reused.image.data);
    EXPECT_EQ(go_back(scene, fresh, upstream).gaussians.center,
              go_back(scene, reused, upstream).gaussians.center);
  }
}

// Depths that differ by less than a float can tell: the nearer one, not the first, is in front.
TEST(GaussianRaster, OrderIsThatOfDoublePrecision) {
  GaussianScene3d scene = gaussian_soup(16, 16, 0, 1, 0, 1, 8);
  scene.camera.camera_from_world_rotation.setIdentity();
  scene.camera.camera_from_world_translation = Vec3d(0, 0, 4);
  scene.camera.cx = scene.camera.cy = 8;
  Random random(1);
  add_gaussian(scene.gaussians, {0, 0, 1e-8}, Mat3d::Identity(), {1, 1, 1}, 0.99, random);
  add_gaussian(scene.gaussians, {0, 0, 0}, Mat3d::Identity(), {1, 1, 1}, 0.99, random);
  scene.gaussians.features = {0.0f, 1.0f};
  EXPECT_GT(draw(scene).image.plane(1)[8 * 16 + 8], 0.9f);
}

// The opacity's factor holds the total weight of a Gaussian far below a pixel: without it the
// weight is that of the blur, with it that of the Gaussian itself.
TEST(GaussianRaster, CompensationKeepsTheWeightOfSmallGaussians) {
  const auto weight = [](double sigma, bool compensate) {
    GaussianScene3d scene = gaussian_soup(24, 24, 0, 1, 0, 1, 9);
    scene.options.compensate = compensate;
    Random random(2);
    const double unit = 3.0 / scene.camera.fy;
    scene.camera.fx = scene.camera.fy;
    add_gaussian(scene.gaussians, world_at(scene.camera, 12.3, 11.8, 3.0), random_rotation(random),
                 Vec3d::Constant(sigma * unit), 0.9, random);
    double sum = 0;
    const Drawn drawn = draw(scene);
    for (size_t i = 0; i < drawn.image.pixels(); ++i)
      sum += static_cast<double>(drawn.image.plane(0)[i]);
    return sum;
  };
  for (const double sigma : {0.3, 0.6, 1.2}) {
    const double exact = 0.9 * 2 * M_PI * sigma * sigma;
    EXPECT_NEAR(weight(sigma, true), exact, 0.08 * exact) << sigma;
    EXPECT_GT(weight(sigma, false), exact + 1.0) << sigma;
  }
}

TEST(GaussianRasterErrors, ArgumentsThatMakeNoSenseAreRefused) {
  Drawn drawn;
  const auto run = [&](const GaussianScene3d& s) {
    render_gaussians(s.camera, s.gaussians.view(), s.options, drawn.image, drawn.frame);
  };
  GaussianScene3d bad = plain_gaussians();
  bad.camera.width = 0;
  EXPECT_THROW(run(bad), Error);
  bad = plain_gaussians();
  bad.camera.fx = std::nan("");
  EXPECT_THROW(run(bad), Error);
  bad = plain_gaussians();
  bad.options.blur = -1.0f;
  EXPECT_THROW(run(bad), Error);
  bad = plain_gaussians();
  bad.gaussians.channels = 0;
  EXPECT_THROW(run(bad), Error);
  bad = plain_gaussians();
  bad.gaussians.scale.pop_back();
  EXPECT_THROW(run(bad), Error);
}

}  // namespace
}  // namespace effigy
