#include "effigy/rays/ray_scene.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <thread>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

struct Soup {
  std::vector<float> vertices;
  std::vector<Vec3i> triangles;
};

Soup random_soup(int count, uint64_t seed) {
  Random random(seed);
  Soup soup;
  for (int i = 0; i < count; ++i) {
    const Vec3f centre(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c)
        soup.vertices.push_back(centre[c] + static_cast<float>(random.uniform(-0.3, 0.3)));
    soup.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  return soup;
}

struct Found {
  int triangle;
  double distance, b, c;
};

// Every triangle in double precision (Moeller and Trumbore 1997).
std::optional<Found> brute_force(const Soup& soup, const Vec3f& origin, const Vec3f& direction,
                                 double near, double far, double* margin) {
  std::optional<Found> best;
  const Vec3d o = origin.cast<double>(), d = direction.cast<double>();
  auto vertex = [&](int i) { return Vec3f(soup.vertices.data() + 3 * i).cast<double>().eval(); };
  *margin = 1;
  for (size_t f = 0; f < soup.triangles.size(); ++f) {
    const Vec3i& t = soup.triangles[f];
    const Vec3d a = vertex(t[0]), e1 = vertex(t[1]) - a, e2 = vertex(t[2]) - a;
    const Vec3d p = d.cross(e2);
    const double det = e1.dot(p);
    if (std::abs(det) < 1e-12) continue;
    const Vec3d s = o - a, q = s.cross(e1);
    const double b = s.dot(p) / det, c = d.dot(q) / det, distance = e2.dot(q) / det;
    if (distance < near || distance > far) continue;
    // How near an edge the ray passes: such rays may differ between float and double.
    *margin = std::min({*margin, std::abs(b), std::abs(c), std::abs(1 - b - c)});
    if (b < 0 || c < 0 || b + c > 1) continue;
    if (!best || distance < best->distance) best = Found{static_cast<int>(f), distance, b, c};
  }
  return best;
}

void expect_brute_force(const RayScene& scene, const Soup& soup) {
  Random random(2);
  int hits = 0, misses = 0;
  for (int i = 0; i < 3000; ++i) {
    const Vec3f origin(random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-2, 2));
    const Vec3f direction(random.normal(), random.normal(), random.normal());
    const float near = i % 3 == 0 ? 0.5f : 0.0f, far = i % 2 == 0 ? 1e30f : 1.5f;
    double margin = 0;
    const auto expected = brute_force(soup, origin, direction, near, far, &margin);
    if (margin < 1e-5) continue;
    const RayHit hit = scene.closest(origin, direction, near, far);
    EXPECT_EQ(scene.occluded(origin, direction, near, far), expected.has_value());
    ASSERT_EQ(hit.triangle, expected ? expected->triangle : -1);
    if (!expected) {
      ++misses;
      continue;
    }
    ++hits;
    EXPECT_NEAR(hit.distance, expected->distance, 1e-4 * (1 + expected->distance));
    EXPECT_NEAR(hit.b, expected->b, 2e-4);
    EXPECT_NEAR(hit.c, expected->c, 2e-4);
  }
  EXPECT_GT(hits, 300);
  EXPECT_GT(misses, 500);
}

TEST(RayScene, AgreesWithBruteForce) {
  const Soup soup = random_soup(300, 1);
  expect_brute_force(RayScene(soup.vertices, soup.triangles), soup);
}

TEST(RayScene, RefittedItAgreesWithBruteForce) {
  const Soup first = random_soup(300, 7), second = random_soup(300, 1);
  RayScene scene(first.vertices, first.triangles, RayUse::kMoving);
  expect_brute_force(scene, first);
  scene.move(second.vertices);
  expect_brute_force(scene, second);
}

TEST(RayScene, MovesItsVertices) {
  std::vector<float> vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  RayScene scene(vertices, {Vec3i(0, 1, 2)});
  const Vec3f origin(0.2f, 0.2f, 1), direction(0, 0, -1);
  EXPECT_FLOAT_EQ(scene.closest(origin, direction).distance, 1.0f);
  for (int i = 0; i < 3; ++i) vertices[3 * i + 2] = -1;
  scene.move(vertices);
  EXPECT_FLOAT_EQ(scene.closest(origin, direction).distance, 2.0f);
  EXPECT_FALSE(scene.occluded(origin, direction, 0, 1.5f));
}

TEST(RayScene, EmptySceneHitsNothing) {
  const RayScene scene({}, {});
  EXPECT_EQ(scene.closest(Vec3f::Zero(), Vec3f(0, 0, 1)).triangle, -1);
  EXPECT_FALSE(scene.occluded(Vec3f::Zero(), Vec3f(0, 0, 1)));
}

TEST(RayScene, RefusesBadMeshes) {
  const std::vector<float> good = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  EXPECT_THROW(RayScene(good, {Vec3i(0, 1, 3)}), Error);
  EXPECT_THROW(RayScene(good, {Vec3i(-1, 1, 2)}), Error);
  std::vector<float> bad = good;
  bad[4] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(RayScene(bad, {Vec3i(0, 1, 2)}), Error);
}

TEST(RayScene, LeavesTheThreadsToTheProgram) {
  const Soup soup = random_soup(10, 5);
  const RayScene scene(soup.vertices, soup.triangles);
  const int before = thread_count();
  set_thread_count(2);
  // Two pieces that wait for each other: with one thread neither ever sees the other start.
  std::atomic<int> started{0};
  std::atomic<bool> met{false};
  parallel_for(2, 1, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      ++started;
      const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(5);
      while (started < 2 && std::chrono::steady_clock::now() < until) std::this_thread::yield();
      if (started == 2) met = true;
    }
  });
  set_thread_count(before);
  EXPECT_TRUE(met);
}

}  // namespace
}  // namespace effigy
