// Cubemap geometry, seamless lookup, and resampling from equirectangular images.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/light/cubemap_layout.h"
#include "effigy/light/environment.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;

Vec3d random_direction(Random& random) {
  Vec3d d;
  do {
    d = {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
  } while (d.squaredNorm() > 1 || d.squaredNorm() < 1e-4);
  return d.normalized();
}

Cubemap random_cubemap(int n, uint64_t seed) {
  Random random(seed);
  Cubemap cubemap(n);
  for (float& value : cubemap.texels) value = static_cast<float>(random.uniform(0.1, 2.0));
  return cubemap;
}

// Mean of a channel of an equirectangular image over the sphere.
double image_mean(const Image& image, int channel) {
  double sum = 0;
  for (int y = 0; y < image.height; ++y) {
    const double w = std::cos(kPi * y / image.height) - std::cos(kPi * (y + 1) / image.height);
    for (int x = 0; x < image.width; ++x) sum += w / image.width * image.at(x, y)[channel];
  }
  return sum / 2.0;
}

double cubemap_mean(const Cubemap& cubemap, int channel) {
  const int n = cubemap.size;
  double sum = 0;
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x)
        sum += cubemap_solid_angle(x, y, n) *
               cubemap.texels[3 * ((static_cast<size_t>(f) * n + y) * n + x) + channel];
  return sum / (4 * kPi);
}

TEST(Cubemap, FacesAreInOpenGlOrderAndOrientation) {
  // OpenGL 4.6, table 8.19: at a face's centre the direction is the face axis; s and t grow along
  // the table's sc and tc.
  const Vec3f axes[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  for (int f = 0; f < 6; ++f)
    EXPECT_LT((cubemap_direction(f, 1, 1, 3) - axes[f]).norm(), 1e-6f) << f;
  const auto near = [](const Vec3f& a, const Vec3f& b) {
    return (a.normalized() - b.normalized()).norm() < 1e-6f;
  };
  // Top-left texel of 2 x 2: s = t = -1/2.
  EXPECT_TRUE(near(cubemap_direction(0, 0, 0, 2), {1, .5f, .5f}));    // -z, -y
  EXPECT_TRUE(near(cubemap_direction(1, 0, 0, 2), {-1, .5f, -.5f}));  // +z, -y
  EXPECT_TRUE(near(cubemap_direction(2, 0, 0, 2), {-.5f, 1, -.5f}));  // +x, +z
  EXPECT_TRUE(near(cubemap_direction(3, 0, 0, 2), {-.5f, -1, .5f}));  // +x, -z
  EXPECT_TRUE(near(cubemap_direction(4, 0, 0, 2), {-.5f, .5f, 1}));   // +x, -y
  EXPECT_TRUE(near(cubemap_direction(5, 0, 0, 2), {.5f, .5f, -1}));   // -x, -y
}

TEST(Cubemap, SolidAnglesAreExact) {
  for (const int n : {1, 2, 7, 32}) {
    double sum = 0;
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) sum += cubemap_solid_angle(x, y, n);
    EXPECT_NEAR(6 * sum, 4 * kPi, 1e-12) << n;
  }
  // Against quadrature of the area element (1 + s^2 + t^2)^(-3/2).
  const int n = 4, grid = 400;
  double sum = 0;
  for (int j = 0; j < grid; ++j)
    for (int i = 0; i < grid; ++i) {
      const double s = 0.5 + 0.5 * (i + .5) / grid, t = -1 + 0.5 * (j + .5) / grid;
      sum += std::pow(1 + s * s + t * t, -1.5) * 0.25 / grid / grid;
    }
  EXPECT_NEAR(cubemap_solid_angle(3, 0, n), sum, 1e-7);
}

TEST(Cubemap, PointInvertsDirection) {
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < 5; ++y)
      for (int x = 0; x < 5; ++x) {
        const CubePoint p = cube_point(3.0 * cubemap_direction(f, x, y, 5).cast<double>());
        EXPECT_EQ(p.face, f);
        EXPECT_NEAR(p.s, -1 + (2 * x + 1) / 5.0, 1e-6);
        EXPECT_NEAR(p.t, -1 + (2 * y + 1) / 5.0, 1e-6);
      }
}

TEST(Cubemap, LookupAtTexelCentresIsTheTexel) {
  const Cubemap cubemap = random_cubemap(8, 1);
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < 8; ++y)
      for (int x = 0; x < 8; ++x) {
        const Vec3f value = sample_cubemap(cubemap, cubemap_direction(f, x, y, 8));
        for (int c = 0; c < 3; ++c)
          EXPECT_NEAR(value[c], cubemap.texels[3 * ((f * 8 + y) * 8 + x) + c], 1e-5);
      }
}

