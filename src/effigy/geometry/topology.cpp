#include "effigy/geometry/topology.h"

#include <algorithm>
#include <array>
#include <numeric>

#include "effigy/base/error.h"

namespace effigy {
namespace {

// A half-edge with its ends sorted; `forward` says that it runs from low to high.
struct HalfEdge {
  int low, high;
  bool forward;
};

// Edges that belong to an odd number of triangles, in the direction of (one of) their half-edges.
std::vector<std::pair<int, int>> odd_edges(const std::vector<Vec3i>& triangles, int vertex_count) {
  std::vector<HalfEdge> all;
  for (const Vec3i& t : triangles)
    for (int corner = 0; corner < 3; ++corner) {
      const int a = t[corner], b = t[(corner + 1) % 3];
      EFFIGY_CHECK(a >= 0 && b >= 0 && a < vertex_count && b < vertex_count);
      if (a != b) all.push_back({std::min(a, b), std::max(a, b), a < b});
    }
  std::stable_sort(all.begin(), all.end(), [](const HalfEdge& x, const HalfEdge& y) {
    return std::pair(x.low, x.high) < std::pair(y.low, y.high);
  });
  std::vector<std::pair<int, int>> odd;
  for (size_t i = 0; i < all.size();) {
    size_t end = i;
    while (end < all.size() && all[end].low == all[i].low && all[end].high == all[i].high) ++end;
    if ((end - i) % 2 == 1)
      odd.emplace_back(all[i].forward ? std::pair(all[i].low, all[i].high)
                                      : std::pair(all[i].high, all[i].low));
    i = end;
  }
  return odd;
}

// Walks along unused edges. Every vertex meets an even number of odd edges, so a walk only ends
// where it closes.
class LoopWalker {
 public:
  LoopWalker(std::vector<std::pair<int, int>> edges, int vertex_count)
      : edges_(std::move(edges)),
        used_(edges_.size(), false),
        of_vertex_(static_cast<size_t>(vertex_count)),
        place_(static_cast<size_t>(vertex_count), -1) {
    // Outgoing edges are tried before incoming ones, so that consistent meshes keep direction.
    for (size_t e = 0; e < edges_.size(); ++e)
      of_vertex_[static_cast<size_t>(edges_[e].first)].push_back(e);
    for (size_t e = 0; e < edges_.size(); ++e)
      of_vertex_[static_cast<size_t>(edges_[e].second)].push_back(e);
  }

  std::vector<std::vector<int>> walk() {
    for (const auto& edge : edges_) walk_from(edge.first);
    return std::move(loops_);
  }

 private:
  void walk_from(int start) {
    std::vector<int> path = {start};
    place_[static_cast<size_t>(start)] = 0;
    while (true) {
      const int next = step(path.back());
      if (next < 0) break;
      const int seen = place_[static_cast<size_t>(next)];
      if (seen < 0) {
        place_[static_cast<size_t>(next)] = static_cast<int>(path.size());
        path.push_back(next);
        continue;
      }
      loops_.emplace_back(path.begin() + seen, path.end());
      for (size_t i = static_cast<size_t>(seen) + 1; i < path.size(); ++i)
        place_[static_cast<size_t>(path[i])] = -1;
      path.resize(static_cast<size_t>(seen) + 1);
    }
    for (const int vertex : path) place_[static_cast<size_t>(vertex)] = -1;
  }

  int step(int from) {
    auto& candidates = of_vertex_[static_cast<size_t>(from)];
    for (const size_t e : candidates)
      if (!used_[e]) {
        used_[e] = true;
        return edges_[e].first == from ? edges_[e].second : edges_[e].first;
      }
    return -1;
  }

  std::vector<std::pair<int, int>> edges_;
  std::vector<bool> used_;
  std::vector<std::vector<size_t>> of_vertex_;
  std::vector<int> place_;  // in the current path, -1 when not on it
  std::vector<std::vector<int>> loops_;
};

}  // namespace

std::vector<std::vector<int>> boundary_loops(const std::vector<Vec3i>& triangles,
                                             int vertex_count) {
  auto loops = LoopWalker(odd_edges(triangles, vertex_count), vertex_count).walk();
  for (auto& loop : loops)
    std::rotate(loop.begin(), std::min_element(loop.begin(), loop.end()), loop.end());
  std::sort(loops.begin(), loops.end(), [](const auto& a, const auto& b) {
    return a.size() != b.size() ? a.size() > b.size() : a < b;
  });
  return loops;
}

std::vector<int> connected_pieces(const std::vector<Vec3i>& triangles, int vertex_count) {
  std::vector<int> parent(static_cast<size_t>(vertex_count));
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int v) {
    while (parent[static_cast<size_t>(v)] != v) {
      int& up = parent[static_cast<size_t>(v)];
      up = parent[static_cast<size_t>(up)];
      v = up;
    }
    return v;
  };
  for (const Vec3i& t : triangles)
    for (int corner = 1; corner < 3; ++corner) {
      EFFIGY_CHECK(t[0] >= 0 && t[corner] >= 0 && t[0] < vertex_count && t[corner] < vertex_count);
      const int a = root(t[0]), b = root(t[corner]);
      parent[static_cast<size_t>(std::max(a, b))] = std::min(a, b);
    }
  std::vector<int> piece(parent.size());
  int count = 0;
  for (size_t v = 0; v < parent.size(); ++v) {
    const int top = root(static_cast<int>(v));
    piece[v] = top == static_cast<int>(v) ? count++ : piece[static_cast<size_t>(top)];
  }
  return piece;
}

}  // namespace effigy
