#include "effigy/light/lobe_environment.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/light/cubemap_layout.h"

namespace effigy {
namespace {

constexpr float kFinest = 0.01f;   // sigma of level 0
constexpr int kLargestSize = 256;  // texels a side
constexpr int kSmallest = 8;
constexpr double kReadTexels = 2.0;     // of the light, in a sigma
constexpr double kWrittenTexels = 3.0;  // of the filtered map, in a sigma
constexpr int kSide = 8;                // of the blocks of texels that are passed over together
constexpr size_t kBlock = kSide * kSide;
constexpr double kReach = 4.0;  // standard deviations

double level_width(size_t level) {
  return static_cast<double>(LobeEnvironment::level_sigma(static_cast<int>(level)));
}

size_t texel_at(int face, int x, int y, int n) {
  return (static_cast<size_t>(face) * static_cast<size_t>(n) + static_cast<size_t>(y)) *
             static_cast<size_t>(n) +
         static_cast<size_t>(x);
}

// What is filtered: the light of every texel and where it comes from. When texels are taken
// together, their light is summed and comes from its own middle, so that a lamp stays where it is.
struct Source {
  int size = 0;
  struct Texel {
    Vec3d direction, light;  // light: radiance times solid angle
    double area;
  };
  std::vector<Texel> texels;  // as in Cubemap
};

Source source_of(const Cubemap& map) {
  const int n = map.size;
  Source source{n, {}};
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        const float* rgb = map.texels.data() + 3 * texel_at(face, x, y, n);
        const double area = cubemap_solid_angle(x, y, n);
        source.texels.push_back({cubemap_direction(face, x, y, n).cast<double>().normalized(),
                                 area * Vec3d(rgb[0], rgb[1], rgb[2]), area});
      }
  return source;
}

Cubemap radiance_of(const Source& source) {
  Cubemap map(source.size);
  for (size_t i = 0; i < source.texels.size(); ++i)
    for (size_t c = 0; c < 3; ++c)
      map.texels[3 * i + c] =
          static_cast<float>(source.texels[i].light[static_cast<int>(c)] / source.texels[i].area);
  return map;
}

Source half_of(const Source& fine) {
  const int n = fine.size / 2;
  Source coarse{n, {}};
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        Source::Texel sum{Vec3d::Zero(), Vec3d::Zero(), 0.0};
        Vec3d middle = Vec3d::Zero();
        for (int k = 0; k < 4; ++k) {
          const Source::Texel& t =
              fine.texels[texel_at(face, 2 * x + k % 2, 2 * y + k / 2, fine.size)];
          sum.light += t.light;
          sum.area += t.area;
          sum.direction += std::max(0.0, t.light.sum()) * t.direction;
          middle += t.direction;
        }
        if (!(sum.direction.norm() > 1e-6 * std::abs(sum.light.sum()))) sum.direction = middle;
        sum.direction.normalize();
        coarse.texels.push_back(sum);
      }
  return coarse;
}

// Texels that are neighbours, as arrays, with their bounding cone.
struct Block {
  float x[kBlock], y[kBlock], z[kBlock], area[kBlock], light[3][kBlock];
  Vec3f direction;
  float radius;  // angle
};

std::vector<Block> blocks_of(const Source& source) {
  std::vector<Block> blocks;
  const int n = source.size;
  for (int face = 0; face < 6; ++face)
    for (int by = 0; by < n; by += kSide)
      for (int bx = 0; bx < n; bx += kSide) {
        Block block;
        Vec3d sum = Vec3d::Zero();
        for (size_t k = 0; k < kBlock; ++k) {
          const Source::Texel& t = source.texels[texel_at(face, bx + static_cast<int>(k) % kSide,
                                                          by + static_cast<int>(k) / kSide, n)];
          block.x[k] = static_cast<float>(t.direction.x());
          block.y[k] = static_cast<float>(t.direction.y());
          block.z[k] = static_cast<float>(t.direction.z());
          block.area[k] = static_cast<float>(t.area);
          for (int c = 0; c < 3; ++c) block.light[c][k] = static_cast<float>(t.light[c]);
          sum += t.direction;
        }
        block.direction = sum.normalized().cast<float>();
        block.radius = 0.0f;
        for (size_t k = 0; k < kBlock; ++k) {
          const float cosine = block.direction.dot(Vec3f(block.x[k], block.y[k], block.z[k]));
          block.radius = std::max(block.radius, std::acos(std::clamp(cosine, -1.0f, 1.0f)));
        }
        blocks.push_back(block);
      }
  return blocks;
}

// Adds a block's light under exp(-theta^2 / 2 sigma^2) about q, and the weights.
EFFIGY_CLONES
void add_block(const Block& b, float qx, float qy, float qz, float scale, float* sums) {
  float w[kBlock];
  for (size_t k = 0; k < kBlock; ++k) {
    const float x = b.x[k] - qx, y = b.y[k] - qy, z = b.z[k] - qz;
    float theta2, unused;
    sg_angle(0.25f * (x * x + y * y + z * z), theta2, unused);
    w[k] = sg_exp2(scale * theta2);
  }
  // Eight sums side by side, so that the order of additions does not depend on the processor.
  float lanes[4][8] = {};
  for (size_t k = 0; k < kBlock; k += 8)
    for (size_t i = 0; i < 8; ++i) {
      lanes[0][i] += w[k + i] * b.light[0][k + i];
      lanes[1][i] += w[k + i] * b.light[1][k + i];
      lanes[2][i] += w[k + i] * b.light[2][k + i];
      lanes[3][i] += w[k + i] * b.area[k + i];
    }
  for (size_t c = 0; c < 4; ++c)
    for (const float x : lanes[c]) sums[c] += x;
}

