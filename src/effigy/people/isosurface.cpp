#include "effigy/people/isosurface.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <unordered_map>

#include "effigy/base/threads.h"

namespace effigy::people {
namespace {

constexpr int kBlock = 12;  // cubes along the side of a block
constexpr int kPatch = 3;   // corners along the side of what a block skips where it can

struct Grid {
  Vec3d low;
  double cell;
  Vec3i blocks;
  Vec3d corner(int x, int y, int z) const { return low + cell * Vec3d(x, y, z); }
};

// Key of the surface's sheet in a cube of the whole grid.
int64_t key(int x, int y, int z, int sheet) {
  return (((static_cast<int64_t>(x + 1) << 14 | (y + 1)) << 14 | (z + 1)) << 4) | sheet;
}

struct BlockResult {
  std::vector<std::pair<int64_t, Vec3d>> points;  // one a sheet and cube
  std::vector<std::array<int64_t, 4>> quads;      // keys of points
};

class BlockMesher {
 public:
  BlockMesher(const std::function<double(const Vec3d&)>& distance, const Grid& grid,
              double steepness)
      : distance_(distance),
        grid_(grid),
        reach_(steepness * grid.cell * (kPatch + 1) * std::sqrt(3.0) / 2) {}

  // Cubes of the block; quads around the edges that start at its corners.
  void run(const Vec3i& block, BlockResult& out) {
    origin_ = block * kBlock;
    for (int z = 0; z < kSide; z += kPatch)
      for (int y = 0; y < kSide; y += kPatch)
        for (int x = 0; x < kSide; x += kPatch) measure(x, y, z);
    for (int z = 1; z <= kBlock; ++z)
      for (int y = 1; y <= kBlock; ++y)
        for (int x = 1; x <= kBlock; ++x) {
          cube(x, y, z, out);
          for (int axis = 0; axis < 3; ++axis) edge(x, y, z, axis, out);
        }
  }

 private:
  static constexpr int kSide = kBlock + 2;  // one corner before the block, one after
  static int index(int x, int y, int z) { return (z * kSide + y) * kSide + x; }
  double at(int x, int y, int z) const { return value_[static_cast<size_t>(index(x, y, z))]; }

  Vec3d corner(int x, int y, int z) const {
    return grid_.corner(origin_.x() + x - 1, origin_.y() + y - 1, origin_.z() + z - 1);
  }
  // A patch of corners; where no edge from or to them can cross the surface only the side counts,
  // which the middle has too.
  void measure(int x0, int y0, int z0) {
    const Vec3d half = Vec3d::Constant(0.5 * (kPatch - 1) * grid_.cell);
    const double middle = distance_(corner(x0, y0, z0) + half);
    const bool far = std::abs(middle) > reach_;
    for (int z = z0; z < std::min(z0 + kPatch, kSide); ++z)
      for (int y = y0; y < std::min(y0 + kPatch, kSide); ++y)
        for (int x = x0; x < std::min(x0 + kPatch, kSide); ++x)
          value_[static_cast<size_t>(index(x, y, z))] = far ? middle : distance_(corner(x, y, z));
  }
  bool crossed(int x, int y, int z) const {
    const bool side = at(x, y, z) < 0;
    for (int c = 1; c < 8; ++c)
      if ((at(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)) < 0) != side) return true;
    return false;
  }

  // Edge 4 axis + (offset along the next axis) + 2 (offset along the one after).
  // The sheet of the surface that each crossed edge of a cube belongs to, -1 where it is not
  // crossed. Sheets are separated across a face whose inside corners lie diagonally, so that both
  // cubes at the face agree and the surface stays a manifold (Nielson 2004).
  using Sheets = std::array<int, 12>;
  Sheets sheets(int x, int y, int z) const {
    Sheets sheet{};
    const auto inside = [&](const std::array<int, 3>& c) {
      return at(x + c[0], y + c[1], z + c[2]) < 0;
    };
    for (size_t axis = 0; axis < 3; ++axis)
      for (int c = 0; c < 4; ++c) {
        std::array<int, 3> corner{};
        corner[(axis + 1) % 3] = c & 1;
        corner[(axis + 2) % 3] = c >> 1;
        const bool a = inside(corner);
        corner[axis] = 1;
        const size_t e = 4 * axis + static_cast<size_t>(c);
        sheet[e] = a == inside(corner) ? -1 : static_cast<int>(e);
      }
    const auto unite = [&](size_t e, size_t f) {
      const int from = std::max(sheet[e], sheet[f]), to = std::min(sheet[e], sheet[f]);
      for (int& s : sheet)
        if (s == from) s = to;
    };
    for (size_t f = 0; f < 3; ++f)
      for (int side = 0; side < 2; ++side) {
        const size_t p = (f + 1) % 3, q = (f + 2) % 3;
        const auto along_p = [&](int j) { return 4 * p + static_cast<size_t>(j + 2 * side); };
        const auto along_q = [&](int i) { return 4 * q + static_cast<size_t>(side + 2 * i); };
        std::array<size_t, 4> crossed{};
        size_t n = 0;
        for (const size_t e : {along_p(0), along_p(1), along_q(0), along_q(1)})
          if (sheet[e] >= 0) crossed[n++] = e;
        if (n == 2) unite(crossed[0], crossed[1]);
        if (n != 4) continue;
        for (int i = 0; i < 2; ++i)
          for (int j = 0; j < 2; ++j) {
            std::array<int, 3> corner{};
            corner[f] = side;
            corner[p] = i;
            corner[q] = j;
            if (inside(corner)) unite(along_p(j), along_q(i));
          }
      }
    return sheet;
  }

