#include "effigy/geometry/decimate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <queue>
#include <unordered_set>

#include "effigy/base/error.h"

namespace effigy {

namespace {

// The sum of squared distances to weighted planes: x' A x + 2 b'x + c, and the sum of weights.
struct Quadric {
  double a[6] = {}, b[3] = {}, c = 0, weight = 0;

  void add_plane(const Vec3d& normal, double offset, double w) {
    a[0] += w * normal.x() * normal.x();
    a[1] += w * normal.x() * normal.y();
    a[2] += w * normal.x() * normal.z();
    a[3] += w * normal.y() * normal.y();
    a[4] += w * normal.y() * normal.z();
    a[5] += w * normal.z() * normal.z();
    for (int k = 0; k < 3; ++k) b[k] += w * normal[k] * offset;
    c += w * offset * offset;
  }
  void add(const Quadric& other) {
    for (int k = 0; k < 6; ++k) a[k] += other.a[k];
    for (int k = 0; k < 3; ++k) b[k] += other.b[k];
    c += other.c;
    weight += other.weight;
  }
  double at(const Vec3d& p) const {
    const double x = p.x(), y = p.y(), z = p.z();
    return a[0] * x * x + a[3] * y * y + a[5] * z * z +
           2 * (a[1] * x * y + a[2] * x * z + a[4] * y * z) + 2 * (b[0] * x + b[1] * y + b[2] * z) +
           c;
  }
};

struct Candidate {
  double cost;
  int from, to;
  uint32_t stamp;
  // Cheapest first; ties by index, so that the result does not depend on the heap.
  bool operator<(const Candidate& other) const {
    if (cost != other.cost) return cost > other.cost;
    if (from != other.from) return from > other.from;
    return to > other.to;
  }
};

uint64_t edge_key(int a, int b) {
  return (static_cast<uint64_t>(static_cast<uint32_t>(std::min(a, b))) << 32) |
         static_cast<uint32_t>(std::max(a, b));
}

class Decimator {
 public:
  Decimator(const Mesh& mesh, const DecimateOptions& options);
  void run();
  Decimated result() const;

 private:
  // An edge as the triangles know it, when the collapse of `from` onto `to` is looked at.
  struct Shared {
    int triangles[2];
    int count = 0;
  };

  Vec3d position(size_t pose, int v) const {
    const std::vector<float>& x = pose == 0 ? mesh_.vertices : options_.poses[pose - 1];
    const float* p = x.data() + 3 * static_cast<size_t>(v);
    return {p[0], p[1], p[2]};
  }
  double size_of(int v) const {
    return options_.size.empty() ? std::numeric_limits<double>::infinity()
                                 : static_cast<double>(options_.size[static_cast<size_t>(v)]);
  }
  double tolerance_of(int v) const {
    return static_cast<double>(options_.vertex_tolerance.empty()
                                   ? options_.tolerance
                                   : options_.vertex_tolerance[static_cast<size_t>(v)]);
  }
  int corner_of(int t, int v) const {
    const Vec3i& f = triangles_[static_cast<size_t>(t)];
    return f[0] == v ? 0 : f[1] == v ? 1 : 2;
  }
  bool has(int t, int v) const {
    const Vec3i& f = triangles_[static_cast<size_t>(t)];
    return f[0] == v || f[1] == v || f[2] == v;
  }
  const std::vector<int>& around(int v) const { return around_[static_cast<size_t>(v)]; }
  // The other vertices of the triangles around v, sorted.
  void ring(int v, std::vector<int>& out) const;
  Shared shared(int a, int b) const;
  bool is_feature(const Shared& edge, int a, int b) const;
  int feature_degree(int v, bool& boundary) const;

  void build_quadrics();
  double cost(int from, int to) const;
  void push(int from);
  bool allowed(int from, int to) const;
  bool wedges_follow(int from, int to, const Shared& edge,
                     std::array<std::pair<int, int>, 2>& wedge) const;
  bool shapes_stay(int from, int to, const std::array<std::pair<int, int>, 2>& wedge) const;
  void collapse(int from, int to);

