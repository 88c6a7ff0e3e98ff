#include "effigy/people/head_landmarks.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/people/head_domain.h"
#include "effigy/people/head_network_points.h"
#include "effigy/people/head_shape.h"

namespace effigy::people {
namespace {

// Barycentric weights of the point of triangle abc nearest to p (Ericson 2005, 5.1.5).
Vec3d nearest_weights(const Vec3d& p, const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  const Vec3d ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap), d3 = ab.dot(bp), d4 = ac.dot(bp);
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const double vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return {1 - d1 / (d1 - d3), d1 / (d1 - d3), 0};
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return {1 - d2 / (d2 - d6), 0, d2 / (d2 - d6)};
  const double e = d4 - d3, f = d5 - d6;
  if (va <= 0 && e >= 0 && f >= 0) return {0, 1 - e / (e + f), e / (e + f)};
  const double sum = va + vb + vc;
  return {va / sum, vb / sum, vc / sum};
}

// Of a skin triangle, millimetres: what at_point may skip.
constexpr double kLongestEdge = 40;

class Embedder {
 public:
  explicit Embedder(const HeadMesh& head) : head_(head) {}

  // The skin point nearest to p, millimetres.
  void at_point(int index, const Vec3d& p) {
    double best = 1e30;
    int triangle = -1;
    Vec3d weights = Vec3d::Zero();
    for (int f = 0; f < head_.mesh.triangle_count(); ++f) {
      if (head_.mesh.triangle_part[f] != 0) continue;
      const Vec3i& t = head_.mesh.triangles[f];
      const Vec3d &a = head_.vertices[t[0]].p, &b = head_.vertices[t[1]].p,
                  &c = head_.vertices[t[2]].p;
      const double reach = std::sqrt(best) + kLongestEdge;
      if ((a - p).squaredNorm() > reach * reach) continue;
      const Vec3d w = nearest_weights(p, a, b, c);
      const double distance = (w[0] * a + w[1] * b + w[2] * c - p).squaredNorm();
      if (distance < best) {
        best = distance;
        triangle = f;
        weights = w;
      }
    }
    add(index, triangle, weights);
  }

  void at_ring(int index, Region region, int ring, int place, int side) {
    const int vertex = head_.find(region, ring, place, side);
    for (int f = 0; f < head_.mesh.triangle_count(); ++f)
      for (int k = 0; k < 3; ++k)
        if (head_.mesh.triangles[f][k] == vertex) {
          add(index, f, Vec3d::Unit(k));
          return;
        }
  }

  // Between two neighbours of a ring: place may be fractional.
  void on_ring(int index, Region region, int ring, double place, int side) {
    const int from = std::min(static_cast<int>(place), 2 * kLipCorner - 1);
    const double t = place - from;
    const int a = head_.find(region, ring, from, side),
              b = head_.find(region, ring, from + 1, side);
    for (int f = 0; f < head_.mesh.triangle_count(); ++f) {
      Vec3d weights = Vec3d::Zero();
      int found = 0;
      for (int k = 0; k < 3; ++k) {
        const int v = head_.mesh.triangles[f][k];
        if (v == a) weights[k] = 1 - t;
        if (v == b) weights[k] = t;
        found += v == a || v == b ? 1 : 0;
      }
      if (found < 2) continue;
      add(index, f, weights);
      return;
    }
  }

  LandmarkEmbedding finish() {
    std::sort(found_.begin(), found_.end(),
              [](const Found& a, const Found& b) { return a.index < b.index; });
    LandmarkEmbedding out;
    for (const Found& f : found_) {
      out.index.push_back(f.index);
      out.triangle.push_back(f.triangle);
      out.barycentric.push_back(f.weights.cast<float>());
    }
    return out;
  }

 private:
  struct Found {
    int index, triangle;
    Vec3d weights;
  };
  void add(int index, int triangle, const Vec3d& weights) {
    found_.push_back({index, triangle, weights});
  }
  const HeadMesh& head_;
  std::vector<Found> found_;
};

Vec3d front(double x, double y) {
  return march_head({x, y, 160}, {0, 0, -1}, 160);
}

// Near the skin, chin to the left ear.
constexpr std::array<std::array<double, 3>, 9> kJaw = {{{0, -116, 82},
                                                        {17, -112, 74},
                                                        {33, -103, 58},
                                                        {44, -90, 40},
                                                        {52, -75, 26},
                                                        {58, -58, 18},
                                                        {63, -40, 14},
                                                        {67, -22, 13},
                                                        {70, -5, 13}}};
// Upper rim of the brow, in the places that iBUG's mean face, MediaPipe's canonical face and
// ICT-FaceKit agree on when their outer eye corners are brought onto ours.
constexpr std::array<std::array<double, 2>, 5> kBrow = {
    {{12.5, 20.5}, {26, 24.5}, {39.5, 25.5}, {51, 22.5}, {59, 15.5}}};

}  // namespace

