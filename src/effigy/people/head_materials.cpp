#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/people/builtin_head.h"
#include "effigy/people/head_mesh.h"
#include "effigy/people/head_paint.h"

namespace effigy {
namespace {

using people::HeadMesh;
using people::HeadVertex;
using people::Paint;
using people::PaintPart;
using people::Place;
using people::Region;

// What a vertex brings to the texels around it.
struct Marks {
  double lip = 0, lash = 0, inside = 0, ear = 0, nostril = 0, along = 0, gum = 0;
};

Marks marks_of(const HeadVertex& v) {
  Marks m;
  switch (v.region) {
    case Region::kMouthRing:
      m.lip = v.ring <= 1 ? 1.0 : v.ring == 2 ? 0.5 : 0.0;
      m.inside = v.ring <= -2 ? 1.0 : 0.0;
      break;
    case Region::kEyeRing:
      m.lash = v.ring == 0 && v.index != 0 ? (v.index < people::kEyeLoop / 2 ? 1.0 : 0.72) : 0.0;
      m.inside = v.ring < 0 ? 1.0 : 0.0;
      break;
    case Region::kEarRing:
      m.ear = v.ring == 0 ? 0.0 : 1.0;
      break;
    case Region::kNostrilRing:
      m.nostril = v.ring == 0 ? 0.0 : v.ring == 1 ? 0.5 : 1.0;
      break;
    case Region::kUpperTeeth:
    case Region::kLowerTeeth:
      // Seven teeth on each side of the middle.
      m.along = 7.0 * v.index / 12.0;
      m.gum = v.ring == 0 || v.ring == 4 ? 1.0 : v.ring == 1 ? 0.45 : 0.0;
      break;
    default:
      break;
  }
  return m;
}

PaintPart part_of(const std::string& name) {
  if (name == "eye_left" || name == "eye_right") return PaintPart::kEye;
  if (name == "teeth") return PaintPart::kTeeth;
  return name == "mouth" ? PaintPart::kMouth : PaintPart::kSkin;
}

// Calls visit(x, y, triangle, weights) for texel centres inside each UV triangle, grown by half a
// texel or so, so that edges leave no gaps.
template <typename Visit>
void rasterize_uv(const Mesh& mesh, int size, Visit visit) {
  for (int f = 0; f < mesh.triangle_count(); ++f) {
    std::array<Vec2d, 3> q;
    for (int k = 0; k < 3; ++k) {
      const Vec2f& uv = mesh.uvs[mesh.uv_triangles[f][k]];
      q[k] = {uv.x() * size, (1 - uv.y()) * size};
    }
    const double area =
        (q[1] - q[0]).x() * (q[2] - q[0]).y() - (q[1] - q[0]).y() * (q[2] - q[0]).x();
    if (area == 0) continue;
    const auto [x0, x1] = std::minmax({q[0].x(), q[1].x(), q[2].x()});
    const auto [y0, y1] = std::minmax({q[0].y(), q[1].y(), q[2].y()});
    for (int y = std::max(0, static_cast<int>(y0 - 1));
         y <= std::min(size - 1, static_cast<int>(y1 + 1)); ++y)
      for (int x = std::max(0, static_cast<int>(x0 - 1));
           x <= std::min(size - 1, static_cast<int>(x1 + 1)); ++x) {
        const Vec2d p(x + 0.5, y + 0.5);
        Vec3d w;
        for (int k = 0; k < 3; ++k) {
          const Vec2d a = q[(k + 1) % 3] - p, b = q[(k + 2) % 3] - p;
          w[k] = (a.x() * b.y() - a.y() * b.x()) / area;
        }
        if (w.minCoeff() >= -1e-9) visit(x, y, f, w);
      }
  }
}

class Painter {
 public:
  Painter(int size, uint64_t subject)
      : head_(people::shared_head_mesh()),
        subject_(people::make_subject(subject)),
        size_(size),
        places_(pixels()),
        filled_(pixels(), 0) {}

  HeadMaterials paint() {
    collect();
    evaluate();
    spread();
    return finish();
  }

 private:
  size_t pixels() const { return static_cast<size_t>(size_) * size_; }
  size_t at(int x, int y) const { return static_cast<size_t>(y) * size_ + x; }

