#include "effigy/head/edit_accuracy.h"

#include <algorithm>
#include <cmath>

#include "effigy/avatar/renderer.h"
#include "effigy/base/progress.h"
#include "effigy/image/resample.h"

namespace effigy {
namespace {

constexpr double kFacing = 0.64;      // cosine of 50 degrees
constexpr double kInFront = 0.02;     // metres that may lie in front of the surface
constexpr double kSmallestCell = 12;  // pixels
constexpr int kWindow = 5;            // half-width of the corner search, pixels
constexpr double kFarthest = 8;       // corners that wander further are not corners

// A place on the atlas: the triangle it lies in and its barycentric weights.
struct AtlasPoint {
  int triangle;
  Vec3f weights;
};

// Finds the skin triangle that covers each grid corner of the atlas.
class AtlasGrid {
 public:
  AtlasGrid(const Mesh& mesh, int cells) : cells_(cells), points_((cells + 1) * (cells + 1)) {
    for (int t = 0; t < mesh.triangle_count(); ++t) {
      if (!mesh.triangle_part.empty() && mesh.parts[mesh.triangle_part[t]] != "skin") continue;
      add_triangle(mesh, t);
    }
  }
  // Null when the corner lies in no island.
  const AtlasPoint* at(int i, int j) const {
    const AtlasPoint& p = points_[static_cast<size_t>(j) * (cells_ + 1) + i];
    return found_.empty() || !found_[static_cast<size_t>(j) * (cells_ + 1) + i] ? nullptr : &p;
  }

 private:
  void add_triangle(const Mesh& mesh, int t) {
    if (found_.empty()) found_.assign(points_.size(), 0);
    const Vec2f a = mesh.uvs[mesh.uv_triangles[t][0]], b = mesh.uvs[mesh.uv_triangles[t][1]],
                c = mesh.uvs[mesh.uv_triangles[t][2]];
    const float area = (b - a).x() * (c - a).y() - (b - a).y() * (c - a).x();
    if (std::abs(area) < 1e-12f) return;
    const Vec2f low = a.cwiseMin(b).cwiseMin(c) * static_cast<float>(cells_);
    const Vec2f high = a.cwiseMax(b).cwiseMax(c) * static_cast<float>(cells_);
    for (int j = std::max(0, static_cast<int>(std::ceil(low.y()))); j <= high.y() && j <= cells_;
         ++j)
      for (int i = std::max(0, static_cast<int>(std::ceil(low.x()))); i <= high.x() && i <= cells_;
           ++i) {
        const Vec2f p(static_cast<float>(i) / cells_, static_cast<float>(j) / cells_);
        const float wb = ((p - a).x() * (c - a).y() - (p - a).y() * (c - a).x()) / area;
        const float wc = ((b - a).x() * (p - a).y() - (b - a).y() * (p - a).x()) / area;
        if (wb < 0 || wc < 0 || wb + wc > 1) continue;
        const size_t k = static_cast<size_t>(j) * (cells_ + 1) + i;
        points_[k] = {t, Vec3f(1 - wb - wc, wb, wc)};
        found_[k] = 1;
      }
  }
  int cells_;
  std::vector<AtlasPoint> points_;
  std::vector<uint8_t> found_;
};

double sample(const Image& image, double x, double y) {
  float value = 0;
  sample_bilinear(image, x, y, &value);
  return value;
}

// Sub-pixel checker corner near `start`: the point q at which all gradients g in the window are
// orthogonal to q - p (least squares, iterated). False when it runs away.
bool refine_corner(const Image& image, Vec2d& corner) {
  const Vec2d start = corner;
  for (int iteration = 0; iteration < 12; ++iteration) {
    Eigen::Matrix2d a = Eigen::Matrix2d::Zero();
    Vec2d b = Vec2d::Zero();
    for (int dy = -kWindow; dy <= kWindow; ++dy)
      for (int dx = -kWindow; dx <= kWindow; ++dx) {
        const Vec2d p = corner + Vec2d(dx, dy);
        const Vec2d g(sample(image, p.x() + 1, p.y()) - sample(image, p.x() - 1, p.y()),
                      sample(image, p.x(), p.y() + 1) - sample(image, p.x(), p.y() - 1));
        const double weight = std::exp(-(dx * dx + dy * dy) / 8.0);
        a += weight * g * g.transpose();
        b += weight * g * g.dot(p);
      }
    if (a.determinant() < 1e-6) return false;
    const Vec2d next = a.inverse() * b;
    const double moved = (next - corner).norm();
    corner = next;
    if ((corner - start).norm() > kFarthest) return false;
    if (moved < 0.01) return true;
  }
  return true;
}

// Distance over which the profile from `from` to `to` rises from 10 to 90 % of its ends; negative
// when it does not rise enough to tell.
double edge_width(const Image& image, const Vec2d& from, const Vec2d& to) {
  constexpr int kSamples = 64;
  double profile[kSamples + 1];
  for (int i = 0; i <= kSamples; ++i) {
    const Vec2d p = from + (to - from) * (static_cast<double>(i) / kSamples);
    profile[i] = sample(image, p.x(), p.y());
  }
  const double low = profile[0], high = profile[kSamples];
  if (std::abs(high - low) < 0.4) return -1;
  double at10 = -1, at90 = -1;
  for (int i = 1; i <= kSamples; ++i) {
    const double a = (profile[i - 1] - low) / (high - low), b = (profile[i] - low) / (high - low);
    if (at10 < 0 && b >= 0.1) at10 = i - 1 + (0.1 - a) / std::max(1e-9, b - a);
    if (at90 < 0 && b >= 0.9) at90 = i - 1 + (0.9 - a) / std::max(1e-9, b - a);
  }
  return (at90 - at10) / kSamples * (to - from).norm();
}

// Measures one rendered view.
class ViewMeasurement {
 public:
  ViewMeasurement(const HeadAvatar& avatar, const AtlasGrid& grid, int cells)
      : avatar_(avatar), grid_(grid), cells_(cells) {}

