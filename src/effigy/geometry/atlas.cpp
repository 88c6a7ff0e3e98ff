#include "effigy/geometry/atlas.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>
#include <tuple>

#include "effigy/base/error.h"

namespace effigy {

namespace {

double cross2(const Vec2d& a, const Vec2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

Vec2d uv(const Mesh& mesh, int index) {
  return mesh.uvs[static_cast<size_t>(index)].cast<double>();
}

double uv_area(const Mesh& mesh, size_t t) {
  const Vec3i& u = mesh.uv_triangles[t];
  const Vec2d a = uv(mesh, u[0]);
  return 0.5 * cross2(uv(mesh, u[1]) - a, uv(mesh, u[2]) - a);
}

double surface_area(const Mesh& mesh, size_t t) {
  const Vec3i& f = mesh.triangles[t];
  const Vec3d a = mesh.vertex(f[0]).cast<double>();
  return 0.5 *
         (mesh.vertex(f[1]).cast<double>() - a).cross(mesh.vertex(f[2]).cast<double>() - a).norm();
}

struct Island {
  std::vector<size_t> triangles;
  std::vector<int> uvs;  // its UV vertices, sorted
  double scale = 0;      // UV units per UV unit at global scale 1
  double mirror = 1;     // -1: u runs the other way
  Vec2d low, high;       // bounds after mirroring, before scaling
};

// A raster of bits, one row after another, each a whole number of words.
struct Bitmap {
  int width = 0, height = 0, words = 0;
  std::vector<uint64_t> bits;
  Bitmap(int w, int h)
      : width(w), height(h), words((w + 63) / 64 + 1), bits(static_cast<size_t>(words * h), 0) {}
  uint64_t* row(int y) { return bits.data() + static_cast<size_t>(words) * static_cast<size_t>(y); }
  const uint64_t* row(int y) const {
    return bits.data() + static_cast<size_t>(words) * static_cast<size_t>(y);
  }
  void set(int x, int y) { row(y)[x >> 6] |= uint64_t{1} << (x & 63); }
  bool get(int x, int y) const { return (row(y)[x >> 6] >> (x & 63)) & 1; }
};

// True when the triangle and the cell [x, x+1] x [y, y+1] have a point in common (separating axes).
bool touches(const Vec2d p[3], double x, double y) {
  for (int k = 0; k < 3; ++k) {
    const Vec2d along = p[(k + 1) % 3] - p[k];
    const Vec2d normal(-along.y(), along.x());
    const double side = normal.dot(p[(k + 2) % 3] - p[k]);
    const double sign = side < 0 ? -1 : 1;
    double best = -1e300;
    for (int c = 0; c < 4; ++c)
      best = std::max(best, sign * normal.dot(Vec2d(x + (c & 1), y + (c >> 1)) - p[k]));
    if (best < 0) return false;
  }
  return true;
}

// The cells an island covers, plus one cell all around (the margin between islands).
Bitmap rasterize(const Mesh& mesh, const Island& island, double cells_per_uv, int turn,
                 Vec2d& origin) {
  const auto place = [&](int index) {
    Vec2d p = uv(mesh, index);
    p.x() *= island.mirror;
    p *= cells_per_uv;
    for (int k = 0; k < turn; ++k) p = Vec2d(-p.y(), p.x());
    return p;
  };
  Vec2d low(1e300, 1e300), high(-1e300, -1e300);
  for (const int u : island.uvs) {
    low = low.cwiseMin(place(u));
    high = high.cwiseMax(place(u));
  }
  origin = low;
  const Vec2d extent = high - low;
  Bitmap tight(static_cast<int>(extent.x()) + 1, static_cast<int>(extent.y()) + 1);
  for (const size_t t : island.triangles) {
    const Vec3i& u = mesh.uv_triangles[t];
    const Vec2d p[3] = {place(u[0]) - low, place(u[1]) - low, place(u[2]) - low};
    const Vec2d least = p[0].cwiseMin(p[1]).cwiseMin(p[2]);
    const Vec2d most = p[0].cwiseMax(p[1]).cwiseMax(p[2]);
    for (int y = static_cast<int>(least.y());
         y <= std::min(static_cast<int>(most.y()), tight.height - 1); ++y)
      for (int x = static_cast<int>(least.x());
           x <= std::min(static_cast<int>(most.x()), tight.width - 1); ++x)
        if (!tight.get(x, y) && touches(p, x, y)) tight.set(x, y);
  }
  return tight;
}

Bitmap grown(const Bitmap& tight) {
  Bitmap wide(tight.width + 2, tight.height + 2);
  for (int y = 0; y < tight.height; ++y)
    for (int x = 0; x < tight.width; ++x)
      if (tight.get(x, y))
        for (int j = 0; j < 3; ++j)
          for (int i = 0; i < 3; ++i) wide.set(x + i, y + j);
  return wide;
}

bool collides(const Bitmap& page, const Bitmap& shape, int x, int y) {
  const int word = x >> 6, shift = x & 63;
  for (int j = 0; j < shape.height; ++j) {
    const uint64_t* s = shape.row(j);
    const uint64_t* p = page.row(y + j) + word;
    uint64_t carry = 0;
    for (int w = 0; w < shape.words; ++w) {
      const uint64_t moved = (s[w] << shift) | carry;
      carry = shift ? s[w] >> (64 - shift) : 0;
      if (word + w < page.words && (moved & p[w])) return true;
    }
  }
  return false;
}

void stamp(Bitmap& page, const Bitmap& shape, int x, int y) {
  for (int j = 0; j < shape.height; ++j)
    for (int i = 0; i < shape.width; ++i)
      if (shape.get(i, j)) page.set(x + i, y + j);
}

struct Placement {
  int turn = 0;
  Vec2d offset = Vec2d::Zero();  // in cells, added after turning
};

// Every island at `scale`, or nothing when one does not fit. `order`: largest first.
bool place_all(const Mesh& mesh, const std::vector<Island>& islands, const std::vector<int>& order,
               double scale, int cells, std::vector<Placement>& placements) {
  // The page has a rim of one cell on each side where only margins may lie.
  Bitmap page(cells + 2, cells + 2);
  placements.assign(islands.size(), {});
  for (const int index : order) {
    const Island& island = islands[static_cast<size_t>(index)];
    bool found = false;
    int best_top = 0, best_x = 0, best_y = 0;
    Bitmap best(1, 1);
    for (int turn = 0; turn < 4; ++turn) {
      if (index == order.front() && turn != 0) break;  // the largest stays upright
      Vec2d origin;
      const Bitmap tight = rasterize(mesh, island, island.scale * scale * cells, turn, origin);
      const Bitmap wide = grown(tight);
      for (int y = 0; y + wide.height <= page.height; ++y) {
        if (found && y + wide.height >= best_top) break;
        int x = 0;
        for (; x + wide.width <= page.width; ++x)
          if (!collides(page, tight, x + 1, y + 1)) break;
        if (x + wide.width > page.width) continue;
        found = true;
        best_top = y + wide.height;
        best_x = x;
        best_y = y;
        best = wide;
        placements[static_cast<size_t>(index)] = {turn, Vec2d(x, y) - origin};
        break;
      }
    }
    if (!found) return false;
    stamp(page, best, best_x, best_y);
  }
  return true;
}

std::vector<Island> collect_islands(const Mesh& mesh, const std::vector<float>& density) {
  const std::vector<int> number = uv_islands(mesh);
  std::vector<Island> islands;
  std::vector<double> in_uv, in_space, wanted;
  for (size_t t = 0; t < number.size(); ++t) {
    const size_t i = static_cast<size_t>(number[t]);
    if (i >= islands.size()) {
      islands.emplace_back();
      in_uv.push_back(0);
      in_space.push_back(0);
      wanted.push_back(
          mesh.triangle_part.empty()
              ? 1.0
              : static_cast<double>(density[static_cast<size_t>(mesh.triangle_part[t])]));
    }
    islands[i].triangles.push_back(t);
    for (int k = 0; k < 3; ++k) islands[i].uvs.push_back(mesh.uv_triangles[t][k]);
    in_uv[i] += uv_area(mesh, t);
    in_space[i] += surface_area(mesh, t);
  }
  for (size_t i = 0; i < islands.size(); ++i) {
    Island& island = islands[i];
    std::sort(island.uvs.begin(), island.uvs.end());
    island.uvs.erase(std::unique(island.uvs.begin(), island.uvs.end()), island.uvs.end());
    if (!(std::abs(in_uv[i]) > 0) || !(in_space[i] > 0))
      throw Error("A UV island has no area; give the mesh a proper UV layout.");
    island.mirror = in_uv[i] < 0 ? -1 : 1;
    island.scale = wanted[i] * std::sqrt(in_space[i] / std::abs(in_uv[i]));
    island.low = Vec2d(1e300, 1e300);
    island.high = -island.low;
    for (const int u : island.uvs) {
      const Vec2d p(uv(mesh, u).x() * island.mirror, uv(mesh, u).y());
      island.low = island.low.cwiseMin(p);
      island.high = island.high.cwiseMax(p);
    }
  }
  return islands;
}

}  // namespace

std::vector<int> uv_islands(const Mesh& mesh) {
  std::vector<int> parent(mesh.uvs.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto find = [&](int a) {
    while (parent[static_cast<size_t>(a)] != a) {
      int& up = parent[static_cast<size_t>(a)];
      up = parent[static_cast<size_t>(up)];
      a = up;
    }
    return a;
  };
  for (const Vec3i& u : mesh.uv_triangles) {
    parent[static_cast<size_t>(find(u[1]))] = find(u[0]);
    parent[static_cast<size_t>(find(u[2]))] = find(u[0]);
  }
  std::vector<int> number(mesh.uvs.size(), -1), out;
  out.reserve(mesh.uv_triangles.size());
  int count = 0;
  for (const Vec3i& u : mesh.uv_triangles) {
    int& n = number[static_cast<size_t>(find(u[0]))];
    if (n < 0) n = count++;
    out.push_back(n);
  }
  return out;
}

void weld_uvs(Mesh& mesh, float tolerance) {
  struct Wedge {
    int vertex, part, uv;
  };
  std::vector<Wedge> wedges;
  for (size_t t = 0; t < mesh.uv_triangles.size(); ++t)
    for (int k = 0; k < 3; ++k)
      wedges.push_back({mesh.triangles[t][k],
                        mesh.triangle_part.empty() ? 0 : mesh.triangle_part[t],
                        mesh.uv_triangles[t][k]});
  const auto order = [](const Wedge& a, const Wedge& b) {
    return std::tie(a.vertex, a.part, a.uv) < std::tie(b.vertex, b.part, b.uv);
  };
  std::sort(wedges.begin(), wedges.end(), order);
  // A UV vertex may serve several vertices or parts, hence a table per wedge.
  std::vector<int> became(wedges.size());
  for (size_t i = 0; i < wedges.size(); ++i) {
    became[i] = wedges[i].uv;
    for (size_t j = i;
         j-- > 0 && wedges[j].vertex == wedges[i].vertex && wedges[j].part == wedges[i].part;)
      if ((mesh.uvs[static_cast<size_t>(wedges[j].uv)] -
           mesh.uvs[static_cast<size_t>(wedges[i].uv)])
              .cwiseAbs()
              .maxCoeff() <= tolerance)
        became[i] = became[j];
  }
  for (size_t t = 0; t < mesh.uv_triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      const Wedge wedge{mesh.triangles[t][k],
                        mesh.triangle_part.empty() ? 0 : mesh.triangle_part[t],
                        mesh.uv_triangles[t][k]};
      const auto at = std::lower_bound(wedges.begin(), wedges.end(), wedge, order);
      mesh.uv_triangles[t][k] = became[static_cast<size_t>(at - wedges.begin())];
    }
}

void pack_atlas(Mesh& mesh, const AtlasOptions& options) {
  if (!mesh.triangle_part.empty()) EFFIGY_CHECK_EQ(options.density.size(), mesh.parts.size());
  EFFIGY_CHECK(options.cells >= 16);
  if (mesh.uv_triangles.empty()) throw Error("The mesh has no UVs to pack; export it with UVs.");
  const std::vector<Island> islands = collect_islands(mesh, options.density);
  std::vector<int> order(islands.size());
  std::iota(order.begin(), order.end(), 0);
  const auto box = [&](int i) {
    const Island& island = islands[static_cast<size_t>(i)];
    return (island.high - island.low).prod() * island.scale * island.scale;
  };
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return box(a) > box(b); });

