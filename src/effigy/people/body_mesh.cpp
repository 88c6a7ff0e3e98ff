#include "effigy/people/body_mesh.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <string>

#include "effigy/base/error.h"
#include "effigy/geometry/atlas.h"
#include "effigy/geometry/topology.h"
#include "effigy/people/body_charts.h"
#include "effigy/people/isosurface.h"
#include "effigy/people/remesh.h"
#include "effigy/people/smooth.h"

namespace effigy::people {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kCell = 4.5;  // millimetres: the spaces between the fingers' roots must show

Vec3d ring_point(const Rig& head, size_t i, const Vec3d& offset) {
  return 1e3 * head.mesh.vertex(head.neck_ring[i]).cast<double>() + offset;
}

// Wanted edge length.
double edge_size(const BodyForm& form, const Vec3d& p) {
  const BodyJoints& j = form.joints();
  const double k = form.build().stature;
  const Vec3d q(std::abs(p.x()), p.y(), p.z());
  double size = 12.5;
  const double arm = form.along_arm(q) - form.arm_reach();
  if (q.x() > j.upper_arm.x() + 100 * k) {
    size = mix(size, 9.0, smooth_step(-150 * k, -40 * k, arm));
    size = mix(size, 4.6, smooth_step(-40 * k, 60 * k, arm));
  }
  size = mix(size, 9.0, smooth_step(110 * k, 60 * k, p.y()));  // shoes
  const double neck = (p - j.neck).norm();
  size = mix(size, 8.5, smooth_step(140, 90, neck));
  // The edges of garments.
  const BodyForm::Cover c = form.cover(p);
  double edge = std::min(std::abs(c.top), c.top > 0 ? 1e3 : std::abs(c.bottom));
  if (c.top < 0 && c.bottom < 0) edge = std::min(edge, std::abs(c.shoe));
  return std::min(size, mix(6.0, 12.5, smooth_step(4, 40, edge)));
}

// Corner 3 t + k stands for the edge of triangle t from its corner k on.
std::pair<int, int> directed_edge(const Surface& surface, int corner) {
  const Vec3i& c = surface.triangles[static_cast<size_t>(corner / 3)];
  return {c[corner % 3], c[(corner % 3 + 1) % 3]};
}

// The corners of each edge, as runs of equal keys.
std::vector<std::pair<uint64_t, int>> sorted_edges(const Surface& surface) {
  std::vector<std::pair<uint64_t, int>> edges;
  for (int c = 0; c < 3 * static_cast<int>(surface.triangles.size()); ++c) {
    const auto [a, b] = directed_edge(surface, c);
    edges.emplace_back(static_cast<uint64_t>(std::min(a, b)) << 32 | std::max(a, b), c);
  }
  std::sort(edges.begin(), edges.end());
  return edges;
}

// The corner across each edge, -1 at the rim; at an edge of four triangles those that face the
// same way most belong together.
std::vector<int> edge_twins(const Surface& surface,
                            const std::vector<std::pair<uint64_t, int>>& edges) {
  const auto normal = [&](int corner) {
    const Vec3i& c = surface.triangles[static_cast<size_t>(corner / 3)];
    return (surface.points[c[1]] - surface.points[c[0]])
        .cross(surface.points[c[2]] - surface.points[c[0]])
        .normalized();
  };
  std::vector<int> twin(edges.size(), -1);
  for (size_t first = 0, last; first < edges.size(); first = last) {
    for (last = first; last < edges.size() && edges[last].first == edges[first].first;) ++last;
    for (size_t i = first; i < last; ++i) {
      const int c = edges[i].second;
      if (twin[c] >= 0) continue;
      int best = -1;
      for (size_t j = i + 1; j < last; ++j) {
        const int d = edges[j].second;
        if (twin[d] >= 0 || directed_edge(surface, d).first == directed_edge(surface, c).first)
          continue;
        if (best < 0 || normal(c).dot(normal(d)) > normal(c).dot(normal(best))) best = d;
      }
      if (best < 0) continue;
      twin[c] = best;
      twin[best] = c;
    }
  }
  return twin;
}

// One point for each fan of triangles.
void separate_fans(Surface& surface, const std::vector<int>& twin) {
  std::vector<char> used(surface.points.size(), 0), done(twin.size(), 0);
  const std::vector<Vec3i> before = surface.triangles;
  for (size_t start = 0; start < done.size(); ++start) {
    if (done[start]) continue;
    const int v = before[start / 3][static_cast<int>(start % 3)];
    int number = v;
    if (used[v]++) {
      number = static_cast<int>(surface.points.size());
      surface.points.push_back(surface.points[v]);
    }
    // Both ways round the point, corner by corner.
    std::vector<int> open{static_cast<int>(start)};
    while (!open.empty()) {
      const int c = open.back();
      open.pop_back();
      if (done[c]) continue;
      done[c] = 1;
      surface.triangles[static_cast<size_t>(c / 3)][c % 3] = number;
      const int ahead = twin[c];  // its corner of the edge from v: the twin starts at the far end
      if (ahead >= 0) open.push_back(ahead / 3 * 3 + (ahead % 3 + 1) % 3);
      const int behind = twin[c / 3 * 3 + (c % 3 + 2) % 3];
      if (behind >= 0) open.push_back(behind);
    }
  }
}

// Puts a point on an edge of two triangles.
void split_edge(Surface& surface, int corner, int twin) {
  const auto [a, b] = directed_edge(surface, corner);
  const int m = static_cast<int>(surface.points.size());
  surface.points.push_back(0.5 * (surface.points[a] + surface.points[b]));
  for (const int c : {corner, twin}) {
    Vec3i& first = surface.triangles[static_cast<size_t>(c / 3)];
    Vec3i second = first;
    first[(c % 3 + 1) % 3] = m;
    second[c % 3] = m;
    surface.triangles.push_back(second);
  }
}

// Gives sheets that touch along an edge or in a point their own points, so that every edge belongs
// to two triangles. Where a sheet touches itself along an edge both ends of which it goes round in
// one fan, that edge gets a point in the middle for each side.
void separate_sheets(Surface& surface) {
  for (bool whole = false; !whole;) {
    whole = true;
    const std::vector<int> twin = edge_twins(surface, sorted_edges(surface));
    separate_fans(surface, twin);
    const auto edges = sorted_edges(surface);
    std::vector<char> touched(surface.triangles.size(), 0);
    for (size_t first = 0, last; first < edges.size(); first = last) {
      for (last = first; last < edges.size() && edges[last].first == edges[first].first;) ++last;
      if (last - first <= 2) continue;
      whole = false;
      const int c = edges[first].second, d = twin[c];
      if (d < 0 || touched[c / 3] || touched[d / 3]) continue;
      touched[c / 3] = touched[d / 3] = 1;
      split_edge(surface, c, d);
    }
  }
}

// The form's surface below the neck ring, whose points come first.
Surface form_surface(const BodyForm& form, const std::vector<Vec3d>& ring) {
  const BodyJoints& j = form.joints();
  double reach = j.upper_arm.x();
  for (const auto& finger : j.fingers)
    for (const Vec3d& p : finger) reach = std::max(reach, p.x());
  reach += 40;
  const double top = form.ring().highest() + 22;
  Surface whole = surface_nets([&](const Vec3d& p) { return form.distance(p); },
                               Vec3d(-reach, -25, -230), Vec3d(reach, top, 240), kCell);
  separate_sheets(whole);
  // Without what lies above the cut, and without crumbs.
  const auto below = [&](int v) {
    const Vec3d& p = whole.points[static_cast<size_t>(v)];
    return p.y() < form.ring().height_at(p) - 8;
  };
  std::vector<Vec3i> kept;
  for (const Vec3i& t : whole.triangles)
    if (below(t[0]) && below(t[1]) && below(t[2])) kept.push_back(t);
  const auto piece = connected_pieces(kept, static_cast<int>(whole.points.size()));
  std::map<int, int> sizes;
  for (const Vec3i& t : kept) ++sizes[piece[t[0]]];
  int largest = -1, most = 0;
  for (const auto& [p, n] : sizes)
    if (n > most) {
      largest = p;
      most = n;
    }
  Surface out;
  out.points = ring;
  std::vector<int> number(whole.points.size(), -1);
  for (const Vec3i& t : kept) {
    if (piece[t[0]] != largest) continue;
    Vec3i mapped;
    for (int k = 0; k < 3; ++k) {
      int& n = number[t[k]];
      if (n < 0) {
        n = static_cast<int>(out.points.size());
        out.points.push_back(whole.points[t[k]]);
      }
      mapped[k] = n;
    }
    out.triangles.push_back(mapped);
  }
  return out;
}

// Joins the rim of the open surface to the ring, going around both by angle.
void sew(Surface& surface, size_t ring_size) {
  const auto loops = boundary_loops(surface.triangles, static_cast<int>(surface.points.size()));
  EFFIGY_CHECK(!loops.empty());
  Vec3d centre = Vec3d::Zero();
  for (size_t i = 0; i < ring_size; ++i)
    centre += surface.points[i] / static_cast<double>(ring_size);
  const auto angle = [&](int v) {
    const Vec3d q = surface.points[static_cast<size_t>(v)] - centre;
    return std::atan2(q.x(), q.z());
  };
  // Both by rising angle, starting nearest to -pi.
  const auto ordered = [&](std::vector<int> loop) {
    double turn = 0;
    for (size_t i = 0; i < loop.size(); ++i)
      turn += std::remainder(angle(loop[(i + 1) % loop.size()]) - angle(loop[i]), 2 * kPi);
    if (turn < 0) std::reverse(loop.begin(), loop.end());
    const auto first = std::min_element(loop.begin(), loop.end(),
                                        [&](int a, int b) { return angle(a) < angle(b); });
    std::rotate(loop.begin(), first, loop.end());
    return loop;
  };
  std::vector<int> ring(ring_size);
  for (size_t i = 0; i < ring_size; ++i) ring[i] = static_cast<int>(i);
  const std::vector<int> upper = ordered(ring), lower = ordered(loops[0]);
  const auto unrolled = [&](const std::vector<int>& loop, size_t i) {
    return i < loop.size() ? angle(loop[i]) : angle(loop[i - loop.size()]) + 2 * kPi;
  };
  size_t a = 0, b = 0;
  while (a < upper.size() || b < lower.size()) {
    const int u = upper[a % upper.size()], l = lower[b % lower.size()];
    const bool move_upper =
        b >= lower.size() || (a < upper.size() && unrolled(upper, a + 1) < unrolled(lower, b + 1));
    if (move_upper) {
      surface.triangles.emplace_back(u, l, upper[(a + 1) % upper.size()]);
      ++a;
    } else {
      surface.triangles.emplace_back(u, l, lower[(b + 1) % lower.size()]);
      ++b;
    }
  }
}

int part_at(const BodyForm& form, const Vec3d& p) {
  const BodyForm::Cover c = form.cover(p);
  if (c.hand > 0 && std::abs(p.x()) > form.joints().hand.x() - 60) return kHands;
  if (c.top > 0) return kTop;
  if (c.bottom > 0) return kBottom;
  return c.shoe > 0 ? kShoes : kSkin;
}

int head_part(const std::string& name) {
  if (name == "eye_left") return kEyeLeft;
  if (name == "eye_right") return kEyeRight;
  if (name == "teeth") return kTeeth;
  if (name == "hair") return kHair;
  return name == "mouth" ? kMouth : kFace;
}

// Texels a metre, relative.
std::vector<float> densities() {
  std::vector<float> d(kBodyParts, 1.0f);
  d[kFace] = 2.6f;
  d[kEyeLeft] = d[kEyeRight] = 2.6f;
  d[kTeeth] = 1.8f;
  d[kMouth] = 1.2f;
  d[kHair] = 1.5f;
  d[kHands] = 2.0f;
  d[kSkin] = 1.2f;
  d[kShoes] = 0.9f;
  return d;
}

}  // namespace

