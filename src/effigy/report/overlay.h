// Drawing on pictures, and pictures of quantities that have no colour of their own. Positions are
// continuous pixels (centres at +0.5).
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "effigy/image/image.h"

namespace effigy {

using Rgb8 = std::array<uint8_t, 3>;

struct Ink {
  Rgb8 colour = {255, 255, 255};
  float opacity = 1.0f;
  float width = 1.5f;  // of lines, in pixels
};

// Anti-aliased; parts outside the picture are left out, lines with a non-finite end altogether.
// Pictures have 3 or 4 channels (alpha becomes opaque where drawn).
void draw_line(Image8& image, double x0, double y0, double x1, double y1, const Ink& ink);
// A filled disc.
void draw_point(Image8& image, double x, double y, double radius, const Ink& ink);
// A ring of ink.width around the circle.
void draw_circle(Image8& image, double x, double y, double radius, const Ink& ink);
// Edges of a projected mesh: vertices as x, y pairs (2 V floats), triangles as index triples (3 T).
// Every edge once; triangles with a non-finite vertex are left out. `cull_back` leaves out
// triangles seen from behind, for meshes whose triangles run counter-clockwise seen from outside:
// projected by a camera with y down they still look counter-clockwise (their signed area in pixels
// is negative).
void draw_triangle_wireframe(Image8& image, std::span<const float> vertices,
                             std::span<const int32_t> triangles, const Ink& ink,
                             bool cull_back = true);

enum class ColourMap {
  kGrey,
  kPerceptual,  // dark blue to light yellow, equal steps of Oklab lightness
};
// Colour of t in [0, 1] (clamped; not a number: t = 0).
Rgb8 map_colour(double t, ColourMap map);

// Pictures of G-buffer planes: `first` is the index of the first plane used, `coverage` (width x
// height, in [0, 1], may be null) fades to `background`.
struct PlaneView {
  const float* coverage = nullptr;
  Rgb8 background = {24, 24, 28};
};
// (n + 1) / 2 of three planes.
Image8 colour_normals(const Planes& planes, int first, const PlaneView& view = {});
// One plane; low and high map to the ends of the map. low == high: the 2nd and 98th percentile of
// the covered (coverage > 1/2, finite) pixels. For depth pass reverse, so that near is bright.
Image8 colour_scalar(const Planes& planes, int plane, ColourMap map = ColourMap::kPerceptual,
                     double low = 0, double high = 0, bool reverse = false,
                     const PlaneView& view = {});
// Red u, green v, with a grid of `cells` squares a side.
Image8 colour_uv(const Planes& planes, int first, int cells = 16, const PlaneView& view = {});
// Three planes as they are (clamped), e.g. albedo after encoding.
Image8 colour_rgb(const Planes& planes, int first, const PlaneView& view = {});
// Mean absolute difference of the channels; `full` (in [0, 1]) maps to the end of the map.
Image8 colour_difference(const Image8& a, const Image8& b, double full = 0.2);

}  // namespace effigy
