#include "effigy/people/head_half.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/people/delaunay.h"
#include "effigy/people/head_domain.h"
#include "effigy/people/head_shape.h"
#include "effigy/people/smooth.h"

namespace effigy::people {

int Half::add(const HeadVertex& vertex, const Vec2d& at, bool on_seam) {
  vertices.push_back(vertex);
  uv.push_back(at);
  behind.push_back(on_seam ? 1 : 0);
  return static_cast<int>(vertices.size()) - 1;
}

void Half::add_triangle(int a, int b, int c, HalfPart p) {
  triangles.emplace_back(a, b, c);
  part.push_back(p);
}

void Half::add_band(const std::vector<int>& outer, const std::vector<int>& inner, bool closed,
                    HalfPart p) {
  const size_t n = outer.size();
  for (size_t i = 0; i + (closed ? 0 : 1) < n; ++i) {
    const size_t j = (i + 1) % n;
    add_triangle(outer[j], outer[i], inner[i], p);
    add_triangle(outer[j], inner[i], inner[j], p);
  }
}

namespace {

// Wanted edge length, millimetres: fine at the features, about 17 mm^2 triangles on the face.
double spacing(const Vec3d& p) {
  double length = mix(10.0, 6.2, smooth_step(-25, 45, p.z()));
  length = mix(length, 10.0, smooth_step(55, 90, p.y()));
  length = mix(length, 10.0, smooth_step(-112, -135, p.y()));
  double fine = bump(p, {0, -44, 100}, {24, 22, 26});
  fine = std::max(fine, bump(p, {0, kMouthY, 92}, {46, 28, 40}));
  fine = std::max(fine, bump(p, {kEyeX, 2, 80}, {30, 26, 30}));
  fine = std::max(fine, bump(p, {72, -14, -10}, {30, 40, 30}));
  length = mix(length, 4.3, std::min(1.0, 1.3 * fine));
  return mix(length, 2.7, std::min(1.0, 1.3 * bump(p, {9, -44, 99}, {14, 13, 17})));
}

class SkinFiller {
 public:
  SkinFiller(Half& half, const std::vector<int>& mouth, const std::vector<int>& eye,
             const std::vector<int>& ear, const std::vector<int>& nostril)
      : half_(half) {
    collect_boundary(mouth);
    const int outline = static_cast<int>(ids_.size());
    for (int i = 0; i < outline; ++i) rims_.emplace_back(i, (i + 1) % outline);
    for (const auto* loop : {&eye, &ear, &nostril}) {
      std::vector<Vec2d> polygon;
      const int first = static_cast<int>(ids_.size()), n = static_cast<int>(loop->size());
      for (int i = 0; i < n; ++i) rims_.emplace_back(first + i, first + (i + 1) % n);
      for (const int v : *loop) {
        polygon.push_back(half_.uv[v]);
        ids_.push_back(v);
        positions_.push_back(half_.vertices[v].p);
        uv_.push_back(half_.uv[v]);
      }
      holes_.push_back(polygon);
    }
    fixed_ = positions_.size();
  }

  void fill() {
    tabulate();
    scatter();
    for (int round = 0; round < 24; ++round) relax();
    settle();
    triangulate();
    for (int round = 0; round < 12; ++round) even_out();
  }

 private:
  bool inside(const Vec2d& uv) const {
    if (!inside_polygon(outline_, uv)) return false;
    return std::none_of(holes_.begin(), holes_.end(),
                        [&](const auto& hole) { return inside_polygon(hole, uv); });
  }

  void append(int vertex) {
    ids_.push_back(vertex);
    positions_.push_back(half_.vertices[vertex].p);
    uv_.push_back(half_.uv[vertex]);
    outline_.push_back(half_.uv[vertex]);
  }

