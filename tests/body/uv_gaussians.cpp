#include "effigy/body/uv_gaussians.h"

#include <cmath>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/light/zonal.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

using Channels = GaussianChannels;
using Frame = Eigen::Matrix<float, 3, 3, Eigen::RowMajor>;

Mesh ball() {
  return test::ball_rig().mesh;
}

std::vector<float> random_floats(size_t count, uint64_t stream, double size = 1.0) {
  Random random(23, stream);
  std::vector<float> values(count);
  for (float& value : values) value = static_cast<float>(size * random.normal());
  return values;
}

Mat3f rotation_of(const TexelFrames& frames, size_t i) {
  return Eigen::Map<const Frame>(&frames.rotation[9 * i]);
}

TEST(UvGaussians, TexelsLieOnTheMesh) {
  const Mesh mesh = ball();
  const UvTexels texels = uv_texels(mesh, 32);
  const TexelFrames frames = texel_frames(texels, mesh.vertices, mesh.triangles);
  ASSERT_GT(texels.count(), 200u);
  for (size_t i = 0; i < texels.count(); ++i) {
    if (i > 0) {
      EXPECT_GT(texels.texel[i], texels.texel[i - 1]);
    }
    // The corners' UVs, weighted, are the texel's centre.
    Vec2f uv = Vec2f::Zero();
    bool found = false;
    for (size_t f = 0; f < mesh.triangles.size() && !found; ++f) {
      found = true;
      for (int c = 0; c < 3; ++c)
        found &= mesh.triangles[f][c] == texels.corner[3 * i + static_cast<size_t>(c)];
      for (int c = 0; found && c < 3; ++c)
        uv += texels.barycentric[3 * i + static_cast<size_t>(c)] *
              mesh.uvs[static_cast<size_t>(mesh.uv_triangles[f][c])];
    }
    ASSERT_TRUE(found);
    const int x = texels.texel[i] % 32, y = texels.texel[i] / 32;
    EXPECT_NEAR(uv.x(), (static_cast<float>(x) + 0.5f) / 32, 1e-5f);
    EXPECT_NEAR(uv.y(), 1.0f - (static_cast<float>(y) + 0.5f) / 32, 1e-5f);
    const Mat3f r = rotation_of(frames, i);
    EXPECT_LT((r.transpose() * r - Mat3f::Identity()).norm(), 1e-5f);
    EXPECT_NEAR(r.determinant(), 1.0f, 1e-5f);
  }
  // Neighbouring texels in a row: the tangent points from the left one to the right one, and the
  // spacing is about their distance.
  double ratio = 0;
  int pairs = 0;
  for (size_t i = 1; i < texels.count(); ++i) {
    if (texels.texel[i] != texels.texel[i - 1] + 1 || texels.texel[i] % 32 == 0) continue;
    const Vec3f step = Vec3f(&frames.position[3 * i]) - Vec3f(&frames.position[3 * (i - 1)]);
    if (step.norm() > 3 * texels.spacing[i] || step.norm() < 0.3f * texels.spacing[i]) continue;
    EXPECT_GT(step.normalized().dot(rotation_of(frames, i).col(0)), 0.8f) << i;
    ratio += step.norm() / texels.spacing[i];
    ++pairs;
  }
  ASSERT_GT(pairs, 100);
  EXPECT_NEAR(ratio / pairs, 1.0, 0.35);
}

// A square in the plane z = 0 with UVs along x and y, and the same mirrored.
TEST(UvGaussians, FramesOfASquare) {
  for (const bool mirrored : {false, true}) {
    Mesh mesh;
    mesh.vertices = {0, 0, 0, 2, 0, 0, 2, 2, 0, 0, 2, 0};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    mesh.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    if (mirrored) mesh.uvs = {{1, 0}, {0, 0}, {0, 1}, {1, 1}};
    mesh.uv_triangles = mesh.triangles;
    const UvTexels texels = uv_texels(mesh, 4);
    ASSERT_EQ(texels.count(), 16u);
    const TexelFrames frames = texel_frames(texels, mesh.vertices, mesh.triangles);
    for (size_t i = 0; i < 16; ++i) {
      const float sign = mirrored ? -1.0f : 1.0f;
      Mat3f expected = Mat3f::Identity();
      expected(0, 0) = sign;
      expected(1, 1) = sign;  // a rotation, not a mirror
      EXPECT_LT((rotation_of(frames, i) - expected).norm(), 1e-6f);
      EXPECT_NEAR(texels.spacing[i], 0.5f, 1e-6f);
    }
    // Texel 0 is the upper left one.
    EXPECT_NEAR(frames.position[0], mirrored ? 1.75f : 0.25f, 1e-6f);
    EXPECT_NEAR(frames.position[1], 1.75f, 1e-6f);
    const auto views = local_view_directions(frames, Vec3f(frames.position[0], 1.75f, 5));
    EXPECT_LT((Vec3f(views.data()) - Vec3f(0, 0, 1)).norm(), 1e-6f);
    const Vec3f aside = Vec3f(local_view_directions(frames, Vec3f(1e6f, 1.75f, 0)).data());
    EXPECT_LT((aside - Vec3f(mirrored ? -1 : 1, 0, 0)).norm(), 1e-5f);
  }
}

