#include "effigy/learn/normal_consistency.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {
namespace {

Camera make_camera(int width, int height) {
  Camera camera = look_at({0.3, 0.2, 1.0}, {0.02, -0.01, 0.0}, 0.5, width, height);
  camera.cx += 1.7;  // off-centre principal point, unequal focal lengths
  camera.cy -= 0.9;
  camera.fx *= 1.1;
  return camera;
}

// In double precision. `alone` is the alpha that the loss holds constant.
double oracle(const Planes& g, const std::vector<double>& depth, const std::vector<double>& alpha,
              const std::vector<double>& alone, const std::vector<double>& normal,
              const Camera& camera, int* pixels = nullptr) {
  const int width = g.width, height = g.height;
  const auto at = [&](int x, int y) { return static_cast<size_t>(y * width + x); };
  const auto point = [&](int x, int y) -> Vec3d {
    return depth[at(x, y)] / alpha[at(x, y)] *
           Vec3d((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy, 1.0);
  };
  double sum = 0;
  int count = 0;
  for (int y = 1; y + 1 < height; ++y)
    for (int x = 1; x + 1 < width; ++x) {
      bool counts = true;
      for (const auto& [dx, dy] :
           {std::pair{0, 0}, std::pair{1, 0}, std::pair{-1, 0}, std::pair{0, 1}, std::pair{0, -1}})
        counts = counts && g.plane(kAlpha)[at(x + dx, y + dy)] > 1e-5f;
      if (!counts) continue;
      const Vec3d n =
          (point(x, y + 1) - point(x, y - 1)).cross(point(x + 1, y) - point(x - 1, y)).normalized();
      const Vec3d world = camera.camera_from_world_rotation.transpose() * n;
      const double* m = normal.data() + 3 * at(x, y);
      sum += alone[at(x, y)] - (m[0] * world.x() + m[1] * world.y() + m[2] * world.z());
      ++count;
    }
  if (pixels != nullptr) *pixels = count;
  return sum / count;
}

struct Case {
  Camera camera;
  Planes gbuffer;
  std::vector<double> depth, alpha, normal;
  Case(int width, int height, uint64_t seed)
      : camera(make_camera(width, height)), gbuffer(width, height, kGBufferPlanes) {
    Random random(seed);
    const size_t n = gbuffer.pixels();
    for (size_t i = 0; i < n; ++i) {
      const bool hole = random.below(20) == 0;
      const double a = hole ? 0.0 : random.uniform(0.2, 1.0);
      gbuffer.plane(kAlpha)[i] = static_cast<float>(a);
      gbuffer.plane(kDepth)[i] = static_cast<float>(a * random.uniform(0.9, 1.1));
      for (int c = 0; c < 3; ++c)
        gbuffer.plane(kNormal + c)[i] = static_cast<float>(a * random.uniform(-0.6, 0.6));
    }
    depth.assign(gbuffer.plane(kDepth), gbuffer.plane(kDepth) + n);
    alpha.assign(gbuffer.plane(kAlpha), gbuffer.plane(kAlpha) + n);
    normal.resize(3 * n);
    for (size_t i = 0; i < n; ++i)
      for (size_t c = 0; c < 3; ++c)
        normal[3 * i + c] = gbuffer.plane(kNormal + static_cast<int>(c))[i];
  }
};

TEST(NormalConsistency, GradientsMatchFiniteDifferences) {
  Case c(13, 11, 3);
  const std::vector<double> alone = c.alpha;
  std::vector<float> scratch;
  for (const bool detach : {true, false}) {
    Planes d(13, 11, kGBufferPlanes, 0.125f);
    NormalConsistencyOptions options;
    options.detach_alpha = detach;
    const double weight = 2.0;
    const double value = normal_consistency_loss(c.gbuffer, c.camera, options, 2.0f, &d, scratch);
    const auto loss = [&](const std::vector<double>& depth, const std::vector<double>& alpha,
                          const std::vector<double>& normal) {
      return oracle(c.gbuffer, depth, alpha, detach ? alone : alpha, normal, c.camera);
    };
    EXPECT_NEAR(value, loss(c.depth, c.alpha, c.normal), 2e-5);
    EXPECT_NEAR(normal_consistency_loss(c.gbuffer, c.camera, options, 2.0f, nullptr, scratch),
                value, 1e-6);
    const auto check = [&](std::vector<double>& x, size_t i, float got, const char* what) {
      const double keep = x[i], h = 1e-6;
      x[i] = keep + h;
      const double up = loss(c.depth, c.alpha, c.normal);
      x[i] = keep - h;
      const double want = weight * (up - loss(c.depth, c.alpha, c.normal)) / (2 * h);
      x[i] = keep;
      EXPECT_NEAR(got - 0.125, want, 2e-5 + 1e-3 * std::abs(want)) << what << " " << i;
    };
    for (size_t i = 0; i < c.depth.size(); ++i) {
      if (c.alpha[i] == 0) {  // nothing is drawn there: no gradient
        EXPECT_EQ(d.plane(kDepth)[i], 0.125f);
        EXPECT_EQ(d.plane(kAlpha)[i], 0.125f);
        continue;
      }
      check(c.depth, i, d.plane(kDepth)[i], "depth");
      check(c.alpha, i, d.plane(kAlpha)[i], "alpha");
      for (size_t k = 0; k < 3; ++k)
        check(c.normal, 3 * i + k, d.plane(kNormal + static_cast<int>(k))[i], "normal");
    }
    for (const int plane : {kAlbedo, kRoughness, kMappedNormal, kUv})
      EXPECT_EQ(d.plane(plane)[20], 0.125f);
  }
}

// A plane seen askew: its own normal scores 0, a normal turned by t scores 1 - cos t.
TEST(NormalConsistency, PlaneSeenAskew) {
  const Camera camera = make_camera(64, 48);
  const Vec3d n = Vec3d(0.2, 0.3, 1.0).normalized();  // plane through the origin
  Planes g(64, 48, kGBufferPlanes);
  const Vec3d eye = camera.center();
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x) {
      const Vec3d ray((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy, 1.0);
      const Vec3d world = camera.camera_from_world_rotation.transpose() * ray;
      const size_t i = static_cast<size_t>(y * 64 + x);
      const double alpha = 0.8;
      g.plane(kAlpha)[i] = static_cast<float>(alpha);
      g.plane(kDepth)[i] = static_cast<float>(alpha * -eye.dot(n) / world.dot(n));
      for (int c = 0; c < 3; ++c) g.plane(kNormal + c)[i] = static_cast<float>(alpha * n[c]);
    }
  std::vector<float> scratch;
  EXPECT_NEAR(normal_consistency_loss(g, camera, {}, 1.0f, nullptr, scratch), 0.0, 2e-4);
  const Vec3d turned = Eigen::AngleAxisd(0.6, n.unitOrthogonal()) * n;
  for (size_t i = 0; i < g.pixels(); ++i)
    for (int c = 0; c < 3; ++c) g.plane(kNormal + c)[i] = static_cast<float>(0.8 * turned[c]);
  EXPECT_NEAR(normal_consistency_loss(g, camera, {}, 1.0f, nullptr, scratch),
              0.8 * (1 - std::cos(0.6)), 2e-3);
}

TEST(NormalConsistency, NothingDrawnIsZero) {
  std::vector<float> scratch;
  Planes g(8, 8, kGBufferPlanes), d(8, 8, kGBufferPlanes);
  EXPECT_EQ(normal_consistency_loss(g, make_camera(8, 8), {}, 1.0f, &d, scratch), 0.0);
  for (const float value : d.data) EXPECT_EQ(value, 0.0f);
  // Alpha everywhere but depth everywhere the same point: no direction, no NaN.
  for (size_t i = 0; i < g.pixels(); ++i) g.plane(kAlpha)[i] = g.plane(kDepth)[i] = 1e-4f;
  normal_consistency_loss(g, make_camera(8, 8), {}, 1.0f, &d, scratch);
  for (const float value : d.data) EXPECT_TRUE(std::isfinite(value));
  Planes small(2, 2, kGBufferPlanes);
  EXPECT_EQ(normal_consistency_loss(small, make_camera(2, 2), {}, 1.0f, nullptr, scratch), 0.0);
}

TEST(NormalConsistency, ThreadCountDoesNotChangeBits) {
  const Case c(61, 70, 5);
  const int before = thread_count();
  std::vector<float> first, scratch;
  double first_value = 0;
  for (const int threads : {1, 2}) {
    set_thread_count(threads);
    Planes d(61, 70, kGBufferPlanes);
    const double value = normal_consistency_loss(c.gbuffer, c.camera, {}, 1.0f, &d, scratch);
    if (threads == 1) first = d.data, first_value = value;
    EXPECT_EQ(d.data, first);
    EXPECT_EQ(value, first_value);
  }
  set_thread_count(before);
}

TEST(NormalConsistency, Speed) {
  const Case c(512, 512, 7);
  Planes d(512, 512, kGBufferPlanes);
  std::vector<float> scratch;
  double best = 1e9;
  for (int i = 0; i < 5; ++i) {
    const auto start = std::chrono::steady_clock::now();
    normal_consistency_loss(c.gbuffer, c.camera, {}, 1.0f, &d, scratch);
    const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start;
    best = std::min(best, time.count());
  }
  std::printf("normal consistency 512x512, forward+backward: %.2f ms\n", best * 1e3);
  EXPECT_LT(best, 0.2);
}

}  // namespace
}  // namespace effigy