  // New vertices along a line of the domain, evenly by the wanted spacing, both ends included
  // unless left out.
  std::vector<int> line(const Vec2d& from, const Vec2d& to, int side, bool seam, bool with_first,
                        bool with_last) {
    constexpr int kFine = 400;
    std::vector<Vec3d> points(kFine + 1);
    std::vector<double> steps(kFine + 1, 0.0);
    for (int i = 0; i <= kFine; ++i) {
      const Vec2d at = from + (to - from) * (static_cast<double>(i) / kFine);
      points[i] = point_at(at.x(), at.y());
      if (i > 0) steps[i] = steps[i - 1] + (points[i] - points[i - 1]).norm() / spacing(points[i]);
    }
    const int count = std::max(1, static_cast<int>(std::lround(steps[kFine])));
    std::vector<int> made;
    for (int k = with_first ? 0 : 1; k <= (with_last ? count : count - 1); ++k) {
      const double wanted = steps[kFine] * k / count;
      const auto it = std::lower_bound(steps.begin(), steps.end(), wanted - 1e-12);
      const int i = std::clamp(static_cast<int>(it - steps.begin()), 1, kFine);
      const double f = (wanted - steps[i - 1]) / std::max(steps[i] - steps[i - 1], 1e-9);
      const Vec2d at = from + (to - from) * ((i - 1 + std::clamp(f, 0.0, 1.0)) / kFine);
      HeadVertex vertex;
      vertex.p = point_at(at.x(), at.y());
      vertex.side = side;
      if (side == 0) vertex.p.x() = 0;
      made.push_back(half_.add(vertex, uv_at(at.x(), at.y()), seam));
      append(made.back());
    }
    return made;
  }

  // Counter-clockwise in UV: up the mirror plane in front, down behind, back along the neck.
  void collect_boundary(const std::vector<int>& mouth) {
    const double below = domain_of(half_.vertices[mouth.back()].p).y();
    const double above = domain_of(half_.vertices[mouth.front()].p).y();
    const auto chin = line({0, kLevelBottom}, {0, below}, 0, false, true, false);
    for (auto it = mouth.rbegin(); it != mouth.rend(); ++it) append(*it);
    line({0, above}, {0, kLevelTop}, 0, false, false, true);
    const auto back = line({180, kLevelTop}, {180, kLevelBottom}, 0, true, false, true);
    auto neck = line({180, kLevelBottom}, {0, kLevelBottom}, 1, false, false, false);
    half_.neck.push_back(chin.front());
    half_.neck.insert(half_.neck.end(), neck.rbegin(), neck.rend());
    half_.neck.push_back(back.back());
  }

  // Positions on a grid of the domain, so that thousands of candidates need no marching.
  void tabulate() {
    grid_.resize((kColumns + 1) * (kRows + 1));
    for (int r = 0; r <= kRows; ++r)
      for (int k = 0; k <= kColumns; ++k)
        grid_[r * (kColumns + 1) + k] =
            point_at(180.0 * k / kColumns, mix(kLevelBottom, kLevelTop, 1.0 * r / kRows));
  }
  Vec3d about(const Vec2d& domain) const {
    const double x = std::clamp(domain.x() / 180, 0.0, 1.0) * kColumns;
    const double y =
        std::clamp((domain.y() - kLevelBottom) / (kLevelTop - kLevelBottom), 0.0, 1.0) * kRows;
    const int k = std::min(static_cast<int>(x), kColumns - 1),
              r = std::min(static_cast<int>(y), kRows - 1);
    const double fx = x - k, fy = y - r;
    const Vec3d* g = &grid_[r * (kColumns + 1) + k];
    return (1 - fy) * ((1 - fx) * g[0] + fx * g[1]) +
           fy * ((1 - fx) * g[kColumns + 1] + fx * g[kColumns + 2]);
  }

  void scatter() {
    Random random(7);
    for (int attempt = 0; attempt < 60000; ++attempt) {
      const double across = random.uniform(0, 180);
      const Vec2d domain(across, random.uniform(kLevelBottom, kLevelTop));
      const Vec3d p = about(domain);
      const double least = 0.78 * spacing(p);
      const bool free = std::none_of(positions_.begin(), positions_.end(), [&](const Vec3d& q) {
        return (p - q).squaredNorm() < least * least;
      });
      if (!free) continue;
      const Vec2d uv = uv_at(domain.x(), domain.y());
      if (!inside(uv)) continue;
      positions_.push_back(p);
      uv_.push_back(uv);
      domains_.push_back(domain);
    }
  }

