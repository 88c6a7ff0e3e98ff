#include <gtest/gtest.h>

#include <functional>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/splat/bind.h"
#include "splat/bind_oracle.h"

namespace effigy {
namespace {

// A bumpy grid of triangles with a UV chart that is sheared, and mirrored in its right half.
Mesh bumpy_mesh(int cells, uint64_t seed) {
  Mesh mesh;
  Random random(seed);
  const int side = cells + 1;
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const double u = static_cast<double>(x) / cells, v = static_cast<double>(y) / cells;
      mesh.vertices.push_back(static_cast<float>(u + 0.2 / cells * random.normal()));
      mesh.vertices.push_back(static_cast<float>(v + 0.2 / cells * random.normal()));
      mesh.vertices.push_back(static_cast<float>(0.5 / cells * random.normal()));
      mesh.uvs.emplace_back(static_cast<float>(0.5 - std::abs(u - 0.5) + 0.1 * v),
                            static_cast<float>(0.8 * v + 0.1 * u));
    }
  }
  for (int y = 0; y < cells; ++y) {
    for (int x = 0; x < cells; ++x) {
      const int a = y * side + x;
      mesh.triangles.emplace_back(a, a + 1, a + side);
      mesh.triangles.emplace_back(a + side, a + 1, a + side + 1);
    }
  }
  mesh.uv_triangles = mesh.triangles;
  return mesh;
}

BoundSurfels random_surfels(const Mesh& mesh, int count, uint64_t seed) {
  BoundSurfels surfels = sample_surfels(mesh, count, seed);
  Random random(seed, 7);
  for (float& x : surfels.barycentric) x += static_cast<float>(0.2 * random.normal());
  for (float& x : surfels.displacement) x = static_cast<float>(0.05 * random.normal());
  for (float& x : surfels.rotation) x = static_cast<float>(random.normal());
  for (float& x : surfels.log_scale) x += static_cast<float>(0.3 * random.normal());
  for (float& x : surfels.opacity_logit) x = static_cast<float>(random.normal());
  return surfels;
}

PosedSurfels random_upstream(size_t n, uint64_t seed) {
  PosedSurfels d;
  d.resize(n);
  Random random(seed, 9);
  for (auto* field : {&d.center, &d.s, &d.t, &d.opacity, &d.uv, &d.uv_per_st, &d.frame})
    for (float& x : *field) x = static_cast<float>(random.normal());
  return d;
}

double relative_error(const std::vector<double>& expected, const std::vector<float>& actual) {
  EXPECT_EQ(expected.size(), actual.size());
  double error = 0, size = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    const double e = expected[i] - static_cast<double>(actual[i]);
    error += e * e;
    size += expected[i] * expected[i];
  }
  return std::sqrt(error / std::max(size, 1e-30));
}

double loss(const oracle::Posed& p, const PosedSurfels& d) {
  double sum = 0;
  const auto dot = [&](const std::vector<double>& a, const std::vector<float>& b) {
    for (size_t i = 0; i < a.size(); ++i) sum += a[i] * static_cast<double>(b[i]);
  };
  dot(p.center, d.center);
  dot(p.s, d.s);
  dot(p.t, d.t);
  dot(p.opacity, d.opacity);
  dot(p.uv, d.uv);
  dot(p.uv_per_st, d.uv_per_st);
  dot(p.frame, d.frame);
  return sum;
}

struct BindCase {
  const char* name;
  BindOptions options;
};

class Bind : public testing::TestWithParam<BindCase> {
 protected:
  Mesh mesh = bumpy_mesh(4, 3);
  BoundSurfels surfels = random_surfels(mesh, 48, 5);
  BindOptions options = GetParam().options;
};

TEST_P(Bind, ForwardAgreesWithTheOracle) {
  PosedSurfels posed;
  pose_surfels(mesh, mesh.vertices, surfels, options, posed);
  const auto p = oracle::to_double(surfels, mesh.vertices);
  const oracle::Posed expected = oracle::pose(mesh, surfels.triangle, p, p.vertices, options);
  EXPECT_LT(relative_error(expected.center, posed.center), 1e-6);
  EXPECT_LT(relative_error(expected.s, posed.s), 1e-6);
  EXPECT_LT(relative_error(expected.t, posed.t), 1e-6);
  EXPECT_LT(relative_error(expected.opacity, posed.opacity), 1e-6);
  EXPECT_LT(relative_error(expected.uv, posed.uv), 1e-6);
  EXPECT_LT(relative_error(expected.uv_per_st, posed.uv_per_st), 1e-6);
  EXPECT_LT(relative_error(expected.frame, posed.frame), 1e-6);
}