TEST(UvGaussians, MeshesWithoutTexels) {
  Mesh mesh = ball();
  mesh.uv_triangles.clear();
  EXPECT_TRUE(test::contains(test::error_of([&] { uv_texels(mesh, 8); }), "texture coordinates"));
  mesh = ball();
  for (Vec2f& uv : mesh.uvs) uv += Vec2f(5, 5);
  EXPECT_TRUE(test::contains(test::error_of([&] { uv_texels(mesh, 8); }), "between 0 and 1"));
}

// Degenerate triangles after posing still give finite rotations.
TEST(UvGaussians, CollapsedMesh) {
  const Mesh mesh = ball();
  const UvTexels texels = uv_texels(mesh, 16);
  const TexelFrames frames =
      texel_frames(texels, std::vector<float>(mesh.vertices.size(), 0.5f), mesh.triangles);
  for (size_t i = 0; i < texels.count(); ++i) {
    const Mat3f r = rotation_of(frames, i);
    ASSERT_LT((r.transpose() * r - Mat3f::Identity()).norm(), 1e-5f);
  }
}

struct Scene {
  Mesh mesh = ball();
  UvTexels texels = uv_texels(mesh, 12);
  TexelFrames frames = texel_frames(texels, mesh.vertices, mesh.triangles);
};

// What the decoder's zeros mean.
TEST(UvGaussians, StartsAsLambertianDiscsOfTheTexels) {
  const Scene s;
  const size_t n = s.texels.count();
  UvGaussians g;
  place_gaussians(s.texels, s.frames, std::vector<float>(65 * n), g);
  for (size_t i = 0; i < n; ++i) {
    const Mat3f r = rotation_of(s.frames, i);
    for (size_t c = 0; c < 3; ++c) {
      EXPECT_EQ(g.center[3 * i + c], s.frames.position[3 * i + c]);
      EXPECT_NEAR(g.scale[3 * i + c] / s.texels.spacing[i], 1.0f, 1e-4f);
      EXPECT_NEAR(g.normal[c * n + i], r(static_cast<int>(c), 2), 1e-6f);
      for (size_t axis = 0; axis < 3; ++axis)
        EXPECT_NEAR(g.axes[(3 * axis + c) * n + i], r(static_cast<int>(c), static_cast<int>(axis)),
                    1e-6f);
    }
    EXPECT_NEAR(g.opacity[i], 0.5f, 1e-6f);
    const Eigen::Quaternionf q(g.rotation[4 * i], g.rotation[4 * i + 1], g.rotation[4 * i + 2],
                               g.rotation[4 * i + 3]);
    EXPECT_LT((q.toRotationMatrix() - r).norm(), 1e-5f);
  }
  for (size_t c = 0; c < 51; ++c) {
    const bool coloured = c < 36;
    const size_t axis = coloured ? c / 12 : (c - 36) / 5;
    const size_t band = coloured ? c / 3 % 4 : 4 + (c - 36) % 5;
    const double expected = axis == 2 ? lambert_zonal()[band] : 0.0;
    EXPECT_NEAR(g.zonal[c * n], expected, 1e-7) << c;
  }
}