// Fills the kSide x kSide texels of `out` whose first is (bx, by) of `face`.
void filter_tile(const std::vector<Block>& blocks, float sigma, int face, int bx, int by,
                 Cubemap& out) {
  const int n = out.size;
  const float scale = -kSgHalfLog2E / (sigma * sigma);
  Vec3f q[kBlock], middle = Vec3f::Zero();
  for (size_t k = 0; k < kBlock; ++k) {
    q[k] = cubemap_direction(face, bx + static_cast<int>(k) % kSide,
                             by + static_cast<int>(k) / kSide, n)
               .normalized();
    middle += q[k];
  }
  middle.normalize();
  const auto angle = [](const Vec3f& a, const Vec3f& b) {
    return std::acos(std::clamp(a.dot(b), -1.0f, 1.0f));
  };
  float radius = 0.0f;
  for (const Vec3f& direction : q) radius = std::max(radius, angle(middle, direction));
  const auto reach = static_cast<float>(kReach) * sigma;
  const auto cosine_of = [](float a) { return std::cos(std::min(std::numbers::pi_v<float>, a)); };
  std::vector<std::pair<const Block*, float>> near;  // and the cosine within which it counts
  for (const Block& block : blocks)
    if (block.direction.dot(middle) >= cosine_of(reach + block.radius + radius))
      near.emplace_back(&block, cosine_of(reach + block.radius));
  for (size_t k = 0; k < kBlock; ++k) {
    float sums[4] = {};
    for (const auto& [block, cosine] : near)
      if (block->direction.dot(q[k]) >= cosine)
        add_block(*block, q[k].x(), q[k].y(), q[k].z(), scale, sums);
    const size_t texel =
        texel_at(face, bx + static_cast<int>(k) % kSide, by + static_cast<int>(k) / kSide, n);
    for (size_t c = 0; c < 3; ++c) out.texels[3 * texel + c] = sums[c] / sums[3];
  }
}

Cubemap filtered(const Source& source, float sigma, int n) {
  const std::vector<Block> blocks = blocks_of(source);
  Cubemap out(n);
  const int side = n / kSide;  // in tiles
  parallel_for(size_t{6} * static_cast<size_t>(side * side), 1, [&](size_t begin, size_t end, int) {
    for (size_t tile = begin; tile < end; ++tile) {
      const int t = static_cast<int>(tile), face = t / (side * side), rest = t % (side * side);
      filter_tile(blocks, sigma, face, rest % side * kSide, rest / side * kSide, out);
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
  const double held = std::clamp(sigma, level_width(0), level_width(levels.size() - 1));
  size_t k = 0;
  while (k + 2 < levels.size() && level_width(k + 1) < held) ++k;
  const auto narrowness = [](double width) { return 1.0 / (width * width); };
  const double fine_at = narrowness(level_width(k)), coarse_at = narrowness(level_width(k + 1));
  const double f = (fine_at - narrowness(held)) / (fine_at - coarse_at);
  const Lookup fine = look_up(levels[k], q), coarse = look_up(levels[k + 1], q);
  r.mean = fine.value + f * (coarse.value - fine.value);
  r.mean_by_q = fine.slope + f * (coarse.slope - fine.slope);
  const double slope = held == sigma ? 2.0 / (sigma * sigma * sigma * (fine_at - coarse_at)) : 0.0;
  r.mean_by_sigma = slope * (coarse.value - fine.value);
  return r;
}

}  // namespace

float LobeEnvironment::level_sigma(int level) {
  return kFinest * std::exp2(0.5f * static_cast<float>(level));
}

LobeEnvironment::LobeEnvironment(const Cubemap& radiance) {
  const int size = radiance.size;
  if (size < kSmallest || size > 1024 || (size & (size - 1)) != 0)
    throw Error("A cubemap of " + std::to_string(size) +
                " texels a side cannot be filtered; the side must be a power of two from " +
                std::to_string(kSmallest) + " to 1024.");
  std::vector<Source> sources{source_of(radiance)};
  while (sources.back().size > kSmallest) sources.push_back(half_of(sources.back()));
  size_t first = 0;
  while (sources[first].size > kLargestSize) ++first;
  const int finest = sources[first].size;
  for (int k = 0; k < kLevels; ++k) {
    const double sigma = level_width(static_cast<size_t>(k));
    // How many texels of a map of n lie in a sigma where they are largest: n sigma / 2.
    if (0.5 * sigma * finest < 1.0) {
      levels_.push_back(radiance_of(sources[first]));
      continue;
    }
    size_t from = first;
    while (from + 1 < sources.size() && 0.5 * sigma * sources[from + 1].size >= kReadTexels) ++from;
    const int wanted = kSide * static_cast<int>(std::ceil(2.0 * kWrittenTexels / sigma / kSide));
    levels_.push_back(filtered(sources[from], static_cast<float>(sigma), std::min(finest, wanted)));
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
