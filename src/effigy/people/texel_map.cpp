#include "effigy/people/texel_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace effigy::people {

TexelMap map_texels(const Mesh& mesh, int size) {
  TexelMap map;
  map.size = size;
  const size_t pixels = static_cast<size_t>(size) * static_cast<size_t>(size);
  map.triangle.assign(pixels, -1);
  map.barycentric.assign(pixels, Vec3f::Zero());
  std::vector<float> outside(pixels, 1e9f);  // texels beyond the triangle's edge
  for (int f = 0; f < mesh.triangle_count(); ++f) {
    std::array<Vec2f, 3> q;
    for (int k = 0; k < 3; ++k) {
      const Vec2f& uv = mesh.uvs[mesh.uv_triangles[f][k]];
      q[k] = Vec2f(uv.x() * size, (1 - uv.y()) * size);
    }
    const Vec2f e1 = q[1] - q[0], e2 = q[2] - q[0];
    const float area = e1.x() * e2.y() - e1.y() * e2.x();
    if (std::abs(area) < 1e-9f) continue;
    const auto [x0, x1] = std::minmax({q[0].x(), q[1].x(), q[2].x()});
    const auto [y0, y1] = std::minmax({q[0].y(), q[1].y(), q[2].y()});
    for (int y = std::max(0, static_cast<int>(y0 - 1));
         y <= std::min(size - 1, static_cast<int>(y1 + 1)); ++y)
      for (int x = std::max(0, static_cast<int>(x0 - 1));
           x <= std::min(size - 1, static_cast<int>(x1 + 1)); ++x) {
        const Vec2f p(static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
        Vec3f w;
        float beyond = 0;
        for (int k = 0; k < 3; ++k) {
          const Vec2f a = q[(k + 1) % 3] - p, b = q[(k + 2) % 3] - p;
          const float part = a.x() * b.y() - a.y() * b.x();
          w[k] = part / area;
          const float edge = (q[(k + 2) % 3] - q[(k + 1) % 3]).norm();
          if (w[k] < 0) beyond = std::max(beyond, std::abs(part) / std::max(edge, 1e-6f));
        }
        const size_t i = map.at(x, y);
        if (beyond > 0.75f || beyond >= outside[i]) continue;
        outside[i] = beyond;
        map.triangle[i] = f;
        w = w.cwiseMax(0.0f);
        map.barycentric[i] = w / w.sum();
      }
  }
  return map;
}

std::vector<int> nearest_shown(const TexelMap& map) {
  const int size = map.size;
  std::vector<int> from(map.triangle.size(), -1), front;
  for (size_t i = 0; i < from.size(); ++i)
    if (map.triangle[i] >= 0) {
      from[i] = static_cast<int>(i);
      front.push_back(static_cast<int>(i));
    }
  while (!front.empty()) {
    std::vector<int> next;
    for (const int i : front) {
      const int x = i % size, y = i / size;
      for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
        const int nx = x + dx, ny = y + dy;
        if (nx < 0 || ny < 0 || nx >= size || ny >= size) continue;
        const size_t n = map.at(nx, ny);
        if (from[n] >= 0) continue;
        from[n] = from[static_cast<size_t>(i)];
        next.push_back(static_cast<int>(n));
      }
    }
    front = std::move(next);
  }
  return from;
}

}  // namespace effigy::people
