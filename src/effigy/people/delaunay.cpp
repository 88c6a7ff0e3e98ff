#include "effigy/people/delaunay.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace effigy::people {
namespace {

double area2(const Vec2d& a, const Vec2d& b, const Vec2d& c) {
  return (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
}

struct Circle {
  double x, y, squared;
};
Circle circle_through(const Vec2d& a, const Vec2d& b, const Vec2d& c) {
  const Vec2d p = b - a, q = c - a;
  const double d = 2 * (p.x() * q.y() - p.y() * q.x());
  const double x = (q.y() * p.squaredNorm() - p.y() * q.squaredNorm()) / d;
  const double y = (p.x() * q.squaredNorm() - q.x() * p.squaredNorm()) / d;
  return {a.x() + x, a.y() + y, x * x + y * y};
}

double angle_at(const Vec3d& apex, const Vec3d& a, const Vec3d& b) {
  const Vec3d p = a - apex, q = b - apex;
  return std::atan2(p.cross(q).norm(), p.dot(q));
}

int opposite(const Vec3i& t, int a, int b) {
  for (int k = 0; k < 3; ++k)
    if (t[k] != a && t[k] != b) return t[k];
  return -1;
}

}  // namespace

std::vector<Vec3i> delaunay(const std::vector<Vec2d>& points) {
  const int n = static_cast<int>(points.size());
  std::vector<Vec2d> all = points;
  all.insert(all.end(), {Vec2d(-60, -50), Vec2d(60, -50), Vec2d(0, 90)});
  struct Cell {
    Vec3i t;
    Circle circle;
  };
  std::vector<Cell> cells = {
      {Vec3i(n, n + 1, n + 2), circle_through(all[n], all[n + 1], all[n + 2])}};
  for (int i = 0; i < n; ++i) {
    std::map<std::pair<int, int>, int> edges;  // directed, of removed cells
    size_t kept = 0;
    for (size_t c = 0; c < cells.size(); ++c) {
      const Circle& circle = cells[c].circle;
      const double dx = all[i].x() - circle.x, dy = all[i].y() - circle.y;
      if (dx * dx + dy * dy < circle.squared) {
        const Vec3i& t = cells[c].t;
        for (int k = 0; k < 3; ++k) edges[{t[k], t[(k + 1) % 3]}] = 1;
      } else {
        cells[kept++] = cells[c];
      }
    }
    cells.resize(kept);
    for (const auto& [edge, unused] : edges) {
      if (edges.count({edge.second, edge.first}) != 0) continue;
      const Vec3i t(edge.first, edge.second, i);
      cells.push_back({t, circle_through(all[t[0]], all[t[1]], all[t[2]])});
    }
  }
  std::vector<Vec3i> triangles;
  for (const Cell& cell : cells)
    if (cell.t.maxCoeff() < n) triangles.push_back(cell.t);
  return triangles;
}

void recover_edges(std::vector<Vec3i>& triangles, const std::vector<Vec2d>& points,
                   const std::vector<std::pair<int, int>>& edges) {
  auto crosses = [&](int a, int b, int c, int d) {
    if (a == c || a == d || b == c || b == d) return false;
    const Vec2d &p = points[a], &q = points[b], &r = points[c], &s = points[d];
    return area2(p, q, r) * area2(p, q, s) < 0 && area2(r, s, p) * area2(r, s, q) < 0;
  };
  for (const auto& [from, to] : edges) {
    // Every pass flips what can be flipped; a finite number suffices.
    for (int pass = 0, crossing = 1; crossing > 0 && pass < 100; ++pass) {
      crossing = 0;
      for (size_t f = 0; f < triangles.size(); ++f)
        for (int k = 0; k < 3; ++k) {
          const int a = triangles[f][k], b = triangles[f][(k + 1) % 3];
          if (!crosses(from, to, a, b)) continue;
          ++crossing;
          for (size_t g = 0; g < triangles.size(); ++g) {
            const Vec3i t = triangles[g];
            if (g == f || (t.array() == a).count() + (t.array() == b).count() != 2) continue;
            const int c = opposite(triangles[f], a, b), d = opposite(t, a, b);
            const Vec2d &pc = points[c], &pd = points[d];
            if (area2(pc, points[a], pd) <= 0 || area2(pd, points[b], pc) <= 0) break;
            triangles[f] = Vec3i(c, a, d);
            triangles[g] = Vec3i(d, b, c);
            break;
          }
        }
    }
  }
}

void flip_towards_delaunay(std::vector<Vec3i>& triangles, const std::vector<Vec3d>& positions,
                           const std::vector<Vec2d>& uv) {
  for (int round = 0; round < 12; ++round) {
    std::map<std::pair<int, int>, int> owner;  // directed edge -> triangle
    for (int f = 0; f < static_cast<int>(triangles.size()); ++f)
      for (int k = 0; k < 3; ++k) owner[{triangles[f][k], triangles[f][(k + 1) % 3]}] = f;
    std::vector<char> touched(triangles.size(), 0);
    int flips = 0;
    for (const auto& [edge, f] : owner) {
      const auto [a, b] = edge;
      const auto other = owner.find({b, a});
      if (a > b || other == owner.end()) continue;
      const int g = other->second;
      if (touched[f] || touched[g]) continue;
      const int c = opposite(triangles[f], a, b), d = opposite(triangles[g], a, b);
      if (owner.count({c, d}) != 0 || owner.count({d, c}) != 0) continue;
      const double sum = angle_at(positions[c], positions[a], positions[b]) +
                         angle_at(positions[d], positions[a], positions[b]);
      if (sum <= 3.16) continue;
      const Vec3i s(c, a, d), t(d, b, c);
      const double least = 0.15 * (area2(uv[a], uv[b], uv[c]) + area2(uv[b], uv[a], uv[d]));
      if (area2(uv[s[0]], uv[s[1]], uv[s[2]]) < least ||
          area2(uv[t[0]], uv[t[1]], uv[t[2]]) < least)
        continue;
      triangles[f] = s;
      triangles[g] = t;
      touched[f] = touched[g] = 1;
      ++flips;
    }
    if (flips == 0) return;
  }
}

bool inside_polygon(const std::vector<Vec2d>& polygon, const Vec2d& p) {
  bool inside = false;
  for (size_t i = 0, j = polygon.size() - 1; i < polygon.size(); j = i++) {
    const Vec2d &a = polygon[i], &b = polygon[j];
    if ((a.y() > p.y()) != (b.y() > p.y()) &&
        p.x() < (b.x() - a.x()) * (p.y() - a.y()) / (b.y() - a.y()) + a.x())
      inside = !inside;
  }
  return inside;
}

}  // namespace effigy::people