LandmarkEmbedding multipie_landmarks(const HeadMesh& head) {
  Embedder put(head);
  auto mirrored = [](const Vec3d& p) { return Vec3d(-p.x(), p.y(), p.z()); };
  for (int i = 0; i <= 8; ++i) {
    const Vec2d at = domain_of({kJaw[i][0], kJaw[i][1], kJaw[i][2]});
    const Vec3d p = point_at(at.x(), at.y());
    put.at_point(8 + i, p);
    if (i > 0) put.at_point(8 - i, mirrored(p));
  }
  for (int i = 0; i < 5; ++i) {
    const Vec3d p = front(kBrow[i][0], kBrow[i][1]);
    put.at_point(22 + i, p);
    put.at_point(21 - i, mirrored(p));
  }
  for (int i = 0; i < 4; ++i) put.at_point(27 + i, front(0, 3.0 - 14.0 * i));
  // Below the nose: where columella and wings meet the lip.
  put.at_point(33, front(0, -56));
  const Vec3d nostril(6.4, -52, 101), wing(14.5, -50.5, 95.5);
  put.at_point(34, nostril);
  put.at_point(32, mirrored(nostril));
  put.at_point(35, wing);
  put.at_point(31, mirrored(wing));
  // Lids: outer corner, upper, inner corner, lower (right eye); inner corner first (left eye).
  const std::array<int, 6> right_eye = {12, 8, 5, 0, 19, 16}, left_eye = {0, 5, 8, 12, 16, 19};
  for (int i = 0; i < 6; ++i) {
    put.at_ring(36 + i, Region::kEyeRing, 0, right_eye[i], -1);
    put.at_ring(42 + i, Region::kEyeRing, 0, left_eye[i], 1);
  }
  // Lips: {landmark, ring, place, side}.
  static constexpr std::array<std::array<int, 4>, 16> kLips = {{{48, 0, 7, -1},
                                                                {49, 2, 3, -1},
                                                                {50, 2, 1, -1},
                                                                {51, 2, 0, 1},
                                                                {52, 2, 1, 1},
                                                                {53, 2, 3, 1},
                                                                {54, 0, 7, 1},
                                                                {57, 2, 14, 1},
                                                                {60, 0, 7, -1},
                                                                {61, 0, 2, -1},
                                                                {62, 0, 0, 1},
                                                                {63, 0, 2, 1},
                                                                {64, 0, 7, 1},
                                                                {65, 0, 12, 1},
                                                                {66, 0, 14, 1},
                                                                {67, 0, 12, -1}}};
  for (const auto& lip : kLips) put.at_ring(lip[0], Region::kMouthRing, lip[1], lip[2], lip[3]);
  for (int i = 0; i < 2; ++i) {
    put.on_ring(55 + i, Region::kMouthRing, 2, i == 0 ? 10.5 : 12.5, 1);
    put.on_ring(59 - i, Region::kMouthRing, 2, i == 0 ? 10.5 : 12.5, -1);
  }
  return put.finish();
}

LandmarkEmbedding network_landmarks(const HeadMesh& head) {
  Embedder put(head);
  // The inner rims of the lips lie on each other at rest, so they go by the ring: from the corner
  // on the subject's right over the middle to the left, above and below.
  static constexpr std::array<std::array<int, 11>, 2> kInner = {
      {{78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308},
       {78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308}}};
  std::array<bool, 468> done{};
  for (int lip = 0; lip < 2; ++lip)
    for (int k = lip; k <= 10 - lip; ++k) {
      const double from_corner = kLipCorner * (k <= 5 ? k : 10 - k) / 5.0;
      const double place = kLipCorner + (lip == 0 ? -from_corner : from_corner);
      const auto index =
          static_cast<size_t>(kInner[static_cast<size_t>(lip)][static_cast<size_t>(k)]);
      put.on_ring(static_cast<int>(index), Region::kMouthRing, 0, place, k <= 5 ? -1 : 1);
      done[index] = true;
    }
  for (size_t i = 0; i < kNetworkPoints.size(); ++i) {
    const auto& p = kNetworkPoints[i];
    if (!done[i]) put.at_point(static_cast<int>(i), Vec3d(p[0], p[1], p[2]));
  }
  return put.finish();
}

}  // namespace effigy::people
