#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/geometry/gutter.h"
#include "effigy/image/resample.h"
#include "effigy/people/body_model.h"
#include "effigy/people/body_paint.h"
#include "effigy/people/builtin_body.h"
#include "effigy/people/builtin_head.h"
#include "effigy/people/head_subject.h"

namespace effigy {
namespace {

using people::BodyModel;
using people::BodyPaint;
using people::BodyPlace;

class BodyPainter {
 public:
  BodyPainter(const BuiltinBody& body, int size)
      : body_(body),
        model_(*body.model),
        mesh_(body.rig.mesh),
        map_(texel_map(mesh_, size)),
        head_(builtin_head_materials(std::max(256, size * 3 / 4), body.subject)),
        mean_head_(builtin_head_rig()),
        subject_(people::make_subject(body.subject)),
        normals_(vertex_normals(mesh_.vertices, mesh_.triangles)),
        paint_(map_.triangle.size()),
        bump_(map_.triangle.size(), Vec3d(0, 0, 1)) {}

  BodyMaterials paint() {
    skin_ = neck_colour();
    each_texel([&](int x, int y, size_t i) { evaluate(x, y, i); });
    each_texel([&](int x, int y, size_t i) {
      if (!of_head(map_.triangle[i])) bump_[i] = relief(x, y);
    });
    return finish();
  }

 private:
  template <typename Visit>
  void each_texel(Visit visit) const {
    parallel_for(static_cast<size_t>(map_.size), 8, [&](size_t begin, size_t end, int) {
      for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y)
        for (int x = 0; x < map_.size; ++x)
          if (map_.triangle[texel(x, y)] >= 0) visit(x, y, texel(x, y));
    });
  }
  size_t texel(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(map_.size) + static_cast<size_t>(x);
  }
  // Of the triangle's corners.
  Vec3f weights(size_t i) const {
    const float b1 = map_.barycentric[2 * i], b2 = map_.barycentric[2 * i + 1];
    return {1 - b1 - b2, b1, b2};
  }
  bool of_head(int triangle) const { return triangle < model_.mesh.head_triangles; }

  Vec3d place(size_t i) const {
    const Vec3i& t = mesh_.triangles[static_cast<size_t>(map_.triangle[i])];
    Vec3f p = Vec3f::Zero();
    const Vec3f b = weights(i);
    for (int k = 0; k < 3; ++k) p += b[k] * mesh_.vertex(t[k]);
    return 1e3 * p.cast<double>();
  }
  // Millimetres to the neighbouring texel of the same piece; 0 when there is none.
  double step(int x, int y, int dx, int dy) const {
    const int nx = x + dx, ny = y + dy;
    if (nx < 0 || ny < 0 || nx >= map_.size || ny >= map_.size) return 0;
    const size_t a = texel(x, y), b = texel(nx, ny);
    if (map_.triangle[b] < 0 || of_head(map_.triangle[a]) != of_head(map_.triangle[b])) return 0;
    const double length = (place(a) - place(b)).norm();
    return length < 12000.0 / map_.size ? length : 0;
  }

  // The mean colour of the head's skin at its open rim.
  Vec3d neck_colour() const {
    Vec3d sum = Vec3d::Zero();
    int count = 0;
    const auto& ring = model_.form.joints();
    for (size_t i = 0; i < map_.triangle.size(); ++i) {
      const int f = map_.triangle[i];
      if (f < 0 || !of_head(f) || mesh_.triangle_part[static_cast<size_t>(f)] != people::kFace)
        continue;
      if (place(i).y() > ring.neck.y() + 26) continue;
      float c[3];
      sample_head(head_.albedo, i, c);
      sum += Vec3d(c[0], c[1], c[2]);
      ++count;
    }
    return count > 0 ? Vec3d(sum / count) : Vec3d(0.48, 0.30, 0.22);
  }

  Vec2f head_uv(size_t i) const {
    const Vec3i& t = mesh_.uv_triangles[static_cast<size_t>(map_.triangle[i])];
    const Vec3f b = weights(i);
    Vec2f uv = Vec2f::Zero();
    for (int k = 0; k < 3; ++k) uv += b[k] * model_.mesh.head_uvs[static_cast<size_t>(t[k])];
    return uv;
  }
  void sample_head(const Image& image, size_t i, float* out) const {
    const Vec2f uv = head_uv(i);
    sample_bilinear(image, static_cast<double>(uv.x()) * image.width,
                    (1 - static_cast<double>(uv.y())) * image.height, out);
  }

  void evaluate(int x, int y, size_t i) {
    const int f = map_.triangle[i];
    if (of_head(f)) {
      from_head(i);
      return;
    }
    BodyPlace at;
    at.p = place(i);
    const Vec3i& t = mesh_.triangles[static_cast<size_t>(f)];
    const Vec3f b = weights(i);
    Vec3f n = Vec3f::Zero();
    for (int k = 0; k < 3; ++k) n += b[k] * Vec3f(normals_.data() + 3 * static_cast<size_t>(t[k]));
    at.normal = n.cast<double>().normalized();
    at.texel = std::max({step(x, y, 1, 0), step(x, y, 0, 1), 200.0 / map_.size});
    paint_[i] = people::paint_body(model_, skin_, at);
    const int part = paint_[i].part;
    paint_[i].scatter = part == people::kSkin || part == people::kHands ? 1 : 0;
  }

