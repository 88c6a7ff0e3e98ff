#include "effigy/people/unwrap.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/geometry/topology.h"

namespace effigy::people {
namespace {

using Sparse = Eigen::SparseMatrix<double>;
using Triplet = Eigen::Triplet<double>;

// A triangle laid into the plane: corner 0 at the origin, corner 1 on the x axis.
std::array<Vec2d, 3> laid_flat(const std::vector<Vec3d>& p, const Vec3i& t) {
  const Vec3d a = p[t[1]] - p[t[0]], b = p[t[2]] - p[t[0]];
  const double length = std::max(a.norm(), 1e-9);
  const double along = a.dot(b) / length;
  const double height = a.cross(b).norm() / length;
  return {Vec2d(0, 0), Vec2d(length, 0), Vec2d(along, std::max(height, 1e-9))};
}

int turned_over(const std::vector<Vec2d>& uv, const std::vector<Vec3i>& triangles) {
  int count = 0;
  for (const Vec3i& t : triangles) {
    const Vec2d a = uv[t[1]] - uv[t[0]], b = uv[t[2]] - uv[t[0]];
    count += a.x() * b.y() - a.y() * b.x() <= 0;
  }
  return count;
}

std::vector<Vec2d> conformal(const std::vector<Vec3d>& points,
                             const std::vector<Vec3i>& triangles) {
  const int n = static_cast<int>(points.size());
  // The pins: far apart.
  const auto farthest = [&](const Vec3d& from) {
    int best = 0;
    for (int i = 1; i < n; ++i)
      if ((points[i] - from).squaredNorm() > (points[best] - from).squaredNorm()) best = i;
    return best;
  };
  const int p0 = farthest(points[farthest(points[0])]), p1 = farthest(points[p0]);
  std::vector<int> column(points.size());
  for (int i = 0, next = 0; i < n; ++i) column[i] = i == p0 || i == p1 ? -1 : next++;
  const int unknowns = 2 * (n - 2), half = n - 2;
  Eigen::VectorXd rhs = Eigen::VectorXd::Zero(2 * static_cast<Eigen::Index>(triangles.size()));
  std::vector<Triplet> entries;
  const Vec2d pin[2] = {Vec2d(0, 0), Vec2d((points[p1] - points[p0]).norm(), 0)};
  for (size_t t = 0; t < triangles.size(); ++t) {
    const auto q = laid_flat(points, triangles[t]);
    const double area2 = q[1].x() * q[2].y(), scale = 1 / std::sqrt(area2);
    for (int k = 0; k < 3; ++k) {
      const Vec2d w = scale * (q[(k + 2) % 3] - q[(k + 1) % 3]);
      const int v = triangles[t][k], row = static_cast<int>(2 * t);
      // Real and imaginary part of sum_k w_k u_k = 0.
      if (column[v] < 0) {
        const Vec2d u = pin[v == p1];
        rhs[row] -= w.x() * u.x() - w.y() * u.y();
        rhs[row + 1] -= w.y() * u.x() + w.x() * u.y();
      } else {
        entries.emplace_back(row, column[v], w.x());
        entries.emplace_back(row, half + column[v], -w.y());
        entries.emplace_back(row + 1, column[v], w.y());
        entries.emplace_back(row + 1, half + column[v], w.x());
      }
    }
  }
  Sparse a(2 * static_cast<Eigen::Index>(triangles.size()), unknowns);
  a.setFromTriplets(entries.begin(), entries.end());
  const Sparse normal = a.transpose() * a;
  Eigen::SimplicialLDLT<Sparse> solver(normal);
  const Eigen::VectorXd x = solver.solve(Eigen::VectorXd(a.transpose() * rhs));
  std::vector<Vec2d> uv(points.size());
  for (int i = 0; i < n; ++i)
    uv[i] = column[i] < 0 ? pin[i == p1] : Vec2d(x[column[i]], x[half + column[i]]);
  return uv;
}

std::vector<double> cotangents(const std::vector<Vec3d>& points,
                               const std::vector<Vec3i>& triangles) {
  std::vector<double> out;
  for (const Vec3i& t : triangles)
    for (int k = 0; k < 3; ++k) {
      const Vec3d a = points[t[(k + 1) % 3]] - points[t[k]],
                  b = points[t[(k + 2) % 3]] - points[t[k]];
      const double cot = a.dot(b) / std::max(a.cross(b).norm(), 1e-9);
      out.push_back(std::clamp(cot, 0.02, 20.0));  // opposite edge (k+1, k+2)
    }
  return out;
}

// Local rotations, then one global solve, a few times.
std::vector<Vec2d> rigid(const std::vector<Vec3d>& points, const std::vector<Vec3i>& triangles,
                         std::vector<Vec2d> uv) {
  const auto n = static_cast<Eigen::Index>(points.size());
  const std::vector<double> cot = cotangents(points, triangles);
  std::vector<Triplet> entries;
  for (size_t t = 0; t < triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      const int i = triangles[t][(k + 1) % 3], j = triangles[t][(k + 2) % 3];
      const double w = cot[3 * t + static_cast<size_t>(k)];
      entries.emplace_back(i, i, w);
      entries.emplace_back(j, j, w);
      entries.emplace_back(i, j, -w);
      entries.emplace_back(j, i, -w);
    }
  entries.emplace_back(0, 0, 1e-6);
  Sparse laplacian(n, n);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SimplicialLDLT<Sparse> solver(laplacian);
  for (int round = 0; round < 30; ++round) {
    Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(n, 2);
    for (size_t t = 0; t < triangles.size(); ++t) {
      const auto q = laid_flat(points, triangles[t]);
      Eigen::Matrix2d s = Eigen::Matrix2d::Zero();
      for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        s += cot[3 * t + static_cast<size_t>(k)] * (uv[triangles[t][i]] - uv[triangles[t][j]]) *
             (q[i] - q[j]).transpose();
      }
      // The rotation nearest to s.
      const Vec2d r = Vec2d(s(0, 0) + s(1, 1), s(1, 0) - s(0, 1)).normalized();
      Eigen::Matrix2d rotation;
      rotation << r.x(), -r.y(), r.y(), r.x();
      for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const Vec2d d = cot[3 * t + static_cast<size_t>(k)] * (rotation * (q[i] - q[j]));
        rhs.row(triangles[t][i]) += d;
        rhs.row(triangles[t][j]) -= d;
      }
    }
    const Eigen::MatrixXd x = solver.solve(rhs);
    // As far towards the solution as no triangle turns over.
    std::vector<Vec2d> next(points.size());
    double step = 1;
    for (; step > 0.01; step *= 0.5) {
      for (Eigen::Index i = 0; i < n; ++i) {
        const size_t v = static_cast<size_t>(i);
        next[v] = uv[v] + step * (Vec2d(x.row(i)) - uv[v]);
      }
      if (turned_over(next, triangles) == 0) break;
    }
    if (step <= 0.01) break;
    uv = std::move(next);
  }
  return uv;
}

