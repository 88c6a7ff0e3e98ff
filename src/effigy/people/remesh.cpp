#include "effigy/people/remesh.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

namespace effigy::people {
namespace {

class Remesher {
 public:
  Remesher(const Surface& surface, const RemeshOptions& options)
      : options_(options),
        points_(surface.points),
        triangles_(surface.triangles),
        fixed_(options.fixed) {
    fixed_.resize(points_.size(), 0);
    alive_.assign(triangles_.size(), 1);
    fans_.resize(points_.size());
    for (size_t t = 0; t < triangles_.size(); ++t)
      for (int k = 0; k < 3; ++k)
        fans_[static_cast<size_t>(triangles_[t][k])].push_back(static_cast<int>(t));
    fix_boundary();
    size_.resize(points_.size());
    measure(0);
  }

  Surface run() {
    for (int round = 0; round < options_.rounds; ++round) {
      split();
      collapse();
      for (int pass = 0; pass < 2; ++pass) flip();
      relax(round + 1 == options_.rounds ? 2 : 1);
      measure(0);
    }
    return compact();
  }

 private:
  using Edge = std::pair<int, int>;

  size_t z(int v) const { return static_cast<size_t>(v); }
  double length(int a, int b) const { return (points_[z(a)] - points_[z(b)]).norm(); }
  double wanted(int a, int b) const { return 0.5 * (size_[z(a)] + size_[z(b)]); }

  void measure(size_t from) {
    parallel_for(points_.size() - from, 256, [&](size_t begin, size_t end, int) {
      for (size_t i = from + begin; i < from + end; ++i)
        if (!fans_[i].empty()) size_[i] = options_.size(points_[i]);
    });
  }

  std::vector<Edge> edges() const {
    std::vector<Edge> out;
    for (size_t t = 0; t < triangles_.size(); ++t)
      if (alive_[t])
        for (int k = 0; k < 3; ++k) {
          const int a = triangles_[t][k], b = triangles_[t][(k + 1) % 3];
          if (a < b) out.emplace_back(a, b);
        }
    return out;
  }

  // The (at most two) triangles at an edge.
  int around(int a, int b, int found[2]) const {
    int n = 0;
    for (const int t : fans_[z(a)]) {
      const Vec3i& c = triangles_[z(t)];
      if (c[0] == b || c[1] == b || c[2] == b) {
        if (n == 2) return 3;
        found[n++] = t;
      }
    }
    return n;
  }
  int opposite(int t, int a, int b) const {
    const Vec3i& c = triangles_[z(t)];
    for (int k = 0; k < 3; ++k)
      if (c[k] != a && c[k] != b) return c[k];
    return -1;
  }
  std::vector<int> neighbours(int v) const {
    std::vector<int> out;
    for (const int t : fans_[z(v)])
      for (int k = 0; k < 3; ++k)
        if (triangles_[z(t)][k] != v) out.push_back(triangles_[z(t)][k]);
    std::sort(out.begin(), out.end());
    out.erase(std::unique(out.begin(), out.end()), out.end());
    return out;
  }

  void fix_boundary() {
    for (const auto& [a, b] : edges()) {
      int found[2];
      if (around(a, b, found) == 1) fixed_[z(a)] = fixed_[z(b)] = 1;
    }
    // Edges whose only direction is (larger, smaller) are boundary too.
    for (size_t t = 0; t < triangles_.size(); ++t)
      for (int k = 0; k < 3; ++k) {
        const int a = triangles_[t][k], b = triangles_[t][(k + 1) % 3];
        int found[2];
        if (around(a, b, found) == 1) fixed_[z(a)] = fixed_[z(b)] = 1;
      }
  }

  void split() {
    std::vector<std::pair<double, Edge>> list;
    for (const Edge& e : edges()) {
      const double ratio = length(e.first, e.second) / wanted(e.first, e.second);
      if (ratio > 4.0 / 3) list.emplace_back(-ratio, e);
    }
    std::sort(list.begin(), list.end());
    const size_t before = points_.size();
    for (const auto& [ratio, e] : list) split_edge(e.first, e.second);
    parallel_for(points_.size() - before, 64, [&](size_t begin, size_t end, int) {
      for (size_t i = before + begin; i < before + end; ++i)
        points_[i] = options_.project(points_[i]);
    });
    measure(before);
  }