  // Whether hair grows at a texel of the head: by its place on the mean head.
  bool hair_at(size_t i) const {
    const Vec3i& t = mesh_.triangles[static_cast<size_t>(map_.triangle[i])];
    const Vec3f b = weights(i);
    Vec3f p = Vec3f::Zero();
    for (int k = 0; k < 3; ++k) p += b[k] * mean_head_.mesh.vertex(t[k]);
    return people::hair_cover(1e3 * p.cast<double>(), 2, subject_.hair) > 0.5;
  }

  void from_head(size_t i) {
    const int f = map_.triangle[i];
    BodyPaint& p = paint_[i];
    float c[3], roughness, specular, scatter, normal[3];
    sample_head(head_.albedo, i, c);
    sample_head(head_.roughness, i, &roughness);
    sample_head(head_.specular, i, &specular);
    sample_head(head_.normal, i, normal);
    sample_head(head_.scatter, i, &scatter);
    p.scatter = static_cast<double>(scatter);
    p.albedo = Vec3d(c[0], c[1], c[2]);
    p.roughness = static_cast<double>(roughness);
    p.specular = static_cast<double>(specular);
    p.part = mesh_.triangle_part[static_cast<size_t>(f)];
    if (p.part == people::kFace && hair_at(i)) p.part = people::kHair;
    // The tangent frame turns with the island.
    const Vec3i& t = mesh_.uv_triangles[static_cast<size_t>(f)];
    const auto edge = [&](const std::vector<Vec2f>& uvs, int k) {
      return Vec2d(
          (uvs[static_cast<size_t>(t[k])] - uvs[static_cast<size_t>(t[0])]).cast<double>());
    };
    Eigen::Matrix2d ours, theirs;
    ours << edge(mesh_.uvs, 1), edge(mesh_.uvs, 2);
    theirs << edge(model_.mesh.head_uvs, 1), edge(model_.mesh.head_uvs, 2);
    const Eigen::Matrix2d map = ours * theirs.inverse();
    const double scale = std::sqrt(std::abs(map.determinant()));
    Vec2d tilt(normal[0], normal[1]);
    if (scale > 0 && std::isfinite(scale)) tilt = map * tilt / scale;
    bump_[i] =
        Vec3d(tilt.x(), tilt.y(), std::max(0.05, static_cast<double>(normal[2]))).normalized();
  }

  // OpenGL: +x along u, +y along v (up the picture).
  Vec3d relief(int x, int y) const {
    const auto slope = [&](int dx, int dy) {
      const double ahead = step(x, y, dx, dy), behind = step(x, y, -dx, -dy);
      if (ahead == 0 || behind == 0) return 0.0;
      return (paint_[texel(x + dx, y + dy)].height - paint_[texel(x - dx, y - dy)].height) /
             std::max(ahead + behind, 0.2);
    };
    return Vec3d(-std::clamp(slope(1, 0), -0.8, 0.8), -std::clamp(slope(0, -1), -0.8, 0.8), 1)
        .normalized();
  }

  BodyMaterials finish() const {
    const int size = map_.size;
    BodyMaterials out{Image(size, size, 3), Image(size, size, 1),
                      Image(size, size, 1), Image(size, size, 3),
                      Image(size, size, 1), std::vector<uint8_t>(map_.triangle.size(), 0)};
    const std::vector<int> from = nearest_shown(map_.size, map_.triangle);
    for (size_t i = 0; i < from.size(); ++i) {
      const size_t s = static_cast<size_t>(from[i]);
      const BodyPaint& p = paint_[s];
      for (int c = 0; c < 3; ++c) {
        out.albedo.data[3 * i + c] = static_cast<float>(std::clamp(p.albedo[c], 0.004, 0.95));
        out.normal.data[3 * i + c] = static_cast<float>(bump_[s][c]);
      }
      out.roughness.data[i] = static_cast<float>(std::clamp(p.roughness, 0.05, 1.0));
      out.scatter.data[i] = static_cast<float>(std::clamp(p.scatter, 0.0, 1.0));
      out.specular.data[i] = static_cast<float>(std::clamp(p.specular, 0.02, 0.08));
      if (map_.triangle[i] >= 0)
        out.labels[i] =
            static_cast<uint8_t>(body_part_label(mesh_.parts[static_cast<size_t>(p.part)]));
    }
    return out;
  }

  const BuiltinBody& body_;
  const BodyModel& model_;
  const Mesh& mesh_;
  TexelMap map_;
  HeadMaterials head_;
  Rig mean_head_;
  people::Subject subject_;
  std::vector<float> normals_;
  std::vector<BodyPaint> paint_;
  std::vector<Vec3d> bump_;
  Vec3d skin_ = Vec3d::Zero();
};

}  // namespace

BodyMaterials builtin_body_materials(const BuiltinBody& body, int size) {
  if (size < 32 || size > 8192)
    throw Error("The built-in body's texture size must be 32 to 8192, not " + std::to_string(size) +
                ".");
  EFFIGY_CHECK(body.model != nullptr);
  return BodyPainter(body, size).paint();
}

}  // namespace effigy
