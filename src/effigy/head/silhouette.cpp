#include "effigy/head/silhouette.h"

#include <algorithm>
#include <cmath>

#include "effigy/geometry/laplacian.h"

namespace effigy {
namespace {

constexpr float kStep = 0.002f;             // metres, of the march along a normal
constexpr int kMarch = 25, kMarchBack = 5;  // steps outwards and inwards
constexpr float kGrazing = 0.35f;           // |cos| under which a vertex counts as on the outline
constexpr float kFaceRadius = 0.018f;       // metres around a landmark that count as face
constexpr int kSpreadIterations = 300, kSmoothIterations = 8;

// 1 for vertices that may move: skin that is not near a landmark.
std::vector<uint8_t> movable_vertices(const Rig& rig, const std::vector<float>& rest) {
  const int count = rig.mesh.vertex_count();
  std::vector<uint8_t> movable(count, 0);
  for (int t = 0; t < rig.mesh.triangle_count(); ++t) {
    const bool skin =
        rig.mesh.triangle_part.empty() || rig.mesh.parts[rig.mesh.triangle_part[t]] == "skin";
    for (int k = 0; skin && k < 3; ++k) movable[rig.mesh.triangles[t][k]] = 1;
  }
  const auto landmarks = landmark_positions(rig.mediapipe, rig.mesh.triangles, rest);
  for (int v = 0; v < count; ++v) {
    const Vec3f p(&rest[3 * static_cast<size_t>(v)]);
    for (size_t l = 0; movable[v] && l < landmarks.size(); l += 3)
      if ((p - Vec3f(&landmarks[l])).norm() < kFaceRadius) movable[v] = 0;
  }
  return movable;
}

// Highest image row of the neck ring: below it the matte is cut.
double neck_line(const Rig& rig, const std::vector<float>& vertices, const Camera& camera) {
  double row = camera.height;
  for (int v : rig.neck_ring) {
    const float* p = &vertices[3 * static_cast<size_t>(v)];
    row = std::min(row, camera.project({p[0], p[1], p[2]}).y());
  }
  return row;
}

// Distance from p along n to the matte's border, or NaN when it cannot be told.
float distance_to_border(const Vec3f& p, const Vec3f& n, const Camera& camera, const Image8& mask,
                         double lowest_row) {
  const auto inside = [&](int k, bool& known) {
    const Vec2d pixel = camera.project((p + n * (kStep * static_cast<float>(k))).cast<double>());
    known = pixel.x() >= 1 && pixel.y() >= 1 && pixel.x() < camera.width - 1 &&
            pixel.y() < std::min<double>(camera.height - 1, lowest_row);
    return known && *mask.at(static_cast<int>(pixel.x()), static_cast<int>(pixel.y())) > 127;
  };
  bool known = false;
  if (inside(0, known)) {
    for (int k = 1; k <= kMarch; ++k) {
      const bool in = inside(k, known);
      if (!known) return NAN;
      if (!in) return kStep * (static_cast<float>(k) - 0.5f);
    }
    return NAN;  // no border within reach: another part of the head lies behind
  }
  for (int k = 1; known && k <= kMarchBack; ++k)
    if (inside(-k, known)) return -kStep * (static_cast<float>(k) - 0.5f);
  return NAN;
}

void sample_frame(const Capture& capture, const RigShape& shape, int frame,
                  const std::vector<uint8_t>& movable, std::vector<std::vector<float>>& samples) {
  std::vector<float> vertices;
  pose_vertices(shape, capture.poses[frame], vertices);
  const auto normals = vertex_normals(vertices, capture.rig.mesh.triangles);
  const Image8 mask = capture.load_mask(frame);
  const Vec3f eye = capture.camera.center().cast<float>();
  const double lowest = neck_line(capture.rig, vertices, capture.camera);
  for (size_t v = 0; v < movable.size(); ++v) {
    if (!movable[v]) continue;
    const Vec3f p(&vertices[3 * v]), n(&normals[3 * v]);
    if (std::abs(n.dot((eye - p).normalized())) > kGrazing) continue;
    const float distance = distance_to_border(p, n, capture.camera, mask, lowest);
    if (std::isfinite(distance)) samples[v].push_back(distance);
  }
}

}  // namespace

std::vector<float> silhouette_offsets(const Capture& capture, const RigShape& shape,
                                      const std::vector<int>& frames) {
  const auto movable = movable_vertices(capture.rig, shape.rest);
  std::vector<std::vector<float>> samples(movable.size());
  for (int frame : frames) sample_frame(capture, shape, frame, movable, samples);

  std::vector<float> offset(movable.size(), 0.0f), next;
  std::vector<uint8_t> known(movable.size(), 0);
  for (size_t v = 0; v < movable.size(); ++v) {
    if (!movable[v]) known[v] = 1;
    if (samples[v].size() < 2) continue;
    auto middle = samples[v].begin() + static_cast<std::ptrdiff_t>(samples[v].size() / 2);
    std::nth_element(samples[v].begin(), middle, samples[v].end());
    offset[v] = std::clamp(*middle, -0.01f, 0.05f);
    known[v] = 1;
  }
  // Spread into vertices that no frame shows at the outline, then smooth everything that may move.
  const UniformLaplacian graph(capture.rig.mesh.triangles, static_cast<int>(movable.size()));
  for (int pass = 0; pass < kSpreadIterations + kSmoothIterations; ++pass) {
    next = offset;
    for (size_t v = 0; v < movable.size(); ++v) {
      const auto around = graph.neighbours(static_cast<int>(v));
      if (!movable[v] || around.empty() || (known[v] && pass < kSpreadIterations)) continue;
      float sum = 0;
      for (int u : around) sum += offset[u];
      next[v] = sum / static_cast<float>(around.size());
    }
    offset.swap(next);
  }
  return offset;
}

void apply_offsets(const Mesh& mesh, const std::vector<float>& offsets, RigShape& shape) {
  const auto normals = vertex_normals(shape.rest, mesh.triangles);
  for (size_t v = 0; v < offsets.size(); ++v)
    for (size_t c = 0; c < 3; ++c) shape.rest[3 * v + c] += offsets[v] * normals[3 * v + c];
}

}  // namespace effigy
