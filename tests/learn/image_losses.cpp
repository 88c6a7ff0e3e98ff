#include "effigy/learn/image_losses.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <vector>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/image/metrics.h"

namespace effigy {
namespace {

using Doubles = std::vector<double>;

// SSIM by its definition in double precision: 2-D Gaussian window 11, zero padding.
double oracle_ssim(const Doubles& x, const Doubles& y, int width, int height) {
  double window[11], norm = 0;
  for (int i = 0; i < 11; ++i) norm += window[i] = std::exp(-(i - 5) * (i - 5) / 4.5);
  double sum = 0;
  for (int row = 0; row < height; ++row)
    for (int column = 0; column < width; ++column) {
      double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
      for (int j = std::max(0, row - 5); j <= std::min(height - 1, row + 5); ++j)
        for (int i = std::max(0, column - 5); i <= std::min(width - 1, column + 5); ++i) {
          const double w = window[j - row + 5] * window[i - column + 5] / (norm * norm);
          const size_t at = static_cast<size_t>(j * width + i);
          mx += w * x[at], my += w * y[at];
          xx += w * x[at] * x[at], yy += w * y[at] * y[at], xy += w * x[at] * y[at];
        }
      sum += (2 * mx * my + 1e-4) * (2 * (xy - mx * my) + 9e-4) /
             ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4));
    }
  return sum / (width * height);
}

struct Scene {
  Planes colour, target, matte;  // matte: alpha, mask
  std::span<const float> alpha() const { return {matte.plane(0), matte.pixels()}; }
  std::span<const float> mask() const { return {matte.plane(1), matte.pixels()}; }
};

// A smooth picture with noise inside `box`, black outside.
Scene make_scene(int width, int height, uint64_t seed, const PixelBox& box) {
  Random random(seed);
  Scene scene{Planes(width, height, 3), Planes(width, height, 3), Planes(width, height, 2)};
  for (int y = box.y0; y < box.y1; ++y)
    for (int x = box.x0; x < box.x1; ++x) {
      const size_t i = static_cast<size_t>(y) * width + x;
      for (int c = 0; c < 3; ++c) {
        const double base = 0.5 + 0.4 * std::sin(0.21 * x + 0.13 * y * (c + 1));
        scene.colour.plane(c)[i] = static_cast<float>(base * random.uniform(0.7, 1.0));
        scene.target.plane(c)[i] = static_cast<float>(base * random.uniform(0.7, 1.0));
      }
      scene.matte.plane(0)[i] = static_cast<float>(random.uniform(0.1, 1.0));
      scene.matte.plane(1)[i] = random.below(2) ? 1.0f : 0.0f;
    }
  return scene;
}

Doubles channel(const Planes& planes, int c) {
  return Doubles(planes.plane(c), planes.plane(c) + planes.pixels());
}

PhotometricLoss oracle(const Scene& scene) {
  const int width = scene.colour.width, height = scene.colour.height;
  PhotometricLoss loss;
  for (int c = 0; c < 3; ++c) {
    const Doubles x = channel(scene.colour, c), y = channel(scene.target, c);
    loss.dssim += (1 - oracle_ssim(x, y, width, height)) / 3;
    for (size_t i = 0; i < x.size(); ++i)
      loss.l1 += std::abs(x[i] - y[i]) / (3.0 * static_cast<double>(x.size()));
  }
  for (size_t i = 0; i < scene.matte.pixels(); ++i)
    loss.mask += std::abs(static_cast<double>(scene.alpha()[i]) - scene.mask()[i]) /
                 static_cast<double>(scene.matte.pixels());
  return loss;
}

PhotometricLoss run(const Scene& scene, const PhotometricWeights& weights, Planes& d_colour,
                    Planes& d_alpha, const PixelBox& box = {}) {
  return photometric_loss(scene.colour, scene.target, scene.alpha(), scene.mask(), weights,
                          &d_colour, {d_alpha.plane(0), d_alpha.pixels()}, box);
}

TEST(ImageLosses, ValuesMatchDefinition) {
  const int sizes[][2] = {{1, 1}, {3, 40}, {37, 29}, {64, 16}};
  for (const auto& size : sizes) {
    const Scene scene = make_scene(size[0], size[1], 3, {0, 0, size[0], size[1]});
    const PhotometricLoss want = oracle(scene);
    const PhotometricLoss got =
        photometric_loss(scene.colour, scene.target, scene.alpha(), scene.mask(), {}, nullptr, {});
    EXPECT_NEAR(got.l1, want.l1, 1e-6);
    EXPECT_NEAR(got.dssim, want.dssim, 5e-6);
    EXPECT_NEAR(got.mask, want.mask, 1e-6);
    Planes d_colour(size[0], size[1], 3), d_alpha(size[0], size[1], 1);
    const PhotometricLoss both = run(scene, {}, d_colour, d_alpha);
    EXPECT_EQ(both.l1, got.l1);
    EXPECT_EQ(both.dssim, got.dssim);
    EXPECT_EQ(both.mask, got.mask);
  }
}

TEST(ImageLosses, DssimIsTheMetricsSsim) {
  const Scene scene = make_scene(70, 51, 4, {9, 2, 66, 51});
  const PhotometricLoss loss =
      photometric_loss(scene.colour, scene.target, {}, {}, {}, nullptr, {});
  EXPECT_NEAR(1.0 - loss.dssim, ssim(to_image(scene.colour), to_image(scene.target)), 2e-6);
  EXPECT_EQ(loss.mask, 0.0);
}

