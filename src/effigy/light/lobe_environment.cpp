#include "effigy/light/lobe_environment.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/light/cubemap_layout.h"

namespace effigy {
namespace {

constexpr float kFinest = 0.01f;   // sigma of level 0
constexpr int kLargestSize = 256;  // of what is filtered
constexpr int kLargestOutput = 128;
constexpr int kSmallest = 8;
constexpr int kBlockSide = 8;   // texels that are passed over together
constexpr double kReach = 5.0;  // standard deviations

size_t texel_at(int face, int x, int y, int n) {
  return (static_cast<size_t>(face) * static_cast<size_t>(n) + static_cast<size_t>(y)) *
             static_cast<size_t>(n) +
         static_cast<size_t>(x);
}

// Means over 2 x 2 texels.
Cubemap half_of(const Cubemap& source) {
  const int n = source.size / 2;
  Cubemap out(n);
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        double sum[3] = {}, weight = 0;
        for (int k = 0; k < 4; ++k) {
          const int sx = 2 * x + k % 2, sy = 2 * y + k / 2;
          const double area = cubemap_solid_angle(sx, sy, source.size);
          const float* rgb = source.texels.data() + 3 * texel_at(face, sx, sy, source.size);
          for (int c = 0; c < 3; ++c) sum[c] += area * static_cast<double>(rgb[c]);
          weight += area;
        }
        for (size_t c = 0; c < 3; ++c)
          out.texels[3 * texel_at(face, x, y, n) + c] = static_cast<float>(sum[c] / weight);
      }
  return out;
}

Cubemap resized(const Cubemap& source, int n) {
  Cubemap out = source;
  while (out.size > n) out = half_of(out);
  if (out.size == n) return out;
  Cubemap large(n);
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        const Vec3f rgb = sample_cubemap(out, cubemap_direction(face, x, y, n));
        std::copy_n(rgb.data(), 3, large.texels.data() + 3 * texel_at(face, x, y, n));
      }
  return large;
}

int power_of_two_above(double x) {
  int n = kSmallest;
  while (n < x) n *= 2;
  return n;
}

// The texels of a cubemap as a list of blocks with bounding cones.
struct Texel {
  Vec3f direction;
  float area;
  Vec3f radiance;
};
struct Block {
  Vec3f direction;
  float radius;  // angle
  size_t first;
};

struct Blocks {
  std::vector<Texel> texels;
  std::vector<Block> blocks;

  explicit Blocks(const Cubemap& map) {
    const int n = map.size, side = std::min(kBlockSide, n);
    for (int face = 0; face < 6; ++face)
      for (int by = 0; by < n; by += side)
        for (int bx = 0; bx < n; bx += side) {
          Block block{Vec3f::Zero(), 0.0f, texels.size()};
          for (int k = 0; k < side * side; ++k) {
            const int x = bx + k % side, y = by + k / side;
            const float* rgb = map.texels.data() + 3 * texel_at(face, x, y, n);
            const Vec3f direction = cubemap_direction(face, x, y, n).normalized();
            texels.push_back({direction, static_cast<float>(cubemap_solid_angle(x, y, n)),
                              Vec3f(rgb[0], rgb[1], rgb[2])});
            block.direction += direction;
          }
          block.direction.normalize();
          for (size_t k = block.first; k < texels.size(); ++k)
            block.radius = std::max(
                block.radius,
                std::acos(std::clamp(block.direction.dot(texels[k].direction), -1.0f, 1.0f)));
          blocks.push_back(block);
        }
  }
  size_t per_block() const { return texels.size() / blocks.size(); }
};