  void measure(const HeadRenderer& renderer, const Camera& camera, std::vector<double>& errors,
               std::vector<double>& widths) const {
    const Image albedo = buffer_values(renderer.gbuffer(), "albedo");
    Image grey(albedo.width, albedo.height, 1);
    for (size_t i = 0; i < grey.data.size(); ++i) grey.data[i] = albedo.data[3 * i];
    for (int j = 1; j < cells_; ++j)
      for (int i = 1; i < cells_; ++i) {
        Vec2d here, next;
        if (!project(i, j, renderer, camera, here)) continue;
        bool large = true;
        for (const auto& [di, dj] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}})
          large = large && project(i + di, j + dj, renderer, camera, next) &&
                  (next - here).norm() > kSmallestCell;
        if (!large) continue;
        Vec2d corner = here;
        if (refine_corner(grey, corner)) errors.push_back((corner - here).norm());
        project(i + 1, j, renderer, camera, next);
        const Vec2d middle = 0.5 * (here + next), along = (next - here).normalized();
        const Vec2d across(-along.y(), along.x());
        const double width = edge_width(grey, middle - 5 * across, middle + 5 * across);
        if (width > 0) widths.push_back(width);
      }
  }

 private:
  // Pixel of grid corner (i, j); false when it is not plainly visible.
  bool project(int i, int j, const HeadRenderer& renderer, const Camera& camera,
               Vec2d& pixel) const {
    const AtlasPoint* point = grid_.at(i, j);
    if (point == nullptr) return false;
    const Vec3i& corner = avatar_.rig.mesh.triangles[point->triangle];
    Vec3f p[3], at = Vec3f::Zero();
    for (int k = 0; k < 3; ++k) {
      p[k] = Vec3f(&renderer.vertices()[3 * static_cast<size_t>(corner[k])]);
      at += point->weights[k] * p[k];
    }
    const Vec3f normal = (p[1] - p[0]).cross(p[2] - p[0]).normalized();
    const Vec3d world = at.cast<double>();
    if (normal.cast<double>().dot((camera.center() - world).normalized()) < kFacing) return false;
    pixel = camera.project(world);
    const int x = static_cast<int>(pixel.x()), y = static_cast<int>(pixel.y());
    const int margin = kWindow + 3;
    if (x < margin || y < margin || x >= camera.width - margin || y >= camera.height - margin)
      return false;
    const Planes& g = renderer.gbuffer();
    const size_t k = static_cast<size_t>(y) * camera.width + x;
    const float alpha = g.plane(kAlpha)[k];
    return alpha > 0.95f && g.plane(kDepth)[k] / alpha > camera.to_camera(world).z() - kInFront;
  }

  const HeadAvatar& avatar_;
  const AtlasGrid& grid_;
  int cells_;
};

double quantile(std::vector<double>& values, double q) {
  if (values.empty()) return 0;
  const auto k = static_cast<size_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(k), values.end());
  return values[k];
}

}  // namespace

MaterialTexture paint_checker(MaterialTexture texture, int cells) {
  for (int y = 0; y < texture.height; ++y)
    for (int x = 0; x < texture.width; ++x) {
      const bool odd = (x * cells / texture.width + y * cells / texture.height) % 2 != 0;
      float* t = &texture.texels[(static_cast<size_t>(y) * texture.width + x) * 8];
      t[0] = odd ? 0.8f : 0.05f;
      t[1] = odd ? 0.8f : 0.05f;
      t[2] = odd ? 0.8f : 0.30f;
    }
  return texture;
}

Json EditAccuracy::to_json() const {
  return {{"corners", corners},
          {"corner_error_median_px", corner_error_median},
          {"corner_error_p95_px", corner_error_p95},
          {"edge_width_median_px", edge_width_median}};
}

EditAccuracy measure_edit_accuracy(const HeadAvatar& avatar, const std::vector<EditView>& views,
                                   int cells) {
  HeadAvatar edited = avatar;
  edited.material = paint_checker(avatar.material, cells);
  const AtlasGrid grid(avatar.rig.mesh, cells);
  HeadRenderer renderer(edited);
  const ViewMeasurement measurement(edited, grid, cells);
  std::vector<double> errors, widths;
  for (const EditView& view : views) {
    throw_if_interrupted();
    renderer.set_pose(view.pose);
    renderer.draw(view.camera);
    measurement.measure(renderer, view.camera, errors, widths);
  }
  EditAccuracy accuracy;
  accuracy.corners = static_cast<int>(errors.size());
  accuracy.corner_error_median = quantile(errors, 0.5);
  accuracy.corner_error_p95 = quantile(errors, 0.95);
  accuracy.edge_width_median = quantile(widths, 0.5);
  return accuracy;
}

}  // namespace effigy