  void split_edge(int a, int b) {
    int found[2];
    if (around(a, b, found) != 2 || (fixed_[z(a)] && fixed_[z(b)])) return;
    const int m = static_cast<int>(points_.size());
    points_.push_back(0.5 * (points_[z(a)] + points_[z(b)]));
    fixed_.push_back(0);
    size_.push_back(wanted(a, b));
    fans_.emplace_back();
    for (const int t : {found[0], found[1]}) {
      Vec3i first = triangles_[z(t)], second = first;
      for (int k = 0; k < 3; ++k) {
        if (first[k] == b) first[k] = m;
        if (second[k] == a) second[k] = m;
      }
      const int c = opposite(t, a, b), n = static_cast<int>(triangles_.size());
      triangles_[z(t)] = first;
      triangles_.push_back(second);
      alive_.push_back(1);
      auto& fan = fans_[z(b)];
      fan.erase(std::find(fan.begin(), fan.end(), t));
      fan.push_back(n);
      fans_[z(c)].push_back(n);
      fans_[z(m)].push_back(t);
      fans_[z(m)].push_back(n);
    }
  }

  void collapse() {
    std::vector<std::pair<double, Edge>> list;
    for (const Edge& e : edges()) {
      const double ratio = length(e.first, e.second) / wanted(e.first, e.second);
      if (ratio < 0.8) list.emplace_back(ratio, e);
    }
    std::sort(list.begin(), list.end());
    for (const auto& [ratio, e] : list) {
      const auto [a, b] = e;
      if (fans_[z(a)].empty() || fans_[z(b)].empty()) continue;
      if (length(a, b) >= 0.8 * wanted(a, b)) continue;
      if (fixed_[z(b)])
        collapse_edge(b, a);
      else
        collapse_edge(a, b);
    }
  }

  // Removes b; a moves to the middle unless it is fixed.
  void collapse_edge(int a, int b) {
    int found[2];
    if (fixed_[z(b)] || around(a, b, found) != 2) return;
    const auto na = neighbours(a), nb = neighbours(b);
    std::vector<int> shared;
    std::set_intersection(na.begin(), na.end(), nb.begin(), nb.end(), std::back_inserter(shared));
    if (shared.size() != 2) return;
    const Vec3d to = fixed_[z(a)] ? points_[z(a)] : Vec3d(0.5 * (points_[z(a)] + points_[z(b)]));
    for (const int v : nb)
      if (v != a && (points_[z(v)] - to).norm() > 4.0 / 3 * wanted(a, v)) return;
    for (const int v : na)
      if (v != b && !fixed_[z(a)] && (points_[z(v)] - to).norm() > 4.0 / 3 * wanted(a, v)) return;
    if (turns_over(a, b, to) || turns_over(b, a, to)) return;
    points_[z(a)] = to;
    for (const int t : {found[0], found[1]}) {
      alive_[z(t)] = 0;
      for (int k = 0; k < 3; ++k) {
        auto& fan = fans_[z(triangles_[z(t)][k])];
        fan.erase(std::find(fan.begin(), fan.end(), t));
      }
    }
    for (const int t : fans_[z(b)]) {
      for (int k = 0; k < 3; ++k)
        if (triangles_[z(t)][k] == b) triangles_[z(t)][k] = a;
      fans_[z(a)].push_back(t);
    }
    fans_[z(b)].clear();
  }

  bool turns_over(int v, int other, const Vec3d& to) const {
    for (const int t : fans_[z(v)]) {
      const Vec3i& c = triangles_[z(t)];
      if (c[0] == other || c[1] == other || c[2] == other) continue;
      Vec3d p[3];
      for (int k = 0; k < 3; ++k) p[k] = points_[z(c[k])];
      const Vec3d before = (p[1] - p[0]).cross(p[2] - p[0]);
      for (int k = 0; k < 3; ++k)
        if (c[k] == v) p[k] = to;
      const Vec3d after = (p[1] - p[0]).cross(p[2] - p[0]);
      if (before.dot(after) <= 0.3 * before.norm() * after.norm()) return true;
    }
    return false;
  }

  void flip() {
    for (const Edge& e : edges()) flip_edge(e.first, e.second);
  }