Vec3f mean_under_lobe(const Blocks& source, const std::vector<float>& reach_cosine, const Vec3f& q,
                      float sigma) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weight = 0;
  const float scale = -0.5f / (sigma * sigma);
  for (size_t b = 0; b < source.blocks.size(); ++b) {
    const Block& block = source.blocks[b];
    if (block.direction.dot(q) < reach_cosine[b]) continue;
    for (size_t k = block.first; k < block.first + source.per_block(); ++k) {
      const Texel& t = source.texels[k];
      float theta2, unused;
      sg_angle(0.25f * (t.direction - q).squaredNorm(), theta2, unused);
      const float w = t.area * std::exp(scale * theta2);
      sum += (w * t.radiance).cast<double>();
      weight += static_cast<double>(w);
    }
  }
  return (sum / weight).cast<float>();
}

Cubemap filtered(const Cubemap& source, float sigma, int n) {
  const Blocks blocks(source);
  std::vector<float> reach_cosine;
  for (const Block& block : blocks.blocks)
    reach_cosine.push_back(static_cast<float>(
        std::cos(std::min(std::numbers::pi, kReach * static_cast<double>(sigma) +
                                                static_cast<double>(block.radius)))));
  Cubemap out(n);
  const size_t rows = static_cast<size_t>(6 * n);
  parallel_for(rows, 1, [&](size_t begin, size_t end, int) {
    for (size_t row = begin; row < end; ++row) {
      const int face = static_cast<int>(row) / n, y = static_cast<int>(row) % n;
      for (int x = 0; x < n; ++x) {
        const Vec3f q = cubemap_direction(face, x, y, n).normalized();
        const Vec3f rgb = mean_under_lobe(blocks, reach_cosine, q, sigma);
        std::copy_n(rgb.data(), 3, out.texels.data() + 3 * texel_at(face, x, y, n));
      }
    }
  });
  return out;
}

// Bilinear value and its derivatives by the direction.
struct Lookup {
  Vec3d value;
  Eigen::Matrix3d slope;  // column k: by component k of the direction
};

Lookup look_up(const Cubemap& map, const Vec3d& q) {
  const int n = map.size;
  const CubePoint point = cube_point(q);
  const double x = 0.5 * (point.s + 1.0) * n - 0.5, y = 0.5 * (point.t + 1.0) * n - 0.5;
  const int x0 = std::clamp(static_cast<int>(std::floor(x)), -1, n - 1);
  const int y0 = std::clamp(static_cast<int>(std::floor(y)), -1, n - 1);
  const auto tap = [&](int tx, int ty) -> Vec3d {
    const bool outside_x = tx < 0 || tx >= n, outside_y = ty < 0 || ty >= n;
    const auto texel = [&](size_t i) {
      const float* rgb = map.texels.data() + 3 * i;
      return Vec3d(rgb[0], rgb[1], rgb[2]);
    };
    if (!outside_x || !outside_y) return texel(cubemap_texel_across(point.face, tx, ty, n));
    size_t corner[3];  // no texel is there: the mean of the three that meet
    cubemap_corner_texels(point.face, tx >= n, ty >= n, n, corner);
    return (texel(corner[0]) + texel(corner[1]) + texel(corner[2])) / 3.0;
  };
  const Vec3d a = tap(x0, y0), b = tap(x0 + 1, y0), c = tap(x0, y0 + 1), d = tap(x0 + 1, y0 + 1);
  const double fx = x - x0, fy = y - y0;
  const Vec3d top = a + fx * (b - a), bottom = c + fx * (d - c);
  const CubeFace& face = cube_face(point.face);
  const double depth = q.dot(face.normal);
  const Vec3d by_x = (0.5 * n) * ((1.0 - fy) * (b - a) + fy * (d - c));
  const Vec3d by_y = (0.5 * n) * (bottom - top);
  const Vec3d ds = (face.s - point.s * face.normal) / depth;
  const Vec3d dt = (face.t - point.t * face.normal) / depth;
  return {top + fy * (bottom - top), by_x * ds.transpose() + by_y * dt.transpose()};
}

// Light and its scale at (q, sigma), and their derivatives.
struct Response {
  Vec3d mean, mean_by_sigma;
  Eigen::Matrix3d mean_by_q;
  double energy, energy_by_sigma;  // N(sigma) times the lobe's integral
};

