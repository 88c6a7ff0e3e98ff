#include "effigy/head/surface_fill.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr float kCell = 0.004f;  // metres
constexpr int kMostCells = 128;  // along one axis
constexpr float kShare = 0.25f;  // of the surface in a cell, known well, that decides the cell

// Values with weights on a regular grid, and their pull-push pyramid.
class SpaceGrid {
 public:
  SpaceGrid(const Eigen::AlignedBox3f& box, int channels) : channels_(channels), low_(box.min()) {
    const Vec3f extent = box.sizes();
    cell_ = std::max(kCell, extent.maxCoeff() / kMostCells);
    Level level;
    for (int axis = 0; axis < 3; ++axis)
      level.size[axis] = static_cast<int>(extent[axis] / cell_) + 2;
    level.allocate(channels);
    levels_.push_back(std::move(level));
  }

  void add(const Vec3f& point, float weight, const float* values) {
    visit_corners(levels_[0], (point - low_) / cell_, [&](Level& level, size_t at, float share) {
      level.surface[at] += share;
      level.weight[at] += share * weight;
      for (int c = 0; c < channels_; ++c)
        level.value[at * channels_ + c] += share * weight * values[c];
    });
  }

  // Turns sums into means and fills cells without weight. False when there is no weight at all.
  bool fill() {
    finish(levels_[0]);
    while (levels_.back().weight.size() > 1) pull();
    if (levels_.back().weight[0] <= 0) return false;
    for (size_t l = levels_.size() - 1; l-- > 0;) push(levels_[l + 1], levels_[l]);
    return true;
  }

  void sample(const Vec3f& point, float* values) {
    sample(levels_[0], (point - low_) / cell_, values);
  }

 private:
  struct Level {
    std::array<int, 3> size;
    // Points in each cell; their weights, later how far the cell is known in [0, 1]; their values.
    std::vector<float> surface, weight, value;
    void allocate(int channels) {
      weight.assign(static_cast<size_t>(size[0]) * size[1] * size[2], 0.0f);
      surface = weight;
      value.assign(weight.size() * channels, 0.0f);
    }
    size_t index(int x, int y, int z) const {
      return (static_cast<size_t>(z) * size[1] + y) * size[0] + x;
    }
  };

  // Calls visit(level, cell, share) for the eight cells around `at` (cell centres at integers).
  template <typename Visit>
  static void visit_corners(Level& level, const Vec3f& at, Visit&& visit) {
    std::array<int, 3> first, last;
    Vec3f part;
    for (int axis = 0; axis < 3; ++axis) {
      const float x = std::clamp(at[axis], 0.0f, static_cast<float>(level.size[axis] - 1));
      first[axis] = static_cast<int>(x);
      last[axis] = std::min(first[axis] + 1, level.size[axis] - 1);
      part[axis] = x - static_cast<float>(first[axis]);
    }
    for (int corner = 0; corner < 8; ++corner) {
      float share = 1;
      std::array<int, 3> cell;
      for (int axis = 0; axis < 3; ++axis) {
        const bool upper = ((corner >> axis) & 1) != 0;
        share *= upper ? part[axis] : 1 - part[axis];
        cell[axis] = upper ? last[axis] : first[axis];
      }
      if (share > 0) visit(level, level.index(cell[0], cell[1], cell[2]), share);
    }
  }

  void sample(Level& level, const Vec3f& at, float* values) const {
    std::fill_n(values, channels_, 0.0f);
    visit_corners(level, at, [&](const Level& from, size_t cell, float share) {
      for (int c = 0; c < channels_; ++c) values[c] += share * from.value[cell * channels_ + c];
    });
  }

  // Sums become means; a cell is known as far as its surface is, however much of it there is.
  void finish(Level& level) const {
    for (size_t i = 0; i < level.weight.size(); ++i) {
      if (level.weight[i] <= 0) continue;
      for (int c = 0; c < channels_; ++c) level.value[i * channels_ + c] /= level.weight[i];
      level.weight[i] = std::min(1.0f, level.weight[i] / (kShare * level.surface[i]));
    }
  }

  void pull() {
    const Level& fine = levels_.back();
    Level coarse;
    for (int axis = 0; axis < 3; ++axis) coarse.size[axis] = (fine.size[axis] + 1) / 2;
    coarse.allocate(channels_);
    visit_cells(fine, [&](int x, int y, int z, size_t from) {
      const size_t to = coarse.index(x / 2, y / 2, z / 2);
      const float w = fine.weight[from] * fine.surface[from];
      coarse.surface[to] += fine.surface[from];
      coarse.weight[to] += w;
      for (int c = 0; c < channels_; ++c)
        coarse.value[to * channels_ + c] += w * fine.value[from * channels_ + c];
    });
    finish(coarse);
    levels_.push_back(std::move(coarse));
  }

