#include "effigy/rig/embedding_surface.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <queue>

#include "effigy/base/error.h"

namespace effigy::embedding {

namespace {

// Barycentric coordinates of the point of the triangle closest to p (Ericson, Real-Time Collision
// Detection, 5.1.5).
Vec3d closest_on_triangle(const Vec3d& p, const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  const Vec3d ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  const Vec3d bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) {
    const double s = d1 / (d1 - d3);
    return {1 - s, s, 0};
  }
  const Vec3d cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) {
    const double s = d2 / (d2 - d6);
    return {1 - s, 0, s};
  }
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    const double s = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return {0, 1 - s, s};
  }
  const double total = va + vb + vc;
  return {va / total, vb / total, vc / total};
}

int part_number(const Mesh& mesh, const std::string& name) {
  const auto found = std::find(mesh.parts.begin(), mesh.parts.end(), name);
  return found == mesh.parts.end() || mesh.triangle_part.empty()
             ? -1
             : static_cast<int>(found - mesh.parts.begin());
}

double distance_to_segment(const Vec3d& p, const Vec3d& a, const Vec3d& b) {
  const Vec3d along = b - a;
  const double square = along.squaredNorm();
  const double s = square > 0 ? std::clamp((p - a).dot(along) / square, 0.0, 1.0) : 0;
  return (a + s * along - p).norm();
}

double distance_to_line(const Vec3d& p, const std::vector<Vec3d>& line) {
  double best = std::numeric_limits<double>::infinity();
  for (size_t i = 1; i < line.size(); ++i)
    best = std::min(best, distance_to_segment(p, line[i - 1], line[i]));
  return best;
}

// The Catmull-Rom spline through `stops` between stop i and i + 1, as a polyline; beyond the ends
// the spline goes on as it would by mirroring.
std::vector<Vec3d> spline_piece(const std::vector<Vec3d>& stops, size_t i) {
  constexpr int kSteps = 8;
  const Vec3d b = stops[i], c = stops[i + 1];
  const Vec3d a = i > 0 ? stops[i - 1] : Vec3d(2 * b - c);
  const Vec3d d = i + 2 < stops.size() ? stops[i + 2] : Vec3d(2 * c - b);
  std::vector<Vec3d> line;
  for (int k = 0; k <= kSteps; ++k) {
    const double t = static_cast<double>(k) / kSteps;
    line.emplace_back(0.5 * (2 * b + t * (c - a) + t * t * (2 * a - 5 * b + 4 * c - d) +
                             t * t * t * (3 * b - a - 3 * c + d)));
  }
  return line;
}

// Vertices from `from` to `to`, both included; empty when they are not connected. Steps cost the
// more the farther they lead from the line, in units of kNear.
std::vector<int> walk(const Mesh& mesh, const EdgeGraph& graph, int from, int to,
                      const std::vector<Vec3d>& line) {
  constexpr double kNear = 4e-4;
  const auto at = [&](int v) -> Vec3d { return mesh.vertex(v).cast<double>(); };
  const double reach = 3 * (at(to) - at(from)).norm() + 1e-2;  // no sensible way leads farther off
  using Entry = std::pair<double, int>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  std::map<int, double> cost;
  std::map<int, int> before;
  queue.emplace(0, from);
  cost[from] = 0;
  while (!queue.empty()) {
    const auto [c, v] = queue.top();
    queue.pop();
    if (v == to) break;
    if (c > cost[v]) continue;
    const auto neighbours = graph.find(v);
    if (neighbours == graph.end()) continue;
    for (const auto& [w, triangle] : neighbours->second) {
      const double away = distance_to_line(0.5 * (at(v) + at(w)), line);
      if (away > reach) continue;
      const double next = c + (at(w) - at(v)).norm() * (1 + away / kNear);
      const auto known = cost.find(w);
      if (known != cost.end() && known->second <= next) continue;
      cost[w] = next;
      before[w] = v;
      queue.emplace(next, w);
    }
  }
  if (!cost.count(to)) return {};
  std::vector<int> path = {to};
  while (path.back() != from) path.push_back(before.at(path.back()));
  std::reverse(path.begin(), path.end());
  return path;
}

Vec3d corner(const Mesh& mesh, int triangle, int vertex) {
  const Vec3i& f = mesh.triangles[static_cast<size_t>(triangle)];
  return {f[0] == vertex ? 1.0 : 0.0, f[1] == vertex ? 1.0 : 0.0, f[2] == vertex ? 1.0 : 0.0};
}

}  // namespace

