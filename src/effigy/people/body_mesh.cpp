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

// Gives sheets that touch along an edge or in a point their own points, so that every edge belongs
// to two triangles: at an edge of four, those that face the same way most belong together.
void separate_sheets(Surface& surface) {
  std::map<std::pair<int, int>, std::vector<int>> corners;  // 3 triangle + k of each directed edge
  auto& triangles = surface.triangles;
  for (size_t t = 0; t < triangles.size(); ++t)
    for (int k = 0; k < 3; ++k)
      corners[{triangles[t][k], triangles[t][(k + 1) % 3]}].push_back(static_cast<int>(3 * t) + k);
  const auto normal = [&](int corner) {
    const Vec3i& c = triangles[static_cast<size_t>(corner / 3)];
    return (surface.points[c[1]] - surface.points[c[0]])
        .cross(surface.points[c[2]] - surface.points[c[0]])
        .normalized();
  };
  std::vector<int> twin(3 * triangles.size(), -1);
  for (auto& [edge, list] : corners) {
    if (edge.first > edge.second) continue;
    auto other = corners.find({edge.second, edge.first});
    if (other == corners.end()) continue;
    for (const int c : list) {
      int best = -1;
      for (const int d : other->second)
        if (twin[d] < 0 && (best < 0 || normal(c).dot(normal(d)) > normal(c).dot(normal(best))))
          best = d;
      if (best < 0) continue;
      twin[c] = best;
      twin[best] = c;
    }
  }
  // One point for each fan of triangles.
  std::vector<char> used(surface.points.size(), 0), done(3 * triangles.size(), 0);
  const std::vector<Vec3i> before = triangles;
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
      triangles[static_cast<size_t>(c / 3)][c % 3] = number;
      const int ahead = twin[c];  // its corner of the edge from v: the twin starts at the far end
      if (ahead >= 0) open.push_back(ahead / 3 * 3 + (ahead % 3 + 1) % 3);
      const int behind = twin[c / 3 * 3 + (c % 3 + 2) % 3];
      if (behind >= 0) open.push_back(behind);
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
  const double cut = ring[0].y() - 8;
  Surface whole = surface_nets([&](const Vec3d& p) { return form.distance(p); },
                               Vec3d(-reach, -25, -230), Vec3d(reach, cut + 30, 240), kCell);
  separate_sheets(whole);
  // Without what lies above the cut, and without crumbs.
  std::vector<Vec3i> kept;
  for (const Vec3i& t : whole.triangles)
    if (std::max({whole.points[t[0]].y(), whole.points[t[1]].y(), whole.points[t[2]].y()}) < cut)
      kept.push_back(t);
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
  std::vector<std::pair<double, double>> polar;
  for (size_t i = 0; i < n; ++i) {
    const Vec3d q = ring_point(head, i, offset) - ring.centre;
    polar.emplace_back(std::atan2(q.x(), q.z()), std::hypot(q.x(), q.z()));
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
    ring.radius.push_back(mix(before.second, after.second, t));
  }
  return ring;
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