TEST_P(Bind, GradientAgreesWithFiniteDifferences) {
  const PosedSurfels d = random_upstream(surfels.count(), 11);
  BoundSurfelGradients gradients;
  gradients.clear(surfels, mesh.vertices.size());
  pose_surfels_backward(mesh, mesh.vertices, surfels, options, d, gradients);

  auto p = oracle::to_double(surfels, mesh.vertices);
  const std::vector<double> frozen = p.vertices;
  const auto value = [&] {
    const auto& jacobian = options.jacobian_to_vertices ? p.vertices : frozen;
    return loss(oracle::pose(mesh, surfels.triangle, p, jacobian, options), d);
  };
  const auto differences = [&](std::vector<double>& x) {
    std::vector<double> g(x.size());
    for (size_t i = 0; i < x.size(); ++i) {
      const double at = x[i], h = 1e-6;
      x[i] = at + h;
      const double up = value();
      x[i] = at - h;
      const double down = value();
      x[i] = at;
      g[i] = (up - down) / (2 * h);
    }
    return g;
  };
  EXPECT_LT(relative_error(differences(p.barycentric), gradients.barycentric), 1e-5);
  EXPECT_LT(relative_error(differences(p.displacement), gradients.displacement), 1e-5);
  EXPECT_LT(relative_error(differences(p.rotation), gradients.rotation), 1e-5);
  EXPECT_LT(relative_error(differences(p.log_scale), gradients.log_scale), 1e-5);
  EXPECT_LT(relative_error(differences(p.opacity_logit), gradients.opacity_logit), 1e-5);
  EXPECT_LT(relative_error(differences(p.vertices), gradients.vertices), 1e-5);
}

INSTANTIATE_TEST_SUITE_P(
    Options, Bind,
    testing::Values(BindCase{"Default", {}},
                    BindCase{"JacobianToVertices", {.jacobian_to_vertices = true}},
                    BindCase{"InterpolatedNormals", {.interpolated_normals = true}},
                    BindCase{"SplatFrame", {.splat_normal_frame = true}},
                    BindCase{"All", {true, true, true}}),
    [](const auto& tested) { return std::string(tested.param.name); });

TEST(BindProperties, SampleGivesEveryTriangleItsShareOfArea) {
  const Mesh mesh = bumpy_mesh(6, 1);
  std::vector<float> weight(mesh.triangles.size(), 1.0f);
  weight[5] = 0.0f;
  const int count = 7200;
  const BoundSurfels surfels = sample_surfels(mesh, count, 4, weight, 0.8f);
  ASSERT_EQ(surfels.count(), static_cast<size_t>(count));
  std::vector<int> per_triangle(mesh.triangles.size());
  for (size_t i = 0; i < surfels.count(); ++i) {
    ++per_triangle[static_cast<size_t>(surfels.triangle[i])];
    const float b = surfels.barycentric[2 * i], c = surfels.barycentric[2 * i + 1];
    EXPECT_TRUE(b >= 0 && c >= 0 && b + c <= 1.000001f);
    EXPECT_NEAR(1 / (1 + std::exp(-surfels.opacity_logit[i])), 0.8f, 1e-5f);
  }
  double total = 0;
  std::vector<double> area;
  for (size_t f = 0; f < mesh.triangles.size(); ++f) {
    const Vec3i& t = mesh.triangles[f];
    const Vec3f a = mesh.vertex(t[0]);
    area.push_back(0.5 * (mesh.vertex(t[1]) - a).cross(mesh.vertex(t[2]) - a).norm() * weight[f]);
    total += area.back();
  }
  for (size_t f = 0; f < area.size(); ++f)
    EXPECT_NEAR(per_triangle[f], count * area[f] / total, 1.0) << "triangle " << f;
}