  void flip_edge(int a, int b) {
    int found[2];
    if (around(a, b, found) != 2 || (fixed_[z(a)] && fixed_[z(b)])) return;
    const int c = opposite(found[0], a, b), d = opposite(found[1], a, b);
    // Two fixed points may be joined on the other side of the boundary.
    if (c == d || (fixed_[z(c)] && fixed_[z(d)])) return;
    const auto off = [&](int v, int change) {
      const int n = static_cast<int>(fans_[z(v)].size()) + (fixed_[z(v)] ? 3 : 0) + change - 6;
      return n * n;
    };
    const int before = off(a, 0) + off(b, 0) + off(c, 0) + off(d, 0);
    const int after = off(a, -1) + off(b, -1) + off(c, 1) + off(d, 1);
    if (after >= before) return;
    int other[2];
    if (around(c, d, other) != 0) return;
    if (length(c, d) > 1.6 * wanted(c, d)) return;
    // New triangles (a, d, c) and (b, c, d) in the orientation of the old ones.
    Vec3i t0 = triangles_[z(found[0])];
    int k = 0;
    while (t0[k] != c) ++k;
    const int p = t0[(k + 1) % 3], q = t0[(k + 2) % 3];  // (c, p, q) with {p, q} = {a, b}
    const Vec3i first(c, p, d), second(c, d, q);
    if (!same_way(first, found) || !same_way(second, found)) return;
    triangles_[z(found[0])] = first;
    triangles_[z(found[1])] = second;
    const auto remove = [&](int v, int t) {
      auto& fan = fans_[z(v)];
      fan.erase(std::find(fan.begin(), fan.end(), t));
    };
    remove(q, found[0]);
    fans_[z(d)].push_back(found[0]);
    remove(p, found[1]);
    fans_[z(c)].push_back(found[1]);
  }

  Vec3d area_normal(const Vec3i& t) const {
    return (points_[z(t[1])] - points_[z(t[0])]).cross(points_[z(t[2])] - points_[z(t[0])]);
  }
  // Whether a new triangle is not folded against the two it replaces.
  bool same_way(const Vec3i& t, const int found[2]) const {
    const Vec3d n = area_normal(t),
                mean = area_normal(triangles_[z(found[0])]) + area_normal(triangles_[z(found[1])]);
    return n.dot(mean) > 0.5 * n.norm() * mean.norm();
  }

  // Points move along the surface to the size-weighted middle of their fan.
  void relax(int passes) {
    for (int pass = 0; pass < passes; ++pass) {
      std::vector<Vec3d> moved = points_;
      parallel_for(points_.size(), 128, [&](size_t begin, size_t end, int) {
        for (size_t v = begin; v < end; ++v)
          if (!fixed_[v] && !fans_[v].empty()) moved[v] = relaxed(v);
      });
      points_ = std::move(moved);
    }
  }
  Vec3d relaxed(size_t v) const {
    Vec3d sum = Vec3d::Zero(), normal = Vec3d::Zero();
    double weight = 0;
    for (const int t : fans_[v]) {
      const Vec3i& c = triangles_[z(t)];
      const Vec3d n = area_normal(c);
      const double mean = (size_[z(c[0])] + size_[z(c[1])] + size_[z(c[2])]) / 3;
      const double w = n.norm() / (mean * mean);
      sum += w / 3 * (points_[z(c[0])] + points_[z(c[1])] + points_[z(c[2])]);
      weight += w;
      normal += n;
    }
    if (weight <= 0) return points_[v];
    normal.normalize();
    Vec3d step = sum / weight - points_[v];
    step -= normal * normal.dot(step);
    return options_.project(points_[v] + step);
  }

  Surface compact() const {
    std::vector<int> number(points_.size(), -1);
    Surface out;
    for (size_t v = 0; v < points_.size(); ++v)
      if (!fans_[v].empty()) {
        number[v] = static_cast<int>(out.points.size());
        out.points.push_back(points_[v]);
      }
    for (size_t t = 0; t < triangles_.size(); ++t)
      if (alive_[t])
        out.triangles.emplace_back(number[z(triangles_[t][0])], number[z(triangles_[t][1])],
                                   number[z(triangles_[t][2])]);
    return out;
  }

  const RemeshOptions& options_;
  std::vector<Vec3d> points_;
  std::vector<Vec3i> triangles_;
  std::vector<char> fixed_, alive_;
  std::vector<std::vector<int>> fans_;
  std::vector<double> size_;
};

}  // namespace

Surface remesh(const Surface& surface, const RemeshOptions& options) {
  return Remesher(surface, options).run();
}

}  // namespace effigy::people