EdgeGraph edge_graph(const Mesh& mesh, const std::string& part) {
  const int number = part_number(mesh, part);
  EdgeGraph graph;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (number >= 0 && mesh.triangle_part[t] != number) continue;
    for (int k = 0; k < 3; ++k) {
      const int a = mesh.triangles[t][k], b = mesh.triangles[t][(k + 1) % 3];
      graph[a][b].push_back(static_cast<int>(t));
      graph[b][a].push_back(static_cast<int>(t));
    }
  }
  return graph;
}

std::vector<int> walk_through(const Mesh& mesh, const EdgeGraph& graph,
                              const std::vector<int>& stops) {
  std::vector<Vec3d> places;
  for (const int v : stops) places.push_back(mesh.vertex(v).cast<double>());
  std::vector<int> path = {stops.front()};
  for (size_t i = 0; i + 1 < stops.size(); ++i) {
    const std::vector<int> step =
        walk(mesh, graph, stops[i], stops[i + 1], spline_piece(places, i));
    if (step.empty())
      path.push_back(stops[i + 1]);
    else
      path.insert(path.end(), step.begin() + 1, step.end());
  }
  return path;
}

Vec3d position_on(const Mesh& mesh, int triangle, const Vec3d& barycentric) {
  const Vec3i& f = mesh.triangles[static_cast<size_t>(triangle)];
  Vec3d p = Vec3d::Zero();
  for (int k = 0; k < 3; ++k) p += barycentric[k] * mesh.vertex(f[k]).cast<double>();
  return p;
}

Surface::Surface(const Mesh& mesh, const std::string& part) {
  const int number = part_number(mesh, part);
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (number >= 0 && mesh.triangle_part[t] != number) continue;
    const Vec3i& f = mesh.triangles[t];
    Triangle triangle;
    triangle.index = static_cast<int>(t);
    triangle.a = mesh.vertex(f[0]).cast<double>();
    triangle.b = mesh.vertex(f[1]).cast<double>();
    triangle.c = mesh.vertex(f[2]).cast<double>();
    const Vec3d cross = (triangle.b - triangle.a).cross(triangle.c - triangle.a);
    if (!(cross.norm() > 0)) continue;
    triangle.normal = cross.normalized();
    triangle.center = (triangle.a + triangle.b + triangle.c) / 3;
    triangle.radius =
        std::max({(triangle.a - triangle.center).norm(), (triangle.b - triangle.center).norm(),
                  (triangle.c - triangle.center).norm()});
    triangles_.push_back(triangle);
  }
}

SurfacePoint Surface::closest(const Vec3d& point, const Vec3d& normal, double least_cosine) const {
  SurfacePoint best;
  double nearest = std::numeric_limits<double>::infinity();
  for (const Triangle& t : triangles_) {
    const double limit = nearest + t.radius;
    if ((t.center - point).squaredNorm() >= limit * limit || t.normal.dot(normal) < least_cosine)
      continue;
    const Vec3d b = closest_on_triangle(point, t.a, t.b, t.c);
    const Vec3d p = b[0] * t.a + b[1] * t.b + b[2] * t.c;
    const double distance = (p - point).norm();
    if (distance < nearest) {
      nearest = distance;
      best = {t.index, b, p};
    }
  }
  return best;
}

SurfacePoint Surface::last_hit(const Vec3d& origin, const Vec3d& direction) const {
  SurfacePoint best;
  double farthest = 0;
  for (const Triangle& t : triangles_) {
    // Moeller and Trumbore 1997.
    const Vec3d e1 = t.b - t.a, e2 = t.c - t.a, h = direction.cross(e2);
    const double det = e1.dot(h);
    if (std::abs(det) < 1e-18) continue;
    const Vec3d s = origin - t.a;
    const double u = s.dot(h) / det;
    const Vec3d q = s.cross(e1);
    const double v = direction.dot(q) / det, along = e2.dot(q) / det;
    constexpr double kSlack = 1e-9;
    if (u < -kSlack || v < -kSlack || u + v > 1 + kSlack || along <= farthest) continue;
    farthest = along;
    best = {t.index, Vec3d(1 - u - v, u, v), origin + along * direction};
  }
  return best;
}

Vec3d Surface::centroid() const {
  Vec3d sum = Vec3d::Zero();
  double total = 0;
  for (const Triangle& t : triangles_) {
    const double area = (t.b - t.a).cross(t.c - t.a).norm();
    sum += area * t.center;
    total += area;
  }
  return total > 0 ? Vec3d(sum / total) : sum;
}