  // The largest scale at which all fit. The sum of areas bounds it from above.
  double area = 0;
  for (const int i : order) area += box(i);
  double low = 0, high = 0;
  std::vector<Placement> placements, trial;
  for (double scale = 1 / std::sqrt(area); low == 0; scale *= 0.8) {
    if (place_all(mesh, islands, order, scale, options.cells, trial)) {
      low = scale;
      placements = trial;
    } else {
      high = scale;
    }
    if (scale * std::sqrt(area) < 1e-3) throw Error("The UV islands are too many to pack.");
  }
  if (high == 0) high = low * 2;
  for (int step = 0; step < 8; ++step) {
    const double middle = 0.5 * (low + high);
    if (place_all(mesh, islands, order, middle, options.cells, trial)) {
      low = middle;
      placements = trial;
    } else {
      high = middle;
    }
  }
  // An island's UV vertices become its own (two islands never share one).
  const std::vector<Vec2f> old = mesh.uvs;
  for (size_t i = 0; i < islands.size(); ++i)
    for (const int u : islands[i].uvs) {
      Vec2d p = old[static_cast<size_t>(u)].cast<double>();
      p.x() *= islands[i].mirror;
      p *= islands[i].scale * low * options.cells;
      for (int k = 0; k < placements[i].turn; ++k) p = Vec2d(-p.y(), p.x());
      mesh.uvs[static_cast<size_t>(u)] =
          ((p + placements[i].offset) / options.cells).cast<float>().cwiseMax(0.f).cwiseMin(1.f);
    }
}

AtlasReport inspect_atlas(const Mesh& mesh, int size) {
  AtlasReport report;
  std::vector<uint8_t> hits(static_cast<size_t>(size) * static_cast<size_t>(size), 0);
  for (size_t t = 0; t < mesh.uv_triangles.size(); ++t) {
    const Vec3i& u = mesh.uv_triangles[t];
    const Vec2d p[3] = {uv(mesh, u[0]) * size, uv(mesh, u[1]) * size, uv(mesh, u[2]) * size};
    const double area = cross2(p[1] - p[0], p[2] - p[0]);
    if (!(area > 0)) {
      ++report.clockwise;
      continue;
    }
    const Vec2d low = p[0].cwiseMin(p[1]).cwiseMin(p[2]);
    const Vec2d high = p[0].cwiseMax(p[1]).cwiseMax(p[2]);
    const int x0 = std::max(0, static_cast<int>(low.x() - 0.5));
    const int x1 = std::min(size - 1, static_cast<int>(high.x() + 0.5));
    for (int y = std::max(0, static_cast<int>(low.y() - 0.5));
         y <= std::min(size - 1, static_cast<int>(high.y() + 0.5)); ++y)
      for (int x = x0; x <= x1; ++x) {
        const Vec2d c(x + 0.5, y + 0.5);
        bool inside = true;
        // Strictly inside by a hair: a centre on a shared edge belongs to nobody's overlap.
        for (int k = 0; k < 3 && inside; ++k) {
          const Vec2d along = p[(k + 1) % 3] - p[k];
          inside = cross2(along, c - p[k]) > 1e-4 * along.norm();
        }
        if (inside) {
          uint8_t& hit =
              hits[static_cast<size_t>(y) * static_cast<size_t>(size) + static_cast<size_t>(x)];
          if (hit < 255) ++hit;
        }
      }
  }
  int64_t covered = 0;
  for (const uint8_t hit : hits) {
    covered += hit > 0;
    report.overlaps += hit > 1;
  }
  report.coverage = static_cast<double>(covered) / static_cast<double>(hits.size());
  return report;
}

}  // namespace effigy