// Eq. 5, 6 and 10 in double precision for one texel.
struct Oracle {
  Eigen::Vector3d center, scale, normal;
  Eigen::Matrix3d rotation;
  double opacity;
  Oracle(const Scene& s, size_t i, const double* x) {
    const Eigen::Matrix3d tbn = rotation_of(s.frames, i).cast<double>();
    center = Vec3f(&s.frames.position[3 * i]).cast<double>() +
             tbn * (kOffsetUnit * Eigen::Vector3d(x[0], x[1], x[2]));
    const Eigen::Quaterniond q(1 + x[3], x[4], x[5], x[6]);
    rotation = tbn * q.normalized().toRotationMatrix();
    for (int c = 0; c < 3; ++c)
      scale[c] = std::log1p(std::exp(x[7 + c] + std::log(std::expm1(double{s.texels.spacing[i]}))));
    opacity = 1 / (1 + std::exp(-x[10] - std::log(kStartOpacity / (1 - kStartOpacity))));
    normal = rotation * Eigen::Vector3d(x[62], x[63], 1 + x[64]).normalized();
  }
};

TEST(UvGaussians, AgreesWithTheFormulas) {
  const Scene s;
  const size_t n = s.texels.count();
  const std::vector<float> decoded = random_floats(65 * n, 1);
  UvGaussians g;
  place_gaussians(s.texels, s.frames, decoded, g);
  for (size_t i = 0; i < n; ++i) {
    double x[65];
    std::copy_n(&decoded[65 * i], 65, x);
    const Oracle o(s, i, x);
    const Eigen::Quaternionf q(g.rotation[4 * i], g.rotation[4 * i + 1], g.rotation[4 * i + 2],
                               g.rotation[4 * i + 3]);
    EXPECT_NEAR(q.norm(), 1.0f, 1e-5f);
    EXPECT_LT((q.toRotationMatrix().cast<double>() - o.rotation).norm(), 1e-5);
    EXPECT_NEAR(g.opacity[i], o.opacity, 1e-6);
    EXPECT_GT(g.opacity[i], 0.0f);
    EXPECT_LT(g.opacity[i], 1.0f);
    for (size_t c = 0; c < 3; ++c) {
      const auto k = static_cast<int>(c);
      EXPECT_NEAR(g.center[3 * i + c], o.center[k], 1e-6);
      EXPECT_NEAR(g.scale[3 * i + c] / o.scale[k], 1.0, 1e-4);
      EXPECT_NEAR(g.normal[c * n + i], o.normal[k], 1e-5);
      for (size_t axis = 0; axis < 3; ++axis)
        EXPECT_NEAR(g.axes[(3 * axis + c) * n + i], o.rotation(k, static_cast<int>(axis)), 1e-5);
    }
    for (size_t c = 0; c < 51; ++c)
      EXPECT_NEAR(g.zonal[c * n + i] - g.zonal[c * n], decoded[65 * i + 11 + c] - decoded[11 + c],
                  1e-5f);
  }
}

// Every channel against central differences of the double-precision formulas.
TEST(UvGaussians, GradientOfEveryChannel) {
  const Scene s;
  const size_t n = s.texels.count();
  const std::vector<float> decoded = random_floats(65 * n, 1, 0.5);
  const auto d_center = random_floats(3 * n, 2), d_rotation = random_floats(4 * n, 3),
             d_scale = random_floats(3 * n, 4), d_opacity = random_floats(n, 5),
             d_axes = random_floats(9 * n, 6), d_zonal = random_floats(51 * n, 7),
             d_normal = random_floats(3 * n, 8);
  std::vector<float> d_decoded(65 * n);
  place_gaussians_backward(s.texels, s.frames, decoded,
                           {d_center, d_rotation, d_scale, d_opacity, d_axes, d_zonal, d_normal},
                           d_decoded);
  UvGaussians g;
  place_gaussians(s.texels, s.frames, decoded, g);
  const auto loss = [&](size_t i, const double* x) {
    const Oracle o(s, i, x);
    double sum = d_opacity[i] * o.opacity;
    Eigen::Quaterniond q(o.rotation);
    // Of the two quaternions of a rotation the one that the program chose.
    const Eigen::Vector4d chosen(g.rotation[4 * i], g.rotation[4 * i + 1], g.rotation[4 * i + 2],
                                 g.rotation[4 * i + 3]);
    Eigen::Vector4d wxyz(q.w(), q.x(), q.y(), q.z());
    if (wxyz.dot(chosen) < 0) wxyz = -wxyz;
    for (size_t c = 0; c < 4; ++c) sum += d_rotation[4 * i + c] * wxyz[static_cast<int>(c)];
    for (size_t c = 0; c < 3; ++c) {
      const auto k = static_cast<int>(c);
      sum += d_center[3 * i + c] * o.center[k] + d_scale[3 * i + c] * o.scale[k] +
             d_normal[c * n + i] * o.normal[k];
      for (size_t axis = 0; axis < 3; ++axis)
        sum += d_axes[(3 * axis + c) * n + i] * o.rotation(k, static_cast<int>(axis));
    }
    for (size_t c = 0; c < 51; ++c) sum += d_zonal[c * n + i] * x[11 + c];
    return sum;
  };
  constexpr double kStep = 1e-5;
  for (size_t i = 0; i < n; ++i) {
    double x[65];
    std::copy_n(&decoded[65 * i], 65, x);
    for (size_t c = 0; c < 65; ++c) {
      const double kept = x[c];
      x[c] = kept + kStep;
      const double above = loss(i, x);
      x[c] = kept - kStep;
      const double below = loss(i, x);
      x[c] = kept;
      const double expected = (above - below) / (2 * kStep);
      ASSERT_NEAR(d_decoded[65 * i + c], expected, 2e-4 * (1 + std::abs(expected)))
          << "texel " << i << " channel " << c;
    }
  }
}

