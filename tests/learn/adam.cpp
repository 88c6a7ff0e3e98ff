#include "effigy/learn/adam.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

std::vector<float> noise(size_t count, uint64_t seed, double scale = 1.0) {
  Random random(seed);
  std::vector<float> values(count);
  for (float& value : values) value = static_cast<float>(scale * random.normal());
  return values;
}

TEST(Adam, MatchesDoublePrecision) {
  const size_t count = 1003;
  std::vector<float> p = noise(count, 1);
  std::vector<double> want(p.begin(), p.end()), m(count), v(count);
  AdamState state(count);
  const AdamSettings settings;
  for (int t = 1; t <= 60; ++t) {
    const std::vector<float> g = noise(count, 100 + static_cast<uint64_t>(t), 1e-3);
    EXPECT_EQ(adam_step(p, g, state, 0.01f, settings), 0u);
    for (size_t i = 0; i < count; ++i) {
      m[i] = 0.9 * m[i] + 0.1 * g[i];
      v[i] = 0.999 * v[i] + 0.001 * static_cast<double>(g[i]) * g[i];
      want[i] -= 0.01 * (m[i] / (1 - std::pow(0.9, t))) /
                 (std::sqrt(v[i] / (1 - std::pow(0.999, t))) + 1e-15);
    }
  }
  EXPECT_EQ(state.step, 60);
  for (size_t i = 0; i < count; ++i) EXPECT_NEAR(p[i], want[i], 2e-5) << i;
}

TEST(Adam, FirstStepIsTheLearningRateWhateverTheGradient) {
  std::vector<float> p(3, 0.0f);
  const std::vector<float> g{1e-9f, -3.0f, 1e6f};
  AdamState state(3);
  adam_step(p, g, state, 0.5f);
  EXPECT_NEAR(p[0], -0.5f, 1e-4f);  // eps 1e-15 is small against 1e-9 as well
  EXPECT_NEAR(p[1], 0.5f, 1e-5f);
  EXPECT_NEAR(p[2], -0.5f, 1e-5f);
}

TEST(Adam, GradientsThatAreNotFiniteCountAsZero) {
  std::vector<float> p(40, 1.0f), g(40, 0.0f);
  g[3] = std::numeric_limits<float>::quiet_NaN();
  g[17] = std::numeric_limits<float>::infinity();
  g[39] = -std::numeric_limits<float>::infinity();
  AdamState state(40);
  EXPECT_EQ(adam_step(p, g, state, 0.1f), 3u);
  for (const float value : p) EXPECT_EQ(value, 1.0f);
}

TEST(Adam, MomentsNeverBecomeSubnormal) {
  std::vector<float> p(8, 0.0f);
  AdamState state(8);
  adam_step(p, std::vector<float>(8, 1e-3f), state, 0.1f);
  const std::vector<float> zero(8, 0.0f);
  for (int i = 0; i < 1200; ++i) adam_step(p, zero, state, 0.1f);
  for (const float value : state.m) EXPECT_EQ(value, 0.0f);
  for (const float value : p) EXPECT_TRUE(std::isfinite(value));
}

TEST(Adam, SavedAndLoadedGoesOnBitForBit) {
  const size_t count = 500;
  std::vector<float> p = noise(count, 5);
  AdamState state(count);
  for (uint64_t t = 0; t < 7; ++t) adam_step(p, noise(count, t + 10), state, 0.02f);
  TensorFile file;
  save_adam(state, "texture", file);
  const Path path = Path(testing::TempDir()) / "effigy_adam.safetensors";
  write_safetensors(path, file);
  AdamState loaded = load_adam(read_safetensors(path), "texture", count);
  EXPECT_EQ(loaded.step, 7);
  std::vector<float> q = p;
  for (uint64_t t = 0; t < 3; ++t) {
    adam_step(p, noise(count, t + 90), state, 0.02f);
    adam_step(q, noise(count, t + 90), loaded, 0.02f);
  }
  EXPECT_EQ(p, q);
  EXPECT_EQ(state.m, loaded.m);
  EXPECT_EQ(state.v, loaded.v);
  EXPECT_THROW(load_adam(read_safetensors(path), "texture", count + 1), Error);
  EXPECT_THROW(load_adam(read_safetensors(path), "rotation", count), Error);
  file.tensors["texture.v"] =
      Tensor::from(std::vector<float>(count, -1.0f), {static_cast<int64_t>(count)});
  EXPECT_THROW(load_adam(file, "texture", count), Error);
  std::filesystem::remove(path);
}

TEST(Adam, RearrangeKeepsMomentsOfSurvivors) {
  AdamState state(6);
  for (size_t i = 0; i < 6; ++i) {
    state.m[i] = static_cast<float>(i);
    state.v[i] = static_cast<float>(10 + i);
  }
  const std::vector<int32_t> source{2, -1, 0, 2};
  state.rearrange(source, 2);
  EXPECT_EQ(state.m, (std::vector<float>{4, 5, 0, 0, 0, 1, 4, 5}));
  EXPECT_EQ(state.v, (std::vector<float>{14, 15, 0, 0, 10, 11, 14, 15}));
}

TEST(Adam, ThreadCountDoesNotChangeBits) {
  const size_t count = 70001;
  const std::vector<float> g = noise(count, 3);
  const int before = thread_count();
  std::vector<float> one(count), two(count);
  AdamState a(count), b(count);
  set_thread_count(1);
  adam_step(one, g, a, 0.1f);
  const GradientCheck first = check_gradient(g);
  set_thread_count(2);
  adam_step(two, g, b, 0.1f);
  const GradientCheck second = check_gradient(g);
  set_thread_count(before);
  EXPECT_EQ(one, two);
  EXPECT_EQ(a.v, b.v);
  EXPECT_EQ(first.norm, second.norm);
}

TEST(Gradient, CheckAndClip) {
  std::vector<float> g = noise(40003, 9);
  double squares = 0;
  for (const float value : g) squares += static_cast<double>(value) * value;
  const GradientCheck clean = check_gradient(g);
  EXPECT_NEAR(clean.norm, std::sqrt(squares), 1e-9 * std::sqrt(squares));
  EXPECT_EQ(clean.not_finite, 0u);
  const float kept = g[5];
  EXPECT_NEAR(clip_gradient(g, 1e9).norm, clean.norm, 0.0);
  EXPECT_EQ(g[5], kept);
  clip_gradient(g, 2.0);
  EXPECT_NEAR(check_gradient(g).norm, 2.0, 1e-5);
  g[7] = std::numeric_limits<float>::quiet_NaN();
  g[40002] = std::numeric_limits<float>::infinity();
  EXPECT_EQ(check_gradient(g).not_finite, 2u);
  EXPECT_TRUE(std::isfinite(check_gradient(g).norm));
  clip_gradient(g, 100.0);
  EXPECT_EQ(g[7], 0.0f);
  EXPECT_EQ(g[40002], 0.0f);
}

TEST(Adam, Speed) {
  const size_t count = size_t{8} << 20;
  std::vector<float> p(count, 0.5f);
  const std::vector<float> g(count, 1e-3f);
  AdamState state(count);
  double best = 1e9;
  for (int i = 0; i < 4; ++i) {
    const auto start = std::chrono::steady_clock::now();
    adam_step(p, g, state, 0.01f);
    best = std::min(
        best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  std::printf("Adam over 8.4 M parameters: %.2f ms\n", best * 1e3);
  EXPECT_LT(best, 1.0);
}

}  // namespace
}  // namespace effigy