  void collect() {
    std::vector<Marks> marks;
    for (const HeadVertex& v : head_.vertices) marks.push_back(marks_of(v));
    const Mesh& mesh = head_.mesh;
    rasterize_uv(mesh, size_, [&](int x, int y, int f, const Vec3d& w) {
      Place place;
      place.part = part_of(mesh.parts[mesh.triangle_part[f]]);
      for (int k = 0; k < 3; ++k) {
        const int v = mesh.triangles[f][k];
        place.p += w[k] * head_.vertices[v].p;
        place.lip += w[k] * marks[v].lip;
        place.lash += w[k] * marks[v].lash;
        place.inside += w[k] * marks[v].inside;
        place.ear += w[k] * marks[v].ear;
        place.nostril += w[k] * marks[v].nostril;
        place.along += w[k] * marks[v].along;
        place.gum += w[k] * marks[v].gum;
      }
      places_[at(x, y)] = place;
      filled_[at(x, y)] = 1;
    });
  }

  // Millimetres between this texel and a neighbour of the same piece; 0 when there is none.
  double step(int x, int y, int dx, int dy) const {
    const int nx = x + dx, ny = y + dy;
    if (nx < 0 || ny < 0 || nx >= size_ || ny >= size_ || !filled_[at(nx, ny)]) return 0;
    const Place &a = places_[at(x, y)], &b = places_[at(nx, ny)];
    const double length = (a.p - b.p).norm();
    return a.part == b.part && length < 4000.0 / size_ ? length : 0;
  }

  void evaluate() {
    paint_.resize(pixels());
    parallel_for(static_cast<size_t>(size_), 8, [&](size_t begin, size_t end, int) {
      for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y)
        for (int x = 0; x < size_; ++x)
          if (filled_[at(x, y)]) {
            const double texel = std::max({step(x, y, 1, 0), step(x, y, 0, 1), 200.0 / size_});
            paint_[at(x, y)] = paint_at(places_[at(x, y)], texel, subject_);
          }
    });
    normals_.assign(pixels(), Vec3d(0, 0, 1));
    for (int y = 0; y < size_; ++y)
      for (int x = 0; x < size_; ++x)
        if (filled_[at(x, y)]) normals_[at(x, y)] = relief_normal(x, y);
  }

  // OpenGL: +x along u, +y along v (up the picture).
  Vec3d relief_normal(int x, int y) const {
    auto slope = [&](int dx, int dy) {
      const double ahead = step(x, y, dx, dy), behind = step(x, y, -dx, -dy);
      if (ahead == 0 || behind == 0) return 0.0;
      return (paint_[at(x + dx, y + dy)].height - paint_[at(x - dx, y - dy)].height) /
             std::max(ahead + behind, 0.2);
    };
    return Vec3d(-slope(1, 0), -slope(0, -1), 1).normalized();
  }

  // Texels outside the islands take the colour of the nearest ones inside.
  void spread() {
    std::vector<size_t> front;
    for (size_t i = 0; i < pixels(); ++i)
      if (filled_[i]) front.push_back(i);
    while (!front.empty()) {
      std::vector<size_t> next;
      for (const size_t i : front) {
        const int x = static_cast<int>(i % size_), y = static_cast<int>(i / size_);
        for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
          const int nx = x + dx, ny = y + dy;
          if (nx < 0 || ny < 0 || nx >= size_ || ny >= size_ || filled_[at(nx, ny)]) continue;
          filled_[at(nx, ny)] = 1;
          paint_[at(nx, ny)] = paint_[i];
          next.push_back(at(nx, ny));
        }
      }
      front = std::move(next);
    }
  }

  HeadMaterials finish() const {
    HeadMaterials out{Image(size_, size_, 3), Image(size_, size_, 1), Image(size_, size_, 1),
                      Image(size_, size_, 3), Image(size_, size_, 1)};
    for (size_t i = 0; i < pixels(); ++i) {
      for (int c = 0; c < 3; ++c) {
        out.albedo.data[3 * i + c] = static_cast<float>(std::clamp(paint_[i].albedo[c], 0.0, 1.0));
        out.normal.data[3 * i + c] = static_cast<float>(normals_[i][c]);
      }
      out.roughness.data[i] = static_cast<float>(std::clamp(paint_[i].roughness, 0.05, 1.0));
      out.scatter.data[i] = static_cast<float>(std::clamp(paint_[i].scatter, 0.0, 1.0));
      out.specular.data[i] = static_cast<float>(std::clamp(paint_[i].specular, 0.02, 0.08));
    }
    return out;
  }

  const HeadMesh& head_;
  people::Subject subject_;
  int size_;
  std::vector<Place> places_;
  std::vector<char> filled_;
  std::vector<Paint> paint_;
  std::vector<Vec3d> normals_;
};

}  // namespace

HeadMaterials builtin_head_materials(int size, uint64_t subject) {
  if (size < 8 || size > 8192)
    throw Error("The built-in head's texture size must be 8 to 8192, not " + std::to_string(size) +
                ".");
  return Painter(size, subject).paint();
}

}  // namespace effigy