  // Each free point moves away from its neighbours, along the skin.
  void relax() {
    const std::vector<Vec3d> old = positions_;
    for (size_t i = fixed_; i < positions_.size(); ++i) {
      const double reach = 1.5 * spacing(old[i]);
      Vec3d push = Vec3d::Zero();
      for (size_t j = 0; j < old.size(); ++j) {
        const Vec3d d = old[i] - old[j];
        const double squared = d.squaredNorm();
        if (j == i || squared > reach * reach) continue;
        const double length = std::sqrt(squared);
        push += d * (std::pow(1 - length / reach, 2) / std::max(length, 0.1));
      }
      const Vec2d domain = domain_of(old[i] + 0.5 * reach * push.cwiseMax(-0.6).cwiseMin(0.6));
      const Vec2d uv = uv_at(domain.x(), domain.y());
      if (!inside(uv)) continue;
      positions_[i] = about(domain);
      uv_[i] = uv;
      domains_[i - fixed_] = domain;
    }
  }

  // From the table onto the skin itself.
  void settle() {
    for (size_t i = fixed_; i < positions_.size(); ++i)
      positions_[i] = point_at(domains_[i - fixed_].x(), domains_[i - fixed_].y());
  }

  void triangulate() {
    for (size_t i = fixed_; i < positions_.size(); ++i) {
      HeadVertex vertex;
      vertex.p = positions_[i];
      ids_.push_back(half_.add(vertex, uv_[i]));
    }
    std::vector<Vec3i> all = delaunay(uv_);
    recover_edges(all, uv_, rims_);
    std::vector<Vec3i> kept;
    for (const Vec3i& t : all)
      if (inside((uv_[t[0]] + uv_[t[1]] + uv_[t[2]]) / 3)) kept.push_back(t);
    flip_towards_delaunay(kept, positions_, uv_);
    for (const Vec3i& t : kept)
      half_.add_triangle(ids_[t[0]], ids_[t[1]], ids_[t[2]], HalfPart::kSkin);
  }

  // Free vertices move halfway to the middle of their neighbours and back onto the skin, where rays
  // from the centre graze it (beside the nose) and leave uneven triangles.
  void even_out() {
    std::vector<Vec3d> sum(half_.vertices.size(), Vec3d::Zero());
    std::vector<double> weight(half_.vertices.size(), 0.0);
    for (const Vec3i& t : half_.triangles)
      for (int k = 0; k < 3; ++k) {
        const int a = t[k], b = t[(k + 1) % 3];
        sum[a] += half_.vertices[b].p;
        sum[b] += half_.vertices[a].p;
        weight[a] += 1;
        weight[b] += 1;
      }
    for (size_t i = fixed_; i < ids_.size(); ++i) {
      Vec3d& p = half_.vertices[ids_[i]].p;
      p = 0.5 * p + 0.5 * sum[ids_[i]] / weight[ids_[i]];
      for (int step = 0; step < 3; ++step) p -= 0.9 * head_distance(p) * head_normal(p);
    }
  }

  Half& half_;
  std::vector<Vec2d> outline_;
  std::vector<std::vector<Vec2d>> holes_;
  std::vector<std::pair<int, int>> rims_;  // edges that must be in the mesh
  std::vector<int> ids_;                   // of the fixed points, then of all
  std::vector<Vec3d> positions_;
  std::vector<Vec2d> uv_;
  size_t fixed_ = 0;
  std::vector<Vec2d> domains_;  // of the free points
  static constexpr int kColumns = 90, kRows = 102;
  std::vector<Vec3d> grid_;
};

}  // namespace

void add_skin(Half& half, const std::vector<int>& mouth, const std::vector<int>& eye,
              const std::vector<int>& ear, const std::vector<int>& nostril) {
  SkinFiller(half, mouth, eye, ear, nostril).fill();
}

}  // namespace effigy::people
