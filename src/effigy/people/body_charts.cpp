#include "effigy/people/body_charts.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <queue>

#include "effigy/base/threads.h"
#include "effigy/people/body_mesh.h"
#include "effigy/people/unwrap.h"

namespace effigy::people {
namespace {

enum Chart { kTrunk, kArm, kLeg, kShoe, kSole, kHand, kFinger };  // the thumb is kFinger

// Where a place of the hand is: on which finger beyond its root (-1: the palm), and on which side
// of the surface midway between palm and back.
struct HandPlace {
  int finger = -1;
  double side = 0;
};
HandPlace hand_place(const BodyForm& form, const Vec3d& p) {
  const BodyJoints& j = form.joints();
  double best = std::numeric_limits<double>::infinity();
  HandPlace out;
  const auto segment = [&](const Vec3d& a, const Vec3d& b, double slack, int finger, double root) {
    const Vec3d ab = b - a;
    const double t = std::clamp((p - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0);
    const Vec3d q = p - a - t * ab;
    if (q.norm() - slack >= best) return;
    best = q.norm() - slack;
    const Vec3d normal = j.palm_normal - ab.normalized() * ab.normalized().dot(j.palm_normal);
    out = {t > root ? finger : -1, q.dot(normal.normalized())};
  };
  for (int f = 0; f < 5; ++f) {
    const auto& finger = j.fingers[static_cast<size_t>(f)];
    segment(j.hand, finger[0], 4, -1, 0);
    // The webs reach to about half of the first bone.
    segment(finger[0], finger[1], 0, f, f == 0 ? 1 : 0.55);
    segment(finger[1], finger[2], 0, f, f == 0 ? 0.15 : -1);
    segment(finger[2], finger[3], 0, f, -1);
  }
  return out;
}

class Charter {
 public:
  Charter(const BodyForm& form, const Surface& surface, const std::vector<int>& parts)
      : form_(form), surface_(surface), parts_(parts), chart_(surface.triangles.size()) {
    find_neighbours();
    find_crotch();
  }

  ChartedSurface run() {
    for (size_t t = 0; t < chart_.size(); ++t) chart_[t] = chart_of(t);
    for (int round = 0; round < 4; ++round) smooth();
    for (int round = 0; round < 3; ++round) merge_small();
    flatten_changed();
    for (int round = 0; round < 12 && give_away_overlaps(round >= 3); ++round) {
      for (int pass = 0; pass < 2; ++pass) merge_small();
      flatten_changed();
    }
    return joined();
  }

 private:
  Vec3d middle(size_t t) const {
    const Vec3i& c = surface_.triangles[t];
    return (surface_.points[c[0]] + surface_.points[c[1]] + surface_.points[c[2]]) / 3;
  }

  void find_neighbours() {
    std::map<std::pair<int, int>, int> edge;
    neighbour_.assign(surface_.triangles.size(), Vec3i::Constant(-1));
    for (size_t t = 0; t < surface_.triangles.size(); ++t)
      for (int k = 0; k < 3; ++k) {
        const int a = surface_.triangles[t][k], b = surface_.triangles[t][(k + 1) % 3];
        edge[{a, b}] = static_cast<int>(3 * t) + k;
      }
    for (size_t t = 0; t < surface_.triangles.size(); ++t)
      for (int k = 0; k < 3; ++k) {
        const int a = surface_.triangles[t][k], b = surface_.triangles[t][(k + 1) % 3];
        const auto other = edge.find({b, a});
        if (other != edge.end()) neighbour_[t][k] = other->second / 3;
      }
  }

  void find_crotch() {
    const double hip = form_.joints().upper_leg.y();
    crotch_ = hip - 130;
    while (crotch_ < hip && form_.distance(Vec3d(0, crotch_, -6)) > 0) crotch_ += 1;
    crotch_ -= 16;
  }

  int chart_of(size_t t) const {
    const Vec3d p = middle(t), q(std::abs(p.x()), p.y(), p.z());
    const BodyJoints& j = form_.joints();
    const double k = form_.build().stature;
    const int side = p.x() >= 0 ? 0 : 1;
    const auto id = [&](Chart chart, bool front) {
      return 4 * static_cast<int>(chart) + 2 * (front ? 1 : 0) + side;
    };
    if (parts_[t] == kHands) {
      const HandPlace h = hand_place(form_, q);
      return h.finger < 0 ? id(kHand, h.side > 0)
                          : id(static_cast<Chart>(kFinger + h.finger), h.side > 0);
    }
    if (parts_[t] == kShoes) {
      const Vec3i& c = surface_.triangles[t];
      const Vec3d n = (surface_.points[c[1]] - surface_.points[c[0]])
                          .cross(surface_.points[c[2]] - surface_.points[c[0]])
                          .normalized();
      if (p.y() < 8 && n.y() < -0.7) return id(kSole, true);
      const Vec3d toe = j.toe_tip - j.foot;
      return id(kShoe, (q.x() - j.foot.x()) * toe.z() - (q.z() - j.foot.z()) * toe.x() > 0);
    }
    const Vec3d down = (j.lower_arm - j.upper_arm).normalized(), from = q - j.upper_arm;
    const double s = from.dot(down);
    if (s > 38 * k && (from - down * s).norm() < 140 * k) {
      const double arm = form_.along_arm(q), upper = (j.lower_arm - j.upper_arm).norm();
      const Vec3d fore = (j.hand - j.lower_arm).normalized();
      const double axis_z = arm < upper ? j.upper_arm.z() + s * down.z()
                                        : j.lower_arm.z() + (q - j.lower_arm).dot(fore) * fore.z();
      return id(kArm, q.z() > axis_z);
    }
    if (p.y() < crotch_) return id(kLeg, p.z() > leg_axis(p.y()));
    return 4 * kTrunk + (p.z() > trunk_axis(p.y()) ? 2 : 0);
  }
  double leg_axis(double y) const {
    const BodyJoints& j = form_.joints();
    const double t = (y - j.foot.y()) / (j.upper_leg.y() - j.foot.y());
    return j.foot.z() + t * (j.upper_leg.z() - j.foot.z()) - 3;
  }
  double trunk_axis(double y) const {
    // From the legs' middle to the shoulder line.
    const BodyJoints& j = form_.joints();
    const double t = std::clamp((y - crotch_) / (j.upper_arm.y() - crotch_), 0.0, 1.0);
    return leg_axis(crotch_) + t * (j.upper_arm.z() - leg_axis(crotch_));
  }

  void smooth() {
    std::vector<int> next = chart_;
    for (size_t t = 0; t < chart_.size(); ++t) {
      const Vec3i& n = neighbour_[t];
      for (int k = 0; k < 3; ++k) {
        const int a = n[k], b = n[(k + 1) % 3];
        if (a >= 0 && b >= 0 && chart_[a] == chart_[b] && chart_[a] != chart_[t] &&
            hand_of(chart_[a]) == hand_of(chart_[t]))
          next[t] = chart_[a];
      }
    }
    chart_ = std::move(next);
  }
  static bool hand_of(int chart) { return chart / 4 >= kHand; }

  // Pieces that are not the largest of their chart go to the neighbour they touch most.
  void merge_small() {
    std::vector<int> piece(chart_.size(), -1);
    std::vector<std::vector<int>> pieces;
    for (size_t t = 0; t < chart_.size(); ++t) {
      if (piece[t] >= 0) continue;
      const int id = static_cast<int>(pieces.size());
      pieces.emplace_back();
      std::queue<int> open;
      open.push(static_cast<int>(t));
      piece[t] = id;
      while (!open.empty()) {
        const int f = open.front();
        open.pop();
        pieces[static_cast<size_t>(id)].push_back(f);
        for (int k = 0; k < 3; ++k) {
          const int n = neighbour_[f][k];
          if (n >= 0 && piece[n] < 0 && chart_[n] == chart_[f]) {
            piece[n] = id;
            open.push(n);
          }
        }
      }
    }
    std::map<int, size_t> largest;
    for (size_t i = 0; i < pieces.size(); ++i) {
      const int c = chart_[pieces[i][0]];
      const auto found = largest.find(c);
      if (found == largest.end() || pieces[found->second].size() < pieces[i].size()) largest[c] = i;
    }
    const std::vector<int> before = chart_;
    for (size_t i = 0; i < pieces.size(); ++i) {
      const int c = before[pieces[i][0]];
      if (c >= kOwnChart || (largest[c] == i && pieces[i].size() > 30)) continue;
      std::map<int, int> touch;
      for (const int f : pieces[i])
        for (int k = 0; k < 3; ++k) {
          const int n = neighbour_[f][k];
          if (n >= 0 && before[n] != c && before[n] < kOwnChart) ++touch[before[n]];
        }
      int best = c, most = 0;
      for (const auto& [other, count] : touch)
        if (count > most) {
          best = other;
          most = count;
        }
      for (const int f : pieces[i]) chart_[f] = best;
    }
  }

  // Hands triangles at a chart's rim that overlap others over to the chart next door; `cut_out`:
  // makes charts of their own of them. False when there are none.
  bool give_away_overlaps(bool cut_out) {
    std::vector<char> bad(chart_.size(), 0);
    bool any = false;
    for (const auto& [chart, sheet] : sheets_)
      for (const size_t t : sheet.overlapping) {
        bad[t] = 1;
        any = true;
      }
    if (!any) return false;
    if (cut_out) {
      for (size_t t = 0; t < chart_.size(); ++t)
        if (bad[t]) chart_[t] = kOwnChart + static_cast<int>(t);
      return true;
    }
    // With those around them, as the rim may be a triangle away.
    std::vector<char> touched(surface_.points.size(), 0);
    for (size_t t = 0; t < chart_.size(); ++t)
      if (bad[t])
        for (int k = 0; k < 3; ++k) touched[surface_.triangles[t][k]] = 1;
    const std::vector<int> before = chart_;
    for (size_t t = 0; t < chart_.size(); ++t) {
      const Vec3i& c = surface_.triangles[t];
      if (!touched[c[0]] && !touched[c[1]] && !touched[c[2]]) continue;
      for (int k = 0; k < 3; ++k) {
        const int n = neighbour_[t][k];
        if (n >= 0 && before[n] != before[t] && before[n] < kOwnChart && before[t] < kOwnChart)
          chart_[t] = before[n];
      }
    }
    return true;
  }

  // A chart laid flat, millimetres.
  struct Sheet {
    std::vector<size_t> members;  // triangles of the surface
    std::vector<Vec2d> uvs;
    std::vector<Vec3i> triangles;     // per member, indices into uvs
    std::vector<size_t> overlapping;  // members that run clockwise or share a sample point
  };

  static void find_overlapping(Sheet& sheet) {
    constexpr int kSide = 1024;
    Vec2d low = Vec2d::Constant(1e300), high = -low;
    for (const Vec2d& uv : sheet.uvs) {
      low = low.cwiseMin(uv);
      high = high.cwiseMax(uv);
    }
    const double scale = kSide / ((high - low).maxCoeff() * 1.02);
    const int width = std::min(kSide, static_cast<int>(scale * (high - low).x()) + 1);
    std::vector<int> owner(static_cast<size_t>(width) * kSide, -1);
    std::vector<char> bad(sheet.triangles.size(), 0);
    const auto cross = [](const Vec2d& a, const Vec2d& b) { return a.x() * b.y() - a.y() * b.x(); };
    for (size_t t = 0; t < sheet.triangles.size(); ++t) {
      Vec2d q[3];
      for (int k = 0; k < 3; ++k) q[k] = scale * (sheet.uvs[sheet.triangles[t][k]] - low);
      if (cross(q[1] - q[0], q[2] - q[0]) <= 1e-9) bad[t] = 1;
      const Vec2d first = q[0].cwiseMin(q[1]).cwiseMin(q[2]),
                  last = q[0].cwiseMax(q[1]).cwiseMax(q[2]);
      for (int y = static_cast<int>(first.y()); y <= static_cast<int>(last.y()) && y < kSide; ++y)
        for (int x = static_cast<int>(first.x()); x <= static_cast<int>(last.x()) && x < width;
             ++x) {
          const Vec2d p(x + 0.5, y + 0.5);
          bool inside = true;
          for (int k = 0; k < 3; ++k)
            inside = inside && cross(q[(k + 1) % 3] - q[k], p - q[k]) > 1e-9;
          if (!inside) continue;
          int& o = owner[static_cast<size_t>(y) * static_cast<size_t>(width) + x];
          if (o >= 0) bad[static_cast<size_t>(o)] = bad[t] = 1;
          o = static_cast<int>(t);
        }
    }
    for (size_t t = 0; t < bad.size(); ++t)
      if (bad[t]) sheet.overlapping.push_back(sheet.members[t]);
  }

  void lay_flat(Sheet& sheet) const {
    std::map<int, int> local;
    std::vector<Vec3d> points;
    for (const size_t t : sheet.members) {
      Vec3i mapped;
      for (int k = 0; k < 3; ++k) {
        const auto [found, fresh] =
            local.try_emplace(surface_.triangles[t][k], static_cast<int>(points.size()));
        if (fresh) points.push_back(surface_.points[surface_.triangles[t][k]]);
        mapped[k] = found->second;
      }
      sheet.triangles.push_back(mapped);
    }
    sheet.uvs = upright(points, flatten(points, sheet.triangles));
    find_overlapping(sheet);
  }

  // Lays out the charts that have changed.
  void flatten_changed() {
    std::map<int, Sheet> next;
    for (size_t t = 0; t < chart_.size(); ++t) next[chart_[t]].members.push_back(t);
    std::vector<Sheet*> changed;
    for (auto& [chart, sheet] : next) {
      const auto before = sheets_.find(chart);
      if (before != sheets_.end() && before->second.members == sheet.members)
        sheet = std::move(before->second);
      else
        changed.push_back(&sheet);
    }
    parallel_for(changed.size(), 1, [&](size_t begin, size_t end, int) {
      for (size_t i = begin; i < end; ++i) lay_flat(*changed[i]);
    });
    sheets_ = std::move(next);
  }

  ChartedSurface joined() const {
    ChartedSurface out;
    out.uv_triangles.resize(chart_.size());
    for (const auto& [chart, sheet] : sheets_) {
      const int first = static_cast<int>(out.uvs.size());
      out.uvs.insert(out.uvs.end(), sheet.uvs.begin(), sheet.uvs.end());
      for (size_t i = 0; i < sheet.members.size(); ++i)
        out.uv_triangles[sheet.members[i]] = sheet.triangles[i] + Vec3i::Constant(first);
    }
    return out;
  }

  // Turned so that the chart's longer side runs along v.
  static std::vector<Vec2d> upright(const std::vector<Vec3d>& points, std::vector<Vec2d> uv) {
    Vec2d mean = Vec2d::Zero();
    double mean_y = 0;
    for (size_t i = 0; i < uv.size(); ++i) {
      mean += uv[i] / static_cast<double>(uv.size());
      mean_y += points[i].y() / static_cast<double>(uv.size());
    }
    // Up in space is up in the picture, as well as it can be.
    Vec2d up = Vec2d::Zero();
    for (size_t i = 0; i < uv.size(); ++i) up += (points[i].y() - mean_y) * (uv[i] - mean);
    if (up.norm() < 1e-9) up = Vec2d(0, 1);
    up.normalize();
    for (Vec2d& q : uv) {
      const Vec2d d = q - mean;
      q = Vec2d(d.x() * up.y() - d.y() * up.x(), d.dot(up));
    }
    return uv;
  }

  const BodyForm& form_;
  const Surface& surface_;
  const std::vector<int>& parts_;
  static constexpr int kOwnChart = 1000;  // and above: a single triangle
  std::vector<int> chart_;
  std::vector<Vec3i> neighbour_;
  std::map<int, Sheet> sheets_;
  double crotch_ = 0;
};

}  // namespace

ChartedSurface unwrap_body(const BodyForm& form, const Surface& surface,
                           const std::vector<int>& parts) {
  return Charter(form, surface, parts).run();
}

}  // namespace effigy::people