  const Mesh& mesh_;
  const DecimateOptions& options_;
  size_t poses_;
  bool uv_;
  std::vector<Vec3i> triangles_, uv_triangles_;
  std::vector<uint8_t> alive_;
  std::vector<std::vector<int>> around_;
  std::vector<Quadric> quadrics_;  // [V][poses]
  std::vector<uint32_t> stamp_;
  std::unordered_set<uint64_t> creases_;
  std::priority_queue<Candidate> queue_;
  int count_ = 0;
};

Decimator::Decimator(const Mesh& mesh, const DecimateOptions& options)
    : mesh_(mesh),
      options_(options),
      poses_(1 + options.poses.size()),
      uv_(!mesh.uv_triangles.empty()),
      triangles_(mesh.triangles),
      uv_triangles_(mesh.uv_triangles),
      alive_(mesh.triangles.size(), 1),
      around_(static_cast<size_t>(mesh.vertex_count())),
      stamp_(static_cast<size_t>(mesh.vertex_count()), 0),
      count_(mesh.triangle_count()) {
  for (const std::vector<float>& pose : options.poses)
    EFFIGY_CHECK_EQ(pose.size(), mesh.vertices.size());
  if (!options.size.empty()) EFFIGY_CHECK_EQ(options.size.size(), around_.size());
  if (!options.locked.empty()) EFFIGY_CHECK_EQ(options.locked.size(), around_.size());
  if (!options.vertex_tolerance.empty())
    EFFIGY_CHECK_EQ(options.vertex_tolerance.size(), around_.size());
  for (const auto& [a, b] : options.creases) creases_.insert(edge_key(a, b));
  for (int t = 0; t < mesh.triangle_count(); ++t) {
    const Vec3i& f = triangles_[static_cast<size_t>(t)];
    if (f[0] == f[1] || f[1] == f[2] || f[2] == f[0]) {
      alive_[static_cast<size_t>(t)] = 0;  // a fanned polygon with a repeated vertex
      --count_;
      continue;
    }
    for (int k = 0; k < 3; ++k) around_[static_cast<size_t>(f[k])].push_back(t);
  }
  build_quadrics();
}

void Decimator::ring(int v, std::vector<int>& out) const {
  out.clear();
  for (const int t : around(v))
    for (int k = 0; k < 3; ++k)
      if (triangles_[static_cast<size_t>(t)][k] != v)
        out.push_back(triangles_[static_cast<size_t>(t)][k]);
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
}

Decimator::Shared Decimator::shared(int a, int b) const {
  Shared edge;
  for (const int t : around(a))
    if (has(t, b)) {
      if (edge.count < 2) edge.triangles[edge.count] = t;
      ++edge.count;
    }
  return edge;
}

// Boundary, border between two parts, UV seam, crease, or not manifold.
bool Decimator::is_feature(const Shared& edge, int a, int b) const {
  if (edge.count != 2) return true;
  if (!creases_.empty() && creases_.count(edge_key(a, b))) return true;
  const int s = edge.triangles[0], t = edge.triangles[1];
  if (!mesh_.triangle_part.empty() &&
      mesh_.triangle_part[static_cast<size_t>(s)] != mesh_.triangle_part[static_cast<size_t>(t)])
    return true;
  if (!uv_) return false;
  const Vec3i &us = uv_triangles_[static_cast<size_t>(s)],
              &ut = uv_triangles_[static_cast<size_t>(t)];
  return us[corner_of(s, a)] != ut[corner_of(t, a)] || us[corner_of(s, b)] != ut[corner_of(t, b)];
}

int Decimator::feature_degree(int v, bool& boundary) const {
  std::vector<int> neighbours;
  ring(v, neighbours);
  int degree = 0;
  boundary = false;
  for (const int w : neighbours) {
    const Shared edge = shared(v, w);
    degree += is_feature(edge, v, w) ? 1 : 0;
    boundary |= edge.count == 1;
  }
  return degree;
}

void Decimator::build_quadrics() {
  quadrics_.assign(around_.size() * poses_, {});
  const auto add = [&](int v, size_t pose, const Vec3d& normal, double offset, double weight,
                       double mass) {
    Quadric& q = quadrics_[static_cast<size_t>(v) * poses_ + pose];
    q.add_plane(normal, offset, weight);
    q.weight += mass;
  };
  for (size_t t = 0; t < triangles_.size(); ++t) {
    if (!alive_[t]) continue;
    const Vec3i& f = triangles_[t];
    for (size_t pose = 0; pose < poses_; ++pose) {
      const Vec3d p[3] = {position(pose, f[0]), position(pose, f[1]), position(pose, f[2])};
      const Vec3d cross = (p[1] - p[0]).cross(p[2] - p[0]);
      const double length = cross.norm();
      if (!(length > 0)) continue;
      const Vec3d normal = cross / length;
      for (int k = 0; k < 3; ++k)
        add(f[k], pose, normal, -normal.dot(p[0]), length / 6, length / 6);
      // Features also keep their course: a plane through the edge, square to the triangle.
      for (int k = 0; k < 3; ++k) {
        const int a = f[k], b = f[(k + 1) % 3];
        if (!is_feature(shared(a, b), a, b)) continue;
        const Vec3d along = p[(k + 1) % 3] - p[k];
        const Vec3d side = along.cross(normal).normalized();
        const double w = 0.5 * along.squaredNorm();
        add(a, pose, side, -side.dot(p[k]), w, 0);
        add(b, pose, side, -side.dot(p[k]), w, 0);
      }
    }
  }
}

// Infinite beyond the tolerance; else 0..1 for the error, plus the squared edge length in units of
// the wanted one, so that triangles grow evenly.
double Decimator::cost(int from, int to) const {
  double worst = 0;
  for (size_t pose = 0; pose < poses_; ++pose) {
    const Quadric& a = quadrics_[static_cast<size_t>(from) * poses_ + pose];
    const Quadric& b = quadrics_[static_cast<size_t>(to) * poses_ + pose];
    const double mass = a.weight + b.weight;
    if (!(mass > 0)) continue;
    const Vec3d p = position(pose, to);
    worst = std::max(worst, (a.at(p) + b.at(p)) / mass);
  }
  const double tolerance = std::min(tolerance_of(from), tolerance_of(to));
  const double error = worst / (tolerance * tolerance);
  if (!(error <= 1)) return std::numeric_limits<double>::infinity();
  const double size = 0.5 * (size_of(from) + size_of(to));
  if (std::isinf(size)) return error;
  return error + (position(0, from) - position(0, to)).squaredNorm() / (size * size);
}

void Decimator::push(int from) {
  if (!options_.locked.empty() && options_.locked[static_cast<size_t>(from)]) return;
  std::vector<int> neighbours;
  ring(from, neighbours);
  for (const int to : neighbours) {
    const double c = cost(from, to);
    if (std::isfinite(c)) queue_.push({c, from, to, stamp_[static_cast<size_t>(from)]});
  }
}

// The UV vertices of `from` and what each becomes; false when that is not a function (a seam that
// would be pulled off its course).
bool Decimator::wedges_follow(int from, int to, const Shared& edge,
                              std::array<std::pair<int, int>, 2>& wedge) const {
  wedge = {std::pair{-1, -1}, std::pair{-1, -1}};
  if (!uv_) return true;
  for (int i = 0; i < edge.count; ++i) {
    const int t = edge.triangles[i];
    const Vec3i& u = uv_triangles_[static_cast<size_t>(t)];
    wedge[static_cast<size_t>(i)] = {u[corner_of(t, from)], u[corner_of(t, to)]};
  }
  if (edge.count == 2 && wedge[0].first == wedge[1].first && wedge[0].second != wedge[1].second)
    return false;
  for (const int t : around(from)) {
    const int w = uv_triangles_[static_cast<size_t>(t)][corner_of(t, from)];
    if (w != wedge[0].first && w != wedge[1].first) return false;
  }
  return true;
}

// Shape quality: 1 for equilateral, 0 for degenerate.
double quality(const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  const double sum = (b - a).squaredNorm() + (c - b).squaredNorm() + (a - c).squaredNorm();
  return sum > 0 ? 2 * std::sqrt(3.0) * (b - a).cross(c - a).norm() / sum : 0;
}

bool Decimator::shapes_stay(int from, int to,
                            const std::array<std::pair<int, int>, 2>& wedge) const {
  constexpr double kTurn = 0.4;      // least cosine between a triangle's normals, before and after
  constexpr double kQuality = 0.35;  // thinner triangles are made only out of thinner ones
  for (const int t : around(from)) {
    if (has(t, to)) continue;
    const int k = corner_of(t, from);
    const Vec3i& f = triangles_[static_cast<size_t>(t)];
    const int b = f[(k + 1) % 3], c = f[(k + 2) % 3];
    for (size_t pose = 0; pose < poses_; ++pose) {
      const Vec3d pb = position(pose, b), pc = position(pose, c);
      const Vec3d old_a = position(pose, from), new_a = position(pose, to);
      const Vec3d before = (pb - old_a).cross(pc - old_a), after = (pb - new_a).cross(pc - new_a);
      const double scale = before.norm() * after.norm();
      // In further poses a triangle may be folded away to nothing (a closed lid); it then only has
      // to keep its side.
      if (before.dot(after) <= (pose == 0 ? kTurn : 0.0) * scale) return false;
      if (pose == 0) {
        const double q = quality(new_a, pb, pc);
        if (q < kQuality && q < quality(old_a, pb, pc)) return false;
        const double limit = static_cast<double>(options_.stretch) * 0.5;
        if ((new_a - pb).norm() > limit * (size_of(to) + size_of(b)) ||
            (new_a - pc).norm() > limit * (size_of(to) + size_of(c)))
          return false;
      }
    }
    if (uv_) {
      const Vec3i& u = uv_triangles_[static_cast<size_t>(t)];
      const int target = u[k] == wedge[0].first ? wedge[0].second : wedge[1].second;
      const auto area = [&](int i) {
        const Vec2d pa = mesh_.uvs[static_cast<size_t>(i)].cast<double>();
        const Vec2d e = mesh_.uvs[static_cast<size_t>(u[(k + 1) % 3])].cast<double>() - pa;
        const Vec2d g = mesh_.uvs[static_cast<size_t>(u[(k + 2) % 3])].cast<double>() - pa;
        return e.x() * g.y() - e.y() * g.x();
      };
      const double before = area(u[k]), after = area(target);
      if (before * after <= 0 || std::abs(after) < 0.02 * std::abs(before)) return false;
    }
  }
  return true;
}

bool Decimator::allowed(int from, int to) const {
  const Shared edge = shared(from, to);
  if (edge.count < 1 || edge.count > 2) return false;
  bool from_boundary = false, to_boundary = false;
  const int degree = feature_degree(from, from_boundary);
  if (degree != 0 && (degree != 2 || !is_feature(edge, from, to))) return false;
  feature_degree(to, to_boundary);
  if (from_boundary && to_boundary && edge.count != 1) return false;
  // Link condition: the vertices joined to both ends are those of the edge's own triangles.
  std::vector<int> a, b, both;
  ring(from, a);
  ring(to, b);
  std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(both));
  if (both.size() != static_cast<size_t>(edge.count)) return false;
  if (around(from).size() <= 2 && around(to).size() <= 2) return false;  // a lone triangle or pair
  // A tetrahedron has nothing left to give.
  if (a.size() == 3 && b.size() == 3 && edge.count == 2) return false;
  std::array<std::pair<int, int>, 2> wedge;
  return wedges_follow(from, to, edge, wedge) && shapes_stay(from, to, wedge);
}

void Decimator::collapse(int from, int to) {
  const Shared edge = shared(from, to);
  std::array<std::pair<int, int>, 2> wedge;
  wedges_follow(from, to, edge, wedge);
  std::vector<int> touched;
  ring(from, touched);
  if (!creases_.empty())
    for (const int v : touched)
      if (creases_.erase(edge_key(from, v)) && v != to) creases_.insert(edge_key(to, v));
  for (int i = 0; i < edge.count; ++i) {
    const int t = edge.triangles[i];
    alive_[static_cast<size_t>(t)] = 0;
    --count_;
    for (int k = 0; k < 3; ++k) {
      const int v = triangles_[static_cast<size_t>(t)][k];
      if (v == from) continue;
      std::vector<int>& list = around_[static_cast<size_t>(v)];
      list.erase(std::find(list.begin(), list.end(), t));
    }
  }
  for (const int t : around(from)) {
    if (!alive_[static_cast<size_t>(t)]) continue;
    const int k = corner_of(t, from);
    triangles_[static_cast<size_t>(t)][k] = to;
    if (uv_) {
      int& u = uv_triangles_[static_cast<size_t>(t)][k];
      u = u == wedge[0].first ? wedge[0].second : wedge[1].second;
    }
    around_[static_cast<size_t>(to)].push_back(t);
  }
  around_[static_cast<size_t>(from)].clear();
  ++stamp_[static_cast<size_t>(from)];
  for (size_t pose = 0; pose < poses_; ++pose)
    quadrics_[static_cast<size_t>(to) * poses_ + pose].add(
        quadrics_[static_cast<size_t>(from) * poses_ + pose]);
  std::vector<int> neighbours;
  ring(to, neighbours);
  touched.insert(touched.end(), neighbours.begin(), neighbours.end());
  touched.push_back(to);
  std::sort(touched.begin(), touched.end());
  touched.erase(std::unique(touched.begin(), touched.end()), touched.end());
  for (const int v : touched) {
    if (v == from) continue;
    ++stamp_[static_cast<size_t>(v)];
    push(v);
  }
}

void Decimator::run() {
  for (int v = 0; v < mesh_.vertex_count(); ++v) push(v);
  while (!queue_.empty() && count_ > options_.target_triangles) {
    const Candidate best = queue_.top();
    queue_.pop();
    if (best.stamp != stamp_[static_cast<size_t>(best.from)]) continue;
    if (allowed(best.from, best.to)) collapse(best.from, best.to);
  }
}

Decimated Decimator::result() const {
  Decimated out;
  std::vector<int> new_vertex(around_.size(), -1), new_uv(mesh_.uvs.size(), -1);
  std::vector<uint8_t> used(around_.size(), 0), used_uv(mesh_.uvs.size(), 0);
  for (size_t t = 0; t < triangles_.size(); ++t) {
    if (!alive_[t]) continue;
    for (int k = 0; k < 3; ++k) {
      used[static_cast<size_t>(triangles_[t][k])] = 1;
      if (uv_) used_uv[static_cast<size_t>(uv_triangles_[t][k])] = 1;
    }
  }
  for (size_t v = 0; v < used.size(); ++v)
    if (used[v]) {
      new_vertex[v] = static_cast<int>(out.vertex.size());
      out.vertex.push_back(static_cast<int>(v));
      for (size_t k = 0; k < 3; ++k) out.mesh.vertices.push_back(mesh_.vertices[3 * v + k]);
    }
  for (size_t u = 0; u < used_uv.size(); ++u)
    if (used_uv[u]) {
      new_uv[u] = static_cast<int>(out.mesh.uvs.size());
      out.mesh.uvs.push_back(mesh_.uvs[u]);
    }
  out.mesh.parts = mesh_.parts;
  for (size_t t = 0; t < triangles_.size(); ++t) {
    if (!alive_[t]) continue;
    Vec3i f, u;
    for (int k = 0; k < 3; ++k) {
      f[k] = new_vertex[static_cast<size_t>(triangles_[t][k])];
      if (uv_) u[k] = new_uv[static_cast<size_t>(uv_triangles_[t][k])];
    }
    out.mesh.triangles.push_back(f);
    if (uv_) out.mesh.uv_triangles.push_back(u);
    if (!mesh_.triangle_part.empty()) out.mesh.triangle_part.push_back(mesh_.triangle_part[t]);
  }
  return out;
}

}  // namespace

Decimated decimate(const Mesh& mesh, const DecimateOptions& options) {
  check_mesh(mesh, "decimate");
  Decimator decimator(mesh, options);
  decimator.run();
  return decimator.result();
}

}  // namespace effigy