Vec3d head_offset(const BodyBuild& build) {
  // The neck ring lies 172 below the head's origin and 1413 above the floor of the mean body.
  const double k = build.stature;
  return {0, 890 * k * build.legs + (1413 - 890) * k + 172, 0};
}

NeckRing neck_ring(const Rig& head, const Vec3d& offset) {
  if (head.neck_ring.size() < 8) throw Error("The head has no open neck ring to join a body to.");
  NeckRing ring;
  const size_t n = head.neck_ring.size();
  for (size_t i = 0; i < n; ++i)
    ring.centre += ring_point(head, i, offset) / static_cast<double>(n);
  struct Polar {
    double first, radius, height;
    bool operator<(const Polar& other) const { return first < other.first; }
  };
  std::vector<Polar> polar;
  for (size_t i = 0; i < n; ++i) {
    const Vec3d p = ring_point(head, i, offset), q = p - ring.centre;
    polar.push_back({std::atan2(q.x(), q.z()), std::hypot(q.x(), q.z()), p.y()});
  }
  std::sort(polar.begin(), polar.end());
  constexpr int kSteps = 128;
  for (int s = 0; s < kSteps; ++s) {
    const double angle = std::remainder(2 * kPi * s / kSteps, 2 * kPi);
    size_t i = 0;
    while (i < n && polar[i].first < angle) ++i;
    auto before = polar[(i + n - 1) % n], after = polar[i % n];
    if (i == 0) before.first -= 2 * kPi;
    if (i == n) after.first += 2 * kPi;
    const double t = (angle - before.first) / std::max(after.first - before.first, 1e-9);
    ring.radius.push_back(mix(before.radius, after.radius, t));
    ring.height.push_back(mix(before.height, after.height, t));
  }
  return ring;
}