std::vector<Vec2d> convex(const std::vector<Vec3d>& points, const std::vector<Vec3i>& triangles) {
  const auto n = static_cast<Eigen::Index>(points.size());
  const auto loops = boundary_loops(triangles, static_cast<int>(points.size()));
  EFFIGY_CHECK(!loops.empty());
  const std::vector<int>& rim = loops[0];
  double length = 0;
  std::vector<double> at;
  for (size_t i = 0; i < rim.size(); ++i) {
    at.push_back(length);
    length += (points[rim[(i + 1) % rim.size()]] - points[rim[i]]).norm();
  }
  std::vector<char> on_rim(points.size(), 0);
  std::vector<Vec2d> uv(points.size(), Vec2d::Zero());
  for (size_t i = 0; i < rim.size(); ++i) {
    const double angle = 2 * std::numbers::pi * at[i] / length;
    on_rim[rim[i]] = 1;
    uv[rim[i]] = length / (2 * std::numbers::pi) * Vec2d(std::cos(angle), std::sin(angle));
  }
  const std::vector<double> cot = cotangents(points, triangles);
  std::vector<Triplet> entries;
  Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(n, 2);
  for (Eigen::Index i = 0; i < n; ++i)
    if (on_rim[static_cast<size_t>(i)]) {
      entries.emplace_back(i, i, 1.0);
      rhs.row(i) = uv[static_cast<size_t>(i)];
    }
  for (size_t t = 0; t < triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      const int i = triangles[t][(k + 1) % 3], j = triangles[t][(k + 2) % 3];
      const double w = cot[3 * t + static_cast<size_t>(k)];
      for (const auto& [a, b] : {std::pair{i, j}, {j, i}}) {
        if (on_rim[a]) continue;
        entries.emplace_back(a, a, w);
        if (on_rim[b])
          rhs.row(a) += w * uv[b];
        else
          entries.emplace_back(a, b, -w);
      }
    }
  Sparse laplacian(n, n);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SimplicialLDLT<Sparse> solver(laplacian);
  const Eigen::MatrixXd x = solver.solve(rhs);
  for (Eigen::Index i = 0; i < n; ++i) uv[static_cast<size_t>(i)] = x.row(i);
  return uv;
}

}  // namespace

std::vector<Vec2d> flatten(const std::vector<Vec3d>& points, const std::vector<Vec3i>& triangles) {
  EFFIGY_CHECK(points.size() >= 3);
  std::vector<Vec2d> uv = conformal(points, triangles);
  if (turned_over(uv, triangles) > 0) uv = convex(points, triangles);
  return rigid(points, triangles, std::move(uv));
}

}  // namespace effigy::people