Response respond(const std::vector<Cubemap>& levels, SgNorm norm, const Vec3d& q, double sigma) {
  Response r;
  double constant, d_constant, integral, d_integral;
  sg_constant(norm, sigma, constant, d_constant);
  sg_integral(sigma, integral, d_integral);
  const double s2 = sigma * sigma;
  r.energy = constant * s2 * integral;
  r.energy_by_sigma =
      d_constant * s2 * integral + constant * (2.0 * sigma * integral + s2 * d_integral);
  const double last = static_cast<double>(levels.size()) - 1.0;
  const double at = 2.0 * std::log2(sigma / static_cast<double>(kFinest));
  const double inside = std::clamp(at, 0.0, last);
  const size_t k = static_cast<size_t>(std::min(std::floor(inside), last - 1.0));
  const double f = inside - static_cast<double>(k);
  const Lookup fine = look_up(levels[k], q), coarse = look_up(levels[k + 1], q);
  r.mean = fine.value + f * (coarse.value - fine.value);
  r.mean_by_q = fine.slope + f * (coarse.slope - fine.slope);
  const double slope = at == inside ? 2.0 / (sigma * std::numbers::ln2) : 0.0;
  r.mean_by_sigma = slope * (coarse.value - fine.value);
  return r;
}

}  // namespace

float LobeEnvironment::level_sigma(int level) {
  return kFinest * std::exp2(0.5f * static_cast<float>(level));
}

LobeEnvironment::LobeEnvironment(const Cubemap& radiance) {
  const int size = radiance.size;
  if (size < 2 || size > 1024 || (size & (size - 1)) != 0)
    throw Error("A cubemap of " + std::to_string(size) +
                " texels a side cannot be filtered; the side must be a power of two up to 1024.");
  for (int k = 0; k < kLevels; ++k) {
    const float sigma = level_sigma(k);
    const int from = std::min(kLargestSize, power_of_two_above(4.0 / static_cast<double>(sigma)));
    const int to = std::min(kLargestOutput, power_of_two_above(1.6 / static_cast<double>(sigma)));
    levels_.push_back(filtered(resized(radiance, from), sigma, to));
  }
}

void LobeEnvironment::add(SgNorm norm, size_t count, const float* q, const float* sigma,
                          size_t stride, float* colour) const {
  if (levels_.empty()) return;
  for (size_t i = 0; i < count; ++i) {
    if (!(sigma[i] > 0.0f)) continue;
    const Vec3d direction(q[i], q[stride + i], q[2 * stride + i]);
    if (!(direction.squaredNorm() > 0.0)) continue;
    const Response r = respond(levels_, norm, direction, static_cast<double>(sigma[i]));
    for (int c = 0; c < 3; ++c)
      colour[static_cast<size_t>(c) * stride + i] += static_cast<float>(r.energy * r.mean[c]);
  }
}

void LobeEnvironment::add_backward(SgNorm norm, size_t count, const float* q, const float* sigma,
                                   size_t stride, const float* d_colour, float* d_q,
                                   float* d_sigma) const {
  if (levels_.empty()) return;
  for (size_t i = 0; i < count; ++i) {
    if (!(sigma[i] > 0.0f)) continue;
    const Vec3d direction(q[i], q[stride + i], q[2 * stride + i]);
    if (!(direction.squaredNorm() > 0.0)) continue;
    const Vec3d g(d_colour[i], d_colour[stride + i], d_colour[2 * stride + i]);
    const Response r = respond(levels_, norm, direction, static_cast<double>(sigma[i]));
    const Vec3d by_q = r.energy * r.mean_by_q.transpose() * g;
    for (int c = 0; c < 3; ++c)
      d_q[static_cast<size_t>(c) * stride + i] += static_cast<float>(by_q[c]);
    d_sigma[i] +=
        static_cast<float>(r.energy_by_sigma * r.mean.dot(g) + r.energy * r.mean_by_sigma.dot(g));
  }
}

}  // namespace effigy