SurfaceLine::SurfaceLine(const Rig& rig, const EdgeGraph& graph, const std::vector<int>& landmarks,
                         Course course)
    : mesh_(rig.mesh), course_(course) {
  double length = 0;
  const auto add = [&](int triangle, const Vec3d& from, const Vec3d& to, double step) {
    if (!(step > 0)) return;
    length += step;
    segments_.push_back({triangle, from, to, length});
  };
  const auto add_on = [&](int triangle, const Vec3d& from, const Vec3d& to) {
    add(triangle, from, to,
        (position_on(mesh_, triangle, to) - position_on(mesh_, triangle, from)).norm());
  };
  // Each landmark as it is embedded, and the corner of its triangle nearest to it.
  std::vector<SurfacePoint> exact;
  std::vector<int> corners;
  std::vector<Vec3d> places;
  for (const int landmark : landmarks) {
    const auto found = std::find(rig.multipie.index.begin(), rig.multipie.index.end(), landmark);
    EFFIGY_CHECK(found != rig.multipie.index.end());
    const size_t i = static_cast<size_t>(found - rig.multipie.index.begin());
    const int triangle = rig.multipie.triangle[i];
    const Vec3d b = rig.multipie.barycentric[i].cast<double>();
    exact.push_back({triangle, b, position_on(mesh_, triangle, b)});
    places.push_back(exact.back().position);
    int k = 0;
    b.maxCoeff(&k);
    corners.push_back(mesh_.triangles[static_cast<size_t>(triangle)][k]);
  }
  first_ = exact[0];
  stops_ = {0};
  std::vector<int> walked = {corners[0]};
  for (size_t i = 0; i + 1 < corners.size(); ++i) {
    const std::vector<Vec3d> spline = spline_piece(places, i);
    const std::vector<int> path = walk(mesh_, graph, corners[i], corners[i + 1], spline);
    walked.insert(walked.end(), path.begin(), path.end());
    if (course == Course::kSmooth) {
      for (size_t k = 1; k < spline.size(); ++k)
        add(-1, spline[k - 1], spline[k], (spline[k] - spline[k - 1]).norm());
    } else {
      add_on(exact[i].triangle, exact[i].barycentric, corner(mesh_, exact[i].triangle, corners[i]));
      for (size_t k = 1; k < path.size(); ++k) {
        const int t = graph.at(path[k - 1]).at(path[k]).front();
        add_on(t, corner(mesh_, t, path[k - 1]), corner(mesh_, t, path[k]));
      }
      add_on(exact[i + 1].triangle, corner(mesh_, exact[i + 1].triangle, corners[i + 1]),
             exact[i + 1].barycentric);
    }
    stops_.push_back(length);
  }
  if (course == Course::kSmooth) {
    for (const int v : walked) {
      const auto neighbours = graph.find(v);
      if (neighbours == graph.end()) continue;
      for (const auto& [w, triangles] : neighbours->second)
        near_.insert(near_.end(), triangles.begin(), triangles.end());
    }
    for (const SurfacePoint& point : exact) near_.push_back(point.triangle);
    std::sort(near_.begin(), near_.end());
    near_.erase(std::unique(near_.begin(), near_.end()), near_.end());
  }
}

SurfacePoint SurfaceLine::at(double length) const {
  double begin = 0;
  for (const Segment& segment : segments_) {
    if (length > segment.end && &segment != &segments_.back()) {
      begin = segment.end;
      continue;
    }
    const double s = std::clamp((length - begin) / (segment.end - begin), 0.0, 1.0);
    const Vec3d p = (1 - s) * segment.from + s * segment.to;
    if (course_ == Course::kEdges)
      return {segment.triangle, p, position_on(mesh_, segment.triangle, p)};
    SurfacePoint best;
    double nearest = std::numeric_limits<double>::infinity();
    for (const int t : near_) {
      const Vec3i& f = mesh_.triangles[static_cast<size_t>(t)];
      const Vec3d b =
          closest_on_triangle(p, mesh_.vertex(f[0]).cast<double>(),
                              mesh_.vertex(f[1]).cast<double>(), mesh_.vertex(f[2]).cast<double>());
      const Vec3d q = position_on(mesh_, t, b);
      if ((q - p).norm() < nearest) {
        nearest = (q - p).norm();
        best = {t, b, q};
      }
    }
    return best;
  }
  return first_;
}

}  // namespace effigy::embedding