  void cube(int x, int y, int z, BlockResult& out) const {
    if (!crossed(x, y, z)) return;
    const Sheets sheet = sheets(x, y, z);
    const int gx = origin_.x() + x - 1, gy = origin_.y() + y - 1, gz = origin_.z() + z - 1;
    for (int s = 0; s < 12; ++s) {
      Vec3d sum = Vec3d::Zero();
      int crossings = 0;
      for (size_t e = 0; e < 12; ++e) {
        if (sheet[e] != s) continue;
        const size_t axis = e / 4;
        std::array<int, 3> a{};
        a[(axis + 1) % 3] = static_cast<int>(e & 1);
        a[(axis + 2) % 3] = static_cast<int>(e >> 1 & 1);
        std::array<int, 3> b = a;
        b[axis] = 1;
        const double va = at(x + a[0], y + a[1], z + a[2]), vb = at(x + b[0], y + b[1], z + b[2]);
        Vec3d p(a[0], a[1], a[2]);
        p[static_cast<int>(axis)] = va / (va - vb);
        sum += p;
        ++crossings;
      }
      if (crossings > 0)
        out.points.emplace_back(key(gx, gy, gz, s),
                                grid_.corner(gx, gy, gz) + grid_.cell * sum / crossings);
    }
  }

  void edge(int x, int y, int z, int axis, BlockResult& out) const {
    std::array<int, 3> d{};
    d[static_cast<size_t>(axis)] = 1;
    const bool a = at(x, y, z) < 0, b = at(x + d[0], y + d[1], z + d[2]) < 0;
    if (a == b) return;
    const auto point_key = [&](int i, int j) {
      int c[3] = {x, y, z};
      c[(axis + 1) % 3] -= i;
      c[(axis + 2) % 3] -= j;
      const int sheet = sheets(c[0], c[1], c[2])[static_cast<size_t>(4 * axis + i + 2 * j)];
      return key(origin_.x() + c[0] - 1, origin_.y() + c[1] - 1, origin_.z() + c[2] - 1, sheet);
    };
    std::array<int64_t, 4> quad = {point_key(1, 1), point_key(0, 1), point_key(0, 0),
                                   point_key(1, 0)};
    if (!a) std::swap(quad[1], quad[3]);
    out.quads.push_back(quad);
  }

  const std::function<double(const Vec3d&)>& distance_;
  const Grid& grid_;
  double reach_;
  Vec3i origin_ = Vec3i::Zero();
  std::array<double, static_cast<size_t>(kSide) * kSide * kSide> value_{};
};

}  // namespace

Surface surface_nets(const std::function<double(const Vec3d&)>& distance, const Vec3d& low,
                     const Vec3d& high, double cell, double steepness) {
  Grid grid;
  grid.cell = cell;
  grid.low = low;
  grid.blocks = ((high - low) / (cell * kBlock)).array().ceil().cast<int>();
  const Vec3i n = grid.blocks;
  const size_t count = static_cast<size_t>(n.x()) * n.y() * n.z();
  std::vector<BlockResult> results(count);
  const double reach = steepness * cell * (kBlock + 2) * std::sqrt(3.0) / 2;
  parallel_for(count, 4, [&](size_t begin, size_t end, int) {
    auto mesher = BlockMesher(distance, grid, steepness);
    for (size_t i = begin; i < end; ++i) {
      const Vec3i block(static_cast<int>(i % n.x()), static_cast<int>(i / n.x() % n.y()),
                        static_cast<int>(i / n.x() / n.y()));
      const Vec3d middle = low + cell * kBlock * (block.cast<double>() + Vec3d::Constant(0.5));
      if (std::abs(distance(middle)) < reach) mesher.run(block, results[i]);
    }
  });
  Surface surface;
  std::unordered_map<int64_t, int> number;
  for (const BlockResult& r : results)
    for (const auto& [k, p] : r.points) {
      number.emplace(k, static_cast<int>(surface.points.size()));
      surface.points.push_back(p);
    }
  for (const BlockResult& r : results)
    for (const auto& quad : r.quads) {
      int v[4];
      bool whole = true;
      for (int c = 0; c < 4; ++c) {
        const auto found = number.find(quad[static_cast<size_t>(c)]);
        whole = whole && found != number.end();
        v[c] = whole ? found->second : -1;
      }
      if (!whole) continue;
      const auto& p = surface.points;
      const bool other = (p[v[0]] - p[v[2]]).squaredNorm() > (p[v[1]] - p[v[3]]).squaredNorm();
      if (other) {
        surface.triangles.emplace_back(v[0], v[1], v[3]);
        surface.triangles.emplace_back(v[1], v[2], v[3]);
      } else {
        surface.triangles.emplace_back(v[0], v[1], v[2]);
        surface.triangles.emplace_back(v[0], v[2], v[3]);
      }
    }
  return surface;
}

}  // namespace effigy::people
