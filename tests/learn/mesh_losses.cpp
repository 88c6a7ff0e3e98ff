#include "effigy/learn/mesh_losses.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <set>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

using Doubles = std::vector<double>;

std::vector<float> noise(size_t count, uint64_t seed, double scale = 1.0) {
  Random random(seed);
  std::vector<float> values(count);
  for (float& value : values) value = static_cast<float>(scale * random.normal());
  return values;
}

// A strip of triangles, a fan, and one vertex that no triangle uses.
std::vector<Vec3i> triangles() {
  return {{0, 1, 2}, {2, 1, 3}, {2, 3, 4}, {4, 3, 5}, {0, 2, 6}, {0, 6, 7}, {0, 7, 1}};
}
constexpr int kVertices = 9;

double laplacian_oracle(const Doubles& offset) {
  std::vector<std::set<int>> neighbours(kVertices);
  for (const Vec3i& t : triangles())
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        if (i != j) neighbours[static_cast<size_t>(t[i])].insert(t[j]);
  double sum = 0;
  for (size_t v = 0; v < kVertices; ++v)
    for (size_t k = 0; k < 3; ++k) {
      if (neighbours[v].empty()) continue;
      double mean = 0;
      for (const int n : neighbours[v]) mean += offset[3 * static_cast<size_t>(n) + k];
      sum += std::pow(offset[3 * v + k] - mean / static_cast<double>(neighbours[v].size()), 2);
    }
  return sum / kVertices;
}

void expect_gradient(const std::vector<float>& at, const std::function<double(const Doubles&)>& f,
                     double weight, const std::vector<float>& gradient, double base) {
  Doubles x(at.begin(), at.end());
  for (size_t i = 0; i < x.size(); ++i) {
    const double keep = x[i], h = 1e-6 * std::max(1.0, std::abs(keep));
    x[i] = keep + h;
    const double up = f(x);
    x[i] = keep - h;
    const double want = weight * (up - f(x)) / (2 * h);
    x[i] = keep;
    EXPECT_NEAR(gradient[i] - base, want, 1e-6 + 1e-4 * std::abs(want)) << i;
  }
}

TEST(MeshLosses, Laplacian) {
  const UniformLaplacian laplacian(triangles(), kVertices);
  const std::vector<float> tuned = noise(3 * kVertices, 1), original = noise(3 * kVertices, 2);
  const auto loss = [&](const Doubles& x) {
    Doubles offset(x.size());
    for (size_t i = 0; i < x.size(); ++i) offset[i] = x[i] - original[i];
    return laplacian_oracle(offset);
  };
  std::vector<float> gradient(tuned.size(), 0.5f), scratch;
  const double value = laplacian_loss(laplacian, tuned, original, 3.0f, gradient, scratch);
  EXPECT_NEAR(value, loss(Doubles(tuned.begin(), tuned.end())), 1e-5);
  EXPECT_EQ(laplacian_loss(laplacian, tuned, original, 3.0f, {}, scratch), value);
  expect_gradient(tuned, loss, 3.0, gradient, 0.5);
}

TEST(MeshLosses, LaplacianIgnoresTranslation) {
  const UniformLaplacian laplacian(triangles(), kVertices);
  const std::vector<float> original = noise(3 * kVertices, 2);
  std::vector<float> tuned = original, scratch;
  for (size_t i = 0; i < tuned.size(); ++i) tuned[i] += static_cast<float>(i % 3) * 0.25f;
  EXPECT_NEAR(laplacian_loss(laplacian, tuned, original, 1.0f, {}, scratch), 0.0, 1e-12);
}

TEST(MeshLosses, Barycentric) {
  const std::vector<float> b = noise(2 * 37, 3, 0.3);
  const auto loss = [](const Doubles& x) {
    double sum = 0;
    for (size_t i = 0; i < x.size(); i += 2)
      for (const double w : {1 - x[i] - x[i + 1], x[i], x[i + 1]}) sum += std::pow(w - 1.0 / 3, 2);
    return sum / static_cast<double>(x.size() / 2);
  };
  std::vector<float> gradient(b.size(), -1.0f);
  EXPECT_NEAR(barycentric_loss(b, 2.0f, gradient), loss(Doubles(b.begin(), b.end())), 1e-6);
  expect_gradient(b, loss, 2.0, gradient, -1.0);
  const std::vector<float> centre(10, 1.0f / 3.0f);
  EXPECT_NEAR(barycentric_loss(centre, 1.0f, {}), 0.0, 1e-12);
  EXPECT_EQ(barycentric_loss({}, 1.0f, {}), 0.0);
}

TEST(MeshLosses, Distances) {
  const std::vector<float> value = noise(60, 5), reference = noise(60, 6);
  for (const Distance distance : {Distance::kMeanSquared, Distance::kMeanRowNorm})
    for (const size_t width : {size_t{1}, size_t{3}, size_t{60}}) {
      const auto loss = [&](const Doubles& x) {
        double sum = 0;
        for (size_t row = 0; row < x.size() / width; ++row) {
          double squares = 0;
          for (size_t k = 0; k < width; ++k)
            squares += std::pow(x[row * width + k] - reference[row * width + k], 2);
          sum += distance == Distance::kMeanSquared ? squares / static_cast<double>(width)
                                                    : std::sqrt(squares);
        }
        return sum / static_cast<double>(x.size() / width);
      };
      std::vector<float> gradient(value.size(), 0.25f);
      EXPECT_NEAR(distance_loss(value, reference, distance, width, 1.5f, gradient),
                  loss(Doubles(value.begin(), value.end())), 1e-5);
      expect_gradient(value, loss, 1.5, gradient, 0.25);
      std::vector<float> none(value.size(), 0.0f);
      EXPECT_EQ(distance_loss(value, value, distance, width, 1.5f, none), 0.0);
      EXPECT_EQ(none, std::vector<float>(value.size(), 0.0f));
    }
}

TEST(MeshLosses, DistanceSpeed) {
  const size_t count = size_t{3} << 19;  // a blendshape basis
  const std::vector<float> value = noise(count, 1), reference = noise(count, 2);
  std::vector<float> gradient(count);
  double best = 1e9;
  for (int i = 0; i < 4; ++i) {
    const auto start = std::chrono::steady_clock::now();
    distance_loss(value, reference, Distance::kMeanRowNorm, 3, 1.0f, gradient);
    const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start;
    best = std::min(best, time.count());
  }
  std::printf("distance of 1.6 M entries: %.2f ms\n", best * 1e3);
  EXPECT_LT(best, 0.5);
}

TEST(MeshLosses, ThreadCountDoesNotChangeBits) {
  const std::vector<float> value = noise(3 * 20000, 7), reference = noise(3 * 20000, 8);
  const int before = thread_count();
  double first = 0, first_bary = 0;
  for (const int threads : {1, 2}) {
    set_thread_count(threads);
    const double norm = distance_loss(value, reference, Distance::kMeanRowNorm, 3, 1.0f, {});
    const double bary = barycentric_loss(value, 1.0f, {});
    if (threads == 1) first = norm, first_bary = bary;
    EXPECT_EQ(norm, first);
    EXPECT_EQ(bary, first_bary);
  }
  set_thread_count(before);
}

}  // namespace
}  // namespace effigy