  void push(Level& coarse, Level& fine) const {
    std::vector<float> around(channels_);
    visit_cells(fine, [&](int x, int y, int z, size_t at) {
      const float w = fine.weight[at];
      if (w >= 1) return;
      const Vec3f inside = 0.5f * (Vec3f(x, y, z) + Vec3f::Constant(0.5f)) - Vec3f::Constant(0.5f);
      sample(coarse, inside, around.data());
      for (int c = 0; c < channels_; ++c) {
        float& value = fine.value[at * channels_ + c];
        value = w * value + (1 - w) * around[c];
      }
    });
  }

  template <typename Visit>
  static void visit_cells(const Level& level, Visit&& visit) {
    for (int z = 0; z < level.size[2]; ++z)
      for (int y = 0; y < level.size[1]; ++y)
        for (int x = 0; x < level.size[0]; ++x) visit(x, y, z, level.index(x, y, z));
  }

  int channels_;
  Vec3f low_;
  float cell_ = kCell;
  std::vector<Level> levels_;  // finest first
};

// A texel of one part: its index (row 0 = v 0) and its place.
struct PlacedTexel {
  size_t texel;
  Vec3f place;
};

// The texel of `map` that is in a triangle: `t` itself or one next to it (bilinear lookups reach a
// texel beyond a triangle's border); -1: none.
std::ptrdiff_t covered_texel(const TexelMap& map, size_t t) {
  if (map.triangle[t] >= 0) return static_cast<std::ptrdiff_t>(t);
  const int row = static_cast<int>(t) / map.size, column = static_cast<int>(t) % map.size;
  for (int y = std::max(0, row - 1); y <= std::min(map.size - 1, row + 1); ++y)
    for (int x = std::max(0, column - 1); x <= std::min(map.size - 1, column + 1); ++x) {
      const auto at = static_cast<std::ptrdiff_t>(y) * map.size + x;
      if (map.triangle[at] >= 0) return at;
    }
  return -1;
}

// Texels of each part of the mesh; all in one where it has no parts.
std::vector<std::vector<PlacedTexel>> place_texels(const Mesh& mesh, int size) {
  const TexelMap map = texel_map(mesh, size);
  std::vector<std::vector<PlacedTexel>> parts(std::max<size_t>(1, mesh.parts.size()));
  for (size_t t = 0; t < map.triangle.size(); ++t) {
    const std::ptrdiff_t from = covered_texel(map, t);
    if (from < 0) continue;
    const auto triangle = static_cast<size_t>(map.triangle[from]);
    const Vec3i& corner = mesh.triangles[triangle];
    const float b = map.barycentric[2 * from], c = map.barycentric[2 * from + 1];
    const Vec3f place = (1 - b - c) * mesh.vertex(corner[0]) + b * mesh.vertex(corner[1]) +
                        c * mesh.vertex(corner[2]);
    const size_t row = t / static_cast<size_t>(size), column = t % static_cast<size_t>(size);
    const size_t texel = (static_cast<size_t>(size) - 1 - row) * static_cast<size_t>(size) + column;
    parts[mesh.triangle_part.empty() ? 0 : mesh.triangle_part[triangle]].push_back({texel, place});
  }
  return parts;
}

}  // namespace

void fill_over_surface(const Mesh& mesh, int size, int channels, float enough,
                       const std::vector<float>& weights, std::vector<float>& values) {
  EFFIGY_CHECK(enough > 0 && channels > 0);
  EFFIGY_CHECK_EQ(weights.size(), static_cast<size_t>(size) * size);
  EFFIGY_CHECK_EQ(values.size(), weights.size() * channels);
  std::vector<float> around(channels);
  for (const std::vector<PlacedTexel>& part : place_texels(mesh, size)) {
    if (part.empty()) continue;
    Eigen::AlignedBox3f box;
    for (const PlacedTexel& t : part) box.extend(t.place);
    SpaceGrid grid(box, channels);
    const auto known = [&](const PlacedTexel& t) {
      return std::clamp(weights[t.texel] / enough, 0.0f, 1.0f);
    };
    for (const PlacedTexel& t : part) grid.add(t.place, known(t), &values[t.texel * channels]);
    if (!grid.fill()) continue;
    for (const PlacedTexel& t : part) {
      const float w = known(t);
      if (w >= 1) continue;
      grid.sample(t.place, around.data());
      for (int c = 0; c < channels; ++c) {
        float& value = values[t.texel * channels + c];
        value = w * value + (1 - w) * around[c];
      }
    }
  }
}

}  // namespace effigy