void raise_neck(Rig& head, const Vec3d& offset, const BodyForm& form) {
  constexpr double kClear = 10, kMost = 60, kFade = 90;
  const NeckRing& ring = form.ring();
  const size_t n = ring.radius.size();
  // How far above the ring the shoulders reach beside the neck, by angle.
  std::vector<double> lift(n, 0);
  for (size_t i = 0; i < n; ++i) {
    const double angle = 2 * kPi * static_cast<double>(i) / static_cast<double>(n);
    Vec3d p = ring.centre + (ring.radius[i] + 4) * Vec3d(std::sin(angle), 0, std::cos(angle));
    // Upwards, as the neck above leans over this place.
    for (p.y() -= kClear; lift[i] < kMost && form.distance(p) < 0; p.y() += 0.5) lift[i] += 0.5;
  }
  for (int pass = 0; pass < 12; ++pass) {
    const std::vector<double> before = lift;
    for (size_t i = 0; i < n; ++i)
      lift[i] = std::max(0.25 * (before[(i + 1) % n] + before[(i + n - 1) % n]) + 0.5 * before[i],
                         before[i] - 0.3);
  }
  NeckRing lifts = ring;
  lifts.height = lift;
  for (int v = 0; v < head.mesh.vertex_count(); ++v) {
    const Vec3d p = 1e3 * head.mesh.vertex(v).cast<double>() + offset;
    const double up = p.y() - ring.centre.y();
    if (up > kFade) continue;
    head.mesh.vertices[3 * static_cast<size_t>(v) + 1] +=
        static_cast<float>(1e-3 * lifts.height_at(p) * smooth_step(kFade, 0, up));
  }
}

