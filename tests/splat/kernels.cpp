// The table-driven harness of the rasterizer's kernels. Rows: random scenes, one per kind of
// trouble (random_scenes.h), times every instruction set this machine has. Three modes: forward
// against the double-precision oracle, gradient against finite differences of the oracle, speed.

#include <gtest/gtest.h>

#include <bit>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_kernels.h"
#include "splat/kernel_targets.h"
#include "splat/oracle.h"
#include "splat/random_scenes.h"

namespace effigy {
namespace {

std::vector<int64_t> all_targets() {
  std::vector<int64_t> targets = surfel_kernel_targets();
  targets.push_back(0);
  return targets;
}

struct Drawn {
  Planes gbuffer;
  SurfelFrame frame;
};

Drawn draw(const RandomScene& scene) {
  Drawn drawn;
  render_surfels(scene.camera, scene.surfels, scene.texture, scene.options, drawn.gbuffer,
                 drawn.frame);
  return drawn;
}

struct Gradients {
  PosedSurfels surfels;
  std::vector<float> texels;
};

Gradients go_back(const RandomScene& scene, const Drawn& drawn, const Planes& upstream) {
  Gradients g;
  g.surfels.resize(scene.surfels.count());
  g.texels.resize(scene.texture.texels.size());
  render_surfels_backward(scene.camera, scene.surfels, scene.texture, scene.options, drawn.gbuffer,
                          drawn.frame, upstream, g.surfels, g.texels);
  return g;
}

oracle::Scene oracle_scene(const RandomScene& scene) {
  return oracle::make_scene(scene.camera, scene.surfels, scene.texture, scene.options);
}

// 99.9th percentile of the error within 1e-4 of the plane's largest value.
void expect_planes_near(const oracle::Image& expected, const Planes& actual, int planes) {
  ASSERT_EQ(actual.data.size(), expected.planes.size());
  const size_t pixels = actual.pixels();
  for (int plane = 0; plane < planes; ++plane) {
    std::vector<double> errors(pixels);
    double largest = 1e-6;
    for (size_t i = 0; i < pixels; ++i) {
      const double e = expected.planes[static_cast<size_t>(plane) * pixels + i];
      const double a = static_cast<double>(actual.plane(plane)[i]);
      ASSERT_TRUE(std::isfinite(a));
      largest = std::max(largest, std::abs(e));
      errors[i] = std::abs(a - e);
    }
    std::sort(errors.begin(), errors.end());
    EXPECT_LE(errors[pixels * 999 / 1000], 1e-4 * largest) << "plane " << plane;
  }
}

class SurfelKernelTest : public testing::TestWithParam<SceneCase> {};

// The float with only as many bits as a half has.
float cut_to_half(float x) {
  return std::bit_cast<float>(std::bit_cast<uint32_t>(x) & 0xffffe000u);
}

TEST_P(SurfelKernelTest, ForwardAgreesWithTheOracle) {
  RandomScene scene = GetParam().make();
  for (float& x : scene.texture.texels) x = cut_to_half(x);
  const oracle::Image expected = oracle::render(oracle_scene(scene));
  for (const int64_t target : all_targets()) {
    const UseTarget use(target);
    SCOPED_TRACE(target_name(target));
    if (target != 0) {
      EXPECT_STREQ(best_surfel_kernels().target, hwy::TargetName(target));
    }
    const Drawn drawn = draw(scene);
    // A pixel may differ where a threshold is met to the last bit.
    EXPECT_NEAR(static_cast<double>(drawn.frame.pairs()), static_cast<double>(expected.pairs),
                1 + 1e-4 * static_cast<double>(expected.pairs));
    expect_planes_near(expected, drawn.gbuffer, kGBufferPlanes);
    // Playback with a lookup for every surfel is the same picture, without the distortion.
    Drawn played;
    const PlaybackOptions playback{scene.options.near, scene.options.low_pass, 0.0f, 0.0f};
    render_surfels_playback(scene.camera, scene.surfels, PlaybackTexture(scene.texture), playback,
                            played.gbuffer, played.frame);
    expect_planes_near(expected, played.gbuffer, kUvDistortion);
    EXPECT_EQ(played.frame.pairs(), drawn.frame.pairs());
  }
}

// Derivatives of sum(upstream * output) by central differences of the oracle; NaN where the two
// ends of the step took different decisions (thresholds, clamps, texel borders), or left out by
// `stride`.
class Differences {
 public:
  Differences(const RandomScene& scene, const Planes& upstream)
      : scene_(oracle_scene(scene)), upstream_(upstream) {}