TEST(Cubemap, LookupIsContinuousOverFaceBorders) {
  for (const int n : {1, 2, 5, 16}) {
    const Cubemap cubemap = random_cubemap(n, 2);
    Random random(3);
    double largest = 0;
    for (int i = 0; i < 3000; ++i) {
      // A point on one of the cube's edges (sometimes its corners), seen from both sides.
      const int axis = static_cast<int>(random.below(3));
      Vec3d p;
      p[axis] = i % 10 == 0 ? 1.0 : random.uniform(-1, 1);
      p[(axis + 1) % 3] = random.below(2) ? 1 : -1;
      p[(axis + 2) % 3] = random.below(2) ? 1 : -1;
      Vec3d a = p, b = p;
      a[(axis + 1) % 3] *= 1 + 1e-7;
      b[(axis + 2) % 3] *= 1 + 1e-7;
      const Vec3f va = sample_cubemap(cubemap, a.cast<float>());
      const Vec3f vb = sample_cubemap(cubemap, b.cast<float>());
      largest = std::max<double>(largest, (va - vb).norm());
    }
    EXPECT_LT(largest, 1e-5 * n) << n;
  }
}

TEST(Cubemap, LookupStaysBetweenNeighbours) {
  // A smooth function of direction is reproduced closely everywhere, borders and corners included:
  // a wrong neighbour would be off by far more.
  const int n = 32;
  Cubemap cubemap(n);
  const auto f = [](const Vec3d& d) {
    return Vec3d(1 + d.x(), 1 + d.y() * d.z(), 2 + d.z() - d.x() * d.y());
  };
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x)
        Eigen::Map<Vec3f>(&cubemap.texels[3 * ((face * n + y) * n + x)]) =
            f(cubemap_direction(face, x, y, n).cast<double>()).cast<float>();
  Random random(5);
  double largest = 0;
  for (int i = 0; i < 20000; ++i) {
    Vec3d d = random_direction(random);
    if (i % 2) {  // half of them close to the cube's edges
      const int axis = i / 2 % 3;
      d[axis] = std::copysign(d.cwiseAbs().maxCoeff() * random.uniform(0.97, 1.03), d[axis]);
      d.normalize();
    }
    const Vec3d value = sample_cubemap(cubemap, d.cast<float>()).cast<double>();
    largest = std::max(largest, (value - f(d)).norm());
  }
  EXPECT_LT(largest, 0.02);
}

TEST(Equirectangular, EveryPixelOfLightIsKept) {
  // Flux is conserved for smooth, noisy and single-pixel images, coarser and finer than the
  // cubemap.
  Random random(7);
  for (const int size : {6, 16, 32, 128}) {
    for (const int width : {16, 100, 512}) {
      Image image(width, width / 2, 3);
      for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < width; ++x) {
          image.at(x, y)[0] = static_cast<float>(random.uniform());
          image.at(x, y)[1] = 0.01f;
          image.at(x, y)[2] = 1.5f + static_cast<float>(std::sin(6.28 * x / width));
        }
      const int row = static_cast<int>(random.below(static_cast<uint64_t>(image.height)));
      image.at(static_cast<int>(random.below(static_cast<uint64_t>(width))), row)[1] = 1e5f;
      const Cubemap cubemap = cubemap_from_equirectangular(image, size, 0.3);
      for (int c = 0; c < 3; ++c) {
        const double expected = image_mean(image, c);
        EXPECT_NEAR(cubemap_mean(cubemap, c), expected, 1e-3 * expected)
            << size << " " << width << " " << c << " row " << row;
      }
    }
  }
}

TEST(Equirectangular, ConstantStaysConstant) {
  const Cubemap cubemap = cubemap_from_equirectangular(Image(50, 25, 3, 0.7f), 12);
  for (const float value : cubemap.texels) EXPECT_NEAR(value, 0.7f, 1e-6f);
  const Image back = equirectangular_from_cubemap(cubemap, 20, 10);
  for (const float value : back.data) EXPECT_NEAR(value, 0.7f, 1e-5f);
}

TEST(Equirectangular, TexelsAreAreaMeans) {
  // Against a fine brute-force average of the piecewise constant image over each texel.
  Random random(11);
  Image image(24, 12, 3);
  for (float& value : image.data) value = static_cast<float>(random.uniform());
  const double rotation = -0.4;
  const int n = 4, grid = 250;
  const Cubemap cubemap = cubemap_from_equirectangular(image, n, rotation);
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        const CubeFace& face = cube_face(f);
        Vec3d sum = Vec3d::Zero();
        double weights = 0;
        for (int j = 0; j < grid; ++j)
          for (int i = 0; i < grid; ++i) {
            const double s = -1 + 2.0 * (x + (i + .5) / grid) / n;
            const double t = -1 + 2.0 * (y + (j + .5) / grid) / n;
            const Vec3d d = (face.normal + s * face.s + t * face.t).normalized();
            const double w = std::pow(1 + s * s + t * t, -1.5);
            double u = (std::atan2(d.x(), -d.z()) + rotation) / (2 * kPi) + 0.5;
            u -= std::floor(u);
            const double v = std::acos(d.y()) / kPi;
            sum += w * Eigen::Map<const Vec3f>(image.at(std::min(23, static_cast<int>(u * 24)),
                                                        std::min(11, static_cast<int>(v * 12))))
                           .cast<double>();
            weights += w;
          }
        for (int c = 0; c < 3; ++c)
          EXPECT_NEAR(cubemap.texels[3 * ((f * n + y) * n + x) + c], sum[c] / weights, 4e-3);
      }
}

