#include "effigy/report/overlay.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "effigy/base/error.h"

namespace effigy {
namespace {

void blend(Image8& image, int x, int y, const Ink& ink, double coverage) {
  const double amount = std::clamp(coverage, 0.0, 1.0) * static_cast<double>(ink.opacity);
  if (amount <= 0.0) return;
  uint8_t* pixel = image.at(x, y);
  for (size_t c = 0; c < 3; ++c)
    pixel[c] = static_cast<uint8_t>(std::lround(pixel[c] + amount * (ink.colour[c] - pixel[c])));
  if (image.channels == 4)
    pixel[3] = static_cast<uint8_t>(std::lround(pixel[3] + amount * (255 - pixel[3])));
}

// Calls coverage(x, y) at the centre of every pixel of the picture within the box.
template <typename Coverage>
void paint_box(Image8& image, double left, double top, double right, double bottom, const Ink& ink,
               Coverage&& coverage) {
  const auto clamp_to = [](double v, int size) {
    return static_cast<int>(std::clamp(v, -1.0, static_cast<double>(size)));
  };
  const int x0 = std::max(0, clamp_to(std::floor(left), image.width));
  const int x1 = std::min(image.width - 1, clamp_to(std::ceil(right), image.width));
  const int y0 = std::max(0, clamp_to(std::floor(top), image.height));
  const int y1 = std::min(image.height - 1, clamp_to(std::ceil(bottom), image.height));
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) blend(image, x, y, ink, coverage(x + 0.5, y + 0.5));
}

// Liang and Barsky: the part of the segment within the picture and a margin; false when none.
bool clip(const Image8& image, double margin, double& x0, double& y0, double& x1, double& y1) {
  const double dx = x1 - x0, dy = y1 - y0;
  double from = 0.0, to = 1.0;
  const auto edge = [&](double direction, double distance) {
    if (direction == 0.0) return distance >= 0.0;
    const double t = distance / direction;
    if (direction < 0.0) {
      from = std::max(from, t);
    } else {
      to = std::min(to, t);
    }
    return from <= to;
  };
  if (!edge(-dx, x0 + margin) || !edge(dx, image.width + margin - x0) || !edge(-dy, y0 + margin) ||
      !edge(dy, image.height + margin - y0))
    return false;
  x1 = x0 + to * dx;
  y1 = y0 + to * dy;
  x0 += from * dx;
  y0 += from * dy;
  return true;
}

void check_drawable(const Image8& image) {
  EFFIGY_CHECK(image.channels == 3 || image.channels == 4);
}

}  // namespace

void draw_line(Image8& image, double x0, double y0, double x1, double y1, const Ink& ink) {
  check_drawable(image);
  if (!std::isfinite(x0) || !std::isfinite(y0) || !std::isfinite(x1) || !std::isfinite(y1)) return;
  const double half = 0.5 * static_cast<double>(ink.width);
  if (!clip(image, half + 1.0, x0, y0, x1, y1)) return;
  const double dx = x1 - x0, dy = y1 - y0, squared = dx * dx + dy * dy;
  const auto coverage = [&](double x, double y) {
    const double t =
        squared > 0.0 ? std::clamp(((x - x0) * dx + (y - y0) * dy) / squared, 0.0, 1.0) : 0.0;
    return half + 0.5 - std::hypot(x - x0 - t * dx, y - y0 - t * dy);
  };
  // In short pieces along the longer axis, so that a diagonal does not visit its whole box.
  const int pieces = std::max(1, static_cast<int>(std::sqrt(squared) / 16.0));
  const double room = half + 1.0;
  const bool wide = std::fabs(dx) >= std::fabs(dy);
  const double slope = wide ? (dx != 0.0 ? dy / dx : 0.0) : dx / dy;
  const double low = (wide ? std::min(x0, x1) : std::min(y0, y1)) - room;
  const double high = (wide ? std::max(x0, x1) : std::max(y0, y1)) + room;
  const double cross = room * std::sqrt(1.0 + slope * slope) + 1.0;
  for (int i = 0; i < pieces; ++i) {
    // Whole pixels belong to one piece.
    const double from = std::floor(low + (high - low) * i / pieces);
    const double to = std::floor(low + (high - low) * (i + 1) / pieces) - (i + 1 < pieces ? 1 : -1);
    if (wide) {
      const double a = y0 + slope * (from - x0), b = y0 + slope * (to + 1 - x0);
      paint_box(image, from, std::min(a, b) - cross, to, std::max(a, b) + cross, ink, coverage);
    } else {
      const double a = x0 + slope * (from - y0), b = x0 + slope * (to + 1 - y0);
      paint_box(image, std::min(a, b) - cross, from, std::max(a, b) + cross, to, ink, coverage);
    }
  }
}

void draw_point(Image8& image, double x, double y, double radius, const Ink& ink) {
  check_drawable(image);
  if (!std::isfinite(x) || !std::isfinite(y)) return;
  paint_box(image, x - radius - 1, y - radius - 1, x + radius + 1, y + radius + 1, ink,
            [&](double px, double py) { return radius + 0.5 - std::hypot(px - x, py - y); });
}

void draw_circle(Image8& image, double x, double y, double radius, const Ink& ink) {
  check_drawable(image);
  if (!std::isfinite(x) || !std::isfinite(y)) return;
  const double half = 0.5 * static_cast<double>(ink.width), room = radius + half + 1.0;
  paint_box(image, x - room, y - room, x + room, y + room, ink, [&](double px, double py) {
    return half + 0.5 - std::fabs(std::hypot(px - x, py - y) - radius);
  });
}

void draw_triangle_wireframe(Image8& image, std::span<const float> vertices,
                             std::span<const int32_t> triangles, const Ink& ink, bool cull_back) {
  EFFIGY_CHECK(vertices.size() % 2 == 0 && triangles.size() % 3 == 0);
  const auto position = [&](int32_t index) {
    const auto i = static_cast<size_t>(index);
    EFFIGY_CHECK(index >= 0 && 2 * i + 1 < vertices.size());
    return std::pair<double, double>(vertices[2 * i], vertices[2 * i + 1]);
  };
  std::vector<std::pair<int32_t, int32_t>> edges;
  for (size_t t = 0; t < triangles.size(); t += 3) {
    const auto [ax, ay] = position(triangles[t]);
    const auto [bx, by] = position(triangles[t + 1]);
    const auto [cx, cy] = position(triangles[t + 2]);
    const double area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    // y points down: counter-clockwise as seen is a negative area.
    if (!std::isfinite(area) || (cull_back && area >= 0.0)) continue;
    for (size_t k = 0; k < 3; ++k)
      edges.emplace_back(std::minmax(triangles[t + k], triangles[t + (k + 1) % 3]));
  }
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  for (const auto& [a, b] : edges) {
    const auto [ax, ay] = position(a);
    const auto [bx, by] = position(b);
    draw_line(image, ax, ay, bx, by, ink);
  }
}

}  // namespace effigy