  std::vector<double> of(std::vector<double> oracle::Surfels::*field, size_t stride = 1) {
    return of(scene_.surfels.*field, stride);
  }
  std::vector<double> of_texels(size_t stride) { return of(scene_.texels, stride); }

 private:
  std::vector<double> of(std::vector<double>& x, size_t stride) {
    std::vector<double> g(x.size(), std::nan(""));
    for (size_t i = 0; i < x.size(); i += stride) {
      const double at = x[i], h = 1e-7;
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
  std::pair<double, uint64_t> value() const {
    const oracle::Image image = oracle::render(scene_);
    double sum = 0;
    for (size_t i = 0; i < image.planes.size(); ++i)
      sum += image.planes[i] * static_cast<double>(upstream_.data[i]);
    return {sum, image.signature};
  }
  oracle::Scene scene_;
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

TEST_P(SurfelKernelTest, GradientAgreesWithFiniteDifferences) {
  const RandomScene scene = GetParam().make();
  const Planes upstream = random_upstream(scene.camera, kGBufferPlanes, 3);
  Differences differences(scene, upstream);
  const size_t n = scene.surfels.count();
  struct Row {
    const char* name;
    std::vector<float> PosedSurfels::*actual;
    std::vector<double> expected;
  };
  using S = oracle::Surfels;
  const Row rows[] = {
      {"center", &PosedSurfels::center, differences.of(&S::center)},
      {"s", &PosedSurfels::s, differences.of(&S::s)},
      {"t", &PosedSurfels::t, differences.of(&S::t)},
      {"opacity", &PosedSurfels::opacity, differences.of(&S::opacity)},
      {"uv", &PosedSurfels::uv, differences.of(&S::uv)},
      {"uv_per_st", &PosedSurfels::uv_per_st, differences.of(&S::uv_per_st)},
      {"frame", &PosedSurfels::frame, differences.of(&S::frame)},
  };
  const std::vector<double> texels = differences.of_texels(23);
  for (const int64_t target : all_targets()) {
    const UseTarget use(target);
    SCOPED_TRACE(target_name(target));
    const Gradients g = go_back(scene, draw(scene), upstream);
    for (const Row& row : rows) {
      size_t known = 0;
      EXPECT_LE(relative_error(row.expected, g.surfels.*row.actual, known), 1e-3) << row.name;
      EXPECT_GE(2 * known, (g.surfels.*row.actual).size()) << "too few entries checked";
    }
    size_t known = 0;
    EXPECT_LE(relative_error(texels, g.texels, known), 1e-3) << "texels";
    EXPECT_GT(known, 0u);
    for (size_t i = 7; i < g.texels.size(); i += 8) EXPECT_EQ(g.texels[i], 0.0f);
  }
  EXPECT_EQ(n == 0, std::string(GetParam().name) == "Empty");
}

INSTANTIATE_TEST_SUITE_P(Scenes, SurfelKernelTest, testing::ValuesIn(kSceneCases),
                         [](const auto& tested) { return std::string(tested.param.name); });

TEST(SurfelKernelSpeed, TheBestKernelsAreSeveralTimesFasterThanOneLane) {
  RandomScene scene = soup(192, 192, 700, 5, 0.3, 21);
  Random random(5);
  scene.texture = random_texture(256, 256, random);
  const Planes upstream = random_upstream(scene.camera, kGBufferPlanes, 4);
  expect_faster_than_one_lane(
      surfel_kernel_targets(), [&] { return draw(scene); },
      [&](const Drawn& drawn) { go_back(scene, drawn, upstream); });
}

TEST(SurfelRaster, ForwardIsTheSameForEveryThreadCount) {
  const RandomScene scene = soup(90, 70, 120, 6, 0.2, 31);
  const int before = thread_count();
  set_thread_count(1);
  const Drawn one = draw(scene);
  set_thread_count(3);
  const Drawn three = draw(scene);
  set_thread_count(before);
  EXPECT_EQ(one.gbuffer.data, three.gbuffer.data);
  EXPECT_EQ(one.frame.pairs(), three.frame.pairs());
}

TEST(SurfelRaster, BackwardRepeatsBitForBitAndAgreesAcrossThreadCounts) {
  const RandomScene scene = soup(90, 70, 120, 6, 0.2, 32);
  const Planes upstream = random_upstream(scene.camera, kGBufferPlanes, 5);
  const int before = thread_count();
  set_thread_count(1);
  const Gradients one = go_back(scene, draw(scene), upstream);
  set_thread_count(3);
  const Drawn drawn = draw(scene);
  const Gradients three = go_back(scene, drawn, upstream);
  const Gradients again = go_back(scene, drawn, upstream);
  set_thread_count(before);
  EXPECT_EQ(three.surfels.center, again.surfels.center);
  EXPECT_EQ(three.surfels.uv_per_st, again.surfels.uv_per_st);
  EXPECT_EQ(three.texels, again.texels);
  size_t known = 0;
  const std::vector<double> wide(one.texels.begin(), one.texels.end());
  EXPECT_LT(relative_error(wide, three.texels, known), 1e-5);
  const std::vector<double> center(one.surfels.center.begin(), one.surfels.center.end());
  EXPECT_LT(relative_error(center, three.surfels.center, known), 1e-4);
}

TEST(SurfelRaster, BackwardAddsToWhatIsThere) {
  const RandomScene scene = plain_scene();
  const Planes upstream = random_upstream(scene.camera, kGBufferPlanes, 6);
  const Drawn drawn = draw(scene);
  const Gradients alone = go_back(scene, drawn, upstream);
  Gradients sum;
  sum.surfels.resize(scene.surfels.count());
  std::fill(sum.surfels.center.begin(), sum.surfels.center.end(), 2.0f);
  sum.texels.assign(scene.texture.texels.size(), 3.0f);
  render_surfels_backward(scene.camera, scene.surfels, scene.texture, scene.options, drawn.gbuffer,
                          drawn.frame, upstream, sum.surfels, sum.texels);
  for (size_t i = 0; i < sum.surfels.center.size(); ++i)
    EXPECT_NEAR(sum.surfels.center[i], alone.surfels.center[i] + 2.0f,
                1e-5f * (3.0f + std::abs(alone.surfels.center[i])));
  for (size_t i = 0; i < sum.texels.size(); ++i)
    EXPECT_NEAR(sum.texels[i], alone.texels[i] + 3.0f, 1e-5f * (4.0f + std::abs(alone.texels[i])));
}

TEST(SurfelRaster, AFrameCanBeUsedAgainForOtherScenes) {
  Drawn reused;
  for (const auto make : {plain_scene, empty_scene, huge_scene, stacked_scene, plain_scene}) {
    const RandomScene scene = make();
    const Planes upstream = random_upstream(scene.camera, kGBufferPlanes, 7);
    const Drawn fresh = draw(scene);
    render_surfels(scene.camera, scene.surfels, scene.texture, scene.options, reused.gbuffer,
                   reused.frame);
    EXPECT_EQ(fresh.gbuffer.data, reused.gbuffer.data);
    EXPECT_EQ(go_back(scene, fresh, upstream).texels, go_back(scene, reused, upstream).texels);
  }
}

TEST(SurfelRaster, ASurfelsSidesDifferOnlyInTheirNormals) {
  RandomScene scene = soup(32, 32, 1, 6, 0.5, 41);
  const Drawn front = draw(scene);
  std::swap(scene.surfels.s, scene.surfels.t);  // turns the normal, and nothing else but s and t
  std::swap(scene.surfels.uv_per_st[0], scene.surfels.uv_per_st[1]);
  std::swap(scene.surfels.uv_per_st[2], scene.surfels.uv_per_st[3]);
  const Drawn back = draw(scene);
  for (int plane = 0; plane < kGBufferPlanes; ++plane) {
    const float sign = plane >= kMappedNormal && plane < kMappedNormal + 3 ? -1.0f : 1.0f;
    for (size_t i = 0; i < front.gbuffer.pixels(); ++i)
      EXPECT_NEAR(front.gbuffer.plane(plane)[i], sign * back.gbuffer.plane(plane)[i], 1e-4f)
          << "plane " << plane;
  }
}

// A smooth texture seen through layers that agree about it: one lookup does for all.
TEST(SurfelPlayback, SharedLookupsAreCloseToALookupForEverySurfel) {
  Random random(8);
  RandomScene scene = soup(64, 64, 0, 5, 0.6, 51);
  scene.texture = MaterialTexture(64, 64);
  for (size_t y = 0; y < 64; ++y) {
    for (size_t x = 0; x < 64; ++x) {
      float* texel = &scene.texture.texels[8 * (64 * y + x)];
      for (size_t c = 0; c < 7; ++c)
        texel[c] = 0.4f + 0.3f * std::sin(0.2f * static_cast<float>(x + c) +
                                          0.15f * static_cast<float>(y));
    }
  }
  const Camera& camera = scene.camera;
  const Mat3d world_from_camera = camera.camera_from_world_rotation.transpose();
  for (int i = 0; i < 500; ++i) {
    const double x = random.uniform(0, 64), y = random.uniform(0, 64), z = random.uniform(2.9, 3.1);
    const double sx = 3.0 * z / camera.fx, sy = 3.0 * z / camera.fy;
    add_surfel(scene.surfels, world_at(camera, x, y, z), world_from_camera * Vec3d(sx, 0, 0),
               world_from_camera * Vec3d(0, sy, 0), 0.7, random);
    // uv = pixel / 64, but for a tenth of a texel.
    const size_t k = scene.surfels.count() - 1;
    scene.surfels.uv[2 * k] = static_cast<float>((x + random.uniform(-0.1, 0.1)) / 64);
    scene.surfels.uv[2 * k + 1] = static_cast<float>((y + random.uniform(-0.1, 0.1)) / 64);
    const float j[4] = {3.0f / 64, 0, 0, 3.0f / 64};
    std::copy_n(j, 4, &scene.surfels.uv_per_st[4 * k]);
    for (size_t c = 0; c < 9; ++c) scene.surfels.frame[9 * k + c] = scene.surfels.frame[c];
  }
  const auto play = [&](float spread) {
    Drawn drawn;
    render_surfels_playback(camera, scene.surfels, PlaybackTexture(scene.texture),
                            {0.01f, true, spread, 0.0f}, drawn.gbuffer, drawn.frame);
    return drawn.gbuffer;
  };
  const Planes every = play(0.0f), shared = play(1.0f);
  for (int plane = 0; plane < kUvDistortion; ++plane) {
    double error = 0;
    for (size_t i = 0; i < every.pixels(); ++i)
      error += std::pow(static_cast<double>(every.plane(plane)[i] - shared.plane(plane)[i]), 2);
    EXPECT_LT(std::sqrt(error / static_cast<double>(every.pixels())), 1e-3) << "plane " << plane;
  }
  EXPECT_NE(every.data, shared.data);  // they did share
}

// Materials are drawn as the texture's to within a half's rounding.
TEST(SurfelPlayback, TexelsAreRoundedToHalves) {
  const RandomScene scene = soup(40, 30, 200, 9, 0.9, 61);
  const Drawn exact = draw(scene);
  for (const int64_t target : all_targets()) {
    const UseTarget use(target);
    Drawn played;
    render_surfels_playback(scene.camera, scene.surfels, PlaybackTexture(scene.texture),
                            {scene.options.near, scene.options.low_pass, 0.0f, 0.0f},
                            played.gbuffer, played.frame);
    for (int plane = kAlbedo; plane < kNormal; ++plane)
      for (size_t i = 0; i < exact.gbuffer.pixels(); ++i)
        EXPECT_NEAR(exact.gbuffer.plane(plane)[i], played.gbuffer.plane(plane)[i], 6e-4f);
  }
}

// only_shading draws its planes like the others and keeps out of the rest.
TEST(SurfelPlayback, OnlyShadingDrawsTheSamePlanes) {
  const RandomScene scene = soup(70, 50, 60, 9, 0.8, 62);
  const PlaybackTexture texture(scene.texture);
  PlaybackOptions options;
  Drawn all, some;
  render_surfels_playback(scene.camera, scene.surfels, texture, options, all.gbuffer, all.frame);
  options.only_shading = true;
  some.gbuffer = Planes(70, 50, kGBufferPlanes, 7.0f);
  render_surfels_playback(scene.camera, scene.surfels, texture, options, some.gbuffer, some.frame);
  size_t covered = 0;
  for (size_t i = 0; i < all.gbuffer.pixels(); ++i) {
    const float alpha = all.gbuffer.plane(kAlpha)[i];
    EXPECT_EQ(some.gbuffer.plane(kAlpha)[i], alpha);
    for (const int plane : {int{kDepth}, int{kNormal}, int{kUv}, int{kUvDistortion}})
      EXPECT_EQ(some.gbuffer.plane(plane)[i], 7.0f);
    if (alpha == 0.0f) continue;
    ++covered;
    for (const int plane : {int{kAlbedo}, int{kAlbedo} + 2, int{kRoughness}, int{kSpecular},
                            int{kMappedNormal}, int{kMappedNormal} + 2})
      EXPECT_EQ(some.gbuffer.plane(plane)[i], all.gbuffer.plane(plane)[i]);
  }
  EXPECT_GT(covered, 500u);
}

// What passes a pixel that is done falls on its last surfel: nothing of it is lost.
TEST(SurfelPlayback, PixelsThatAreDoneAreFull) {
  const RandomScene scene = soup(64, 64, 1500, 9, 0.8, 63);
  const PlaybackTexture texture(scene.texture);
  PlaybackOptions options{scene.options.near, scene.options.low_pass, 0.0f, 0.0f};
  Drawn all, done;
  render_surfels_playback(scene.camera, scene.surfels, texture, options, all.gbuffer, all.frame);
  options.opaque = 0.05f;
  render_surfels_playback(scene.camera, scene.surfels, texture, options, done.gbuffer, done.frame);
  size_t full = 0;
  for (size_t i = 0; i < all.gbuffer.pixels(); ++i) {
    const float before = all.gbuffer.plane(kAlpha)[i], after = done.gbuffer.plane(kAlpha)[i];
    if (before > 0.951f) {
      EXPECT_NEAR(after, 1.0f, 1e-5f);
      ++full;
    }
    EXPECT_GE(after, before - 1e-4f);
    EXPECT_LE(after, before + 0.05f);
  }
  EXPECT_GT(full, 500u);
  EXPECT_LT(done.frame.pairs(), all.frame.pairs());
}

TEST(SurfelRasterErrors, SizesThatMakeNoSenseAreRefused) {
  RandomScene scene = plain_scene();
  Drawn drawn;
  const auto run = [&](const RandomScene& s) {
    render_surfels(s.camera, s.surfels, s.texture, s.options, drawn.gbuffer, drawn.frame);
  };
  RandomScene bad = scene;
  bad.camera.width = 0;
  EXPECT_THROW(run(bad), Error);
  bad = scene;
  bad.camera.fx = std::nan("");
  EXPECT_THROW(run(bad), Error);
  bad = scene;
  bad.texture = MaterialTexture();
  EXPECT_THROW(run(bad), Error);
}

}  // namespace
}  // namespace effigy
