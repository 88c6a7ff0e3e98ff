#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/mesh.h"

namespace effigy {
namespace {

// Range of texel indices whose centres may lie in [low, high] (in texels), clipped to the image.
std::pair<int, int> texel_range(double low, double high, int size) {
  const double first = std::clamp(std::ceil(low - 0.5 - 1e-6), 0.0, static_cast<double>(size));
  const double last = std::clamp(std::floor(high - 0.5 + 1e-6), -1.0, size - 1.0);
  return {static_cast<int>(first), static_cast<int>(last)};
}

// Calls visit(texel, b1, b2) for the texels whose centres are inside or on the edge of the triangle
// (texel coordinates, y down), with the barycentric weights of its second and third corner.
template <typename Visit>
void visit_texels(const std::array<Vec2d, 3>& p, int size, Visit&& visit) {
  const Vec2d e1 = p[1] - p[0], e2 = p[2] - p[0];
  const double twice_area = e1.x() * e2.y() - e1.y() * e2.x();
  if (!(std::abs(twice_area) > 1e-12)) return;
  const auto [x0, x1] = texel_range(std::min({p[0].x(), p[1].x(), p[2].x()}),
                                    std::max({p[0].x(), p[1].x(), p[2].x()}), size);
  const auto [y0, y1] = texel_range(std::min({p[0].y(), p[1].y(), p[2].y()}),
                                    std::max({p[0].y(), p[1].y(), p[2].y()}), size);
  constexpr double kEdge = -1e-9;  // texel centres exactly on an edge count as inside
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) {
      const Vec2d d = Vec2d(x + 0.5, y + 0.5) - p[0];
      const double b1 = (d.x() * e2.y() - d.y() * e2.x()) / twice_area;
      const double b2 = (e1.x() * d.y() - e1.y() * d.x()) / twice_area;
      if (b1 >= kEdge && b2 >= kEdge && b1 + b2 <= 1 - kEdge)
        visit(static_cast<size_t>(y) * static_cast<size_t>(size) + static_cast<size_t>(x), b1, b2);
    }
}

// Calls visit(triangle, texel, b1, b2) for all triangles.
template <typename Visit>
void visit_mesh_texels(const Mesh& mesh, int size, Visit&& visit) {
  for (size_t t = 0; t < mesh.uv_triangles.size(); ++t) {
    std::array<Vec2d, 3> p;
    for (int corner = 0; corner < 3; ++corner) {
      const Vec2d uv = mesh.uvs[static_cast<size_t>(mesh.uv_triangles[t][corner])].cast<double>();
      p[static_cast<size_t>(corner)] = Vec2d(uv.x() * size, (1 - uv.y()) * size);
    }
    visit_texels(p, size, [&](size_t texel, double b1, double b2) { visit(t, texel, b1, b2); });
  }
}

// Maximum over a (2 r + 1)-long window along a line of `count` texels, `stride` apart.
void dilate_line(const uint8_t* in, uint8_t* out, int count, size_t stride, int radius) {
  int next = -1;  // last set texel at or before i + radius
  int scanned = 0;
  for (int i = 0; i < count; ++i) {
    for (; scanned < count && scanned <= i + radius; ++scanned)
      if (in[static_cast<size_t>(scanned) * stride]) next = scanned;
    out[static_cast<size_t>(i) * stride] = next >= 0 && next >= i - radius ? 1 : 0;
  }
}

}  // namespace

std::vector<uint8_t> uv_coverage(const Mesh& mesh, int size, int dilate) {
  EFFIGY_CHECK(size > 0 && dilate >= 0);
  const size_t n = static_cast<size_t>(size);
  std::vector<uint8_t> mask(n * n, 0);
  visit_mesh_texels(mesh, size, [&](size_t, size_t texel, double, double) { mask[texel] = 1; });
  if (dilate == 0) return mask;
  std::vector<uint8_t> rows(n * n);
  for (size_t y = 0; y < n; ++y)
    dilate_line(mask.data() + y * n, rows.data() + y * n, size, 1, dilate);
  for (size_t x = 0; x < n; ++x) dilate_line(rows.data() + x, mask.data() + x, size, n, dilate);
  return mask;
}

TexelMap texel_map(const Mesh& mesh, int size) {
  EFFIGY_CHECK(size > 0);
  const size_t n = static_cast<size_t>(size);
  TexelMap map{size, std::vector<int32_t>(n * n, -1), std::vector<float>(2 * n * n, 0.0f)};
  visit_mesh_texels(mesh, size, [&](size_t triangle, size_t texel, double b1, double b2) {
    if (map.triangle[texel] >= 0) return;
    map.triangle[texel] = static_cast<int32_t>(triangle);
    map.barycentric[2 * texel] = static_cast<float>(b1);
    map.barycentric[2 * texel + 1] = static_cast<float>(b2);
  });
  return map;
}

}  // namespace effigy