TEST(ImageLosses, EqualImagesGiveZero) {
  Scene scene = make_scene(33, 21, 5, {4, 3, 30, 20});
  scene.target = scene.colour;
  std::copy_n(scene.matte.plane(0), scene.matte.pixels(), scene.matte.plane(1));
  Planes d_colour(33, 21, 3), d_alpha(33, 21, 1);
  const PhotometricLoss loss = run(scene, {}, d_colour, d_alpha);
  EXPECT_EQ(loss.l1, 0.0);
  EXPECT_NEAR(loss.dssim, 0.0, 1e-6);
  EXPECT_EQ(loss.mask, 0.0);
  for (const float g : d_colour.data) EXPECT_NEAR(g, 0.0f, 1e-7f);
  for (const float g : d_alpha.data) EXPECT_EQ(g, 0.0f);
}

// The oracle in double precision, differentiated by central differences.
TEST(ImageLosses, GradientsMatchFiniteDifferences) {
  const int width = 27, height = 23;
  const Scene scene = make_scene(width, height, 7, {0, 0, width, height});
  const PhotometricWeights weights{0.7f, 0.9f, 0.3f};
  Planes d_colour(width, height, 3, 0.5f), d_alpha(width, height, 1, 0.25f);  // must add
  run(scene, weights, d_colour, d_alpha);
  const double pixels = width * height;
  for (int c = 0; c < 3; ++c) {
    Doubles x = channel(scene.colour, c);
    const Doubles y = channel(scene.target, c);
    for (size_t i = static_cast<size_t>(c); i < x.size(); i += 7) {
      const double keep = x[i], h = 1e-5;
      x[i] = keep + h;
      const double up = oracle_ssim(x, y, width, height);
      x[i] = keep - h;
      const double down = oracle_ssim(x, y, width, height);
      x[i] = keep;
      const double want = -weights.dssim * (up - down) / (2 * h) / 3 +
                          weights.l1 * (x[i] > y[i] ? 1 : -1) / (3 * pixels);
      EXPECT_NEAR(d_colour.plane(c)[i] - 0.5, want, 2e-7 + 1e-4 * std::abs(want)) << c << " " << i;
    }
  }
  for (size_t i = 0; i < d_alpha.pixels(); ++i) {
    const float difference = scene.alpha()[i] - scene.mask()[i];
    const double want = difference == 0 ? 0 : std::copysign(weights.mask / pixels, difference);
    EXPECT_NEAR(d_alpha.data[i] - 0.25, want, 1e-7);
  }
}

TEST(ImageLosses, BoxGivesTheResultOfTheWholeImage) {
  const int width = 90, height = 70;
  for (const PixelBox& box : {PixelBox{31, 22, 60, 45}, PixelBox{0, 3, 12, 70}}) {
    const Scene scene = make_scene(width, height, 11, box);
    EXPECT_EQ(nonzero_box(scene.colour, scene.target, scene.alpha(), scene.mask()), box);
    Planes whole(width, height, 3), whole_alpha(width, height, 1);
    Planes part(width, height, 3), part_alpha(width, height, 1);
    const PhotometricLoss a = run(scene, {}, whole, whole_alpha);
    const PhotometricLoss b = run(scene, {}, part, part_alpha, box);
    EXPECT_NEAR(a.l1, b.l1, 1e-9);
    EXPECT_NEAR(a.dssim, b.dssim, 1e-7);
    EXPECT_NEAR(a.mask, b.mask, 1e-9);
    for (size_t i = 0; i < whole.data.size(); ++i)
      ASSERT_NEAR(whole.data[i], part.data[i], 1e-9f) << i;
    for (size_t i = 0; i < whole_alpha.data.size(); ++i)
      ASSERT_EQ(whole_alpha.data[i], part_alpha.data[i]);
  }
  const Scene black = make_scene(20, 20, 1, {});
  EXPECT_TRUE(nonzero_box(black.colour, black.target, black.alpha(), black.mask()).empty());
}

TEST(ImageLosses, BitReproducibleForEveryThreadCount) {
  const Scene scene = make_scene(75, 61, 13, {5, 5, 70, 60});
  const int before = thread_count();
  std::vector<float> first;
  PhotometricLoss first_loss;
  for (const int threads : {1, 2}) {
    set_thread_count(threads);
    Planes d_colour(75, 61, 3), d_alpha(75, 61, 1);
    const PhotometricLoss loss = run(scene, {}, d_colour, d_alpha);
    if (first.empty()) {
      first = d_colour.data;
      first_loss = loss;
    }
    EXPECT_EQ(d_colour.data, first);
    EXPECT_EQ(loss.dssim, first_loss.dssim);
    EXPECT_EQ(loss.l1, first_loss.l1);
  }
  set_thread_count(before);
}

TEST(ImageLosses, Speed) {
  const int size = 512;
  const Scene scene = make_scene(size, size, 17, {100, 60, 420, 512});
  Planes d_colour(size, size, 3), d_alpha(size, size, 1);
  double best = 1e9, best_box = 1e9, best_value = 1e9;
  const auto seconds = [](auto&& body) {
    const auto start = std::chrono::steady_clock::now();
    body();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  for (int i = 0; i < 8; ++i) {
    best = std::min(best, seconds([&] { run(scene, {}, d_colour, d_alpha); }));
    best_box = std::min(best_box, seconds([&] {
                          run(scene, {}, d_colour, d_alpha,
                              nonzero_box(scene.colour, scene.target, scene.alpha(), scene.mask()));
                        }));
    best_value = std::min(best_value, seconds([&] {
                            photometric_loss(scene.colour, scene.target, scene.alpha(),
                                             scene.mask(), {}, nullptr, {});
                          }));
  }
  std::printf("photometric loss 512x512: forward+backward %.2f ms, in box %.2f ms, value %.2f ms\n",
              best * 1e3, best_box * 1e3, best_value * 1e3);
  EXPECT_LT(best, 0.5);
}

}  // namespace
}  // namespace effigy