TEST(Equirectangular, DirectionsAndRotationAreAsDocumented) {
  // A bright pixel at u = 3/4 is in direction +x; at the middle in direction -z; the top row is +y.
  const auto brightest = [](const Cubemap& cubemap) {
    size_t best = 0;
    for (size_t i = 0; i < cubemap.texels.size() / 3; ++i)
      if (cubemap.texels[3 * i] > cubemap.texels[3 * best]) best = i;
    const int n = cubemap.size;
    return cubemap_direction(static_cast<int>(best / (n * n)), static_cast<int>(best % n),
                             static_cast<int>(best / n % n), n);
  };
  const auto spot = [](int x, int y) {
    Image image(64, 32, 3, 0.1f);
    for (int c = 0; c < 3; ++c) image.at(x, y)[c] = 1000.0f;
    return image;
  };
  EXPECT_GT(brightest(cubemap_from_equirectangular(spot(48, 16), 16)).x(), 0.98f);
  EXPECT_LT(brightest(cubemap_from_equirectangular(spot(32, 16), 16)).z(), -0.98f);
  EXPECT_LT(brightest(cubemap_from_equirectangular(spot(16, 16), 16)).x(), -0.98f);
  EXPECT_GT(brightest(cubemap_from_equirectangular(spot(40, 0), 16)).y(), 0.98f);
  EXPECT_LT(brightest(cubemap_from_equirectangular(spot(40, 31), 16)).y(), -0.98f);
  // A quarter turn counter-clockwise seen from above carries light from -z to -x, from +x to -z.
  EXPECT_LT(brightest(cubemap_from_equirectangular(spot(32, 16), 16, kPi / 2)).x(), -0.98f);
  EXPECT_LT(brightest(cubemap_from_equirectangular(spot(48, 16), 16, kPi / 2)).z(), -0.98f);
}

TEST(Equirectangular, RoundTripThroughTheCubemap) {
  Image image(128, 64, 3);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 128; ++x) {
      const double phi = 2 * kPi * ((x + .5) / 128 - .5), theta = kPi * (y + .5) / 64;
      image.at(x, y)[0] = static_cast<float>(1.2 + std::sin(theta) * std::sin(2 * phi + 1));
      image.at(x, y)[1] = static_cast<float>(1.5 + std::cos(theta));
      image.at(x, y)[2] = static_cast<float>(1.2 + std::sin(theta) * std::cos(phi));
    }
  const Image back = equirectangular_from_cubemap(cubemap_from_equirectangular(image, 64), 128, 64);
  double largest = 0;
  for (size_t i = 0; i < image.data.size(); ++i)
    largest = std::max<double>(largest, std::abs(image.data[i] - back.data[i]));
  EXPECT_LT(largest, 0.03);
}

TEST(Equirectangular, RejectsOtherShapes) {
  EXPECT_THROW(cubemap_from_equirectangular(Image(64, 64, 3), 8), Error);
  EXPECT_THROW(cubemap_from_equirectangular(Image(), 8), Error);
  EXPECT_NO_THROW(cubemap_from_equirectangular(Image(63, 32, 1), 8));
}

TEST(Equirectangular, SameBitsForEveryThreadCount) {
  Random random(13);
  Image image(64, 32, 3);
  for (float& value : image.data) value = static_cast<float>(random.uniform());
  const int threads = thread_count();
  set_thread_count(1);
  const Cubemap one = cubemap_from_equirectangular(image, 16);
  set_thread_count(2);
  const Cubemap two = cubemap_from_equirectangular(image, 16);
  set_thread_count(threads);
  EXPECT_EQ(one.texels, two.texels);
}

TEST(MeanRadiance, IsTheLuminanceMean) {
  EXPECT_NEAR(mean_radiance(Cubemap(8, 3.0f)), 3.0, 1e-5);
  Cubemap cubemap(8);  // the upper half of the sphere green
  for (int f = 0; f < 6; ++f)
    for (int y = 0; y < 8; ++y)
      for (int x = 0; x < 8; ++x)
        if (cubemap_direction(f, x, y, 8).y() > 0)
          cubemap.texels[3 * ((f * 8 + y) * 8 + x) + 1] = 2;
  EXPECT_NEAR(mean_radiance(cubemap), 0.7152, 1e-5);
}

}  // namespace
}  // namespace effigy