TEST(UvGaussians, NoRotationAtAllIsTheIdentity) {
  const Scene s;
  const size_t n = s.texels.count();
  std::vector<float> decoded(65 * n);
  for (size_t i = 0; i < n; ++i) {
    decoded[65 * i + 3] = -1.0f;
    decoded[65 * i + 64] = -1.0f;
  }
  UvGaussians g;
  place_gaussians(s.texels, s.frames, decoded, g);
  const auto up = random_floats(9 * n, 1);
  std::vector<float> d_decoded(65 * n);
  place_gaussians_backward(s.texels, s.frames, decoded, {{}, {}, {}, {}, up, {}, {}}, d_decoded);
  for (size_t i = 0; i < n; ++i) {
    const Mat3f r = rotation_of(s.frames, i);
    for (size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(g.axes[(6 + c) * n + i], r(static_cast<int>(c), 2), 1e-6f);
      EXPECT_NEAR(g.normal[c * n + i], r(static_cast<int>(c), 2), 1e-6f);
    }
    for (size_t c = 0; c < 65; ++c) EXPECT_EQ(d_decoded[65 * i + c], 0.0f);
  }
}

// A body that turns takes everything along.
TEST(UvGaussians, TurnWithTheBody) {
  Scene s;
  const size_t n = s.texels.count();
  const std::vector<float> decoded = random_floats(65 * n, 1);
  UvGaussians before, after;
  place_gaussians(s.texels, s.frames, decoded, before);
  const Mat3f turn = Eigen::Quaternionf(0.3f, -0.5f, 0.7f, 0.2f).normalized().toRotationMatrix();
  const Vec3f move(1, -2, 0.5f);
  std::vector<float> vertices = s.mesh.vertices;
  for (size_t v = 0; v < vertices.size(); v += 3) {
    const Vec3f moved = turn * Vec3f(&s.mesh.vertices[v]) + move;
    std::copy_n(moved.data(), 3, &vertices[v]);
  }
  place_gaussians(s.texels, texel_frames(s.texels, vertices, s.mesh.triangles), decoded, after);
  EXPECT_EQ(before.scale, after.scale);
  EXPECT_EQ(before.opacity, after.opacity);
  EXPECT_EQ(before.zonal, after.zonal);
  const auto plane = [n](const std::vector<float>& planes, size_t first, size_t i) {
    return Vec3f(planes[first * n + i], planes[(first + 1) * n + i], planes[(first + 2) * n + i]);
  };
  for (size_t i = 0; i < n; ++i) {
    EXPECT_LT((turn * Vec3f(&before.center[3 * i]) + move - Vec3f(&after.center[3 * i])).norm(),
              1e-5f);
    for (size_t axis = 0; axis < 9; axis += 3)
      EXPECT_LT((turn * plane(before.axes, axis, i) - plane(after.axes, axis, i)).norm(), 1e-4f);
    EXPECT_LT((turn * plane(before.normal, 0, i) - plane(after.normal, 0, i)).norm(), 1e-4f);
  }
}

}  // namespace
}  // namespace effigy