BodyMesh build_body_mesh(const BodyForm& form, const Rig& head, const Vec3d& offset) {
  std::vector<Vec3d> ring;
  for (size_t i = 0; i < head.neck_ring.size(); ++i) ring.push_back(ring_point(head, i, offset));
  Surface surface = form_surface(form, ring);
  sew(surface, ring.size());
  RemeshOptions options;
  options.size = [&](const Vec3d& p) { return edge_size(form, p); };
  options.project = [&](const Vec3d& p) { return form.project(p); };
  options.fixed.assign(surface.points.size(), 0);
  std::fill_n(options.fixed.begin(), ring.size(), static_cast<char>(1));
  surface = remesh(surface, options);

  BodyMesh out;
  Mesh& mesh = out.mesh;
  mesh.parts = {"face",  "eye_left", "eye_right", "teeth", "mouth", "skin",
                "hands", "top",      "bottom",    "shoes", "hair"};
  out.head_vertices = head.mesh.vertex_count();
  out.head_triangles = head.mesh.triangle_count();
  for (int v = 0; v < out.head_vertices; ++v)
    for (int c = 0; c < 3; ++c)
      mesh.vertices.push_back(head.mesh.vertices[3 * static_cast<size_t>(v) + c] +
                              static_cast<float>(1e-3 * offset[c]));
  mesh.triangles = head.mesh.triangles;
  mesh.uvs = head.mesh.uvs;
  out.head_uvs = head.mesh.uvs;
  mesh.uv_triangles = head.mesh.uv_triangles;
  for (int f = 0; f < out.head_triangles; ++f)
    mesh.triangle_part.push_back(
        head_part(head.mesh.parts[static_cast<size_t>(head.mesh.triangle_part[f])]));

  // The body's points follow; the ring's are the head's own.
  std::vector<int> number(surface.points.size());
  for (size_t i = 0; i < surface.points.size(); ++i) {
    number[i] = i < ring.size() ? head.neck_ring[i] : mesh.vertex_count();
    if (i >= ring.size())
      for (int c = 0; c < 3; ++c)
        mesh.vertices.push_back(static_cast<float>(1e-3 * surface.points[i][c]));
  }
  std::vector<int> parts;
  for (const Vec3i& t : surface.triangles) {
    const Vec3d middle = (surface.points[t[0]] + surface.points[t[1]] + surface.points[t[2]]) / 3;
    parts.push_back(part_at(form, middle));
  }
  const ChartedSurface charts = unwrap_body(form, surface, parts);
  const int first_uv = static_cast<int>(mesh.uvs.size());
  for (const Vec2d& uv : charts.uvs) {
    mesh.uvs.push_back(uv.cast<float>());
    out.head_uvs.emplace_back(-1.0f, -1.0f);
  }
  for (size_t f = 0; f < surface.triangles.size(); ++f) {
    const Vec3i& t = surface.triangles[f];
    mesh.triangles.emplace_back(number[t[0]], number[t[1]], number[t[2]]);
    mesh.uv_triangles.push_back(charts.uv_triangles[f] + Vec3i::Constant(first_uv));
    mesh.triangle_part.push_back(parts[f]);
  }
  pack_atlas(mesh, {densities(), 256});
  check_mesh(mesh, "built-in body");
  return out;
}

}  // namespace effigy::people
