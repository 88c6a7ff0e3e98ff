// The left half of the head's skin, from which head_mesh.cpp makes the whole.
#pragma once

#include <vector>

#include "effigy/people/head_mesh.h"

namespace effigy::people {

enum class HalfPart : uint8_t { kSkin, kEye, kTeeth, kMouth };

struct Half {
  std::vector<HeadVertex> vertices;
  std::vector<Vec2d> uv;         // per vertex
  std::vector<char> behind;      // on the seam of the atlas (mirror plane, back)
  std::vector<Vec3i> triangles;  // counter-clockwise from outside
  std::vector<HalfPart> part;    // per triangle
  std::vector<int> neck;         // open ring, front to back

  int add(const HeadVertex& vertex, const Vec2d& at, bool on_seam = false);
  void add_triangle(int a, int b, int c, HalfPart p);
  // The band between two loops of the same length that run clockwise seen from outside.
  void add_band(const std::vector<int>& outer, const std::vector<int>& inner, bool closed,
                HalfPart p);
};

// Loops around openings; each returns its outermost loop, whose UVs are those of the surrounding
// skin.
std::vector<int> add_mouth_rings(Half& half);  // open: middle above .. middle below
std::vector<int> add_eye_rings(Half& half);
std::vector<int> add_ear_rings(Half& half);
std::vector<int> add_nostril_rings(Half& half);
// Fills the skin between the loops and the mirror plane with triangles of even size.
void add_skin(Half& half, const std::vector<int>& mouth, const std::vector<int>& eye,
              const std::vector<int>& ear, const std::vector<int>& nostril);
// Eyeball, teeth, tongue: pieces of their own.
void add_eyeball(Half& half);
void add_teeth(Half& half);
void add_tongue(Half& half);

}  // namespace effigy::people
