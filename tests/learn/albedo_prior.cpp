#include "effigy/learn/albedo_prior.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {
namespace {

double srgb(double x) {
  return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

struct Case {
  Planes gbuffer, prior;
  std::vector<float> mask;
  Case(int width, int height, uint64_t seed)
      : gbuffer(width, height, kGBufferPlanes), prior(width, height, 3), mask(prior.pixels()) {
    Random random(seed);
    for (size_t i = 0; i < mask.size(); ++i) {
      const double alpha = random.below(8) == 0 ? 0.005 : random.uniform(0.05, 1.0);
      gbuffer.plane(kAlpha)[i] = static_cast<float>(alpha);
      for (int c = 0; c < 3; ++c) {
        const double albedo = random.below(5) == 0 ? 0.002 : random.uniform(0.02, 0.9);
        gbuffer.plane(kAlbedo + c)[i] = static_cast<float>(alpha * albedo);
        prior.plane(c)[i] = static_cast<float>(random.uniform());
      }
      mask[i] = random.below(4) == 0 ? 0.0f : static_cast<float>(random.uniform(0.3, 1.0));
    }
  }
};

double oracle(const Case& c, const std::vector<double>& alpha, const std::vector<double>& albedo,
              bool mean_over_mask) {
  double sum = 0, masks = 0;
  for (size_t i = 0; i < c.mask.size(); ++i) {
    if (c.gbuffer.plane(kAlpha)[i] < 0.01f) continue;
    masks += c.mask[i];
    for (size_t k = 0; k < 3; ++k)
      sum += c.mask[i] *
             std::abs(srgb(albedo[3 * i + k] / alpha[i]) - c.prior.plane(static_cast<int>(k))[i]);
  }
  return sum / (3 * (mean_over_mask ? masks : static_cast<double>(c.mask.size())));
}

TEST(AlbedoPrior, ValueAndGradients) {
  const Case c(19, 9, 3);
  const size_t n = c.mask.size();
  std::vector<double> alpha(c.gbuffer.plane(kAlpha), c.gbuffer.plane(kAlpha) + n), albedo(3 * n);
  for (size_t i = 0; i < n; ++i)
    for (size_t k = 0; k < 3; ++k)
      albedo[3 * i + k] = c.gbuffer.plane(kAlbedo + static_cast<int>(k))[i];
  for (const bool over_mask : {false, true}) {
    AlbedoPriorOptions options;
    options.mean_over_mask = over_mask;
    Planes d(19, 9, kGBufferPlanes, 0.5f);
    const double value = albedo_prior_loss(c.gbuffer, c.prior, c.mask, options, 3.0f, &d);
    EXPECT_NEAR(value, oracle(c, alpha, albedo, over_mask), 2e-6);
    EXPECT_NEAR(albedo_prior_loss(c.gbuffer, c.prior, c.mask, options, 3.0f, nullptr), value, 1e-6);
    const auto check = [&](std::vector<double>& x, size_t i, float got) {
      const double keep = x[i], h = 1e-7;
      x[i] = keep + h;
      const double up = oracle(c, alpha, albedo, over_mask);
      x[i] = keep - h;
      const double want = 3.0 * (up - oracle(c, alpha, albedo, over_mask)) / (2 * h);
      x[i] = keep;
      EXPECT_NEAR(got - 0.5, want, 2e-6 + 1e-4 * std::abs(want)) << i;
    };
    for (size_t i = 0; i < n; ++i) {
      check(alpha, i, d.plane(kAlpha)[i]);
      for (size_t k = 0; k < 3; ++k)
        check(albedo, 3 * i + k, d.plane(kAlbedo + static_cast<int>(k))[i]);
      EXPECT_EQ(d.plane(kDepth)[i], 0.5f);
    }
  }
}

TEST(AlbedoPrior, NothingToCompareIsZero) {
  Case c(8, 8, 5);
  std::fill(c.mask.begin(), c.mask.end(), 0.0f);
  AlbedoPriorOptions options;
  options.mean_over_mask = true;
  Planes d(8, 8, kGBufferPlanes);
  EXPECT_EQ(albedo_prior_loss(c.gbuffer, c.prior, c.mask, options, 1.0f, &d), 0.0);
  EXPECT_EQ(albedo_prior_loss(c.gbuffer, c.prior, c.mask, {}, 1.0f, &d), 0.0);
  for (const float value : d.data) EXPECT_EQ(value, 0.0f);
}

TEST(AlbedoPrior, ThreadCountDoesNotChangeBits) {
  const Case c(50, 66, 7);
  const int before = thread_count();
  std::vector<float> first;
  double first_value = 0;
  for (const int threads : {1, 2}) {
    set_thread_count(threads);
    Planes d(50, 66, kGBufferPlanes);
    const double value = albedo_prior_loss(c.gbuffer, c.prior, c.mask, {}, 1.0f, &d);
    if (threads == 1) first = d.data, first_value = value;
    EXPECT_EQ(d.data, first);
    EXPECT_EQ(value, first_value);
  }
  set_thread_count(before);
}

TEST(AlbedoPrior, Speed) {
  const Case c(512, 512, 9);
  Planes d(512, 512, kGBufferPlanes);
  double best = 1e9;
  for (int i = 0; i < 5; ++i) {
    const auto start = std::chrono::steady_clock::now();
    albedo_prior_loss(c.gbuffer, c.prior, c.mask, {}, 1.0f, &d);
    const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start;
    best = std::min(best, time.count());
  }
  std::printf("albedo prior 512x512, forward+backward: %.2f ms\n", best * 1e3);
  EXPECT_LT(best, 0.2);
}

}  // namespace
}  // namespace effigy