TEST(BindProperties, TheTangentPointsAlongUAndTheBitangentAlongV) {
  const Mesh mesh = bumpy_mesh(4, 8);
  const BoundSurfels surfels = sample_surfels(mesh, 200, 2);  // local rotation: identity
  PosedSurfels posed;
  pose_surfels(mesh, mesh.vertices, surfels, {}, posed);
  for (size_t i = 0; i < posed.count(); ++i) {
    const auto f = static_cast<size_t>(surfels.triangle[i]);
    const Vec3i t = mesh.triangles[f];
    const Vec3f e1 = mesh.vertex(t[1]) - mesh.vertex(t[0]);
    const Vec3f e2 = mesh.vertex(t[2]) - mesh.vertex(t[0]);
    const Vec2f u1 = mesh.uvs[static_cast<size_t>(t[1])] - mesh.uvs[static_cast<size_t>(t[0])];
    const Vec2f u2 = mesh.uvs[static_cast<size_t>(t[2])] - mesh.uvs[static_cast<size_t>(t[0])];
    Eigen::Matrix2f uv;
    uv << u1, u2;
    Eigen::Matrix<float, 3, 2> jacobian;
    jacobian << e1, e2;
    const Eigen::Matrix<float, 3, 2> along = jacobian * uv.inverse();
    const Vec3f tangent(posed.frame.data() + 9 * i), bitangent(posed.frame.data() + 9 * i + 3),
        normal(posed.frame.data() + 9 * i + 6);
    EXPECT_GT(tangent.dot(along.col(0).normalized()), 0.9999f);
    EXPECT_GT(bitangent.dot(along.col(1)), 0.0f);
    EXPECT_GT(normal.dot(e1.cross(e2).normalized()), 0.9999f);
    EXPECT_NEAR(tangent.dot(bitangent), 0.0f, 1e-5f);
  }
}

TEST(BindProperties, DegenerateTrianglesGiveFiniteResults) {
  Mesh mesh;
  mesh.vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0, 2, 0, 0, 0, 0, 0};
  // A point, a needle, a sliver with both ends equal, and a sound triangle with no UV area.
  mesh.triangles = {{0, 0, 0}, {0, 1, 3}, {0, 4, 1}, {0, 1, 2}};
  mesh.uvs = {{0.1f, 0.2f}, {0.4f, 0.5f}, {0.7f, 0.8f}};
  mesh.uv_triangles = {{0, 1, 2}, {0, 1, 2}, {0, 1, 2}, {0, 1, 2}};
  BoundSurfels surfels;
  surfels.triangle = {0, 1, 2, 3};
  surfels.barycentric.assign(8, 0.3f);
  surfels.displacement.assign(4, 0.1f);
  surfels.rotation.assign(16, 0.0f);  // zero quaternions as well
  surfels.log_scale.assign(8, -3.0f);
  surfels.opacity_logit.assign(4, 1.0f);
  for (const bool all : {false, true}) {
    const BindOptions options{all, false, true};
    PosedSurfels posed;
    pose_surfels(mesh, mesh.vertices, surfels, options, posed);
    BoundSurfelGradients gradients;
    gradients.clear(surfels, mesh.vertices.size());
    pose_surfels_backward(mesh, mesh.vertices, surfels, options, random_upstream(4, 1), gradients);
    for (const auto* field :
         {&posed.center, &posed.s, &posed.t, &posed.opacity, &posed.uv, &posed.uv_per_st,
          &posed.frame, &gradients.barycentric, &gradients.displacement, &gradients.rotation,
          &gradients.log_scale, &gradients.opacity_logit, &gradients.vertices}) {
      for (const float x : *field) EXPECT_TRUE(std::isfinite(x));
    }
    for (size_t i = 0; i < 4; ++i)
      for (size_t k = 0; k < 3; ++k)
        EXPECT_NEAR(Vec3f(posed.frame.data() + 9 * i + 3 * k).norm(), 1.0f, 1e-5f);
  }
}

TEST(BindProperties, ResultsDoNotDependOnTheNumberOfThreads) {
  const Mesh mesh = bumpy_mesh(30, 2);
  const BoundSurfels surfels = random_surfels(mesh, 3000, 3);
  const PosedSurfels d = random_upstream(surfels.count(), 4);
  BoundSurfelGradients first, second;
  const int before = thread_count();
  for (auto [threads, to] : {std::pair{1, &first}, std::pair{3, &second}}) {
    set_thread_count(threads);
    to->clear(surfels, mesh.vertices.size());
    pose_surfels_backward(mesh, mesh.vertices, surfels, {}, d, *to);
  }
  set_thread_count(before);
  EXPECT_EQ(first.vertices, second.vertices);
  EXPECT_EQ(first.rotation, second.rotation);
}

TEST(BindErrors, ATriangleOutOfRangeIsRefused) {
  const Mesh mesh = bumpy_mesh(2, 1);
  BoundSurfels surfels = sample_surfels(mesh, 4, 1);
  surfels.triangle[2] = 99;
  PosedSurfels posed;
  EXPECT_THROW(pose_surfels(mesh, mesh.vertices, surfels, {}, posed), Error);
  EXPECT_THROW(sample_surfels(mesh, 0, 1), Error);
  EXPECT_THROW(sample_surfels(mesh, 5, 1, std::vector<float>(mesh.triangles.size(), 0.0f)), Error);
}

}  // namespace
}  // namespace effigy
